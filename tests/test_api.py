"""The product as a programmer calls it: what may be given, what comes back, and what is refused."""

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
import torch
from performances import RATE, babble
from test_pipeline import same

import gesticulator
from data_module.controls import Controls, Curve
from data_module.errors import InputError
from data_module.speech.audio import amplified
from data_module.types import Speech, Word
from gesticulator.gesticulator import Gesticulator

# -------------------------------------------------------------------------------------------------- the names

def test_the_top_has_every_name_and_imports_nothing_for_it() -> None:
    code = ("import sys, gesticulator\n"
            "assert not {'torch', 'numpy', 'librosa'} & set(sys.modules)\n"
            "for name in gesticulator.__all__: assert getattr(gesticulator, name)\n"
            "assert gesticulator.Speech.__name__ == 'Speech' and gesticulator.Motion.__name__ == 'Motion'\n"
            "try: gesticulator.nothing\nexcept AttributeError as error: assert 'nothing' in str(error)\n"
            "else: raise SystemExit('no error')")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert gesticulator.Gesticulator is Gesticulator and gesticulator.InputError is InputError


# ------------------------------------------------------------------------------------------- what may be given

def test_a_path_samples_and_a_speech_are_one(g: Gesticulator, tmp_path: Path) -> None:
    soundfile.write(tmp_path / "speech.wav", babble(2.0), RATE, subtype="FLOAT")
    base = g(Speech(babble(2.0), RATE))
    for made in (g(tmp_path / "speech.wav"), g(str(tmp_path / "speech.wav")), g(babble(2.0), RATE),
                 g(io.BytesIO((tmp_path / "speech.wav").read_bytes())),
                 g(babble(2.0).astype(np.float64), float(RATE)), g(np.stack([babble(2.0), babble(2.0)], axis=1), RATE),
                 g(torch.as_tensor(babble(2.0)), RATE)):
        assert same(made, base)


@pytest.mark.parametrize(("samples", "rate", "said"), [
    (np.zeros(RATE, np.float32), None, "sample_rate: is missing"), (np.zeros(RATE, np.float32), 0, "sample_rate 0"),
    (np.zeros(RATE, np.float32), float("nan"), "sample_rate nan"), (np.zeros(100, np.float32), RATE, "too short"),
    (np.zeros(0, np.float32), RATE, "too short"), (np.zeros((2, RATE), np.float32), RATE, "samples first"),
    (np.zeros((RATE, 0), np.float32), RATE, "samples first"), (np.zeros((2, 2, RATE)), RATE, "shaped"),
    (np.zeros(RATE, complex), RATE, "complex"), (np.full(RATE, "a"), RATE, "numbers"),
    (np.full(RATE, np.nan, np.float32), RATE, "not a number"), (np.full(RATE, 20000.0), RATE, "full scale is 1"),
    (np.zeros(RATE, np.float32), 16000.5, "out of range"),
])
def test_samples_that_cannot_be_used(samples: np.ndarray, rate: float | None, said: str, g: Gesticulator) -> None:
    with pytest.raises(InputError, match=said):
        g(samples, rate)


def test_a_str_is_what_is_said_and_a_path_is_a_file(g: Gesticulator, tmp_path: Path) -> None:
    spoken = "тяжёлый хлеб медленно поднимается"  # the aligner knows English alone, so the times are guessed
    (tmp_path / "words.txt").write_text(spoken, encoding="utf-8")
    said, read = g(babble(2.0), RATE, text=spoken), g(babble(2.0), RATE, text=tmp_path / "words.txt")
    assert same(said, read) and said.decided.notes == read.decided.notes and "4 words" in said.decided.notes[0]
    assert [word.text for word in said.speech.words or () if word.text] == spoken.split()
    assert not same(said, g(babble(2.0), RATE))
    for name in (str(tmp_path / "words.txt"), "nowhere.srt"):
        with pytest.raises(InputError, match="is the name of a file"):
            g(babble(2.0), RATE, text=name)
    for empty in ("", "  \n", "..."):
        with pytest.raises(InputError, match="has no words"):
            g(babble(2.0), RATE, text=empty)


