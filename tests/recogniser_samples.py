"""The files that recognisers write for the same words, as their documentation describes them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

Words: TypeAlias = Sequence[tuple[str, float, float]]
"""(word, start, end), seconds; times of whole milliseconds."""


def _ms(seconds: float) -> int:
    return round(seconds * 1000)


def _ticks(seconds: float) -> int:
    return round(seconds * 1000) * 10_000


def _text(words: Words) -> str:
    return " ".join(word for word, _, _ in words)


def _plain(words: Words, key: str = "word", **more: Any) -> list[dict[str, Any]]:
    return [{key: word, "start": start, "end": end, **more} for word, start, end in words]


def _parts(words: Words) -> list[Words]:
    """Two segments, as all but short recordings have."""
    half = (len(words) + 1) // 2
    return [part for part in (words[:half], words[half:]) if part]


def _clock(seconds: float, comma: str = ",") -> str:
    milliseconds = _ms(seconds)
    whole, rest = divmod(milliseconds, 1000)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}{comma}{rest:03d}"


def openai_words(words: Words) -> Any:
    """The interface's verbose_json with times of words."""
    return {"task": "transcribe", "language": "english", "duration": words[-1][2], "text": _text(words),
            "words": _plain(words), "segments": None, "usage": {"type": "duration", "seconds": 4}}


def whisper(words: Words) -> Any:
    """The program whisper with --word_timestamps True."""
    segments = [{"id": n, "seek": 0, "start": part[0][1], "end": part[-1][2], "text": " " + _text(part),
                 "tokens": [50364, 2425], "temperature": 0.0, "avg_logprob": -0.3, "compression_ratio": 1.1,
                 "no_speech_prob": 0.01, "words": [{"word": " " + word, "start": start, "end": end,
                                                    "probability": 0.9} for word, start, end in part]}
                for n, part in enumerate(_parts(words))]
    return {"text": " " + _text(words), "segments": segments, "language": "en"}


def faster_whisper(words: Words) -> Any:
    """Its segments as dictionaries, in a list."""
    return [{**segment, "words": [{**word} for word in segment["words"]]} for segment in whisper(words)["segments"]]


def whisperx(words: Words) -> Any:
    return {"segments": [{"start": part[0][1], "end": part[-1][2], "text": _text(part),
                          "words": _plain(part, score=0.9)} for part in _parts(words)],
            "word_segments": _plain(words, score=0.9), "language": "en"}


def _cpp(text: str, start: float, end: float, **more: Any) -> dict[str, Any]:
    return {"timestamps": {"from": _clock(start), "to": _clock(end)}, "offsets": {"from": _ms(start), "to": _ms(end)},
            "text": text, **more}


def _halves(word: str, start: float, end: float) -> list[dict[str, Any]]:
    """The tokens of a word: its first letter and the rest, as the byte pairs of whisper cut words."""
    middle = _ms((start + end) / 2) / 1000
    return [_cpp(" " + word[:1], start, middle if word[1:] else end, id=1, p=0.9)] + (
        [_cpp(word[1:], middle, end, id=2, p=0.9)] if word[1:] else [])


def whisper_cpp(words: Words) -> Any:
    """With -ojf: tokens, some of which are marks."""
    segments = []
    for part in _parts(words):
        start, end = part[0][1], part[-1][2]
        tokens = [_cpp("[_BEG_]", start, start, id=50363, p=0.8),
                  *(token for word in part for token in _halves(*word)), _cpp("[_TT_150]", end, end, id=50513, p=0.1)]
        segments.append(_cpp(" " + _text(part), start, end, tokens=tokens))
    return {"systeminfo": "AVX = 1", "model": {"type": "base"}, "params": {"model": "ggml-base.en.bin"},
            "result": {"language": "en"}, "transcription": segments}


def whisper_cpp_words(words: Words) -> Any:
    """With -oj -ml 1: each token is a segment."""
    return {"result": {"language": "en"}, "transcription": [token for word in words for token in _halves(*word)]}


def vosk(words: Words) -> Any:
    return {"result": _plain(words, conf=1.0), "text": _text(words)}


def transformers(words: Words) -> Any:
    return {"text": " " + _text(words),
            "chunks": [{"text": " " + word, "timestamp": [start, end]} for word, start, end in words]}


