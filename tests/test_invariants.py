"""Invariants of the whole that no test of a single module would see fail."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from performances import RATE, babble
from untrained import PLAIN, untrained

from data_module.layers import freeze
from data_module.motion import rotation
from data_module.speech.beats import BeatSettings, BeatTracker
from data_module.types import Array, Speech
from generator.model import Generator
from generator.settings import GeneratorConfig, GeneratorWidths
from gesticulator.gesticulator import Gesticulator
from gesticulator.training.stages.windows import Sequence, Windows, with_silence
from interpreters.base import BlockFeatures
from interpreters.statistical import StatisticalInterpreter
from lexicon.autoencoder import Lexicon, LexiconConfig
from lexicon.inventory import count

FRAMES, WIDTH, AUDIO, CODE = 6, 5, 4, 12
SMALL = GeneratorConfig(motion_features=8, audio_features=6, style_width=4, position_width=4, hidden=24, groups=4,
                        classes=8, lstm_width=24, lstm_layers=1)


# ---- beats


@given(onsets=st.lists(st.floats(0, 0.2), max_size=6), duration=st.floats(0.01, 0.199))
def test_a_recording_shorter_than_the_shortest_interval_is_one_block(onsets: list[float], duration: float) -> None:
    beats = BeatTracker(BeatSettings(0.2, 0.5)).finish([(onset, 1.0) for onset in sorted(set(onsets))], [], duration)
    assert [time for time, _ in beats] == [duration]


# ---- rotations


ANGLES = st.tuples(*[st.floats(-np.pi, np.pi)] * 3).map(np.array)
TURNS = st.tuples(*[st.integers(-2, 2)] * 3).map(np.array)


@given(angles=ANGLES, turns=TURNS, order=st.sampled_from(["XYZ", "ZXY", "YXZ"]))
def test_whole_turns_change_no_rotation(angles: Array, turns: Array, order: str) -> None:
    q = rotation.from_euler(angles, order)
    assert rotation.angle_between(rotation.from_euler(angles + 2 * np.pi * turns, order), q) < 1e-6
    v = rotation.to_exponential_map(q)
    length = np.linalg.norm(v)
    if length > 1e-3:
        assert rotation.angle_between(rotation.from_exponential_map(v * (1 + 2 * np.pi * turns[0] / length)), q) < 1e-6
    back = rotation.from_euler(rotation.to_euler(rotation.from_exponential_map(v), order), order)
    assert rotation.angle_between(back, q) < 1e-5


# ---- the generator's inputs, codes and losses


def small_generator(blocks: int = 0) -> Generator:
    torch.manual_seed(0)
    return Generator(SMALL, GeneratorWidths(FRAMES, WIDTH, AUDIO, CODE), blocks)


def test_lexeme_and_perceptual_losses_reach_neither_encoder_nor_codebook() -> None:
    torch.manual_seed(0)
    lexicon = Lexicon(LexiconConfig(size=8, code_width=CODE, widths=(8, 12, 12, 16)), FRAMES, WIDTH)
    frozen = freeze(copy.deepcopy(lexicon))
    assert isinstance(frozen, Lexicon)
    before = {key: value.clone() for key, value in frozen.state_dict().items()}
    model = small_generator(blocks=20).train()
    batch = {"motion": torch.randn(3, 5, FRAMES, WIDTH), "audio": torch.randn(3, 5, 3 * FRAMES, AUDIO),
             "lexeme": frozen.vectors[torch.randint(8, (3, 5))], "style": torch.randint(1, 21, (3, 5)),
             "mask": torch.ones(3, WIDTH), "valid": torch.ones(3, 5)}
    for name in ("lexeme", "perceptual"):
        model.zero_grad()
        model.losses(batch, 0.5, frozen.encode)[name].backward()
        assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in model.to_motion.parameters())
        assert all(p.grad is None for p in (*lexicon.parameters(), *frozen.parameters())), name
    after = frozen.state_dict()
    assert all(torch.equal(value, after[key]) for key, value in before.items()), "no batch statistics move either"


# ---- what training reads


def small_corpus(blocks: int = 30) -> SimpleNamespace:
    """As much of a corpus as windows read: block i's motion is i everywhere, every third block is silent."""
    motion = torch.arange(float(blocks))[:, None, None].expand(-1, FRAMES, WIDTH)
    low = torch.zeros(blocks, 3 * FRAMES, AUDIO)
    return SimpleNamespace(motion=motion, low=low, high=low, silent=np.arange(blocks) % 3 == 0,
                           durations=np.full(blocks, 0.3), mask=torch.ones(1, WIDTH), speaker_of=np.zeros(1, np.int64),
                           statistics=SimpleNamespace(speakers=("ann",)))


def small_part(blocks: int = 30) -> Sequence:
    own = np.arange(blocks)
    return Sequence(0, own, np.zeros(blocks, bool), own, own % 7, own + 1)


