"""What a part bought: known interpreters have known figures, and differences are those of the pairs."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from data_module.store import Store
from eval.context import EvalContext
from eval.probes import parts
from eval.stats import Interval
from gesticulator import bundle as bundles
from gesticulator.config import with_settings
from gesticulator.stages.corpus import Corpus
from interpreters.lstm import LstmConfig

FRAMES, SIZE = 2, 4


def corpus(lengths: tuple[int, ...], labels: np.ndarray) -> Corpus:
    """Recordings of these lengths, whose words say their lexemes: word w + 1 stands for lexeme w."""
    count = sum(lengths)
    word_at = np.repeat(labels[:, None] + 1, 3 * FRAMES, axis=1).astype(np.int32)
    empty = torch.zeros(count, 3 * FRAMES, 1)
    return Corpus(
        names=tuple(f"r{i}" for i in range(len(lengths))), splits=("test",) * len(lengths),
        speaker_of=np.zeros(len(lengths), dtype=np.int64), motion=torch.zeros(count, FRAMES, 3), low=empty, high=empty,
        silent=np.zeros(count, bool), durations=np.ones(count), recording=np.repeat(np.arange(len(lengths)), lengths),
        first=torch.zeros(len(lengths), 3), mask=torch.ones(len(lengths), 3),
        control=np.zeros((count, FRAMES, 3), np.float32), statistics=None,  # type: ignore[arg-type]
        has_text=np.ones(len(lengths), bool), word_at=torch.as_tensor(word_at),
        words=torch.cat([torch.zeros(1, SIZE), torch.eye(SIZE)]).half())


class ByTable:
    """Scores by the lexeme before: log of a table [S, S]."""

    config = LstmConfig()
    speakers = 1

    def __init__(self, table: np.ndarray) -> None:
        self.table = torch.as_tensor(table).float().log()

    def scores(self, previous: Tensor, audio: Tensor, speaker: Tensor, hidden: None = None, text: Tensor | None = None,
               pose: None = None) -> tuple[Tensor, None]:
        assert text is None and audio.shape[:2] == previous.shape
        return self.table[previous], None


class ByWord(ByTable):
    """Scores by the word that sounds on the middle block: ten times surer than chance."""

    config = LstmConfig(text_features=1)

    def __init__(self) -> None:
        super().__init__(np.ones((1, 1)))

    def scores(self, previous: Tensor, audio: Tensor, speaker: Tensor, hidden: None = None, text: Tensor | None = None,
               pose: None = None) -> tuple[Tensor, None]:
        assert text is not None and text.shape[:2] == previous.shape
        return 10.0 * text[:, :, FRAMES], None


def test_accuracy_and_nll_of_a_table_by_hand() -> None:
    labels = np.array([0, 1, 2, 0, 3, 3, 1])
    own = corpus((4, 3), labels)
    table = np.array([[0.1, 0.7, 0.1, 0.1], [0.2, 0.2, 0.4, 0.2], [0.25, 0.3, 0.2, 0.25], [0.1, 0.1, 0.1, 0.7]])
    got = parts.teacher_forced(ByTable(table), own, labels, [0, 1])  # type: ignore[arg-type]
    # 0 to 1 and 1 to 2 are the likeliest, 2 to 0 is not; 3 to 3 is, 3 to 1 is not. The first block is given.
    np.testing.assert_allclose(got["accuracy"], [200 / 3, 50.0])
    by_hand = [-(math.log(0.7) + math.log(0.4) + math.log(0.25)) / 3, -(math.log(0.7) + math.log(0.1)) / 2]
    np.testing.assert_allclose(got["nll"], by_hand, rtol=1e-6)
    np.testing.assert_allclose(got["sampled"], [100 * (0.7 + 0.4 + 0.25) / 3, 100 * (0.7 + 0.1) / 2], rtol=1e-6)
    sharper = parts.teacher_forced(ByTable(table), own, labels, [0, 1], temperature=0.5)  # type: ignore[arg-type]
    shares = [0.7**2 / (0.7**2 + 3 * 0.1**2), 0.1**2 / (0.7**2 + 3 * 0.1**2)]
    assert sharper["sampled"][1] == pytest.approx(50 * sum(shares)) and sharper["accuracy"][1] == 50


def test_right_words_tell_and_wrong_words_mislead() -> None:
    labels = np.array([0, 1, 2, 3, 0, 1, 1, 2, 3])
    own = corpus((5, 4), labels)  # the second, one block behind, is shorter: its words begin anew
    right = parts.teacher_forced(ByWord(), own, labels, [0, 1])  # type: ignore[arg-type]
    wrong = parts.teacher_forced(ByWord(), own, labels, [0, 1], [1, 0])  # type: ignore[arg-type]
    assert right["accuracy"].tolist() == [100.0, 100.0]
    # Recording 0 wants 1 2 3 0 and reads 1 2 3 1; recording 1 wants 1 2 3 and reads 1 2 3.
    assert wrong["accuracy"].tolist() == [75.0, 100.0]
    sure = math.log(math.exp(10) + 3) - 10
    np.testing.assert_allclose(right["nll"], sure, rtol=1e-3)
    np.testing.assert_allclose(wrong["nll"][0], (3 * sure + sure + 10) / 4, rtol=1e-4)


def test_a_wrong_text_is_the_mean_over_several() -> None:
    labels = np.array([0, 1, 2, 3, 0, 1, 1, 2, 3, 0, 2, 2])
    own = corpus((4, 4, 4), labels)
    mean = parts.wrongly_read(ByWord(), own, labels, [0, 1, 2])  # type: ignore[arg-type]
    each = [parts.teacher_forced(ByWord(), own, labels, [0, 1, 2], words) for words in ([1, 2, 0], [2, 0, 1])]  # type: ignore[arg-type]
    for key, values in mean.items():
        np.testing.assert_allclose(values, (each[0][key] + each[1][key]) / 2)
    one = parts.wrongly_read(ByWord(), own, labels, [0, 1, 2], most=1)  # type: ignore[arg-type]
    np.testing.assert_array_equal(one["nll"], each[0]["nll"])


@pytest.mark.parametrize("recordings", [[3, 4], [5, 1, 2], list(range(9))])
def test_nobody_reads_their_own_words(recordings: list[int]) -> None:
    others = parts.another(recordings)
    assert sorted(others) == sorted(recordings)
    assert all(other != own for own, other in zip(recordings, others, strict=True))


def test_one_recording_has_nobody_elses_words() -> None:
    with pytest.raises(ValueError, match="two"):
        parts.another([3])
    with pytest.raises(ValueError, match="two"):
        parts.another([3, 4], 2)


def test_differences_are_paired() -> None:
    rows = {"a": {"accuracy": np.array([10.0, 20.0, 60.0]), "sampled": np.array([5.0, 6.0, 7.0]),
                  "nll": np.array([1.0, 2.0, 3.0])},
            "b": {"accuracy": np.array([0.0, 15.0, 30.0]), "sampled": np.array([4.0, 5.0, 6.0]),
                  "nll": np.array([1.5, 2.5, 3.5])}}
    table = parts.table("Text", rows, [("a", "b")], [1, 1, 2])
    own, apart = table.rows["a"], table.rows["a - b"]
    assert isinstance(own["accuracy"], Interval) and own["accuracy"].mean == pytest.approx((10 + 20 + 2 * 60) / 4)
    assert isinstance(apart["accuracy"], Interval)
    assert apart["accuracy"].mean == pytest.approx((10 + 5 + 2 * 30) / 4)
    # The rows differ widely between recordings, but by the same in each: nothing is left to doubt.
    assert apart["nll"] == Interval(-0.5, -0.5, -0.5, 3)
    assert isinstance(own["nll"], Interval) and own["nll"].low < own["nll"].high


def test_the_tables_of_a_trained_bundle(tiny_store: Path, tiny_bundle: Path) -> None:
    bundle = bundles.load(tiny_bundle)
    bundle = dataclasses.replace(bundle, config=with_settings(bundle.config, ["schedules.interpreter.steps=5"]))
    work = tiny_bundle.with_name(tiny_bundle.name + ".work")
    text, levels = parts.parts(EvalContext(Store.open(tiny_store), bundle, work, progress=False))
    assert list(text.rows) == ["text", "wrong text", "audio only", "text - wrong text", "text - audio only"]
    # All test recordings have words here, so the audio-only row is the same row in both tables.
    assert text.rows["audio only"] == levels.rows["vqwav2vec"]
    assert text.rows["text"]["nll"] != text.rows["wrong text"]["nll"]
    assert levels.rows["mel"] != levels.rows["vqwav2vec"]
    assert all(row["accuracy"].n == 2 for row in text.rows.values())  # type: ignore[union-attr]
