"""The Q-network sees what it may and no more; conservative Q-learning does what its equations say."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
from runners import played_q
from torch import Tensor
from torch.nn import functional

from interpreters.base import BlockFeatures, LexemeInterpreter, select
from interpreters.cql import ConservativeQ, DecisionBatch, QConfig, QNetwork, conservative_q_loss, data_nll
from interpreters.transformer import two_stream_mask

FRAMES, AUDIO, SIZE, SPEAKERS, WINDOW = 3, 2, 5, 2, 6
SMALL = QConfig(width=16, heads=2, layers=2, decisions=WINDOW, audio_features=4, audio_bottleneck=0)
SILENT = (1, 3)


def network(silent: tuple[int, ...] = SILENT, seed: int = 0, **changes: object) -> QNetwork:
    """A network whose weights are large enough for what it hears to matter."""
    torch.manual_seed(seed)
    net = QNetwork(replace(SMALL, **changes), FRAMES, AUDIO, SIZE, SPEAKERS, silent)  # type: ignore[arg-type]
    for parameter in net.parameters():
        parameter.data.mul_(8.0 if parameter.dim() > 1 else 1.0)
    return net.eval()


def heard(steps: int, count: int = 1, seed: int = 0) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """previous, audio, speaker and silent for `count` takes of `steps` decisions."""
    draw = torch.Generator().manual_seed(seed)
    return (torch.randint(SIZE, (count, steps), generator=draw),
            torch.randn(count, steps, 3 * FRAMES, AUDIO, generator=draw),
            functional.one_hot(torch.arange(count) % SPEAKERS, SPEAKERS).float(),
            torch.rand(count, steps, generator=draw) < 0.3)


def windows(count: int = 4, steps: int = WINDOW, seed: int = 0) -> dict[str, Tensor]:
    """A batch of `count` windows of `steps` decisions and the one after them; silent blocks hold silent lexemes."""
    previous, audio, speaker, silent = heard(steps + 1, count, seed)
    draw = torch.Generator().manual_seed(seed + 1)
    action = torch.randint(SIZE, (count, steps + 1), generator=draw)
    action = torch.where(silent, torch.full_like(action, SILENT[0]), action)
    return {"previous": previous, "audio": audio, "speaker": speaker, "silent": silent, "action": action,
            "reward": torch.rand(count, steps + 1, generator=draw) * 2 - 1,
            "terminal": torch.zeros(count, steps + 1, dtype=torch.bool), "valid": torch.ones(count, steps + 1),
            "cloned": torch.ones(count, steps + 1)}


def says_always(net: QNetwork, values: list[float]) -> None:
    """Give the network the same Q values in every state."""
    with torch.no_grad():
        net.head[1].weight.zero_()
        net.head[1].bias.copy_(torch.tensor(values))


def stream(net: LexemeInterpreter, previous: Tensor, audio: Tensor, silent: Tensor, speaker: int = 0) -> np.ndarray:
    """Scores [M, S] of a take, block by block."""
    runner, out = played_q(net), []
    state = runner.start(speaker, int(previous[0]))
    for action, window, quiet in zip(previous, audio.numpy(), silent, strict=True):
        scores, state = runner.step(state, BlockFeatures(np.zeros_like(window), window, bool(quiet)), int(action))
        out.append(scores)
    return np.stack(out)


# ---- what a decision sees


def test_mask_repeats_a_lower_triangle_two_by_two() -> None:
    expected = np.tile(np.tril(np.ones((4, 4))), (2, 2))
    mask = two_stream_mask(4)
    np.testing.assert_array_equal(torch.exp(mask).numpy(), expected)
    assert set(mask.flatten().tolist()) == {0.0, -torch.inf}


@pytest.mark.parametrize("at", range(WINDOW))
def test_a_decision_sees_its_own_audio_and_the_action_before_it_and_nothing_later(at: int) -> None:
    net = network()
    previous, audio, speaker, silent = heard(WINDOW)
    base = net.values(previous, audio, speaker, silent)
    other_action, other_audio, other_silent = previous.clone(), audio.clone(), silent.clone()
    other_action[0, at] = (previous[0, at] + 1) % SIZE
    other_audio[0, at] += 1.0
    other_silent[0, at] ^= True
    for changed in ((other_action, audio, speaker, silent), (previous, other_audio, speaker, silent),
                    (previous, audio, speaker, other_silent)):
        moved = (net.values(*changed) - base).abs().amax(dim=(0, 2)).detach()
        assert float(moved[:at].sum()) < 1e-6
        assert (moved[at:] > 1e-5).all(), "the decision itself and all later ones hear it"


def test_all_of_the_window_of_audio_is_heard_and_the_speaker_when_asked_for() -> None:
    previous, audio, speaker, silent = heard(2)
    for row in range(3 * FRAMES):
        other = audio.clone()
        other[0, 1, row] += 1.0
        net = network()
        base, moved = (net.values(previous, heard_now, speaker, silent) for heard_now in (audio, other))
        assert not torch.allclose(base, moved)
    for use in (True, False):
        net = network(use_speaker=use)
        one, another = (net.values(previous, audio, who, silent) for who in (speaker, speaker.flip(1)))
        assert torch.equal(one, another) != use


def test_a_stream_equals_the_sliding_window_far_past_its_length() -> None:
    net = network()
    previous, audio, _, silent = heard(40)
    speaker = torch.tensor([[0.0, 1.0]])
    streamed = stream(net, previous[0], audio[0], silent[0], speaker=1)
    offline = net.values(previous, audio, speaker, silent)[0].detach().numpy()
    np.testing.assert_allclose(streamed, offline, atol=1e-5)
    for last in range(40):
        part = slice(max(0, last + 1 - WINDOW), last + 1)
        alone = net.values(previous[:, part], audio[:, part], speaker, silent[:, part])[0, -1]
        np.testing.assert_allclose(streamed[last], alone.detach().numpy(), atol=1e-5)


@pytest.mark.parametrize("size", [50, 512])
def test_the_network_of_the_paper_has_86_million_weights(size: int) -> None:
    with torch.device("meta"):
        config = QConfig(width=768, heads=12, layers=12, decisions=15)
        net = QNetwork(config, 8, 129, size, 1, (0,))
    assert 85.5e6 < sum(weights.numel() for weights in net.parameters()) < 87.5e6
    assert tuple(net.positions.shape) == (2, 15, 768)


# ---- the silent mask


def test_the_set_of_actions_is_never_empty() -> None:
    silent = torch.tensor([[True, False]])
    assert network(()).allowed(silent).all()
    allowed = network().allowed(silent)
    assert allowed[0, 0].nonzero().flatten().tolist() == list(SILENT) and allowed[0, 1].all()
    torch.testing.assert_close(network().allowed(silent.float()), allowed)  # a flag may come as a number


def test_masked_actions_are_never_chosen_never_summed_and_never_bootstrapped() -> None:
    net = network(double=False)
    says_always(net, [9.0, 1.0, 8.0, 2.0, 7.0])  # the best by far are not silent
    learner = ConservativeQ(net)
    batch = windows()
    batch["silent"] = torch.ones_like(batch["silent"])
    batch["action"] = torch.full_like(batch["action"], 1)
    values = net.values(batch["previous"], batch["audio"], batch["speaker"], batch["silent"])
    assert (net.choose(values, batch["silent"]) == 3).all()
    assert int(select(values[0, 0].detach().double().numpy(), allowed=np.array(SILENT))) == 3
    torch.testing.assert_close(learner.next_values(batch), torch.full((4, WINDOW), 2.0))
    summed = learner.losses(batch)["conservative"]
    torch.testing.assert_close(summed, torch.logsumexp(torch.tensor([1.0, 2.0]), 0) - 1.0)
    for double in (True, False):
        net = network(double=double)
        learner, batch = ConservativeQ(net), windows(seed=3)
        before = learner.losses(batch)
        barred = ~net.allowed(batch["silent"])
        original = QNetwork.values

        def raised(self: QNetwork, *arguments: Tensor, barred: Tensor = barred, original: object = original) -> Tensor:
            out = original(self, *arguments)  # type: ignore[operator]
            return out + 100.0 * barred[:, :out.shape[1]]

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(QNetwork, "values", raised)
            after = learner.losses(batch)
        for key in before:
            torch.testing.assert_close(before[key], after[key])


def test_an_action_outside_its_set_is_not_pushed_up_for_ever() -> None:
    values = torch.zeros(1, 2, SIZE, requires_grad=True)
    allowed = torch.ones(1, 2, SIZE, dtype=torch.bool)
    allowed[0, 0, 2] = False
    each = data_nll(values, torch.tensor([[2, 2]]), allowed)
    each.sum().backward()
    assert values.grad is not None and not values.grad[0, 0].any() and values.grad[0, 1].any()


# ---- the loss


def test_alone_the_conservative_term_is_cross_entropy() -> None:
    batch = windows(count=6)
    batch["valid"][0, 3:] = 0
    ours, theirs = ConservativeQ(network(temporal=0.0)), network(temporal=0.0)
    assert ours.weights == {"conservative": 0.1}
    ours.losses(batch)["conservative"].backward()
    part = slice(0, WINDOW)
    logits = theirs.values(batch["previous"][:, part], batch["audio"][:, part], batch["speaker"],
                           batch["silent"][:, part])
    logits = logits.masked_fill(~theirs.allowed(batch["silent"][:, part]), -torch.inf)
    each = functional.cross_entropy(logits.flatten(0, 1), batch["action"][:, part].flatten(), reduction="none")
    each[batch["valid"][:, part].flatten() > 0].mean().backward()
    for (name, own), other in zip(ours.online.named_parameters(), theirs.parameters(), strict=True):
        assert own.grad is not None and other.grad is not None, name
        torch.testing.assert_close(own.grad, other.grad, atol=1e-6, rtol=1e-4, msg=name)


def by_hand(**changes: Tensor) -> tuple[Tensor, Tensor]:
    """Two steps of two actions: Q = (1, 3) and (0, 2), actions 0 and 1, rewards 1 and 0.5, V(s') = 4 and 8."""
    given = {"valid": torch.ones(1, 2), "known": torch.ones(1, 2), "cloned": torch.ones(1, 2),
             "terminal": torch.tensor([[False, True]]), **changes}
    return conservative_q_loss(torch.tensor([[[1.0, 3.0], [0.0, 2.0]]]), torch.tensor([[4.0, 8.0]]),
                               DecisionBatch(torch.tensor([[0, 1]]), torch.tensor([[1.0, 0.5]]), given["terminal"],
                                         torch.ones(1, 2, 2, dtype=torch.bool), given["valid"], given["known"],
                                         given["cloned"]), 0.5)


def test_the_two_terms_by_hand() -> None:
    near, far = np.log(1 + np.exp(2.0)), np.log(1 + np.exp(-2.0))  # log-sum-exp less the action's own value
    conservative, difference = by_hand()
    assert float(conservative) == pytest.approx((near + far) / 2)
    # y = 1 + 0.5 x 4 = 3 against Q = 1; the second ends the take: y = 0.5 against Q = 2.
    assert float(difference) == pytest.approx((0.5 * 4 + 0.5 * 2.25) / 2)
    # Not an end: y = 0.5 + 0.5 x 8 = 4.5 against Q = 2.
    assert float(by_hand(terminal=torch.tensor([[False, False]]))[1]) == pytest.approx((0.5 * 4 + 0.5 * 6.25) / 2)


def test_the_end_of_a_take_is_not_bootstrapped_and_a_cut_is() -> None:
    net = network(double=False, gamma=0.5)
    says_always(net, [0.0] * SIZE)
    learner = ConservativeQ(net)
    says_always(learner.target, [0.0, 1.0, 2.0, 1.5, 4.0])
    batch = windows(count=1)
    batch["silent"] = torch.zeros_like(batch["silent"])
    batch["reward"] = torch.ones_like(batch["reward"])
    # y = 1 + 0.5 x 4 = 3 at all of the steps, the last one too: the window is only a cut.
    assert float(learner.losses(batch)["temporal_difference"]) == pytest.approx(0.5 * 9)
    batch["terminal"][0, WINDOW - 1] = True
    assert float(learner.losses(batch)["temporal_difference"]) == pytest.approx(0.5 * (9 * (WINDOW - 1) + 1) / WINDOW)
    # In silence only 1 and 3 are there to go on with: y = 1 + 0.5 x 1.5.
    batch["terminal"][:] = False
    batch["silent"][:] = True
    assert float(learner.losses(batch)["temporal_difference"]) == pytest.approx(0.5 * 1.75 ** 2)


def test_padding_is_never_bootstrapped_from_and_never_matters() -> None:
    learner = ConservativeQ(network())
    batch = windows(count=3)
    batch["valid"][0, 3:] = 0
    batch["terminal"][0, 2] = True
    batch["valid"][1, WINDOW] = 0  # cut where nothing is known of what follows
    before = learner.losses(batch)
    for key in ("audio", "reward"):
        batch[key][0, 3:] += 50.0
        batch[key][1, WINDOW] -= 50.0
    batch["action"][0, 3:] = 0
    after = learner.losses(batch)
    for key in before:
        torch.testing.assert_close(before[key], after[key])


def test_double_learning_by_hand() -> None:
    batch = windows(count=1)
    batch["silent"] = torch.zeros_like(batch["silent"])
    for double, expected in ((True, 2.0), (False, 7.0)):
        net = network(double=double)
        says_always(net, [0.0, 1.0, 5.0, 1.0, 0.0])
        learner = ConservativeQ(net)
        says_always(learner.target, [7.0, 1.0, 2.0, 1.0, 0.0])  # its own best is 0; the online network picks 2
        torch.testing.assert_close(learner.next_values(batch), torch.full((1, WINDOW), expected))


# ---- the target network


def test_the_target_is_copied_when_its_time_has_come() -> None:
    learner = ConservativeQ(network(copy_every=3))

    def same() -> bool:
        pairs = zip(learner.online.parameters(), learner.target.parameters(), strict=True)
        return all(torch.equal(a, b) for a, b in pairs)

    seen = []
    for step in range(7):
        with torch.no_grad():
            learner.online.positions.add_(1.0)
        learner.before_step(step)
        seen.append(same())
    assert seen == [True, False, False, True, False, False, True]
    learner.online.positions.data.add_(1.0)
    learner.copy_target()
    assert same()
    assert not any(a is b for a, b in zip(learner.online.parameters(), learner.target.parameters(), strict=True))


# ---- does it learn


HORIZON, CHOICES, DISCOUNT = 4, 3, 0.9


def reward_of(tone: int, before: int, action: int) -> float:
    """0 pays at once, 1 pays nothing but makes 2 pay well next, 2 pays on a high tone alone and after a 1."""
    return {0: 0.3, 1: 0.0, 2: 1.0 if tone and before == 1 else -0.2}[action]


def best_actions() -> dict[tuple[int, int, int], int]:
    """The optimal policy by dynamic programming: (step, tone, action before) to action. Tones alternate."""
    ahead = {(tone, before): 0.0 for tone in (0, 1) for before in range(CHOICES)}
    policy = {}
    for step in reversed(range(HORIZON)):
        now = {}
        for tone, before in itertools.product((0, 1), range(CHOICES)):
            worth = [reward_of(tone, before, a) + DISCOUNT * ahead[1 - tone, a] for a in range(CHOICES)]
            policy[step, tone, before] = int(np.argmax(worth))
            now[tone, before] = max(worth)
        ahead = now
    return policy


def takes(rng: np.random.Generator, count: int) -> dict[str, Tensor]:
    """Whole takes of a behaviour that chooses at random, and a padding step to bootstrap from (never used)."""
    previous = rng.integers(CHOICES, size=(count, HORIZON + 1))
    action = np.roll(previous, -1, axis=1)
    tone = (rng.integers(2, size=(count, 1)) + np.arange(HORIZON + 1)) % 2
    reward = np.vectorize(reward_of)(tone, previous, action)
    audio = torch.from_numpy(tone[..., None, None].repeat(3 * FRAMES, 2)).float().expand(-1, -1, -1, AUDIO)
    last = np.arange(HORIZON + 1)
    return {"previous": torch.from_numpy(previous), "action": torch.from_numpy(action), "audio": audio,
            "reward": torch.from_numpy(reward).float(), "speaker": torch.ones(count, 1),
            "silent": torch.zeros(count, HORIZON + 1, dtype=torch.bool), "cloned": torch.ones(count, HORIZON + 1),
            "terminal": torch.from_numpy(np.broadcast_to(last == HORIZON - 1, action.shape).copy()),
            "valid": torch.from_numpy(np.broadcast_to(last < HORIZON, action.shape).copy()).float()}


def test_a_small_problem_is_solved_and_cloning_alone_does_not_solve_it() -> None:
    policy, disagreements = best_actions(), {}
    for temporal, conservative in ((1.0, 0.02), (0.0, 1.0)):
        torch.manual_seed(0)
        config = replace(SMALL, decisions=HORIZON, gamma=DISCOUNT, copy_every=40, temporal=temporal,
                         conservative=conservative)
        learner = ConservativeQ(QNetwork(config, FRAMES, AUDIO, CHOICES, 1))
        learner.eval()  # without dropout the answer is exact
        optimiser = torch.optim.Adam(learner.online.parameters(), 3e-3)
        for step in range(400):
            learner.before_step(step)
            optimiser.zero_grad()
            terms = learner.losses(takes(np.random.default_rng([7, step]), 64))
            sum((learner.weights[key] * term for key, term in terms.items()), start=torch.zeros(())).backward()
            optimiser.step()
        check = takes(np.random.default_rng(99), 200)
        values = learner.online.values(check["previous"], check["audio"], check["speaker"], check["silent"])
        chosen = learner.online.choose(values, check["silent"])[:, :HORIZON]
        best = torch.tensor([[policy[i, int(check["audio"][b, i, 0, 0]), int(check["previous"][b, i])]
                              for i in range(HORIZON)] for b in range(200)])
        disagreements[temporal] = float((chosen != best).float().mean())
    assert len(set(policy.values())) == CHOICES, "the problem needs every action"
    assert disagreements[1.0] == 0 and disagreements[0.0] > 0.3