def test_a_block_has_the_same_style_code_in_every_window_that_holds_it() -> None:
    corpus = small_corpus()
    windows = Windows(corpus, [small_part()], 8)  # type: ignore[arg-type]
    batch = windows.batch(windows.starts)
    table, rows = small_generator(blocks=30).styles, {}
    assert table is not None
    for block, number, code in zip(batch["motion"][..., 0, 0].flatten(), batch["style"].flatten(),
                                   table(batch["style"]).flatten(0, 1), strict=True):
        rows.setdefault(int(block), []).append((int(number), tuple(code.tolist())))
    assert len(rows) == 30 and max(map(len, rows.values())) >= 9, "windows overlap"
    assert all(len(set(row)) == 1 for row in rows.values()), "one block, one code"
    assert len({row[0] for row in rows.values()}) == 30, "and another's is another"


@given(share=st.floats(0.01, 0.3), longest=st.integers(3, 12), seed=st.integers(0, 99))
def test_inserted_silence_is_its_share_to_the_block(share: float, longest: int, seed: int) -> None:
    parts = [small_part(), small_part()]
    longer = with_silence(parts, small_corpus(), np.full(30, 3), share, longest,  # type: ignore[arg-type]
                          np.random.default_rng(seed))
    inserted = sum(int(part.held.sum()) for part in longer)
    budget = share * 60 / (1 - share)
    runs = [run for part in longer for run in np.diff(np.flatnonzero(~part.held)) - 1]
    # Twenty places: enough for all but the largest shares in the shortest runs.
    assert inserted == round(budget) or (inserted < budget and np.count_nonzero(runs) >= 18)
    assert sum(len(part.motion) for part in longer) == 60 + inserted
    assert max(runs, default=0) <= longest


# ---- interpreters


@given(labels=st.lists(st.integers(0, 3), max_size=30), speaker=st.integers(0, 3))
def test_a_lexeme_that_was_never_seen_keeps_a_chance(labels: list[int], speaker: int) -> None:
    inventory = count([("ann", np.array(labels, dtype=np.int64))], size=6)  # 4 and 5 never occur
    np.testing.assert_allclose(inventory.transitions.sum(1), 1.0)
    system = StatisticalInterpreter(inventory.frequencies["ann"][None], inventory.transitions)
    nothing = np.zeros((1, 1), np.float32)
    scores, _ = system.step(system.start(0, speaker), BlockFeatures(nothing, nothing), speaker)
    assert np.exp(scores).sum() == pytest.approx(1.0)
    assert scores.min() > -120.0, "far from the floor of the logarithm"


@pytest.fixture(scope="module", params=["mel", "vqwav2vec"])
def system(request: pytest.FixtureRequest) -> Gesticulator:
    """A bundle that was never trained, by either front end."""
    return Gesticulator(untrained(*(PLAIN if request.param == "mel" else ())))


@pytest.fixture(scope="module")
def even() -> Gesticulator:
    """One with beats that do not listen, so that blocks stay where they are."""
    return Gesticulator(untrained(*PLAIN, "rhythm.beats.rule=even"))


@pytest.mark.parametrize("block", [1, 4, 7])
def test_a_choice_hears_the_next_block_and_not_the_one_after(even: Gesticulator, block: int) -> None:
    sound = babble(6.0)
    whole = even(Speech(sound, RATE), fps=20)
    for first, heard in ((block + 1, True), (block + 2, False)):
        other = sound.copy()
        start, end = (round(edge * RATE) for edge in whole.blocks.edges[first:first + 2])
        other[start:end] = 0.3 * np.sin(np.arange(end - start))
        told = even(Speech(other, RATE), fps=20)
        assert np.array_equal(told.blocks.edges, whole.blocks.edges)
        assert np.array_equal(told.scores[:block], whole.scores[:block])
        assert np.array_equal(told.scores[block], whole.scores[block]) != heard


# ---- streaming and silence


@pytest.mark.parametrize(("system", "name"), [
    ("mel", "lstm"), ("mel", "statistical"), ("vqwav2vec", "lstm"), ("vqwav2vec", "cql"), ("vqwav2vec", "statistical")],
    indirect=["system"])
def test_what_has_come_in_so_far_decides_what_is_played_so_far(system: Gesticulator, name: str) -> None:
    """The offline result of every beginning is the beginning of the offline result, past the Q-network's window too."""
    sound, options = babble(7.3), {"interpreter": name, "seed": 3, "temperature": 1.0, "fps": 20}
    whole = system(Speech(sound, RATE), **options)  # type: ignore[arg-type]
    beats = system.bundle.config.rhythm.beats
    for seconds in (3.31, 5.9):
        part = system(Speech(sound[:round(seconds * RATE)], RATE), **options)  # type: ignore[arg-type]
        # A block is sure when the one after it is: no beat looks further than d_max + d_min, no onset than 0.3 s.
        sure = int(np.searchsorted(part.blocks.edges, seconds - beats.d_max - beats.d_min - 0.3)) - 2
        assert sure > (system.bundle.config.cql.decisions if seconds > 5 else 3)
        np.testing.assert_allclose(part.blocks.edges[:sure + 1], whole.blocks.edges[:sure + 1], atol=1e-9)
        np.testing.assert_array_equal(part.lexemes[:sure], whole.lexemes[:sure])
        np.testing.assert_allclose(part.scores[:sure], whole.scores[:sure], atol=1e-4)
        np.testing.assert_allclose(part.codes[:sure], whole.codes[:sure], atol=1e-4)
        frames = int((part.blocks.edges[sure] - 0.2) * 20)
        np.testing.assert_allclose(part.motion.rotations[:frames], whole.motion.rotations[:frames], atol=1e-4)
