"""Every recogniser's transcript: the same words give the same words and times, whatever program wrote them."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import recogniser_samples as samples
from hypothesis import given, settings
from hypothesis import strategies as st

from data_module.errors import InputError
from data_module.text.transcript import Transcript, read_transcript
from data_module.types import Speech

RATE = 16000
SPOKEN: samples.Words = (("And", 0.0, 0.3), ("so,", 0.3, 0.55), ("my", 0.7, 0.9), ("fellow", 0.9, 1.4),
                 ("Americans,", 1.4, 2.1), ("ask", 2.6, 2.9), ("not", 3.0, 3.4))
TIMED = sorted(set(samples.FILES) - samples.WITHOUT_TIMES)
UNENDING = {"vtt, rolling", "lrc"}
"""Samples that tell when words begin only: each lasts until the next."""


def _read(folder: Path, suffix: str, content: str, seconds: float | None = None) -> Transcript:
    path = folder / f"a{suffix}"
    path.write_text(content, encoding="utf-8")
    speech = None if seconds is None else Speech(np.full(round(seconds * RATE), 0.1, np.float32), RATE)
    return read_transcript(path, speech)


def _sample(folder: Path, name: str, words: samples.Words) -> Transcript:
    suffix, write = samples.FILES[name]
    return _read(folder, suffix, write(words))


def _same(found: Transcript, words: samples.Words, ends: bool = True) -> None:
    assert found.timing == "words" and found.words is not None and found.guessed == 0
    assert [word.text for word in found.words] == [word for word, _, _ in words]
    np.testing.assert_allclose([word.start for word in found.words], [start for _, start, _ in words], atol=1e-9)
    if ends:
        np.testing.assert_allclose([word.end for word in found.words], [end for _, _, end in words], atol=1e-9)


WORD = st.from_regex(r"[A-Za-z]{1,9}[a-z][,.]?", fullmatch=True)


@settings(max_examples=8)
@given(st.lists(st.tuples(WORD, st.integers(0, 90), st.integers(8, 90)), min_size=3, max_size=20))
def test_any_words_read_the_same_from_every_recogniser(tmp_path_factory: pytest.TempPathFactory,
                                                       drawn: list[tuple[str, int, int]]) -> None:
    words, at = [], 0
    for word, pause, length in drawn:
        words.append((word, (at + pause) / 100, (at + pause + length) / 100))
        at += pause + length
    folder = tmp_path_factory.mktemp("words")
    for name in TIMED:
        _same(_sample(folder, name, words), words, name not in UNENDING)


@pytest.mark.parametrize("name", sorted(samples.WITHOUT_TIMES - {"text"}))
def test_lines_are_cues_and_their_words_are_spread(name: str, tmp_path: Path) -> None:
    found = _sample(tmp_path, name, SPOKEN)
    assert found.timing == "cues" and [cue.text for cue in found.cues] == ["And so, my fellow", "Americans, ask not"]
    np.testing.assert_allclose([(cue.start, cue.end) for cue in found.cues], [(0.0, 1.4), (1.4, 3.4)], atol=1e-9)


def _without_words(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _without_words(value) for key, value in content.items() if key not in ("words", "Words")}
    return [_without_words(item) for item in content] if isinstance(content, list) else content


@pytest.mark.parametrize("name", ["whisper", "whisperx", "faster-whisper", "google", "azure", "azure, batch",
                                  "azure, fast", "deepgram"])
def test_a_file_without_word_times_gives_its_lines_or_its_text(name: str, tmp_path: Path) -> None:
    content = _without_words(samples.JSON[name](SPOKEN))
    found = _read(tmp_path, ".json", json.dumps(content))
    assert found.timing == ("none" if name == "deepgram" else "cues")
    assert found.text == "And so, my fellow Americans, ask not"


def test_emphasis_in_a_line_is_no_time(tmp_path: Path) -> None:
    """Italics, and one underlined word in a line that is shown once."""
    text = ("1\n00:00:00,000 --> 00:00:02,000\nI <u>really</u> mean <i>it</i>\n\n"
            "2\n00:00:02,000 --> 00:00:04,000\n<b>you</b> do not\n")
    found = _read(tmp_path, ".srt", text)
    assert found.timing == "cues" and found.text == "I really mean it you do not"


@pytest.mark.parametrize("label", ["[SPEAKER_00]: ", "SPEAKER_01: ", "[Speaker A]: "])
def test_who_speaks_is_neither_spoken_nor_a_mark(label: str, tmp_path: Path) -> None:
    found = _read(tmp_path, ".srt", f"1\n00:00:00,000 --> 00:00:02,000\n{label}I mean it\n")
    assert [(word.text, word.marks) for word in found.words or ()] == [("I", ()), ("mean", ()), ("it", ())]


def test_a_list_of_word_segments_is_read_with_what_it_lacks_and_in_order(tmp_path: Path) -> None:
    words: list[dict[str, Any]] = samples.whisperx(SPOKEN)["word_segments"]
    words[1:5] = [{"word": "2266"}, words[1], words[2], {"word": "?"}, words[4], words[3]]
    found = _read(tmp_path, ".json", json.dumps({"word_segments": words, "language": "en"}))
    assert "the times were not in order and were sorted" in found.notes
    spoken = [word for word in found.words or () if word.text not in ("2266", "?")]
    assert [word.text for word in spoken] == [word for word, *_ in SPOKEN]
    assert next(word.start for word in found.words or () if word.text == "2266") == 0.3


def test_words_without_times_stay_within_their_segment(tmp_path: Path) -> None:
    content = samples.faster_whisper(SPOKEN)
    content[0]["words"][2:] = [{"word": word["word"]} for word in content[0]["words"][2:]]
    found = _read(tmp_path, ".json", json.dumps(content)).words or ()
    assert [word.text for word in found] == [word for word, *_ in SPOKEN]
    assert found[3].end == pytest.approx(1.4) and found[4].start == pytest.approx(1.4)


@pytest.mark.parametrize(("content", "said"), [
    # Hundredths of seconds, minutes, and a list whose words come many times.
    ([{"word": "a", "start": 40.5 * n, "end": 40.5 * n + 30.5} for n in range(20)], "half of its words last over 30 s"),
    ([{"word": "a", "start": n / 150, "end": (n + 1) / 150} for n in range(79)], "79 words in 0.53 s are more than"),
    ({"results": {"channels": [{"alternatives": [{"words": [{"word": "a", "start": 0, "end": 1}]}]}] * 2}},
     "the words of 2 channels"),
    ({"results": {"channels": [{"alternatives": [{"words": [{"word": "a", "start": "x", "end": 1}]}]}]}},
     "results.channels[0].alternatives[0].words[0].start: 'x' is not a time"),
    ({"transcription": [{"text": "a", "offsets": {"from": 0, "to": 9}}, {"text": " b c"}]},
     "transcription[1]: has no times"),
    ({"chunks": [{"text": "a", "timestamp": [0, 1]}, {"text": "b c", "timestamp": 3}]}, "chunks[1]: has no times"),
    ({"results": [{"alternatives": [{"words": [{"word": "a", "endTime": "1:5"}]}]}]}, "'1:5' is not a time"),
    ({"chapters": []}, "neither words nor segments"),
    ([{"audio_filepath": name, "pred_text": name} for name in ("a.wav", "b.wav")], "the words of several recordings"),
])
def test_what_cannot_be_used_is_refused(content: Any, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        _read(tmp_path, ".json", json.dumps(content))
    assert said in str(caught.value)


@pytest.mark.parametrize(("root", "times", "start", "end"), [
    ("", "begin='00:01:01.5' xml:id='a' end='00:01:02'", 61.5, 62), ("", 'dur="0.5s" begin="1.5s"', 1.5, 2),
    ("", 'begin="250ms" end="0.1m"', .25, 6), ("", 'begin="59" end="1:04"', 59, 64),
    ('p:frameRate="25"', 'begin="00:00:01:05" end="50f"', 1.2, 2),
    # A tick is a second, or a frame where their rate is given.
    ("", 'begin="1t" end="2t"', 1, 2), ('p:frameRate="24"', 'begin="12t" end="48t"', .5, 2),
    ('p:tickRate="90000"', 'begin="45000t" dur="90000t"', .5, 1.5),
    # At 29.97 frames a second; as a time code, 30 of them are called a second.
    ('p:frameRate="30" p:frameRateMultiplier="1000 1001"', 'begin="1800f" end="00:01:01:15"', 60.06, 61.5005),
])
def test_times_of_ttml(root: str, times: str, start: float, end: float, tmp_path: Path) -> None:
    text = f"<tt:tt xmlns:tt='tt' xmlns:p='p' {root}>\n" + (
        f"<tt:p {times}>so<tt:br/>be\n it &amp; <tt:metadata>not</tt:metadata>on</tt:p></tt:tt>")
    [cue] = _read(tmp_path, ".dfxp", text).cues
    assert (cue.text, cue.start, cue.end) == ("so be it & on", pytest.approx(start), pytest.approx(end))


@pytest.mark.parametrize("times", [
    # By the standard, and as lyrics have them.
    ("10s", "5s", "0.5s", "1s", "0.25s"), ("10s", "15s", "15.5s", "16s", "15.75s")])
def test_times_of_ttml_count_from_what_is_around_or_from_the_recording(times: tuple[str, ...], tmp_path: Path) -> None:
    text = ('<tt><body begin="{}"><div begin="{}"><p begin="{}" end="{}">so <span begin="{}">it</span></p>'
            "</div></body></tt>").format(*times)
    found = _read(tmp_path, ".ttml", text).words or ()
    assert [(word.text, word.start, word.end) for word in found] == [("so", 15.5, 15.75), ("it", 15.75, 16.0)]


@pytest.mark.parametrize(("content", "said"), [
    ("<tt>\n<p begin='1s' end='2s'>a</tt>", "is not XML (mismatched tag: line 2, column"),
    ("<tt>\n\n<p begin='1 o&apos;clock'>a</p></tt>", "\"1 o'clock\" is not a time"),
    ("<tt frameRate='0'/>", "has a rate of frames or ticks that is no number above 0"), ("<tt/>", "has no words"),
    ("<tt><p begin='2s' end='1s'>a</p></tt>", "the line 'a': ends at 1 s, before it starts at 2 s"),
    ("<p>" + "<span>" * 9999 + "</span>" * 9999 + "</p>", "has no words"),
])
def test_broken_ttml_is_refused(content: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        _read(tmp_path, ".ttml", content)


@pytest.mark.parametrize(("content", "said"), [
    ("begin\tend\ttext\n", "line 1: does not name"), ("start\tend\ttext\n1\t2\n", "line 2: is not a start"),
    ("start\tend\ttext\n1\tx\ta\n", "line 2: is not a start"), ("start\tend\ttext\n", "has no words"),
    ("start\tend\ttext\n1\t1" + "0" * 400 + "\ta\n", "line 2: inf s is no time"),
])
def test_broken_tables_are_named_by_line(content: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        _read(tmp_path, ".tsv", content)
    assert said in str(caught.value)


def test_a_token_without_times_leaves_the_end_of_its_word(tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    file.write_text(json.dumps({"transcription": [
        {"offsets": {"from": 100, "to": 300}, "text": " hel"}, {"text": "lo"},
        {"offsets": {"from": 400, "to": 600}, "text": " there"}]}))
    words = read_transcript(file).words
    assert words is not None
    assert [(word.text, word.start, word.end) for word in words] == [("hello", 0.1, 0.3), ("there", 0.4, 0.6)]


def test_texts_in_a_script_without_spaces_are_spread_over_their_tokens(tmp_path: Path) -> None:
    part = samples.whisper([("今天天气很好", 0.0, 1.2)])
    found = _read(tmp_path, ".json", json.dumps(part))
    assert found.words is not None and found.words[0].start == 0.0 and found.words[-1].end == 1.2
    assert "".join(word.text for word in found.words) == "今天天气很好"
    assert _read(tmp_path, ".json", json.dumps(samples.whisperx(SPOKEN))).timing == "words"


def test_a_nameless_part_is_no_list_of_words(tmp_path: Path) -> None:
    items = [{"text": "hello", "start": 0.1, "": 0.3}, {"text": "there", "start": 0.3, "end": 0.5}]
    with pytest.raises(InputError, match=r"\[0\].end: .* is not a time"):
        _read(tmp_path, ".json", json.dumps(items))
