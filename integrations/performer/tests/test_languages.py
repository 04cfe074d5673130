"""Corpora in other languages, and the figures of a model that is driven by them."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gesticulator_performer import espeak, voices
from gesticulator_performer.plan import plan
from gesticulator_performer.procedural import procedural_strokes
from gesticulator_performer.reader import Script
from gesticulator_performer.text import compose
from hypothesis import given
from hypothesis import strategies as st

from data_module.corpora.base import Options, Reader
from data_module.corpora.table import open_corpus
from data_module.errors import InputError
from data_module.speech.audio import write_flac
from data_module.types import Speech
from eval.clip.measure import ClipMeasurement
from eval.commands import PROBE
from eval.metrics.diversity import expected_kinds
from eval.probes import languages
from eval.table import load
from gesticulator.pipeline import Gesticulator

RATE = 16000
needs_espeak = pytest.mark.skipif(not espeak.available(), reason="libespeak-ng is not installed")


# ---------------------------------------------------------------------------------------------------- corpora

def _plan(source: Path, *spoken: str, hours: float = 1.5) -> Reader:
    return open_corpus("performer", source, Options(hours=hours, languages=spoken))


@pytest.mark.parametrize("spoken", [("de",), ("de", "es"), ("cmn",), ("cmn", "de", "es")])
def test_a_corpus_of_other_languages_has_nothing_else(outside_data: Path, spoken: tuple[str, ...]) -> None:
    items = _plan(outside_data, *spoken).items()
    infos = [item.info for item in items]
    assert {info.language for info in infos} == set(spoken)
    talks = [info for info in infos if info.name.startswith("talk")]
    assert {info.language for info in talks if info.split == "train"} == set(spoken)
    assert all(voices.VOICES[info.voice].language == info.language for info in talks)
    assert {info.voice for info in infos if info.name.startswith("read")} == {
        f"{language}_prose_1" for language in spoken if language != "cmn"}
    kept = {info.voice for info in talks if info.split == "test"}
    assert kept and not kept & {info.voice for info in talks if info.split != "test"}
    train = {u.text for item in items if isinstance(item.content, Script) and item.info.split != "test"
             for u in item.content.utterances}
    test = {u.text for item in items if isinstance(item.content, Script) and item.info.split == "test"
            for u in item.content.utterances}
    assert test and not train & test


def test_languages_share_the_talks_and_the_performers(outside_data: Path) -> None:
    talks = [i.info for i in _plan(outside_data, "de", "es", hours=4.2).items() if i.info.name.startswith("talk")]
    by = Counter((info.language, info.speaker) for info in talks)
    assert len(by) == 8 and min(by.values()) > 0.6 * max(by.values())


def test_the_order_of_languages_does_not_matter(outside_data: Path) -> None:
    one, other = _plan(outside_data, "de", "es", hours=0.3), _plan(outside_data, "es", "de", "es", hours=0.3)
    assert one.items() == other.items() and one.settings() == other.settings()
    assert one.settings() != _plan(outside_data, "de", hours=0.3).settings()


def test_without_languages_talks_are_english_and_every_reading_is_used(outside_data: Path) -> None:
    pytest.importorskip("pocketsphinx")
    reader = open_corpus("performer", outside_data, Options())
    talks = [item for item in reader.items() if item.info.part == "talk"]
    assert [(item.info.name, item.info.split, item.info.voice) for item in talks[:8]] == [
        ("talk_0000_brad", "train", "slt"), ("talk_0001_brad2", "train", "rms"), ("talk_0002_connor", "train", "kal"),
        ("talk_0003_garza", "train", "us_f3"), ("talk_0004_brad", "train", "rms_light"),
        ("talk_0005_brad2", "train", "gb_m3"), ("talk_0006_brad", "test", "awb"),
        ("talk_0007_connor", "train", "slt_high")]
    assert {item.info.language for item in talks} == {"en"}
    assert {item.info.voice for item in reader.items() if item.info.language != "en"} == {"de_prose_1", "es_prose_1"}
    assert "languages" not in reader.settings()


def test_languages_that_nobody_speaks_are_refused(outside_data: Path) -> None:
    with pytest.raises(InputError, match=r"--languages de,xx: no voice speaks xx.*cmn, de, en, es"):
        _plan(outside_data, "de", "xx")
    with pytest.raises(InputError, match="--languages: is not for the tiny preset"):
        open_corpus("performer", None, Options(preset="tiny", languages=("de",)))


@needs_espeak
def test_mandarin_gets_beats_and_nothing_that_asks_for_words() -> None:
    strokes = procedural_strokes()
    who = strokes.performers[0]
    assert not all(stroke.lexeme.startswith("Beat") for stroke in strokes.of(who, "train")), "others could be chosen"
    text = compose(np.random.default_rng(0), 15, "train", language="cmn")
    spoken = voices.speak("x", text, "cmn_f2", np.random.default_rng(0))
    planned = plan(spoken, who, strokes, np.random.default_rng(0))
    assert len(planned) > 5 and all(one.stroke.lexeme.startswith("Beat") for one in planned)
    taken = {one.syllable for one in planned}
    prominent = [s.prominence for s in spoken.syllables if s.vowel in taken]
    assert np.mean(prominent) > np.mean([s.prominence for s in spoken.syllables]) + 0.2


# ---------------------------------------------------------------------------------------------------- figures

@given(st.lists(st.integers(0, 4), min_size=1, max_size=7), st.data())
def test_expected_kinds_is_the_mean_over_every_draw(labels: list[int], data: st.DataObject) -> None:
    drawn = data.draw(st.integers(1, len(labels)))
    every = [len({labels[i] for i in chosen}) for chosen in itertools.combinations(range(len(labels)), drawn)]
    assert expected_kinds(np.array(labels), drawn) == pytest.approx(np.mean(every))


def test_more_kinds_than_labels_cannot_be_drawn() -> None:
    with pytest.raises(ValueError, match="4 of 3"):
        expected_kinds(np.arange(3), 4)


def _clip(duration: float, shift: float = 0.0, fps: float = 60.0) -> ClipMeasurement:
    """Onsets at irregular times, motion beats `shift` later; hands at 1 m/s, and 0.2 in the last tenth, silent."""
    rng = np.random.default_rng(0)
    onsets = np.cumsum(rng.uniform(0.5, 1.0, int(2 * duration)))
    onsets = onsets[onsets < duration - 0.5]
    frames = round(duration * fps) - 1
    silent = np.arange(frames) >= 0.9 * frames
    speed = np.where(silent, 0.2, 1.0)[:, None].repeat(2, axis=1)
    return ClipMeasurement(onsets, onsets + shift, duration, speed, silent, np.zeros((frames + 1, 2)))


def test_figures_of_a_motion_in_time_and_of_one_that_is_late() -> None:
    with_it, late = (languages.figures_of(languages.Piece(_clip(15.0, shift), np.array([3, 1, 3, 1])))
                     for shift in (0.02, 0.25))
    assert with_it["pmb"] == 100 and with_it["above_chance"] == pytest.approx(100)
    assert late["pmb"] == 0 and late["above_chance"] < -10
    assert with_it["entropy"] == pytest.approx(np.log(2))
    assert with_it["onsets_per_second"] == with_it["motion_beats_per_second"] == pytest.approx(1.33, abs=0.2)
    assert (with_it["speech_speed"], with_it["silence_speed"]) == (pytest.approx(1.0), pytest.approx(0.2))


@given(st.floats(4.0, 70.0))
def test_pieces_hold_everything_once(duration: float) -> None:
    clip = _clip(duration)
    starts = np.arange(0.0, duration, 0.3)
    parts = languages.pieces(clip, starts, np.arange(len(starts)), 60.0)
    assert len(parts) == max(1, round(duration / 10)) and sum(p.clip.duration for p in parts) == pytest.approx(duration)
    begun = np.cumsum([0.0, *(p.clip.duration for p in parts)])
    np.testing.assert_allclose(np.concatenate([p.clip.onsets + b for p, b in zip(parts, begun, strict=False)]),
                               clip.onsets)
    assert np.array_equal(np.concatenate([p.clip.hand_speed for p in parts]), clip.hand_speed)
    assert np.array_equal(np.concatenate([p.lexemes for p in parts]), np.arange(len(starts)))
    assert all(len(p.clip.silent) == len(p.clip.hand_speed) for p in parts)


def test_rows_average_performances_before_they_count_pieces() -> None:
    """Two pieces, played twice: the interval is over two, each the mean of its two performances."""
    slow, fast = _clip(15.0), _clip(15.0)
    fast.beats = np.sort(np.concatenate([fast.beats, fast.beats + 0.2]))
    play = {"a": [[languages.Piece(slow, np.array([0, 0])), languages.Piece(fast, np.array([1, 1]))]],
            "b": [[languages.Piece(fast, np.array([2, 2])), languages.Piece(fast, np.array([3, 3]))]]}
    heard = [languages.Passage(name, "de", "", Speech(np.zeros(RATE, np.float32), RATE)) for name in play]
    told: Any = languages.player_table("x", heard, lambda passage: play[passage.name], size=8).rows
    row, once = told["German, real"], len(slow.beats) / 15
    assert row["motion_beats_per_second"].mean == pytest.approx((1.5 + 2) / 2 * once)
    assert row["motion_beats_per_second"].n == row["pieces"] == 2 and row["seconds"] == 30
    assert row["used"] == row["used_equally"] == 0.5 and row["entropy"].mean == 0


def _sound(seconds: float) -> Speech:
    """Noise that swells three times a second, with a gap half a second before the last thirty."""
    at = np.arange(round(seconds * RATE)) / RATE
    sound = 0.1 * np.random.default_rng(0).standard_normal(len(at)) * (0.6 + 0.4 * np.sin(6 * np.pi * at))
    sound[(at > seconds - 30.6) & (at < seconds - 30.4)] = 0
    return Speech(sound.astype(np.float32), RATE)


def test_only_what_was_kept_for_test_is_heard(tmp_path: Path) -> None:
    for name, seconds in (("de_one", 45), ("en_sonnet_3", 5), ("en_sonnet_1", 5), ("fr_two", 35)):
        write_flac(tmp_path / f"{name}.flac", _sound(seconds))
    found = {one.name: one for one in languages.passages([tmp_path, tmp_path], (), 1)}
    assert set(found) == {"de_one_tail", "en_sonnet_3", "fr_two_tail"}
    assert found["de_one_tail"].speech.duration == pytest.approx(30.5, abs=0.11)
    assert found["en_sonnet_3"].speech.duration == pytest.approx(5)
    assert [one.group for one in found.values()] == ["German, real", "English, real", "fr, real"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no speech kept for test"):
        languages.passages([tmp_path / "empty"], (), 1)
    with pytest.raises(InputError, match="is not a folder"):
        languages.passages([tmp_path / "nothing"], (), 1)


@needs_espeak
def test_mandarin_is_spoken_where_nothing_brings_it(tmp_path: Path) -> None:
    write_flac(tmp_path / "en_sonnet_3.flac", _sound(3))
    heard = languages.passages([tmp_path], None, 4)
    assert {(one.group, one.engine) for one in heard} == {("English, real", ""), ("Mandarin, synthetic", "espeak-ng")}
    write_flac(tmp_path / "cmn_own.flac", _sound(35))
    assert all(one.engine == "" for one in languages.passages([tmp_path], None, 4))


class _Listener:
    """A system that notes what it was given."""

    speakers = ("one", "two")

    def __init__(self, system: Gesticulator) -> None:
        self.system, self.given = system, []

    def __call__(self, speech: Speech, *, speaker: str, seed: int, interpreter: str) -> Any:
        self.given.append((speaker, seed, speech.words))
        return self.system(speech, seed=seed, interpreter=interpreter)


def test_no_words_reach_the_model(tiny_store: Path, tiny_bundle: Path) -> None:
    passage = languages.passages([tiny_store], (), 1)[0]
    assert passage.speech.words, "the store knows the words"
    listener = _Listener(Gesticulator.from_pretrained(tiny_bundle))
    played = languages.played_by(listener, passage, "lstm", takes=2)  # type: ignore[arg-type]
    assert listener.given == [("one", 0, None), ("one", 1, None), ("two", 0, None), ("two", 1, None)]
    assert [len(players) for players in played] == [4] * max(1, round(passage.speech.duration / 10))


def test_the_lexicon_that_plays_is_the_one_that_is_used(tiny_store: Path, tiny_bundle: Path) -> None:
    """RACER's own codec has more codes than the setting `lexicon.size` says."""
    system = Gesticulator.from_pretrained(tiny_bundle)
    size, config = system.bundle.lexicon.quantizer.size, system.bundle.config
    system.bundle = replace(system.bundle, config=replace(config, lexicon=replace(config.lexicon, size=size // 4)))
    passage = languages.passages([tiny_store], (), 1)[0]
    (row,) = languages.tables({"own": system}, [replace(passage, motion=None)])[1].rows.values()
    played = languages.played_by(system, replace(passage, motion=None), "lstm")
    kinds = len({int(lexeme) for players in played for piece in players for lexeme in piece.lexemes})
    assert row["used"] == kinds / size <= 1


def test_the_command_says_what_is_synthetic(tiny_store: Path, tiny_bundle: Path, tmp_path: Path) -> None:
    speech, out = tmp_path / "speech", tmp_path / "languages.json"
    speech.mkdir()
    write_flac(speech / "de_one.flac", _sound(32))
    assert PROBE.main("gesticulator probe", [
        "languages", "--data", str(speech), str(tiny_store), "--bundle", str(tiny_bundle),
        "--reverse", str(tiny_bundle), "--speak", "", "--takes", "1", "--out", str(out)]) == 0
    voices_, rule, own, reverse = load(out)
    assert voices_.rows["German, real"]["by"] == "a person" and voices_.rows["English, synthetic"]["by"] == "numpy"
    assert rule.title == languages.RULE and set(rule.rows) == {"English, synthetic"}
    assert set(own.rows) == {"English, synthetic", "German, real"} and own.rows == reverse.rows
    assert math.isnan(rule.rows["English, synthetic"]["entropy"].mean)  # type: ignore[union-attr]
    claim = own.rows["German, real"]["above_chance"].to_dict()  # type: ignore[union-attr]
    assert voices_.facts["claim"] == [claim], "each language but English, by the first bundle"


def test_wrong_options_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for wrong, said in ((["--interpreters", "crystal"], "--interpreters crystal"), (["--speak", "xx"], "--speak xx"),
                        (["--takes", "0"], "--takes"), (["--seconds", "nan"], "--seconds")):
        with pytest.raises(SystemExit) as caught:
            PROBE.main("gesticulator probe", ["languages", "--data", str(tmp_path), *wrong])
        assert caught.value.code == 2 and said in capsys.readouterr().err