def deepgram(words: Words) -> Any:
    spoken = [{"word": word.lower().strip(".,"), "start": start, "end": end, "confidence": 0.99,
               "punctuated_word": word} for word, start, end in words]
    return {"metadata": {"request_id": "a", "duration": words[-1][2], "channels": 1},
            "results": {"channels": [{"alternatives": [{"transcript": _text(words), "confidence": 0.99,
                                                        "words": spoken}]}]}}


def assemblyai(words: Words) -> Any:
    return {"id": "a", "status": "completed", "acoustic_model": "assemblyai_default", "audio_duration": 4,
            "text": _text(words), "utterances": None,
            "words": [{"text": word, "start": _ms(start), "end": _ms(end), "confidence": 0.97, "speaker": None}
                      for word, start, end in words]}


def assemblyai_words(words: Words) -> Any:
    """Its words alone, which nothing but their size shows to be in milliseconds."""
    return {"words": assemblyai(words)["words"]}


def google(words: Words) -> Any:
    """Version 1, of a long operation; a start at 0 s may be left out."""
    return {"name": "6212202767953098955", "done": True, "response": {
        "@type": "type.googleapis.com/google.cloud.speech.v1.LongRunningRecognizeResponse",
        "results": [{"alternatives": [{"transcript": _text(part), "confidence": 0.9, "words": [
            {**({"startTime": f"{start:.3f}s"} if start else {}), "endTime": f"{end:.3f}s", "word": word}
            for word, start, end in part]}], "resultEndTime": f"{part[-1][2]:.3f}s", "languageCode": "en-us"}
            for part in _parts(words)]}}


def google_2(words: Words) -> Any:
    """Version 2, of a batch, by file."""
    results = [{"alternatives": [{"transcript": _text(part), "words": [
        {"startOffset": f"{start:.3f}s", "endOffset": f"{end:.3f}s", "word": word} for word, start, end in part]}],
        "resultEndOffset": f"{part[-1][2]:.3f}s"} for part in _parts(words)]
    return {"results": {"gs://a/b.wav": {"inlineResult": {"transcript": {"results": results}}}}}


def google_speakers(words: Words) -> Any:
    """With speakers told apart: the last result has all words once more."""
    content = google(words)
    results = content["response"]["results"]
    spoken = [{**word, "speakerTag": 1} for result in results for word in result["alternatives"][0]["words"]]
    return {"results": [*results, {"alternatives": [{"words": spoken}]}]}


