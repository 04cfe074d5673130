"""What an input is worth: on a made-up corpus whose lexemes hang on what we say they hang on."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from data_module.errors import InputError
from eval.metrics.diversity import longest_run, repetition, runs
from eval.probes import evidence
from eval.stats import Interval
from eval.table import Table
from gesticulator import presets
from gesticulator.config import with_settings
from gesticulator.features import Normaliser, Statistics
from gesticulator.stages import BLOCKS, CORPUS, LABELS, LEXICON, TOKENS, Corpus, Labelled, Run
from gesticulator.stages.interpreter import teacher_logits
from gesticulator.stages.q_network import features_of
from gesticulator.stages.windows import Windows, sequences
from interpreters.lstm import InterpreterWidths, LstmConfig, LstmInterpreter

SIZE, AUDIO, MOTION, SILENT = 4, 5, 3, 3
SETTINGS = ("interpreter.pose_features=8", "interpreter.use_control=false", "interpreter.own_past_most=0",
            "schedules.interpreter.steps=90", "schedules.interpreter.validations=6", "schedules.interpreter.patience=3",
            "text.encoder=")
Lexemes = np.ndarray[Any, np.dtype[np.int64]]


def made_up(hangs_on: str, seed: int = 0) -> tuple[Corpus, Lexemes]:
    """14 recordings of 24 blocks, every sixth silent; a spoken lexeme is one of three, told by the sound ("sound"), by
    the pose before ("pose"), or by nothing."""
    rng, frames = np.random.default_rng(seed), presets.preset("tiny").rhythm.frames
    count, recording = 14 * 24, np.repeat(np.arange(14), 24)
    silent = np.arange(count) % 6 == 5
    labels = np.where(silent, SILENT, rng.integers(SILENT, size=count)).astype(np.int64)
    high = rng.normal(size=(count, 3 * frames, AUDIO)).astype(np.float32)
    motion = rng.normal(size=(count, frames, MOTION)).astype(np.float32)
    if hangs_on == "sound":
        told = 3 * np.random.default_rng(99).normal(size=(SIZE, 1, AUDIO))
        told[..., -1] = 0  # the column of durations, which no sound spoils
        high += told[labels]
    if hangs_on == "pose":
        motion[:-1, -1] += 3 * np.random.default_rng(98).normal(size=(SIZE, MOTION))[labels[1:]]
    heard = torch.as_tensor(high.astype(np.float16))
    nothing = np.zeros((1, MOTION))
    statistics = Statistics(("one",), nothing, nothing, np.ones(MOTION), np.array([-np.ones(MOTION), np.ones(MOTION)]),
                            Normaliser(np.zeros(AUDIO), np.ones(AUDIO)), Normaliser(np.zeros(AUDIO), np.ones(AUDIO)))
    return Corpus(
        names=tuple(f"r{i}" for i in range(14)), splits=("train",) * 8 + ("val",) * 2 + ("test",) * 4,
        speaker_of=np.zeros(14, np.int64), motion=torch.as_tensor(motion), low=heard, high=heard, silent=silent,
        durations=np.full(count, 0.3), recording=recording, first=torch.zeros(14, MOTION),
        mask=torch.ones(14, MOTION), control=np.zeros((count, frames, 3), np.float32), statistics=statistics,
        has_text=np.zeros(14, bool)), labels


def shared(hangs_on: str, work: Path, seeds: int = 2) -> evidence.EvidenceRun:
    """What the rows share, over such a corpus instead of a store's."""
    corpus, labels = made_up(hangs_on)
    store = SimpleNamespace(fingerprint=hangs_on, corpus="made up")
    run = Run(with_settings(presets.preset("tiny"), SETTINGS), store, work, progress=False)  # type: ignore[arg-type]
    lexicon = SimpleNamespace(vectors=torch.randn(SIZE, 6, generator=torch.Generator().manual_seed(3)))
    labelled = Labelled(labels, labels, np.array([SILENT]), np.full(SIZE, SILENT), ~corpus.silent,
                        np.arange(1, len(labels) + 1), None)  # type: ignore[arg-type]
    nodes: Any = {BLOCKS: corpus, CORPUS: corpus, LEXICON: lexicon, TOKENS: lexicon, LABELS: labelled}
    for node, value in nodes.items():
        run.provide(node, value, node.name)
    return evidence.EvidenceRun(run, seeds)