# ----------------------------------------------------------------------------------------------------- options

@pytest.mark.parametrize(("options", "said"), [
    ({"seed": -1}, "seed -1: is not a whole number in range"), ({"seed": 1.5}, "seed 1.5"),
    ({"seed": None}, "seed None"),
    ({"seed": True}, "seed True"), ({"temperature": float("nan")}, "temperature nan"),
    ({"temperature": float("inf")}, "temperature inf"), ({"temperature": "warm"}, "temperature warm"),
    ({"fps": float("nan")}, "fps nan"), ({"fps": 0}, "fps 0"), ({"fps": None}, "fps None"),
    ({"activity": 1.5}, "activity 1.5"), ({"gain": 100}, "gain 100"), ({"speaker": "nobody"}, "speaker nobody"),
    ({"interpreter": "oracle"}, "interpreter oracle"), ({"hand_height": "sky"}, "--hand-height 'sky'"),
    ({"hand_speed": -1.0}, "--hand-speed -1.0"), ({"hand_height": float("nan")}, "--hand-height nan"),
    ({"hand_height": 0.1, "controls": Controls()}, "one or the other"),
])
def test_options_out_of_range_are_input_errors(options: dict[str, Any], said: str, g: Gesticulator) -> None:
    with pytest.raises(InputError, match=said):
        g(babble(2.0), RATE, **options)


def test_hands_are_arguments_in_every_form(g: Gesticulator) -> None:
    levels = g.bundle.levels
    assert levels is not None
    high = levels.value("height", "high")
    base = g(babble(2.0), RATE, controls=Controls(height=high))
    for asked in ("high", high, repr(high), Curve((0.0, 1.0), (high, high)), np.float64(high)):
        assert same(g(babble(2.0), RATE, hand_height=asked), base), asked
    assert not same(g(babble(2.0), RATE), base)
    two = g(babble(2.0), RATE, hand_height="high", hand_speed=0.8)
    assert not same(two, base) and same(two, g(babble(2.0), RATE, controls=Controls(height=high, speed=0.8)))


def test_gain_is_decibels() -> None:
    speech = Speech(np.linspace(-0.2, 0.2, RATE, dtype=np.float32), RATE, (Word("a", 0, 1),))
    np.testing.assert_allclose(amplified(speech, 6.0206).samples, 2 * speech.samples, rtol=1e-5)
    assert amplified(speech, 40).samples.max() == 1.0 and amplified(speech, 40).words == speech.words
    assert amplified(speech, 0) is speech


# -------------------------------------------------------------------------------------------- what comes back


def test_the_explanation_says_what_was_done(g: Gesticulator) -> None:
    made = g(babble(2.0), RATE, seed=3, hand_height="low", hand_speed=Curve((0.0, 1.0), (0.2, 0.4)), activity=0.5,
             fps=25, interpreter="cql", text="тяжёлый хлеб")
    told = json.loads(json.dumps(made.explain()))
    levels = g.bundle.levels
    assert levels is not None and told["score_is"] == "Q value" and told["notes"] == list(made.decided.notes)
    assert told["made_by"]["gesticulator"] == gesticulator.__version__
    assert told["made_by"]["settings"] == {
        "words": True, "fps": 25.0, "gain": 0.0,
        "temperature": g.bundle.config.selection.q_temperature, "hand_height": levels.value("height", "low"),
        "hand_speed": {"times": [0.0, 1.0], "values": [0.2, 0.4]}}
    assert {name: told[name] for name in ("speaker", "interpreter", "seed", "variation")} == {
        "speaker": "ann", "interpreter": "cql", "seed": 3, "variation": 0}
    assert told["knobs"]["activity"] == told["drawn"]["knobs"]["activity"] == 0.5
    # What was done can be done again from it.
    again = {"speaker": "ann", "interpreter": "cql", "seed": 3, "activity": 0.5, **told["made_by"]["settings"]}
    del again["words"]
    again["hand_speed"] = Curve(*map(tuple, again["hand_speed"].values()))
    assert same(g(made.speech, **again), made)
