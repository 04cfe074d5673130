"""Forced alignment of a transcript with its recording (RG 4.1.2).

The aligner is pocketsphinx (extra `align`). The recording is cut at pauses into pieces of at most ten seconds; each
piece is decoded along the chain of the remaining words. If words are left over, the whole recording is aligned with a
wide beam. If that fails too, they are left out where the others fit the sound, because the text goes on after it; else
all words are spread over the loud frames by their length. The result says so, and where the speech has no text.
"""

from __future__ import annotations

import functools
import importlib.util
import itertools
import re
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.registry import Requirement
from data_module.speech.audio import resample
from data_module.types import Speech, Word

if TYPE_CHECKING:
    from collections.abc import Sequence

ALIGNER_RATE = 16000
"""Sample rate of the aligner's acoustic model, hertz."""
FRAME = 0.01
"""Seconds per frame of the aligner, and of the loudness for the detection of pauses."""
LONGEST_PIECE = 10.0
"""Longest piece that is aligned at a time, seconds."""
SHORTEST_PAUSE = 0.15
"""Shortest pause at which the sound is cut, seconds."""
LONGEST_WIDE = 180.0
"""Longest recording for the wide beam, seconds: it takes about 0.15 s per second, more for longer recordings."""
GOES_ON, LEAST_FIT = 0.5, -1.25
"""Seconds of loud frames after the last word from which on a text stops early; least likelihood of the words of a text,
log10 a frame: -0.5 to -0.8 in readings with it, -1.0 with noise at -10 dB, -1.5 to -2.3 with another text."""
_Span = tuple[float, float, float]  # a word: start and end, seconds, and log10 of its likelihood
_WIDE_BEAM = {"beam": 1e-120, "pbeam": 1e-120, "wbeam": 1e-120}
_WORDS_PER_SECOND = 6
_KNOWN_LETTERS = frozenset("abcdefghijklmnopqrstuvwxyzéèêëïçàâ")
_STRANGE_WORDS = 0.05
# Scripts without spaces between words, and the longest stretch of them that counts as one word.
_UNSPACED, _LONGEST_UNSPACED = re.compile(r"[\u3040-\u30ff\u3400-\u9fff\uf900-\ufaff\U00020000-\U0003ffff]"), 4


# Letters to ARPABET sounds, longest match first; accurate enough for words outside the dictionary.
_SOUNDS = {
    "tion": "SH AH N", "sion": "ZH AH N", "ough": "AO", "augh": "AO", "eigh": "EY", "igh": "AY", "tch": "CH",
    "sch": "SH", "dge": "JH", "ch": "CH", "sh": "SH", "th": "TH", "ph": "F", "wh": "W", "ck": "K", "ng": "NG",
    "qu": "K W", "kn": "N", "wr": "R", "gh": "G", "ee": "IY", "ea": "IY", "ie": "IY", "ei": "EY", "ai": "EY",
    "ay": "EY", "ey": "IY", "oa": "OW", "ow": "OW", "ou": "AW", "oo": "UW", "oi": "OY", "oy": "OY", "au": "AO",
    "aw": "AO", "ew": "Y UW", "ue": "UW", "ar": "AA R", "er": "ER", "ir": "ER", "ur": "ER", "or": "AO R",
    "a": "AE", "b": "B", "c": "K", "d": "D", "e": "EH", "f": "F", "g": "G", "h": "HH", "i": "IH", "j": "JH",
    "k": "K", "l": "L", "m": "M", "n": "N", "o": "AA", "p": "P", "q": "K", "r": "R", "s": "S", "t": "T",
    "u": "AH", "v": "V", "w": "W", "x": "K S", "y": "IY", "z": "Z",
}
_LONG = {"a": "EY", "e": "IY", "i": "AY", "o": "OW", "u": "UW"}


