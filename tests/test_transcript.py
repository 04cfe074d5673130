"""Transcripts: every format by hand, what is broken is named, and real readings get the times they have."""

import json
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import recogniser_samples as samples
from hypothesis import example, given, settings
from hypothesis import strategies as st

from data_module.errors import InputError, install_line
from data_module.speech.audio import load_speech
from data_module.text import alignment as text
from data_module.text.marks import EMOJI
from data_module.text.transcript import Transcript, read_transcript, with_transcript
from data_module.text.word_vectors import _parted
from data_module.types import Speech, Word
from tests.hanging import never_hangs

RATE = 16000
WORDS = (Word("", 0.0, 0.25), Word("he said", 0.25, 0.5), Word('"no"', 0.5, 1.0), Word("naïve", 1.0, 1.5),
         Word("", 1.5, 2.0))


def _noise(seconds: float, speaker: str | None = None) -> Speech:
    samples = 0.1 * np.random.default_rng(0).standard_normal(round(seconds * RATE))
    return Speech(samples.astype(np.float32), RATE, speaker=speaker)


def _long(tiers: dict[str, Sequence[Word]], end: float) -> str:
    lines = ['File type = "ooTextFile"', 'Object class = "TextGrid"', "", "xmin = 0 ", f"xmax = {end} ",
             "tiers? <exists> ", f"size = {len(tiers)} ", "item []: "]
    for n, (name, words) in enumerate(tiers.items(), start=1):
        lines += [f"    item [{n}]:", '        class = "IntervalTier" ', f'        name = "{name}" ',
                  "        xmin = 0 ", f"        xmax = {end} ", f"        intervals: size = {len(words)} "]
        for k, word in enumerate(words, start=1):
            lines += [f"        intervals [{k}]:",
                      f"            xmin = {word.start} ", f"            xmax = {word.end} ",
                      '            text = "{}" '.format(word.text.replace('"', '""'))]
    return "\n".join(lines) + "\n"


def _short(tiers: dict[str, Sequence[Word]], end: float) -> str:
    lines = ['File type = "ooTextFile"', 'Object class = "TextGrid"', "", "0", f"{end}", "<exists>", f"{len(tiers)}"]
    for name, words in tiers.items():
        lines += ['"IntervalTier"', f'"{name}"', "0", f"{end}", f"{len(words)}"]
        for word in words:
            lines += [f"{word.start}", f"{word.end}", '"{}"'.format(word.text.replace('"', '""'))]
    return "\n".join(lines) + "\n"


def _read(folder: Path, name: str, content: str | bytes, speech: Speech | None = None) -> Transcript:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_transcript(path, speech)


def _refusal(folder: Path, name: str, content: str | bytes, speech: Speech | None = None) -> str:
    with pytest.raises(InputError) as caught:
        _read(folder, name, content, speech)
    line = str(caught.value)
    assert line.startswith(str(folder / name)) and "\n" not in line
    return line.removeprefix(str(folder / name) + ": ")


@pytest.mark.parametrize("write", [_long, _short])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_textgrid_in_both_forms(tmp_path: Path, write: Callable[..., str], encoding: str) -> None:
    content = write({"phones": [Word("h", 0.0, 2.0)], "anna - words": WORDS}, 2.0)
    found = _read(tmp_path, "a.TextGrid", content.replace("\n", "\r\n").encode(encoding))
    assert found.words == WORDS and found.timing == "words" and not found.notes
    assert found.text == 'he said "no" naïve'


LINE = st.lists(st.from_regex("[a-gé][a-gß']{0,8}", fullmatch=True), min_size=1, max_size=6)
PIECES = st.lists(st.tuples(LINE, st.integers(0, 200), st.integers(5, 400)), min_size=1, max_size=8)
"""Words, the pause before them and their length, in hundredths of seconds."""


def _lines(drawn: Sequence[tuple[list[str], int, int]]) -> list[tuple[float, float, list[str]]]:
    ends = np.cumsum([pause + length for _, pause, length in drawn])
    return [(float(end - length) / 100, float(end) / 100, words)
            for end, (words, _, length) in zip(ends, drawn, strict=True)]


