"""The reward of motion as it is played: what it learns where motion follows the sound, and that it learns nothing where
it does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from test_infer import babble
from torch import Tensor

from data_module.speech.audio import as_speech
from eval.baselines.interpreters import Majority, Random, ReplayInterpreter
from eval.renderings import TEST, AcceptanceVoice, BundleSystem, KeptRenderings
from eval.runner.played import MAJORITY, PERFORMER, REPLAYED, FurtherPolicy, PlayedVoice, VoicePlayer
from eval.runner.played_reward import (
    PlayedScores,
    PlayedWindows,
    found,
    margins,
    scored,
    train,
    whole_windows,
)
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.config import FitSettings
from gesticulator.pipeline import Gesticulator
from interpreters.base import LexemeInterpreter
from interpreters.reward import RewardModel
from interpreters.reward_table import RewardTable
from interpreters.settings import RewardConfig

FRAMES, MOTION, AUDIO, BLOCKS = 4, 3, 2, 60
RIVAL = "other"
CONFIG = RewardConfig(width=16, projection=8, window=4, shortest=4, longest=6, dilations=(1, 2), rivals=2, speeds=True,
                      members=2, dropout=0.0)


def moved(level: np.ndarray, rng: np.random.Generator) -> Tensor:
    """[N, K, D] motion of this size in each block, in directions of its own."""
    steps = rng.standard_normal((len(level), FRAMES, MOTION)) * np.exp(level)[:, None, None]
    return torch.as_tensor(0.3 * steps.cumsum(1), dtype=torch.float32)


def planted(number: int, strength: float) -> PlayedVoice:
    """The performer's speed follows loudness with this strength; a rival's follows nothing, and has the same spread."""
    rng = np.random.default_rng([7, number])
    loud, free, other = rng.standard_normal((3, BLOCKS))
    level = strength * loud + np.sqrt(1 - strength ** 2) * free
    audio = np.repeat(loud[:, None, None], FRAMES, 1) + 0.1 * rng.standard_normal((BLOCKS, FRAMES, AUDIO))
    own = moved(level, rng)
    return PlayedVoice(str(number), str(number), torch.as_tensor(audio, dtype=torch.float32),
                       np.zeros(BLOCKS, dtype=bool), torch.as_tensor(rng.normal(-1, 0.2, BLOCKS)).float(),
                       {PERFORMER: own, REPLAYED: own, RIVAL: moved(other, rng)})


def taught(strength: float) -> tuple[PlayedScores, dict[str, float]]:
    """What a reward that was trained on twenty voices says of twenty others."""
    learn, test = ([planted(k, strength) for k in span] for span in (range(20), range(20, 40)))
    model = train(PlayedWindows(learn, CONFIG, (REPLAYED,), (RIVAL,)),
                  FitSettings(steps=160, batch=32, rate=3e-3, schedule="cosine"), 1, progress=False)
    hits = found(model, test, REPLAYED)
    return scored(model, test, (REPLAYED, RIVAL)), {name: value.mean for name, value in hits.items()}


def test_where_motion_follows_the_sound_the_performer_wins_and_finds_it() -> None:
    scores, hits = taught(1.0)
    margin = margins(scores, (RIVAL,), [str(k) for k in range(20)])[RIVAL]
    assert margin.low > 0.1 and hits["times"] > 3
    gain = scores.own(REPLAYED) - scores.own(RIVAL)
    assert gain.mean() > 0.5 * margin.mean, "it is the sound of the moment that tells"


def test_where_it_follows_nothing_the_performer_does_not_win() -> None:
    scores, hits = taught(0.0)
    margin = margins(scores, (RIVAL,), [str(k) for k in range(20)])[RIVAL]
    assert margin.low <= 0 or margin.mean < 0.02
    assert hits["times"] < 2


def test_the_reward_follows_the_strength_that_was_planted() -> None:
    group = [str(k) for k in range(20)]
    gains, times = [], []
    for strength in (0.0, 0.5, 1.0):
        scores, hits = taught(strength)
        gains.append(margins(scores, (RIVAL,), group)[RIVAL])
        times.append(hits["times"])
    assert gains[0].high < gains[1].low and gains[1].high < gains[2].low, "margins over a rival"
    assert times == sorted(times), "windows found"


def test_the_parts_of_a_score_add_up_and_silent_windows_are_left_out() -> None:
    voice = planted(0, 1.0)
    voice.silent[:10] = True
    assert len(whole_windows(voice, 4)) == BLOCKS - 3 - 7
    assert len(whole_windows(voice, BLOCKS + 1)) == 0
    scores = PlayedScores({PERFORMER: np.array([0.7, 0.5])}, {PERFORMER: np.array([0.6, 0.5])})
    np.testing.assert_allclose(scores.own(PERFORMER), [0.1, 0.0])


def test_rivals_are_on_the_same_sound_and_only_beside_played_motion() -> None:
    voices = [planted(k, 1.0) for k in range(4)]
    both = PlayedWindows(voices, CONFIG, (PERFORMER, REPLAYED), (RIVAL,))
    kinds = {bool(batch["rivalled"].any()): batch for batch in (
        both.sample(np.random.default_rng(k), 16) for k in range(12))}
    assert "rival" not in kinds[False] and kinds[True]["rival"].shape == (16, 2, 6, FRAMES, MOTION)
    row, valid = kinds[True]["rival"][3, 0], kinds[True]["valid"][3].bool()
    assert any(torch.equal(voice.motions[RIVAL][start:start + int(valid.sum())], row[valid])
               for voice in voices for start in range(BLOCKS) if start + int(valid.sum()) <= BLOCKS)


# Lexemes that are known beforehand


def test_a_replay_goes_on_where_the_generator_begins_anew() -> None:
    replay = ReplayInterpreter([np.array([3, 1, 2]), np.array([0])], 5)
    out = []
    for restarts in (True, True, False, True):
        if restarts:
            replay.start(0, 0)
        out.append(int(replay.step(None, None, 0)[0].argmax()))  # type: ignore[arg-type]
    assert out == [3, 1, 2, 0], "a start within a sequence continues it, one after its end begins the next"


def test_what_is_replayed_is_played_by_the_shipped_bundle() -> None:
    bundle = bundles.load(bundles.SHIPPED)
    assert bundle.config.system == "movement", "its generator starts interpreters again within a recording"
    system, speech = Gesticulator(bundle), babble(8.0)
    count = len(system.encode_speech(as_speech(speech, 16000)).blocks.silent)
    wanted = np.random.default_rng(3).integers(len(bundle.vectors), size=count)
    made = system(speech, 16000, interpreter=ReplayInterpreter([wanted], len(bundle.vectors)), temperature=0.0)
    silent = made.blocks.silent
    spoken = ~(silent | np.append(silent[1:], False))  # rest is a rule, which chooses for itself
    assert spoken.sum() > 10
    np.testing.assert_array_equal(made.lexemes[spoken], wanted[spoken])


def test_a_policy_of_no_bundle_is_played_and_kept_by_what_it_is(tmp_path: Path) -> None:
    ours = BundleSystem("ours", bundles.SHIPPED, KeptRenderings(None))
    sound = as_speech(babble(4.0), 16000)
    own = ours.perform(AcceptanceVoice("babble", sound, TEST), 0)[0].motion
    voice = AcceptanceVoice("babble", sound, TEST, own)
    size = len(ours.bundle.vectors)

    def policy(interpreter: LexemeInterpreter, key: str) -> FurtherPolicy:
        return FurtherPolicy(interpreter, 1.0, key)

    further = {"always": policy(Majority(ours.bundle), "always"), "any": policy(Random(size), "any")}
    player = VoicePlayer(ours, tmp_path, further)
    made = player.play(voice, 3, (MAJORITY, "always", "any"), {}).motions
    torch.testing.assert_close(made["always"], made[MAJORITY])
    assert not torch.equal(made["any"], made["always"])
    files = sorted(tmp_path.iterdir())
    assert len(files) == 3, "each is kept by itself"
    player.further["always"] = further["any"]
    assert torch.equal(player.play(voice, 3, ("always",), {}).motions["always"], made["any"])
    assert sorted(tmp_path.iterdir()) == files, "what was kept is what it is, whatever it is called"


# Speeds in the reward model


def model(**changes: object) -> RewardModel:
    torch.manual_seed(0)
    return RewardModel(RewardConfig(width=8, projection=4, window=3, **changes), FRAMES, MOTION, AUDIO).eval()  # type: ignore[arg-type]


def drawn(*shape: int) -> Tensor:
    return torch.as_tensor(np.random.default_rng(len(shape)).standard_normal(shape), dtype=torch.float32)


def test_speeds_are_per_second_and_zero_for_a_pose_of_any_duration() -> None:
    net = model(speeds=True)
    times = torch.tensor([-2.0, 0.0, 1.0])
    assert torch.equal(net.speeds(torch.ones(3, FRAMES, MOTION), times), torch.zeros(3, 3 * MOTION))
    line = torch.arange(FRAMES).float()[:, None].expand(FRAMES, MOTION)
    once, half = net.speeds(line, torch.tensor(0.0)), net.speeds(line, torch.tensor(np.log(0.5)).float())
    assert once[0] == pytest.approx(np.log1p((FRAMES - 1) / 0.3)), "three steps of 1 in a second"
    assert half[0] == pytest.approx(np.log1p(2 * (FRAMES - 1) / 0.3), rel=1e-5)
    torch.testing.assert_close(net.speeds(line.flip(0), torch.tensor(0.0)), once)


def test_without_the_setting_the_published_encoder_stays() -> None:
    plain = model()
    assert plain.read_speeds is None and not any("speeds" in name for name in plain.state_dict())
    motion = drawn(2, FRAMES, MOTION)
    assert torch.equal(plain.block_motion(motion, torch.zeros(2)), plain.read_motion(motion.flatten(-2)))


@pytest.mark.parametrize("in_context", [False, True])
def test_the_table_of_a_reward_with_speeds_agrees_with_whole_windows(in_context: bool) -> None:
    net, lexemes = model(speeds=True), drawn(5, FRAMES, MOTION)
    audio, times = drawn(20, FRAMES, AUDIO), 0.3 * drawn(20)
    fixed = drawn(20, FRAMES, MOTION) if in_context else torch.zeros(20, FRAMES, MOTION)
    table = RewardTable(net, audio, times, lexemes,
                        bases=(lambda chosen, blocks, valid: fixed[blocks]) if in_context else None)
    chosen, blocks = torch.tensor([0, 3, 1, 4]), torch.tensor([4, 5, 6, 7])
    every = table.sequence_every(chosen, blocks)
    motion = fixed[blocks[1:]] + lexemes[chosen[1:]]
    want = net.window_rewards(motion[None], times[blocks[1:]][None], audio[blocks[1:]][None], torch.ones(1, 3))
    assert float(every[3, 4]) == pytest.approx(float(want), abs=1e-5)
    torch.testing.assert_close(table.sequence(chosen, blocks), every.gather(1, chosen[:, None])[:, 0])