def letters_to_sounds(word: str) -> str:
    """A plausible English pronunciation of a word, as ARPABET sounds separated by spaces; "AH" without letters."""
    text = re.sub("[^a-z]", "", word.lower())
    # A doubled consonant is one sound.
    text = re.sub(r"([bcdfgklmnprstvz])\1", r"\1", text)
    sounds: list[str] = []
    at = 0
    while at < len(text):
        # A silent e: "mate", "use".
        if at == len(text) - 3 and at and re.fullmatch("[aeiou][bcdfgklmnpstvz]e", text[at:]):
            sounds += [_LONG[text[at]], _SOUNDS[text[at + 1]]]
            break
        # Soft before e, i and y, but not at the start of a word, where "get" and "give" are common.
        if text[at] in "cg" and text[at + 1:at + 2] in ("e", "i", "y") and at:
            sounds.append("S" if text[at] == "c" else "JH")
            at += 1
            continue
        if at == len(text) - 1 and text[at] == "y" and at and len(sounds) > 1:
            sounds.append("IY")
            break
        size = next(size for size in (4, 3, 2, 1) if text[at:at + size] in _SOUNDS)
        sounds.append(_SOUNDS[text[at:at + size]])
        at += size
    return " ".join(sounds) or "AH"


def spoken_words(transcript: str) -> list[tuple[str, str]]:
    """The words of a transcript as (as written, in the letters and apostrophes of the dictionary). A hyphenated word
    counts as its parts; tokens without a letter are not words."""
    out = []
    for written in re.sub("[-–—]", " ", re.sub("[’‘`]", "'", transcript)).split():
        plain = re.sub("[^a-z']", "", written.lower()).strip("'")
        if plain:
            out.append((written.strip(".,;:!?\"()[]'“”") or plain, plain))
    return out


def alignment(speech: Speech, transcript: str) -> tuple[tuple[Word, ...], str, str]:
    """The words of an English transcript with their times, which rise and lie within the recording; why the times are
    estimates, "" where they are aligned; and what is missing, "" for nothing: words that come after the recording are
    left out. `InputError` if the transcript has no words or the aligner is not installed."""
    words = spoken_words(transcript)
    if not words:
        raise InputError("transcript", "has no words", "give the text that is spoken")
    plain = [word for _, word in words]
    samples, end = _aligner_samples(speech), speech.duration
    # The narrow beam is fast, and enough where text and sound agree; the wide one follows a reader who slips.
    spans = _by_pieces(samples, plain)
    if len(spans) < len(plain) and end <= LONGEST_WIDE:
        spans = _whole(samples, plain) or spans
    timed = tuple(Word(word, min(a, end), min(b, end)) for (word, _), (a, b, _) in zip(words, spans, strict=False))
    fits = sum(fit for *_, fit in spans) * FRAME >= LEAST_FIT * sum(b - a for a, b, _ in spans) and timed
    # A text of something else is squeezed in somewhere, with times that mean nothing.
    doubt = "" if fits else "the transcript does not follow the recording"
    if len(timed) < len(words):
        missing = f"the recording has no words from word {len(timed) + 1} on, {words[len(timed)][0][:40]!r}"
        return (timed, "", missing) if fits else (shared_out(speech, [word for word, _ in words]), doubt, "")
    if _loud(samples)[round(timed[-1].end / FRAME):].sum() * FRAME <= GOES_ON:
        return timed, doubt, ""
    return timed, doubt, f"the speech goes on after the last word, {timed[-1].text[:40]!r} at {timed[-1].end:.1f} s"


