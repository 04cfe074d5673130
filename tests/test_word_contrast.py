"""The benchmark of contrast with the words: what it counts, and that it sees words and not loudness."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from benchmark_files import benchmark

word_contrast = benchmark("word_contrast")


def test_chance_by_hand() -> None:
    # Two frames of word 3 and one of word 4, among four; then a word that fills its block, which tells nothing.
    word = torch.tensor([[3, 3, 4, -1], [5, 5, 5, 5]])
    assert word_contrast.chance(word) == pytest.approx((0.5 + 0.5 + 0.25) / 3)


def test_another_word_takes_the_place_of_each_and_silence_stays() -> None:
    word = torch.tensor([[0, 0, -1], [1, -1, 1], [2, 2, 2], [3, 3, -1]])
    text = torch.where(word >= 0, word + 1, 0)[..., None].float()
    batch = {"word": word, "text": text}
    other = word_contrast.with_other_words(batch)["text"][..., 0]
    assert (other[word >= 0] != text[..., 0][word >= 0]).all()
    assert sorted(other[word >= 0].tolist()) == sorted(text[..., 0][word >= 0].tolist())
    assert not other[word < 0].any() and (text[..., 0] == torch.where(word >= 0, word + 1, 0)).all()


def test_the_claim_is_of_level_8_alone() -> None:
    rng = np.random.default_rng(0)
    base = rng.uniform(0.4, 0.5, (12, 8))
    better = base.copy()
    better[:, 7] += 0.2
    shares = {f"{name}, {word}": value for name, value in (("encoder trained", better), ("encoder fixed", base))
              for word in ("own word", "another word")}
    shares["encoder trained, another word"] = base
    level, _ = word_contrast.tables(shares, np.full(12, 0.4), [str(k) for k in range(12)], [])
    for held in level.facts["claim"]:
        assert held["mean"] == pytest.approx(20.0)
    assert level.rows["encoder fixed: own word - another word"]["difference"].mean == 0.0
