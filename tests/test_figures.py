"""The README's figures: known answers of the measures that are not chapters of their own."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTER, from_vector
from data_module.store import Store
from data_module.types import Speech
from eval import figures
from eval.metrics.accuracy import lexeme_accuracy
from gesticulator import bundle as bundles
from gesticulator.pipeline import Gesticulator
from gesticulator.prepare import prepare


class Oracle:
    """Knows the sequence beforehand, but for every `miss`-th block."""

    def __init__(self, labels: np.ndarray, size: int, miss: int) -> None:
        self._labels, self._size, self._miss = labels, size, miss

    def start(self, speaker: int, first_lexeme: int) -> int:
        return 0

    def step(self, state: int, features: object, previous_lexeme: int) -> tuple[np.ndarray, int]:
        wanted = int(self._labels[state + 1])
        scores = np.zeros(self._size)
        scores[(wanted + 1) % self._size if self._miss and (state + 1) % self._miss == 0 else wanted] = 1.0
        return scores, state + 1


def test_accuracy_of_known_interpreters(tiny_store: Path, tiny_bundle: Path) -> None:
    bundle = bundles.load(tiny_bundle)
    corpus = prepare(Store.open(tiny_store), bundle.config, tiny_bundle.with_name(tiny_bundle.name + ".work"),
                     progress=False)
    recording = corpus.recordings("test")[0]
    own = corpus.blocks_of(recording)
    corpus.silent[:] = False
    labels = np.random.default_rng(0).integers(bundle.config.lexicon.size, size=len(corpus.silent))
    for teacher in (True, False):
        for miss, expected in ((0, 100.0), (4, 100.0 * (1 - ((len(own) - 1) // 4) / (len(own) - 1)))):
            system = Oracle(labels[own], bundle.config.lexicon.size, miss)
            made = figures.likeliest(system, corpus, labels, bundle.silent, recording, teacher)
            got = lexeme_accuracy(made, labels[own[1:]]).percent
            assert got == pytest.approx(expected)


def test_successors_are_the_commonest_next_lexemes(tiny_store: Path, tiny_bundle: Path) -> None:
    bundle = bundles.load(tiny_bundle)
    corpus = prepare(Store.open(tiny_store), bundle.config, tiny_bundle.with_name(tiny_bundle.name + ".work"),
                     progress=False)
    labels = np.arange(len(corpus.silent)) % 3  # 0 1 2 0 1 2 ... within a recording
    assert figures.successors(corpus, labels, 3)[0].tolist() == [1, 2, 0]


def test_speeds_are_metres_per_second_and_silence_is_told_apart() -> None:
    rate, fps = 16000, 60.0
    t = np.arange(round(8 * fps)) / fps
    pose = np.zeros((len(t), len(CHARACTER), 3))
    moving = t < 4
    pose[:, CHARACTER.index("RightForeArm"), 1] = np.where(moving, np.sin(2 * np.pi * t), 0.0)
    motion = from_vector(pose.reshape(len(t), -1), fps)
    rng = np.random.default_rng(0)
    sound = 1e-4 * rng.normal(size=8 * rate)
    at = np.arange(4 * rate) / rate
    syllables = np.clip(np.sin(2 * np.pi * 3 * at), 0, 1)  # a steady hum would be taken for the room
    sound[:4 * rate] += 0.2 * syllables * np.sign(np.sin(2 * np.pi * 120 * at))
    clip = figures.measure(motion, Speech(sound.astype(np.float32), rate))
    hand = positions_of(motion)[:, CHARACTER.index("RightHand")]
    by_hand = np.linalg.norm(np.diff(hand, axis=0), axis=1) * fps
    np.testing.assert_allclose(clip.hand_speed[:, 0], by_hand, atol=1e-9)
    assert 0.25 * np.pi * 2 * 0.6 < by_hand.max() < 0.25 * np.pi * 2 * 1.01, "a 25 cm forearm, 1 rad at 1 Hz"
    silent = np.flatnonzero(clip.silent) / fps
    assert 4.75 < silent.min() < 5.1, "silence settles a second after the last syllable, which ends at 3.83 s"


def test_the_command_writes_every_table(tiny_store: Path, tiny_bundle: Path, tmp_path: Path,
                                        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    out = tmp_path / "figures.json"
    assert figures.main(["--data", str(tiny_store), "--bundle", str(tiny_bundle), "--out", str(out), "--work",
                         str(tiny_bundle.with_name(tiny_bundle.name + ".work"))]) == 0
    result = json.loads(out.read_text())
    systems = {"lstm", "lstm with text", "statistical", "commonest"}
    assert set(result["accuracy"]) == {"previous lexeme and speaker", *systems}
    assert set(result["rhythm"]) == set(result["motion"]) == {"performer", *systems}
    assert result["motion"]["lstm"] != result["motion"]["lstm with text"], "one hears, the other reads too"
    errors = result["lexicon"]["errors"]
    assert errors["PCA"]["mean"] < errors["quantised"]["mean"]
    assert result["accuracy"]["commonest"]["teacher_forced"] == result["accuracy"]["commonest"]["free_running"]
    assert "| commonest |" in out.with_suffix(".md").read_text()


def test_words_are_read_only_by_the_row_that_is_to_read(tiny_store: Path, tiny_bundle: Path) -> None:
    store, system = Store.open(tiny_store), Gesticulator.from_pretrained(tiny_bundle)
    recording = store.load(store.of_split("test")[0].name)
    assert recording.speech.words
    deaf = Gesticulator(replace(system.bundle, interpreter_text=None, style_text=None, text=None))
    heard, read, never = (figures.play(own, [recording], "lstm", False, "", words=words)[0].hand_speed
                          for own, words in ((system, False), (system, True), (deaf, True)))
    np.testing.assert_array_equal(heard, never)
    assert not np.array_equal(heard, read)


def test_blocks_know_whether_their_stroke_was_shown_in_training(tiny_store: Path) -> None:
    store = Store.open(tiny_store)
    for info in store.recordings:
        recording = store.load(info.name)
        assert recording.truth is not None
        strokes = recording.truth.strokes
        edges = np.arange(0, recording.speech.duration, 0.1)
        kinds = figures.stroke_kinds(recording, edges)
        unseen = sum(s.end - s.start for s in strokes if s.held_out)
        assert (kinds == 1).sum() * 0.1 <= unseen + 0.2 * len(strokes)
        assert (kinds == 1).any() == any(s.held_out for s in strokes)
        if info.split == "train":
            assert not (kinds == 1).any()