def google_protobuf(words: Words) -> Any:
    """As the Python package turns messages to dictionaries."""
    def time(seconds: float) -> dict[str, Any]:
        return {"seconds": str(_ms(seconds) // 1000), "nanos": _ms(seconds) % 1000 * 1_000_000}

    return {"results": [{"alternatives": [{"transcript": _text(words), "words": [
        {"word": word, "start_time": time(start), "end_time": time(end)} for word, start, end in words]}]}]}


def _items(words: Words, word: str, times: Callable[[float], Any]) -> list[dict[str, Any]]:
    """Words and punctuation apart. word: the type of words; times: what a time in seconds is written as."""
    out: list[dict[str, Any]] = []
    for text, start, end in words:
        out.append({"type": word, "start_time": times(start), "end_time": times(end),
                    "alternatives": [{"confidence": 0.9, "content": text.rstrip(",.")}]})
        if text[-1] in ",.":
            out.append({"type": "punctuation", "attaches_to": "previous", "alternatives": [{"content": text[-1]}]})
    return out


def aws(words: Words) -> Any:
    return {"jobName": "a", "status": "COMPLETED", "results": {
        "transcripts": [{"transcript": _text(words)}], "items": _items(words, "pronunciation", str),
        "audio_segments": [{"id": 0, "transcript": _text(words), "start_time": str(words[0][1]),
                            "end_time": str(words[-1][2]), "items": [0, 1]}]}}


def speechmatics(words: Words) -> Any:
    return {"format": "2.9", "job": {"duration": 4}, "metadata": {"type": "transcription"},
            "results": _items(words, "word", float)}


def elevenlabs(words: Words) -> Any:
    spoken = [part for word in _plain(words, "text", type="word", speaker_id="speaker_0")
              for part in (word, {"text": " ", "start": word["end"], "end": word["end"], "type": "spacing"})]
    return {"language_code": "eng", "text": _text(words), "words": [
        *spoken, {"text": "(laughter)", "start": words[-1][2], "end": words[-1][2] + 1, "type": "audio_event"}]}


def gladia(words: Words) -> Any:
    utterances = [{"start": part[0][1], "end": part[-1][2], "channel": 0, "text": _text(part),
                   "words": [{**word, "word": " " + word["word"]} for word in _plain(part)]} for part in _parts(words)]
    return {"id": "a", "status": "done", "result": {"metadata": {"audio_duration": 4}, "transcription": {
        "full_transcript": _text(words), "utterances": utterances}}}


def _steps(words: Words) -> list[dict[str, Any]]:
    return [{**word, "start_offset": n, "end_offset": n + 1} for n, word in enumerate(_plain(words))]


def nemo(words: Words) -> Any:
    """A hypothesis; offsets are in steps of the model."""
    segments = [{"segment": _text(part), "start": part[0][1], "end": part[-1][2]} for part in _parts(words)]
    return {"text": _text(words), "timestamp": {"timestep": [0], "word": _steps(words), "segment": segments}}


def nemo_manifest(words: Words) -> Any:
    return {"audio_filepath": "a.wav", "pred_text": _text(words), "timestamps_char": [], "timestamps_word":
            _steps(words), "timestamps_segment": nemo(words)["timestamp"]["segment"]}


def nemo_speakers(words: Words) -> Any:
    return {"status": "Success", "session_id": "a", "transcription": _text(words), "words": [
        {"word": word, "start_time": start, "end_time": end, "speaker": "speaker_0"} for word, start, end in words]}


def azure(words: Words) -> Any:
    """The SDK's detailed results."""
    silence = {"RecognitionStatus": "InitialSilenceTimeout", "Offset": 0, "Duration": 10**7}
    return [silence, {"Id": "a", "RecognitionStatus": "Success", "Offset": _ticks(words[0][1]), "Channel": 0,
                      "Duration": _ticks(words[-1][2] - words[0][1]), "DisplayText": _text(words), "NBest": [{
                          "Confidence": 0.9, "Lexical": _text(words), "Display": _text(words), "Words": [
                              {"Word": word, "Offset": _ticks(start), "Duration": _ticks(end) - _ticks(start)}
                              for word, start, end in words]}]}]


def azure_batch(words: Words) -> Any:
    def times(start: float, end: float) -> dict[str, Any]:
        return {"offset": f"PT{start}S", "duration": f"PT{end - start}S", "offsetInTicks": float(_ticks(start)),
                "durationInTicks": float(_ticks(end) - _ticks(start))}

    return {"source": "https://example.com/a.wav", "duration": "PT4S", "combinedRecognizedPhrases": [{
        "channel": 0, "lexical": _text(words)}], "recognizedPhrases": [{
            "recognitionStatus": "Success", "channel": 0, "speaker": 1, **times(part[0][1], part[-1][2]),
            "nBest": [{"confidence": 0.9, "lexical": _text(part), "display": _text(part), "words": [
                {"word": word, **times(start, end), "confidence": 0.9} for word, start, end in part]}]}
            for part in _parts(words)]}


def azure_fast(words: Words) -> Any:
    def times(start: float, end: float) -> dict[str, Any]:
        return {"offsetMilliseconds": _ms(start), "durationMilliseconds": _ms(end) - _ms(start)}

    return {"durationMilliseconds": 4000, "combinedPhrases": [{"text": _text(words)}], "phrases": [
        {**times(part[0][1], part[-1][2]), "text": _text(part), "locale": "en-US", "confidence": 0.9,
         "words": [{"text": word, **times(start, end)} for word, start, end in part]} for part in _parts(words)]}


def mfa(words: Words) -> Any:
    return {"start": 0, "end": 4.0, "tiers": {
        "words": {"type": "interval", "entries": [[start, end, word] for word, start, end in words]},
        "phones": {"type": "interval", "entries": [[0.0, 0.1, "spn"]]}}}


JSON: dict[str, Callable[[Words], Any]] = {
    "openai": openai_words, "whisper": whisper, "faster-whisper": faster_whisper, "whisperx": whisperx, "vosk": vosk,
    "whisper.cpp": whisper_cpp, "whisper.cpp -ml 1": whisper_cpp_words,
    "assemblyai": assemblyai, "assemblyai, words": assemblyai_words, "google": google, "google, version 2": google_2,
    "google, speakers": google_speakers, "google, protobuf": google_protobuf, "azure": azure,
    "azure, batch": azure_batch, "azure, fast": azure_fast, "mfa": mfa, "transformers": transformers, "aws": aws,
    "speechmatics": speechmatics, "elevenlabs": elevenlabs, "gladia": gladia, "deepgram": deepgram,
    "dashscope": lambda words: {"transcripts": [{"channel_id": 0, "sentences": [{
        "begin_time": _ms(words[0][1]), "end_time": _ms(words[-1][2]), "words": [
            {"begin_time": _ms(start), "end_time": _ms(end), "text": word} for word, start, end in words]}]}]},
    "soniox": lambda words: {"text": _text(words), "tokens": [
        {"text": f" {word}", "start_ms": _ms(start), "end_ms": _ms(end)} for word, start, end in words]},
    "nemo": nemo, "nemo, manifest": nemo_manifest, "nemo, speakers": nemo_speakers,
    "list": lambda words: _plain(words, "text"), "text": lambda words: {"text": _text(words)},
}
"""Sample -> what writes it; all but "text" have the times of words."""


# ---------------------------------------------------------------------------------------------------- subtitles

def _cue(number: int, start: float, end: float, text: str, comma: str) -> str:
    return f"{number}\n{_clock(start, comma)} --> {_clock(end, comma)}\n{text}\n"


def _highlighted(words: Words, opened: str, closed: str, comma: str) -> str:
    """As whisper highlights words: a cue for each word, and one without a highlight for each pause between."""
    cues: list[tuple[float, float, str]] = []
    for part in _parts(words):
        last = part[0][1]
        for n, (_, start, end) in enumerate(part):
            if last != start:
                cues.append((last, start, _text(part)))
            line = " ".join(f"{opened}{word}{closed}" if k == n else word for k, (word, _, _) in enumerate(part))
            cues.append((start, end, line))
            last = end
    return "\n".join(_cue(n, *cue, comma) for n, cue in enumerate(cues, 1))


def srt_highlighted(words: Words) -> str:
    return _highlighted(words, "<u>", "</u>", ",")


def srt_coloured(words: Words) -> str:
    """As stable-ts highlights words."""
    return _highlighted(words, '<font color="#00ff00">', "</font>", ",")


def vtt_highlighted(words: Words) -> str:
    return "WEBVTT\n\n" + _highlighted(words, "<u>", "</u>", ".")


def vtt_rolling(words: Words) -> str:
    """Rolling captions: a time before each word but the first, and the line before above each."""
    out, above = ["WEBVTT\nKind: captions\nLanguage: en\n"], " "
    for part in _parts(words):
        line = part[0][0] + "".join(f"<{_clock(start, '.')}><c> {word}</c>" for word, start, _ in part[1:])
        start, end = part[0][1], part[-1][2]
        out.append(f"{_clock(start, '.')} --> {_clock(end, '.')} align:start position:0%\n{above}\n{line}\n")
        out.append(f"{_clock(end, '.')} --> {_clock(end, '.')} align:start position:0%\n{_text(part)}\n \n")
        above = _text(part)
    return "\n".join(out)


def srt(words: Words) -> str:
    return "\n".join(_cue(n, part[0][1], part[-1][2], _text(part), ",") for n, part in enumerate(_parts(words), 1))


def vtt(words: Words) -> str:
    return "WEBVTT\n\n" + "\n".join(_cue(n, part[0][1], part[-1][2], _text(part), ".")
                                   for n, part in enumerate(_parts(words), 1))


def tsv(words: Words) -> str:
    """As whisper writes it: milliseconds."""
    return "start\tend\ttext\n" + "".join(f"{_ms(part[0][1])}\t{_ms(part[-1][2])}\t{_text(part)}\n"
                                          for part in _parts(words))


def _lines(words: Words, form: str, newline: str = " ") -> str:
    """form: of a line with its start, its end and its text, in which `newline` is the first space."""
    return "".join(form.format(_clock(part[0][1], "."), _clock(part[-1][2], "."), _text(part).replace(" ", newline, 1))
                   for part in _parts(words))


def lrc(words: Words) -> str:
    """Enhanced: the time of each word in its line."""
    return "[ar:Nobody]\n" + "".join(f"[{_clock(part[0][1], '.')}]" + "".join(
        f" <{_clock(start, '.')}>{word}" for word, start, _ in part) + "\n" for part in _parts(words))


def ttml_words(words: Words) -> str:
    """A span for each word, whose times count from the beginning of its line."""
    return '<tt xmlns="http://www.w3.org/ns/ttml"><body><div>' + "".join(
        f'<p begin="{_ms(part[0][1])}ms" end="{part[-1][2]:.3f}s">' + " ".join(
            f'<span begin="{start - part[0][1]:.3f}s" dur="{_ms(end) - _ms(start)}ms">{word}</span>'
            for word, start, end in part) + "</p>" for part in _parts(words)) + "</div></body></tt>"


def ttml_syllables(words: Words) -> str:
    """As lyrics are written: all times count from the beginning of the recording, and a word may have several spans."""
    def span(text: str, start: float, end: float) -> str:
        return f'<span begin="{_ms(start) * 10_000}t" end="{_ms(end) * 10_000}t">{text}</span>'

    lines = []
    for part in _parts(words):
        halves = [[half["offsets"] | half for half in _halves(*word)] for word in part]
        spans = " ".join("".join(span(half["text"].strip(), half["from"] / 1000, half["to"] / 1000) for half in word)
                         for word in halves)
        lines.append(f'<p begin="{_clock(part[0][1], ".")}" end="{_clock(part[-1][2], ".")}">{spans}</p>')
    return ('<tt xmlns="http://www.w3.org/ns/ttml" xmlns:p="http://www.w3.org/ns/ttml#parameter" '
            'p:tickRate="10000000"><body><div>' + "".join(lines) + "</div></body></tt>")


def ass_coloured(words: Words) -> str:
    """As NeMo's aligner highlights words: the line anew for each."""
    return "".join(
        f"Dialogue: 0,{_clock(start, '.')},{_clock(end, '.')},Default,,0,0,0,," + " ".join(
            f"{{\\c&H{'09ab39' if k == n else 'c7c1c2'}&}}{word}{{\\r}}" for k, (word, _, _) in enumerate(part)) + "\n"
        for part in _parts(words) for n, (_, start, end) in enumerate(part))


FILES: dict[str, tuple[str, Callable[[Words], str]]] = {
    **{name: (".json", lambda words, write=write: json.dumps(write(words))) for name, write in JSON.items()},
    "srt, highlighted": (".srt", srt_highlighted), "srt, coloured": (".srt", srt_coloured),
    "vtt, highlighted": (".vtt", vtt_highlighted), "vtt, rolling": (".vtt", vtt_rolling),
    "srt": (".srt", srt), "vtt": (".vtt", vtt), "tsv": (".tsv", tsv), "lrc": (".lrc", lrc),
    "ass": (".ass", lambda words: _lines(words, "Dialogue: 0,{},{},Default,,0,0,0,,{{\\i1}}{}\n", "\\N")),
    "ass, coloured": (".ass", ass_coloured), "sbv": (".sbv", lambda words: _lines(words, "{},{}\n{}\n\n")),
    "ttml": (".ttml", lambda words: '<tt xmlns="http://www.w3.org/ns/ttml">' + _lines(
        words, '<p begin="{}" xml:id="c" end="{}"><span>{}</span></p>', "<br/>") + "</tt>"),
    "csv": (".csv", lambda words: "start,end,text\n" + "".join(
        f'{_ms(part[0][1])},{_ms(part[-1][2])},"{_text(part)}"\n' for part in _parts(words))),
    "jsonl, nemo's manifest": (".jsonl", lambda words: "".join(json.dumps(
        {"audio_filepath": "a.wav", "offset": part[0][1], "duration": part[-1][2] - part[0][1], "text": _text(part)}
    ) + "\n" for part in _parts(words))),
    "ttml, words": (".ttml", ttml_words), "ttml, syllables": (".dfxp", ttml_syllables),
    "ctm": (".ctm", lambda words: "".join(f"a 1 {a:.3f} {b - a:.3f} {word} 0.9\n" for word, a, b in words)),
}
"""Sample -> its suffix, and what writes it."""
WITHOUT_TIMES = {"srt", "vtt", "tsv", "text", "ass", "ass, coloured", "sbv", "ttml", "csv", "jsonl, nemo's manifest"}
"""Samples without the times of words."""