def gains(table: Table) -> dict[str, Interval]:
    """What the interpreter as it is gains over each other one."""
    found = {name: row["gain"] for name, row in table.rows.items() if "gain" in row}
    assert all(isinstance(gain, Interval) for gain in found.values())
    return found  # type: ignore[return-value]


def test_an_interpreter_that_hears_gains_and_one_that_only_sees_does_not(tmp_path: Path) -> None:
    told = gains(evidence.sound(shared("sound", tmp_path), "test"))
    for name in (evidence.ROLLED, evidence.ANOTHERS, evidence.NO_SOUND):
        assert told[name].above(0.4), name  # ln 3 = 1.1 at most
    assert told[evidence.NO_POSE].mean < 0.1


def test_what_hangs_on_the_pose_is_no_evidence_of_hearing(tmp_path: Path) -> None:
    told = gains(evidence.sound(shared("pose", tmp_path), "test"))
    assert told[evidence.NO_POSE].above(0.4)
    for name in (evidence.ROLLED, evidence.ANOTHERS):
        assert abs(told[name].mean) < 0.1, name


def test_where_nothing_tells_nothing_is_gained_and_the_seeds_are_other_trainings(tmp_path: Path) -> None:
    own = shared("nothing", tmp_path)
    for name, gain in gains(evidence.sound(own, "test")).items():
        assert abs(gain.mean) < 0.1, name
    # The first row at the run's own seed is the interpreter that `gesticulator train` leaves there.
    kept = {folder.name for folder in tmp_path.glob("interpreter-*")}
    assert len(kept) == 2 * 5
    first = own.first.folder(evidence.INTERPRETER)
    assert own.first.config.seed == 1 and first.name in kept


@pytest.mark.parametrize("memory", [0, 3])
def test_a_window_of_training_a_whole_recording_and_a_stream_tell_the_same(memory: int) -> None:
    corpus, labels = made_up("pose")
    corpus = dataclasses.replace(corpus, durations=np.random.default_rng(4).uniform(0.2, 0.5, len(labels)))
    torch.manual_seed(5)
    config = LstmConfig(audio_features=4, width=12, pose_features=6, memory=memory)
    model = LstmInterpreter(config, torch.randn(SIZE, 6),
                            InterpreterWidths(corpus.motion.shape[1], AUDIO, 1, motion=MOTION)).eval()
    own = corpus.blocks_of(2)
    whole = torch.log_softmax(teacher_logits(model, corpus, own, labels[own]), -1)
    parts = sequences(corpus, labels, "train", np.zeros(len(labels), np.int64))
    batch = Windows(corpus, parts, len(own) - 1).batch(np.array([[2, 0]]))
    with torch.no_grad():
        window, _ = model.scores(batch["lexeme_index"][:, :-1], batch["audio_high"][:, 1:], batch["speaker"],
                                 pose=model.seen(batch))
    torch.testing.assert_close(torch.log_softmax(window[0], -1), whole, atol=1e-5, rtol=1e-4)
    features, state = features_of(corpus), model.start(0, int(labels[own[0]]))
    for place, block in enumerate(own[1:]):
        scores, state = model.step(state, features(int(block)), int(labels[block - 1]))
        np.testing.assert_allclose(scores, whole[place].numpy(), atol=1e-5)


def test_before_the_first_block_of_a_recording_its_first_pose_is_held() -> None:
    corpus, _ = made_up("nothing")
    corpus = dataclasses.replace(corpus, first=torch.arange(14.0)[:, None].expand(-1, MOTION),
                                 durations=np.arange(1.0, 337.0))
    motion, seconds = corpus.before(np.array([0, 24, 25]))
    assert (motion[0] == 0).all() and (motion[1] == 1).all() and torch.equal(motion[2], corpus.motion[24])
    assert seconds.tolist() == [[1, 1], [25, 25], [25, 26]]