@settings(max_examples=20)
@given(drawn=PIECES, long=st.booleans(), blanks=st.booleans())
def test_textgrids_are_read_as_praatio_reads_and_writes_them(tmp_path_factory: pytest.TempPathFactory,
                                                             drawn: list[tuple[list[str], int, int]], long: bool,
                                                             blanks: bool) -> None:
    textgrid = pytest.importorskip("praatio.textgrid")
    grid, path, lines = textgrid.Textgrid(), tmp_path_factory.mktemp("grid") / "a.TextGrid", _lines(drawn)
    end = lines[-1][1] + 1.0
    grid.addTier(textgrid.IntervalTier("words", [(a, b, "-".join(words)) for a, b, words in lines], 0, end))
    grid.addTier(textgrid.PointTier("beats", [(0.5 * end, "H*")], 0, end))
    grid.save(str(path), "long_textgrid" if long else "short_textgrid", includeBlankSpaces=blanks)
    theirs = textgrid.openTextgrid(str(path), includeEmptyIntervals=True).getTier("words").entries
    ours = read_transcript(path).words or ()
    assert [(w.start, w.end, w.text) for w in ours] == [tuple(entry) for entry in theirs]
    assert [w.text for w in ours if w.text] == ["-".join(words) for *_, words in lines]


@settings(max_examples=20)
@given(drawn=PIECES)
def test_subtitles_are_read_as_pysubs2_reads_and_writes_them(tmp_path_factory: pytest.TempPathFactory,
                                                             drawn: list[tuple[list[str], int, int]]) -> None:
    """Whole files, that is. Neither it nor praatio takes the place of our readers: a file that is cut off or has a
    broken time reads as a whole one there, without a word; pysubs2 takes the names of WebVTT's cues for speech, and
    knows no SBV and no LRC."""
    pysubs2 = pytest.importorskip("pysubs2")
    folder, lines = tmp_path_factory.mktemp("subs"), _lines(drawn)
    file = pysubs2.SSAFile()
    file.events = [pysubs2.SSAEvent(round(1000 * a), round(1000 * b), "\\N".join(
        " ".join(half) for half in (words[:2], words[2:]) if half)) for a, b, words in lines]
    said = [(pytest.approx(a), pytest.approx(b), " ".join(words)) for a, b, words in lines]
    for suffix, kind in ((".srt", "srt"), (".vtt", "vtt"), (".ass", "ass"), (".ssa", "ssa"), (".ttml", "ttml")):
        assert [(cue.start, cue.end, cue.text)
                for cue in _read(folder, "a" + suffix, file.to_string(kind)).cues] == said, kind
    words = [(" ".join(words), a, b) for a, b, words in lines]
    for kind in ("srt", "vtt"):
        text = samples.FILES[kind][1](words)
        assert [(cue.start, cue.end, cue.text) for cue in _read(folder, "b." + kind, text).cues] == [
            (event.start / 1000, event.end / 1000, event.text) for event in pysubs2.SSAFile.from_string(text, kind)]


def test_broken_textgrids_are_refused(tmp_path: Path) -> None:
    whole = _long({"words": WORDS}, 2.0)
    for broken in (whole[:-80], _short({"words": WORDS}, 2.0)[:-30], whole.replace("xmin = 0.5 ", "xmin = abc "),
                   whole.replace("intervals: size = 5", "intervals: size = 6"), '"something" "else"',
                   whole.replace('text = "" ', "text = 7 ", 1), whole.replace("size = 5", "size = 1e300"),
                   whole.replace("<exists>", "<absent>")):
        assert "is not a whole TextGrid" in _refusal(tmp_path, "a.TextGrid", broken)
    assert "no time of a recording" in _refusal(tmp_path, "a.TextGrid", whole.replace("xmin = 0.5 ", "xmin = 1e999 "))
    assert "its tiers: phones" in _refusal(tmp_path, "a.TextGrid", _short({"phones": WORDS}, 2.0))
    assert "has no words" in _refusal(tmp_path, "a.TextGrid", _short({"words": [Word("", 0.0, 2.0)]}, 2.0))
    backward = [Word("one", 0.0, 0.5), Word("two", 0.5, 1.0)]
    content = _short({"words": backward}, 1.0).replace("0.5\n1.0\n", "0.5\n0.2\n")
    assert "interval 2 of words: ends at 0.2 s, before it starts at 0.5 s" in _refusal(tmp_path, "a.TextGrid", content)