def shared_out(speech: Speech, words: Sequence[str]) -> tuple[Word, ...]:
    """Estimated times of words of any language: spread over the loud parts of the recording by their length."""
    samples, end = _aligner_samples(speech), speech.duration
    loud = np.flatnonzero(_loud(samples))
    if len(loud) == 0:
        loud = np.arange(max(1, len(samples) // int(FRAME * ALIGNER_RATE)))
    # One more than its letters for the pause after each word.
    share = np.concatenate([[0], np.cumsum([len(word) + 1 for word in words])])
    edges = np.floor(share / share[-1] * len(loud)).astype(int)
    last = len(loud) - 1
    # A word ends with its last loud frame, not where the next one begins: pauses lie between words.
    return tuple(Word(word, min(float(loud[min(a, last)] * FRAME), end),
                      min(float((loud[min(max(a, b - 1), last)] + 1) * FRAME), end))
                 for word, (a, b) in zip(words, itertools.pairwise(edges), strict=True))


def written_words(transcript: str) -> list[str]:
    """The words of a transcript in any language, without punctuation. In a script without spaces each character counts
    as a word."""
    out: list[str] = []
    for token in re.sub("[-–—]", " ", transcript).split():
        if len(_UNSPACED.findall(token)) > _LONGEST_UNSPACED:
            # A stretch of such a script is a phrase; shorter ones are words, as a name within a text in another script
            # is.
            token = _UNSPACED.sub(r" \g<0> ", token)
        stripped = (re.sub(r"^[\W_]+|[\W_]+$", "", part) for part in token.split())
        out += [part for part in stripped if part]
    return out


def can_follow(transcript: str) -> bool:
    """Whether the aligner supports a transcript: it has words, and few have letters that English lacks."""
    words = [word.lower() for word in written_words(transcript) if any(letter.isalpha() for letter in word)]
    strange = sum(any(letter.isalpha() and letter not in _KNOWN_LETTERS for letter in word) for word in words)
    # A few foreign names are no reason to give up on an English text.
    return bool(spoken_words(transcript)) and strange <= _STRANGE_WORDS * len(words)


def aligner_installed() -> bool:
    return importlib.util.find_spec("pocketsphinx") is not None


def _aligner_samples(speech: Speech) -> NDArray[np.int16]:
    # The acoustic model takes 16-bit samples.
    return np.round(np.clip(resample(speech, ALIGNER_RATE).samples, -1, 1) * 32767).astype(np.int16)


def _decoder(wide: bool) -> Any:
    """The aligner in its initial state (its running cepstral mean is reset), in 0.1 ms; a new one takes 0.3 s."""
    decoder = _loaded_decoder(wide)
    decoder.reinit_feat()
    return decoder


# One with the narrow and one with the wide beam.
@functools.lru_cache(maxsize=2)
def _loaded_decoder(wide: bool) -> Any:
    Requirement("pocketsphinx", "pocketsphinx", "align").check("alignment of a transcript")
    import pocketsphinx

    return pocketsphinx.Decoder(lm=None, loglevel="FATAL", **(_WIDE_BEAM if wide else {}))


def _know(decoder: Any, words: Sequence[str]) -> None:
    for word in dict.fromkeys(words):
        if decoder.lookup_word(word) is None:
            decoder.add_word(word, letters_to_sounds(word), True)


def dictionary_phones(word: str) -> list[list[str]]:
    """The pronunciations of a word, in the letters of `spoken_words`, by the aligner's dictionary: ARPABET phones each;
    by its letters if the dictionary lacks it. `InputError` if the aligner is not installed."""
    decoder = _loaded_decoder(False)
    spelt = itertools.chain([word], (f"{word}({number})" for number in itertools.count(2)))
    ways = itertools.takewhile(lambda phones: phones is not None, map(decoder.lookup_word, spelt))
    return [way.split() for way in ways] or [letters_to_sounds(word).split()]


def _loudness(samples: NDArray[np.int16]) -> NDArray[np.float64]:
    hop = int(FRAME * ALIGNER_RATE)
    count = max(1, len(samples) // hop)
    # A recording shorter than a frame is repeated to fill one.
    frames = np.resize(samples, count * hop).astype(np.float64).reshape(count, hop) / 32768
    return 10 * np.log10((frames**2).mean(axis=1) + 1e-10)


def _loud(samples: NDArray[np.int16]) -> NDArray[np.bool_]:
    """Loud frames: above a third of the way from the recording's floor (5th percentile) to its 95th, in dB."""
    level = _loudness(samples)
    floor, top = np.percentile(level, [5, 95])
    return level > floor + (top - floor) / 3


def pieces(samples: NDArray[np.int16]) -> list[tuple[int, int]]:
    """Cut 16 kHz samples in the middle of pauses into pieces of at most `LONGEST_PIECE`, as sample ranges. Without a
    pause within reach the cut is at the quietest frame of the second half of the reach."""
    hop, reach = int(FRAME * ALIGNER_RATE), int(LONGEST_PIECE / FRAME)
    level, loud = _loudness(samples), _loud(samples)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], ~loud, [0]]).astype(int))).reshape(-1, 2)
    middles = [int(a + b) // 2 for a, b in edges if (b - a) * FRAME >= SHORTEST_PAUSE]
    cuts = [0]
    while len(level) - cuts[-1] > reach:
        # A pause in the first tenth of the reach is no cut: the piece would be tiny.
        within = [m for m in middles if cuts[-1] + reach // 10 < m <= cuts[-1] + reach]
        quietest = cuts[-1] + reach // 2 + int(np.argmin(level[cuts[-1] + reach // 2:cuts[-1] + reach]))
        cuts.append(within[-1] if within else quietest)
    bounds = [cut * hop for cut in cuts] + [len(samples)]
    return list(itertools.pairwise(bounds))


def _by_pieces(samples: NDArray[np.int16], words: Sequence[str]) -> list[_Span]:
    """The words, piece by piece, up to the last that is found."""
    decoder = _decoder(wide=False)
    _know(decoder, words)
    spans: list[_Span] = []
    cut = pieces(samples)
    for start, stop in cut:
        at = len(spans)
        # More words than anybody speaks in the piece, so that the grammar stays small.
        ahead = words[at:at + int(_WORDS_PER_SECOND * (stop - start) / ALIGNER_RATE) + 10]
        decoded: list[_Span] = []  # the last piece ends with the last word, unless the text goes on
        for to_the_end in (True, False) if (start, stop) == cut[-1] else (False,):
            if ahead and not decoded:
                _follow(decoder, ahead, to_the_end=to_the_end)
                decoded = _decode(decoder, samples[start:stop])
        spans += [(a + start / ALIGNER_RATE, b + start / ALIGNER_RATE, fit) for a, b, fit in decoded]
    return spans


def _follow(decoder: Any, words: Sequence[str], *, to_the_end: bool) -> None:
    """Set the decoder's grammar to any beginning of the chain `words`, or only the whole of it."""
    goal = len(words) + 1
    steps: list[tuple[Any, ...]] = [(n, n + 1, 1.0, word) for n, word in enumerate(words)]
    # From every word an empty transition to the goal, as a piece may end after any of them.
    steps += [(n, goal, 1.0) for n in range(len(words) + 1) if n == len(words) or not to_the_end]
    decoder.add_fsg("chain", decoder.create_fsg("chain", 0, goal, steps))
    decoder.activate_search("chain")


def _decode(decoder: Any, samples: NDArray[np.int16]) -> list[_Span]:
    """The words from the start of the piece, without fillers."""
    decoder.start_utt()
    decoder.process_raw(samples.tobytes(), full_utt=True)
    decoder.end_utt()
    segments = (decoder.seg() or ()) if decoder.hyp() is not None else ()
    return [(segment.start_frame * FRAME, (segment.end_frame + 1) * FRAME, float(np.log10(max(segment.ascore, 1e-300))))
            for segment in segments if not segment.word.startswith(("<", "(", "["))]


def _whole(samples: NDArray[np.int16], words: Sequence[str]) -> list[_Span]:
    """All words from one pass over the whole recording with a wide beam; [] if it fails."""
    decoder = _decoder(wide=True)
    _know(decoder, words)
    decoder.set_align_text(" ".join(words))
    decoded = _decode(decoder, samples)
    return decoded if len(decoded) == len(words) else []