# ---------------------------------------------------------------------------------------------------- what is spoiled

def test_rolled_sound_is_another_spoken_block_of_the_recording() -> None:
    corpus, _ = made_up("sound")
    order = evidence.rolled(corpus)
    assert (corpus.recording[order] == corpus.recording).all() and sorted(order) == list(range(len(order)))
    assert (order[corpus.silent] == np.flatnonzero(corpus.silent)).all()
    spoken = ~corpus.silent
    assert (order[spoken] != np.flatnonzero(spoken)).all() and not corpus.silent[order[spoken]].any()


def test_anothers_sound_is_of_the_split_and_the_performer_where_there_is_one() -> None:
    corpus, _ = made_up("sound")
    corpus = dataclasses.replace(corpus, speaker_of=np.array([0] * 7 + [1] + [0, 1] + [0, 1, 0, 1]))
    order, splits = evidence.of_another(corpus), np.array(corpus.splits)
    spoken, own = ~corpus.silent, corpus.recording
    assert (own[order[spoken]] != own[spoken]).all() and (order[~spoken] == np.flatnonzero(~spoken)).all()
    assert (splits[own[order]] == splits[own]).all()
    same = corpus.speaker_of[own[order]] == corpus.speaker_of[own]
    alone = np.isin(own, [7, 8, 9]) & spoken  # nobody else of the split is this performer
    assert same[~alone].all() and not same[alone].any()
    one = dataclasses.replace(corpus, names=corpus.names[:1], splits=corpus.splits[:1])
    with pytest.raises(InputError, match="one recording"):
        evidence.of_another(one)


def test_the_length_of_a_block_is_told_as_it_was_but_to_the_deaf() -> None:
    corpus, _ = made_up("sound")
    spoiled = evidence.sounding(corpus, evidence.rolled(corpus))
    assert torch.equal(spoiled.high[..., -1], corpus.high[..., -1])
    spoken = torch.as_tensor(~corpus.silent)
    assert not (spoiled.high[spoken][..., :-1] == corpus.high[spoken][..., :-1]).all(dim=(1, 2)).any()
    assert torch.equal(corpus.high, made_up("sound")[0].high), "the corpus itself stays"
    assert evidence.deaf(corpus).high.abs().max() == 0
    with pytest.raises(InputError, match="words"):
        evidence.reading(corpus, evidence.rolled(corpus))


# --------------------------------------------------------------------------------------------------------------- loops

def test_runs_and_repetition_by_hand() -> None:
    labels = [0, 0, 0, 3, 3, 3, 3, 1, 1, 0]
    assert runs(labels) == [(0, 3), (3, 4), (1, 2), (0, 1)]
    assert longest_run([labels]) == 4 and longest_run([labels], [3]) == 3 and np.isnan(longest_run([labels], [0, 1, 3]))
    assert repetition([labels]) == pytest.approx((2 + 3 + 1) / 9)
    assert repetition([labels], [3]) == pytest.approx((2 + 1) / 5)
    assert repetition([[0, 0], [0]]) == 1 and np.isnan(repetition([[0], []]))


def test_a_loop_is_over_the_bound_and_the_performer_is_not() -> None:
    performed = [np.array([0, 0, 1, 3, 3, 3, 2]), np.array([1, 1, 2, 2, 0])]
    looping = [np.array([0, 0, 0, 0, 1, 3, 2]), np.array([1, 2, 2, 2, 2])]
    table = evidence.loops(performed, {"same": performed, "looping": looping}, np.array([SILENT]))
    assert [row["most"] for row in table.rows.values()] == [2, 2, 4]
    assert "1.00 times" in table.notes[0] and "within" in table.notes[0]
    assert "2.00 times" in table.notes[1] and "over" in table.notes[1]
    assert table.rows["same"]["repeated"] == table.rows["performer"]["repeated"]