def test_the_speaker_chooses_the_tier(tmp_path: Path) -> None:
    content = _long({"anna - words": [Word("yes", 0.0, 1.0)], "bert - words": [Word("no", 1.0, 2.0)]}, 2.0)
    assert "several speakers (anna - words, bert - words)" in _refusal(tmp_path, "a.TextGrid", content)
    found = _read(tmp_path, "a.TextGrid", content, _noise(2.0, "bert"))
    assert found.words == (Word("no", 1.0, 2.0),)


def test_subtitles(tmp_path: Path) -> None:
    srt = ("1\n00:00:00,500 --> 00:00:02,000\n- <i>I came,</i>\nI &amp; saw\n\n"
           "2\n00:00:02,000 --> 00:00:03,000\n[music]\n\n3\n00:01:00,250 --> 01:00:00,000\n{\\an8}Gone.\n")
    vtt = ("WEBVTT - a title\nKind: captions\n\nNOTE about\nnothing --> at all\n\n"
           "00:00.500 --> 00:02.000 align:start position:0%\n<v Anna>- I came,\nI &amp; saw\n\n"
           "named\n00:01:00.250 --> 01:00:00.000\nGone.\n")
    for name, content in (("a.srt", srt), ("a.VTT", vtt)):
        found = _read(tmp_path, name, content)
        assert found.timing == "cues" and found.words is not None
        assert [w.text for w in found.words] == ["I", "came", "I", "saw", "Gone"]
        # Shares of 1.5 s by letters + 1: I 2, came 5, I 2, saw 4.
        starts = [0.5 + 1.5 * n / 13 for n in (0, 2, 7, 9)]
        np.testing.assert_allclose([w.start for w in found.words], [*starts, 60.25], atol=1e-9)
        assert found.words[-1].end == 3600.0


def test_broken_subtitles_are_named_by_line(tmp_path: Path) -> None:
    good = "1\n00:00:00,500 --> 00:00:02,000\nhello\n\n"
    assert _refusal(tmp_path, "a.srt", good + "2\n00:00:0x --> 00:00:04\nworld\n").startswith("line 6: '00:00:0x")
    assert "line 6: ends at 2 s, before" in _refusal(tmp_path, "a.srt", good + "2\n00:00:03,0 --> 00:00:02,0\nworld\n")
    assert _read(tmp_path, "a.vtt", good).text == "hello"
    assert "has no words" in _refusal(tmp_path, "a.srt", good.replace("hello", "[Music]"))


def test_words_without_times_lie_between_their_neighbours(tmp_path: Path) -> None:
    """Recognisers leave out the times of what they could not place, such as "2014"."""
    told = [{"word": "in", "start": 0.5, "end": 0.7}, {"word": "2014"}, {"word": "or"},
            {"word": "then", "start": 1.3, "end": 1.6}, {"word": "end"}]
    found = _read(tmp_path, "a.json", json.dumps(told))
    assert found.guessed == 3 and found.words is not None
    np.testing.assert_allclose([(w.start, w.end) for w in found.words],
                               [(0.5, 0.7), (0.7, 1.0), (1.0, 1.3), (1.3, 1.6), (1.6, 1.9)])
    _, timing = with_transcript(_noise(3.0), found)
    assert timing.how == "given" and timing.guessed == 3 and "3 word times are estimates" in timing.note


