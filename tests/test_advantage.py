"""The policy of behaviour and advantage: known answers of its formulas, and what its critics can learn."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from learning import learn
from numpy.typing import NDArray
from runners import played_critics
from torch import Tensor

from gesticulator.training.stages.advantage import CounterfactualRewards, discounted, gains
from interpreters.advantage import Critics, CriticValues, advantages
from interpreters.advantage_run import AdvantageInterpreter
from interpreters.base import BlockFeatures, Scores, select
from interpreters.reward import RewardConfig, RewardModel
from interpreters.reward_table import EnsembleReward, RewardTable
from interpreters.settings import CriticConfig

FRAMES, AUDIO, SIZE, SPEAKERS = 3, 4, 5, 2
SMALL = CriticConfig(width=16, heads=2, layers=1, decisions=4, audio_features=8, audio_bottleneck=0)


@dataclass(frozen=True)
class Always:
    """A behaviour policy that says the same of every block."""

    scores: NDArray[np.float64]

    def start(self, speaker: int, first_lexeme: int) -> int:
        return 0

    def step(self, state: int, features: BlockFeatures, previous_lexeme: int) -> tuple[Scores, int]:
        return self.scores, state + 1


def critics(seed: int = 0, config: CriticConfig = SMALL) -> Critics:
    torch.manual_seed(seed)
    model = Critics(config, FRAMES, AUDIO, SIZE, SPEAKERS).eval()
    with torch.no_grad():
        for head in (model.reward, model.future):
            head.weight.normal_(0.0, 0.5)
    return model


def heard(seed: int = 0) -> BlockFeatures:
    window = torch.randn(3 * FRAMES, AUDIO, generator=torch.Generator().manual_seed(seed)).numpy()
    return BlockFeatures(window, window)


def prior() -> NDArray[np.float64]:
    return np.log(np.array([0.4, 0.3, 0.15, 0.1, 0.05]))


# ------------------------------------------------------------------------------------------------ the formulas

def test_the_advantage_of_one_critic_is_q_less_its_mean_under_the_behaviour() -> None:
    q = torch.tensor([[1.0, 3.0, -2.0]])
    log_prior = torch.log(torch.tensor([0.5, 0.25, 0.25]))
    torch.testing.assert_close(advantages(q, log_prior), torch.tensor([1.0, 3.0, -2.0]) - 0.75)


def test_q_is_the_reward_and_the_discounted_future() -> None:
    q = CriticValues(torch.tensor([[1.0, 2.0]]), torch.tensor([[10.0, -10.0]]), torch.zeros(1)).q()
    torch.testing.assert_close(q, torch.tensor([[10.0, -7.0]]), msg="0.9 of what comes later")


def test_the_least_of_the_critics_is_taken_lexeme_by_lexeme() -> None:
    """Of three lexemes alike to the behaviour, A is (-2, -1, 3) and (-2, 2, 0): the least (-2, -1, 0) has mean -1."""
    q = torch.tensor([[0.0, 1.0, 5.0], [0.0, 4.0, 2.0]])
    torch.testing.assert_close(advantages(q, torch.zeros(3)), torch.tensor([-1.0, 0.0, 1.0]))


def test_beta_0_is_the_behaviour_policy_to_the_last_bit() -> None:
    system = AdvantageInterpreter(Always(prior()), played_critics(critics()), 3.0).steered(0.0, 0.7)
    scores, _ = system.step(system.start(0, 1), heard(), 1)
    np.testing.assert_array_equal(scores, prior())


@pytest.mark.parametrize("temperature", [1.0, 0.7, 2.0])
@pytest.mark.parametrize("beta", [0.5, 2.0])
def test_the_policy_is_the_tempered_prior_times_exp_beta_advantage(beta: float, temperature: float) -> None:
    plain = AdvantageInterpreter(Always(prior()), played_critics(critics()))
    # Up to a constant, which no policy feels.
    advantage = plain.step(plain.start(0, 1), heard(), 1)[0] - prior()
    system = plain.steered(beta, temperature)
    scores, _ = system.step(system.start(0, 1), heard(), 1)
    weights = np.exp(prior()) ** (1 / temperature) * np.exp(beta * advantage)
    tempered = np.exp(scores / temperature)
    np.testing.assert_allclose(tempered / tempered.sum(), weights / weights.sum(), rtol=1e-9)
    drawn = np.bincount([select(scores, temperature=temperature, rng=np.random.default_rng(seed))
                         for seed in range(2000)], minlength=SIZE) / 2000
    np.testing.assert_allclose(drawn, weights / weights.sum(), atol=0.05)


def test_at_temperature_0_the_best_of_the_policy_is_taken() -> None:
    one, none = (AdvantageInterpreter(Always(prior()), played_critics(critics())).steered(2.0, t) for t in (1.0, 0.0))
    np.testing.assert_array_equal(one.step(one.start(0, 1), heard(), 1)[0], none.step(none.start(0, 1), heard(), 1)[0])


# ------------------------------------------------------------------------------------------- counterfactual rewards

def test_returns_are_discounted() -> None:
    np.testing.assert_allclose(discounted(np.array([1.0, 2.0, 4.0], np.float32), 0.5), [3.0, 4.0, 4.0])


def table() -> EnsembleReward:
    torch.manual_seed(4)
    models = [RewardModel(RewardConfig(width=8, projection=6, window=3, longest=4), FRAMES, 6, AUDIO).eval()
              for _ in range(2)]
    generator = torch.Generator().manual_seed(5)
    audio, motion = (torch.randn(*shape, generator=generator) for shape in ((12, FRAMES, AUDIO), (SIZE, FRAMES, 6)))
    return EnsembleReward([RewardTable(model, audio, motion) for model in models], 0.5)


@pytest.mark.parametrize("at", [1, 6, 10, 11])
def test_what_a_swap_gains_is_the_difference_of_the_two_sequences(at: int) -> None:
    rewards, gamma = table(), 0.7
    actions, blocks = torch.as_tensor(np.random.default_rng(1).integers(SIZE, size=12)), torch.arange(12)
    got = gains(rewards, actions, blocks, np.array([at]), np.arange(SIZE)[None], gamma)[0]
    for lexeme in range(SIZE):
        other = actions.clone()
        other[at] = lexeme
        more = (rewards.sequence(other, blocks) - rewards.sequence(actions, blocks))[at + 1:]
        assert got[lexeme] == pytest.approx(sum(gamma ** i * float(m) for i, m in enumerate(more)), abs=1e-5)
    assert got[int(actions[at])] == pytest.approx(0, abs=1e-6)


def data(seed: int = 0, count: int = 400) -> tuple[CounterfactualRewards, Tensor]:
    """Decisions whose reward is a known function of audio and lexeme, and the audio of their blocks."""
    rng = np.random.default_rng(seed)
    audio = torch.as_tensor(rng.standard_normal((count, 3 * FRAMES, AUDIO))).float()
    told = audio[:, FRAMES:2 * FRAMES].mean((1, 2)).numpy() * 3
    liked = np.linspace(-1, 1, SIZE)
    every = (told[:, None] * liked).astype(np.float32)
    action, swap = rng.integers(SIZE, size=count), rng.integers(SIZE, size=(count, 3))
    gained = (0.5 * (liked[swap] - liked[action][:, None])).astype(np.float32)
    gained[::2] = np.nan
    earned = every[np.arange(count), action]
    return CounterfactualRewards(
        np.array([count // 2, count // 2]), np.array([0, 1]), np.arange(count), action,
        np.roll(action, 1), np.zeros(count, bool), every, np.full((count, SIZE), -np.log(SIZE), np.float32), swap,
        gained, discounted(earned, 0.8)), audio


def batch_of(known: CounterfactualRewards, audio: Tensor, rng: np.random.Generator, count: int) -> dict[str, Tensor]:
    """Windows of four decisions with what is heard in them; every critic has heard their recordings."""
    windows = known.windows(rng, count, 4)
    return {**windows, "audio": audio[windows["block"]], "heard": torch.ones(count, 2),
            "speaker": torch.nn.functional.one_hot(windows["speaker"], SPEAKERS).float()}


def test_critics_learn_what_lexemes_earn_now_and_later() -> None:
    known, audio = data()
    model = critics()
    rng = np.random.default_rng(2)

    def loss(step: int) -> Tensor:
        terms = model.losses(batch_of(known, audio, rng, 16), step / 250)
        return sum((model.weights[key] * value for key, value in terms.items()), torch.zeros(()))

    learn(model, loss, 250, 3e-3)
    asked = batch_of(known, audio, rng, 32)
    found = model.values(asked["previous"], asked["audio"], asked["speaker"], asked["silent"])
    learned, true = (value - value.mean(-1, keepdim=True) for value in (found.reward.mean(-2), asked["every"]))
    assert float(torch.cosine_similarity(learned.detach(), true, dim=-1).mean()) > 0.8
    liked = torch.linspace(-1, 1, SIZE)
    later = found.future.mean(-2)
    later = later - later.mean(-1, keepdim=True)
    assert float((later - 0.5 * liked).abs().mean()) < 0.15
    assert float(model.spread) > 0.2


def test_what_a_state_earns_whatever_is_done_is_not_the_rewards_to_learn() -> None:
    batch = batch_of(*data(), np.random.default_rng(0), 8)
    model = critics()
    with torch.no_grad():
        plain = model.losses(batch)["reward"]
        more = model.losses({**batch, "every": batch["every"] + 40 * torch.randn(8, 4, 1)})["reward"]
    torch.testing.assert_close(plain, more, atol=1e-3, rtol=1e-3)


def test_a_critic_learns_from_its_own_recordings_alone() -> None:
    model, batch = critics(), batch_of(*data(), np.random.default_rng(0), 8)
    batch["heard"][:, 0] = 0
    terms = model.losses(batch)
    sum(terms.values()).backward()
    own = model.reward.weight.grad.unflatten(0, (2, SIZE))
    assert float(own[0].abs().max()) == 0 < float(own[1].abs().max())
