"""The first hour: typing errors get a suggestion, wishes that cannot be fulfilled a warning, before models load."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from performances import RATE, babble

from data_module.errors import InputError
from data_module.types import Speech, Word
from gesticulator.directing.cues import OptionWarning
from gesticulator.gesticulator import Gesticulator
from gesticulator.plan.plan import GestureCue

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE = str(ROOT / "examples" / "speech.flac")


def test_a_misspelt_option_suggests_the_right_one_and_names_the_help_of_the_verb(
        refused: Callable[..., str]) -> None:
    line = refused(EXAMPLE, "--intesity", "0.5", "-o", "x.bvh")
    assert "did you mean --intensity?" in line and "gesticulator infer --help" in line
    assert "did you mean" not in refused(EXAMPLE, "--qqqqq", "-o", "x.bvh")


def test_choices_are_checked_before_any_recording_is_done(refused: Callable[..., str], tmp_path: Path) -> None:
    out = str(tmp_path / "x.bvh")
    assert "did you mean connor?" in refused(EXAMPLE, "--speaker", "connr", "-o", out)
    (tmp_path / "file").write_text("no folder")
    assert "file" in refused(EXAMPLE, "-o", str(tmp_path / "file" / "x.bvh"))


def test_a_cue_of_unknown_name_is_refused_before_any_recording_is_done(refused: Callable[..., str],
                                                                       tmp_path: Path) -> None:
    assert "mean wave or wave hello" in refused(EXAMPLE, "--cue", "2.5=wavee", "-o", tmp_path / "x.bvh", "--quiet")
    assert not list(tmp_path.iterdir())


def test_what_a_recording_cannot_fulfil_is_a_warning(g: Gesticulator) -> None:
    spoken = Speech(babble(3.0), RATE, (Word("bread", 0.2, 0.6), Word("and", 0.7, 0.9), Word("Bread,", 1.0, 1.6)))
    wave = GestureCue("wave", "bread", 2)
    with pytest.warns(OptionWarning) as cues:
        directed = g(spoken, cues=(wave, GestureCue("nod", "bread", 3), GestureCue("nod", "zebra")))
    assert "occurrence 3, is left out: the word is spoken 2 times" in str(cues[0].message)
    assert "zebra=nod, occurrence 1, is left out: the word is spoken 0 times" in str(cues[1].message)
    assert directed.options is not None and directed.options.cues == (wave,)
    with warnings.catch_warnings():
        warnings.simplefilter("error", OptionWarning)
        assert np.array_equal(g(spoken, cues=(wave,)).rotations, directed.rotations)


def test_a_cue_at_a_word_without_words_is_refused(g: Gesticulator) -> None:
    with pytest.raises(InputError, match="needs the words"):
        g(babble(3.0), RATE, cues=(GestureCue("wave", "bread"),))