@pytest.mark.parametrize(("content", "said"), [
    ('{"words": [}', "line 1: is not valid JSON"),
    ('{"words": [{"word": "a", "start": "0:01", "end": 2}]}', "words[0].start: '0:01' is not a time"),
    ('{"words": [{"word": "a", "start": 1, "end": NaN}]}', "is not valid JSON"),
    ('{"words": [{"word": "a", "start": 1}]}', "words[0].end: 'None' is not a time"),
    ('{"words": [{"word": "a", "start": true, "end": 2}]}', "words[0].start: 'True' is not a time"),
    ('{"words": [{"word": "a", "start": 1e999, "end": 2}]}', "out of range"),
    ('{"words": [{"word": "a", "start": ' + "9" * 400 + ', "end": 2}]}', "a number of 400 digits"),
    ('{"words": [{"start": 1, "end": 2}]}', "words[0]: has no word"),
    ('{"words": ["a"]}', "words[0]: is not an object"),
    ('{"words": []}', "neither words nor segments"),
    ('{"words": [{"word": "a", "start": -3, "end": -2}]}', "has no words"),
    ('{"segments": [{"text": "a", "start": 0, "end": 1}, {"text": "b"}]}', "segments[1]: has no times"),
    ('{"segments": [{"start": 0, "end": 1, "text": "a b", "words": [{"word": 5}]}]}', "segments[0].words[0]: has no w"),
    ('{"tiers": {"words": {"entries": [[0, 1]]}}}', "has no tier of words"),
    ('{"tiers": {"anna - words": {"entries": [[0, 1, "a"]]}, "bert - words": {"entries": [[0, 1, "b"]]}}}',
     "several speakers (anna - words, bert - words)"),
    ("3", "neither words nor segments"), ("[" * 100000, "nested more than 100 deep"),
    ("9" * 5000, "a number of 5000 digits"),
])
def test_broken_json_is_named(tmp_path: Path, content: str, said: str) -> None:
    assert said in _refusal(tmp_path, "a.json", content)


WORD = st.text(st.characters(exclude_categories=["C", "Z"], exclude_characters="[]<>" + "".join(EMOJI)), min_size=1,
               max_size=6)


@given(st.lists(st.tuples(WORD, st.floats(0, 2), st.floats(0.01, 2)), min_size=1, max_size=8))
@example([("a\"b", 0.0, 1.0)])
def test_json_words_round_trip(tmp_path_factory: pytest.TempPathFactory, drawn: list[tuple[str, float, float]]) -> None:
    words, at = [], 0.0
    for said, pause, length in drawn:
        words.append(Word(said, at + pause, at + pause + length))
        at = words[-1].end
    content = json.dumps({"words": [{"word": w.text, "start": w.start, "end": w.end} for w in words]})
    found = _read(tmp_path_factory.mktemp("json"), "a.json", content)
    assert found.words == tuple(words) and not found.notes
    again = _read(tmp_path_factory.mktemp("grid"), "a.TextGrid", _short({"words": words}, at))
    assert [(w.start, w.end) for w in again.words or ()] == [(w.start, w.end) for w in words]


def test_times_are_put_right_and_it_says_so(tmp_path: Path) -> None:
    told = [("two", 1.0, 1.6), ("one", -0.1, 0.9), ("three", 1.4, 2.2), ("late", 3.1, 3.2)]
    content = json.dumps([{"text": said, "start": a, "end": b} for said, a, b in told])
    found = _read(tmp_path, "a.json", content)
    assert found.words is not None and found.words[:3] == (
        Word("one", 0.0, 0.9), Word("two", 1.0, 1.4), Word("three", 1.4, 2.2))
    speech, timing = with_transcript(_noise(2.0), found)
    assert speech.words == (Word("one", 0.0, 0.9), Word("two", 1.0, 1.4), Word("three", 1.4, 2.0))
    assert timing.words == 3 and timing.note == (
        "3 words, times given; 1 of them began before the recording; the times were not in order and were sorted; "
        "1 of them overlapped the next and were cut; 1 of them left out after the end of the recording")


def test_the_transcript_of_another_recording_is_refused(tmp_path: Path) -> None:
    content = json.dumps([{"text": "later", "start": 500.5, "end": 501}])
    assert "after the end of the recording (2.0 s)" in _refusal(tmp_path, "a.json", content, _noise(2.0))
    with pytest.raises(InputError, match=r"a\.json: 1 of its 1 words come after"):
        with_transcript(_noise(2.0), _read(tmp_path, "a.json", content))


def test_western_subtitles_in_an_older_encoding_are_read_with_a_warning(tmp_path: Path) -> None:
    cue = "1\n00:00:00,500 --> 00:00:02,000\n«Où est le café»\n"
    with pytest.warns(UserWarning, match="a.srt: line 3: is not text in UTF-8, so it is read as windows-1252"):
        assert _read(tmp_path, "a.srt", cue.encode("latin-1")).text == "«Où est le café»"


def test_files_that_are_no_text(tmp_path: Path) -> None:
    assert "line 2: is not text in UTF-8" in _refusal(tmp_path, "a.txt", b"good\nb\x81d\n")
    assert "is not text" in _refusal(tmp_path, "a.txt", b"RIFF\0\0\0")
    assert "has no words" in _refusal(tmp_path, "a.txt", "")
    assert "has no words" in _refusal(tmp_path, "a.txt", "... -- !\n")
    assert "is not a supported transcript; give one of .txt" in _refusal(tmp_path, "a.wav", b"RIFF")
    with pytest.raises(InputError, match="does not exist"):
        read_transcript(tmp_path / "none.txt")
    (tmp_path / "folder.json").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        read_transcript(tmp_path / "folder.json")
    assert _read(tmp_path, "a.txt", b"\xef\xbb\xbfhello\r\nthere").text == "hello\nthere"


@pytest.mark.parametrize(("said", "count"), [("今天天气很好,我们去公园吧", 12), ("Größe läßt grüßen", 3), ("42", 1)])
def test_what_the_aligner_cannot_read_shares_out_the_sound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: str,
                                                           count: int) -> None:
    """It needs no aligner either; the words keep to the loud second of three."""
    monkeypatch.setitem(sys.modules, "pocketsphinx", None)
    speech = _noise(3.0)
    samples = speech.samples.copy()
    samples[:RATE] *= 0.001
    samples[2 * RATE:] *= 0.001
    speech, timing = with_transcript(Speech(samples, RATE), _read(tmp_path, "a.txt", said))
    assert timing.how == "guessed" and timing.guessed == timing.words == count
    assert "word times are estimates" in timing.note
    assert speech.words is not None and len(speech.words) == count
    assert speech.words[0].start == pytest.approx(1.0, abs=0.02)
    assert speech.words[-1].end == pytest.approx(2.0, abs=0.02)
    assert (np.diff([w.start for w in speech.words]) > 0).all()


def test_only_plain_english_needs_the_aligner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pocketsphinx", None)
    text._loaded_decoder.cache_clear()
    plain = _read(tmp_path, "a.txt", "hello there")
    with pytest.raises(InputError, match=re.escape(install_line("align"))):
        with_transcript(_noise(1.0), plain)
    cues = _read(tmp_path, "a.srt", "1\n00:00:00,000 --> 00:00:01,000\nhello there\n")
    speech, timing = with_transcript(_noise(1.0), cues)
    assert timing.how == "guessed" and [w.text for w in speech.words or ()] == ["hello", "there"]
    given_ = _read(tmp_path, "a.TextGrid", _long({"words": WORDS}, 2.0))
    assert with_transcript(_noise(2.0), given_)[1].how == "given"


def test_a_cue_that_is_not_heard_is_counted(outside_data: Path, tmp_path: Path) -> None:
    """The reading cut in two cues: its own text, and under the second half a text that is not spoken there."""
    pytest.importorskip("pocketsphinx")
    speech = load_speech(outside_data / "speech" / "en_austen_0870.flac")
    spoken = (outside_data / "speech" / "en_austen_0870.txt").read_text(encoding="utf-8")
    cues = [{"text": spoken, "start": 0, "end": speech.duration},
            {"text": "nothing of this is said", "start": speech.duration, "end": speech.duration + 1}]
    twice = Speech(np.concatenate([speech.samples, speech.samples[:RATE]]), RATE)
    path = tmp_path / "a.json"
    path.write_text(json.dumps(cues), encoding="utf-8")
    found, timing = with_transcript(twice, read_transcript(path, twice))
    assert found.words is not None and timing.how == "heard" and timing.guessed == 5
    assert timing.note == f"{timing.words} words, 5 word times are estimates: they are spread over their cues"
    assert all(word.start >= speech.duration for word in found.words[-5:])


def test_a_real_reading_in_every_format(outside_data: Path, tmp_path: Path) -> None:
    """Heard in the recording; the same words by lines of subtitles come out where the whole recording puts them."""
    pytest.importorskip("pocketsphinx")
    speech = load_speech(outside_data / "speech" / "en_sonnet_1.flac")
    source = outside_data / "speech" / "en_sonnet_1.txt"
    heard, timing = with_transcript(speech, read_transcript(source, speech))
    assert heard.words is not None and timing.how == "heard" and timing.guessed == 0
    assert timing.words == len(heard.words) == 108 and timing.note == "108 words, times aligned with the recording"

    path = tmp_path / "a.TextGrid"
    path.write_text(_long({"words": heard.words}, speech.duration), encoding="utf-8")
    assert with_transcript(speech, read_transcript(path, speech))[0].words == heard.words

    cues, at = [], 0
    for line in source.read_text(encoding="utf-8").splitlines():
        count = len(text.spoken_words(line))
        if count:
            first, last = heard.words[at], heard.words[at + count - 1]
            cues.append({"text": line, "start": max(0.0, first.start - 0.1), "end": last.end + 0.1})
            at += count
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"segments": cues}), encoding="utf-8")
    by_line, told = with_transcript(speech, read_transcript(path, speech))
    assert by_line.words is not None and [w.text for w in by_line.words] == [w.text for w in heard.words]
    assert told.how == "heard" and told.guessed <= 1  # the title, "I", alone in its cue
    apart = np.abs([a.start - b.start for a, b in zip(by_line.words, heard.words, strict=True)])
    assert np.median(apart) <= 0.02 and (apart < 0.1).mean() > 0.9


@pytest.mark.parametrize("other", ["en_austen_0880", "en_sonnet_2"])
def test_a_wrong_text_is_guessed_and_said_so(outside_data: Path, other: str) -> None:
    """A text much too long for the recording, and a short one that the aligner can always squeeze in somewhere."""
    pytest.importorskip("pocketsphinx")
    speech = load_speech(outside_data / "speech" / "en_austen_0870.flac")
    found, timing = with_transcript(speech, read_transcript(outside_data / "speech" / f"{other}.txt"))
    assert timing.how == "guessed" and timing.guessed == timing.words == len(found.words or ())
    assert "word times are estimates: the transcript" in timing.note
    assert all(0 <= w.start <= w.end <= speech.duration for w in found.words or ())


def test_long_numbers_words_and_marks_cost_no_time(tmp_path: Path) -> None:
    """Every reader is linear: 16,000 digits took seconds, and so did a word with as many dots in it."""
    head = ('File type = "ooTextFile"\nObject class = "TextGrid"\n\n0\n1\n<exists>\n1\n"IntervalTier"\n"words"\n'
            '0\n1\n1\n')
    with never_hangs():
        for tail in ("0\n" + "1" * 200_000 + "x\n", "0\n1\n" + '"' * 200_001):
            assert "is not a whole TextGrid" in _refusal(tmp_path, "a.TextGrid", head + tail)
        for words in ("a" + "." * 100_000 + "b", "a" * 100_000, "." * 100_000 + "a"):
            assert _parted(words, 0)[-1][1] == 0 and text.letters_to_sounds(words)
