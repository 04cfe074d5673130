"""What was said, and when: a transcript brought onto the clock of its recording (RG 4.1.2).

The aligner is pocketsphinx (extra `align`). The recording is cut at pauses into pieces of ten seconds at most; each
piece is decoded along the chain of words that are still to come, so the transcript finds its pieces by itself. Where
that leaves words over, the whole recording is aligned with a wide beam; where even that fails, the words share out
the loud frames by their length, and the result says so. It also says so where the words that were found leave much of
the sound without a word: a short text finds a place in any recording.
"""

from __future__ import annotations

import functools
import importlib.util
import itertools
import re
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.types import Speech, Word

if TYPE_CHECKING:
    from collections.abc import Sequence

ALIGNER_RATE = 16000
"""Hertz that the aligner's acoustic model was trained on."""
FRAME = 0.01
"""Seconds per frame of the aligner, and of the loudness that finds the pauses."""
LONGEST_PIECE = 10.0
"""Seconds of sound that are aligned at a time."""
SHORTEST_PAUSE = 0.15
"""Seconds of a pause at which the sound is cut."""
LONGEST_WIDE = 180.0
"""Seconds; the wide beam costs about 0.15 s a second and grows with the length, so a longer recording goes without."""
LEAST_COVERED = 0.85
"""Share of the loud frames that lies in words where a transcript follows its recording: 0.96 and more in English
readings with their own text, 0.8 and less with another one."""
_WIDE_BEAM = {"beam": 1e-120, "pbeam": 1e-120, "wbeam": 1e-120}
_WORDS_PER_SECOND = 6
_KNOWN_LETTERS = frozenset("abcdefghijklmnopqrstuvwxyzéèêëïçàâ")
_STRANGE_WORDS = 0.05
# Scripts that write words without spaces, and the longest stretch of them that is taken as one word.
_UNSPACED, _LONGEST_UNSPACED = re.compile(r"[\u3040-\u30ff\u3400-\u9fff\uf900-\ufaff\U00020000-\U0003ffff]"), 4


class AlignmentWarning(UserWarning):
    """The aligner could not follow the transcript; the times are guessed."""


@dataclass(frozen=True)
class Alignment:
    """Words with their times, and whether the times were heard (True) or guessed, for the reason given in `doubt`."""

    words: tuple[Word, ...]
    heard: bool
    doubt: str = ""


# Letters to ARPABET sounds, longest match first; good enough to let the aligner pass through a word it never saw.
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
    """A plausible English pronunciation of a word, as ARPABET sounds parted by spaces; "AH" when it has no letters."""
    text = re.sub("[^a-z]", "", word.lower())
    text = re.sub(r"([bcdfgklmnprstvz])\1", r"\1", text)
    sounds: list[str] = []
    at = 0
    while at < len(text):
        # A silent e: "mate", "use".
        if at == len(text) - 3 and at and re.fullmatch("[aeiou][bcdfgklmnpstvz]e", text[at:]):
            sounds += [_LONG[text[at]], _SOUNDS[text[at + 1]]]
            break
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
    """The words of a transcript as (as written, in the plain letters and apostrophes that a dictionary has).

    A hyphened word counts as its parts; marks without a letter are no words.
    """
    out = []
    for written in re.sub("[-–—]", " ", re.sub("[’‘`]", "'", transcript)).split():
        plain = re.sub("[^a-z']", "", written.lower()).strip("'")
        if plain:
            out.append((written.strip(".,;:!?\"()[]'“”") or plain, plain))
    return out


def align(speech: Speech, transcript: str) -> tuple[Word, ...]:
    """The words of an English transcript with their times in the recording; see `alignment`."""
    return alignment(speech, transcript).words


def alignment(speech: Speech, transcript: str, *, warn: bool = True) -> Alignment:
    """Align an English transcript with its recording.

    Words rise in time and lie within the recording. `InputError` when the transcript has no words or the aligner is
    not installed; an `AlignmentWarning`, if `warn`, when the times are guessed.
    """
    words = spoken_words(transcript)
    if not words:
        raise InputError("transcript", "has no words", "give the text that is spoken")
    plain = [word for _, word in words]
    samples = _aligner_samples(speech)
    found = _by_pieces(samples, plain)
    if found is None and speech.duration <= LONGEST_WIDE:
        found = _whole(samples, plain)
    if found is None:
        doubt = "the transcript does not follow the recording"
        timed = shared_out(speech, [written for written, _ in words])
    else:
        end = speech.duration
        timed = tuple(Word(written, min(a, end), min(b, end))
                      for (written, _), (a, b) in zip(words, found, strict=True))
        covered = _covered(samples, found)
        doubt = "" if covered >= LEAST_COVERED else f"the transcript covers only {covered:.0%} of what is said"
    if doubt and warn:
        warnings.warn(f"{doubt} ('{transcript.strip()[:30]}...'); the times of its words are guessed",
                      AlignmentWarning, stacklevel=3)
    return Alignment(timed, not doubt, doubt)


def shared_out(speech: Speech, words: Sequence[str]) -> tuple[Word, ...]:
    """Words of any language that share out the loud parts of the recording by their length; a guess."""
    end = speech.duration
    return tuple(Word(word, min(a, end), min(b, end))
                 for word, (a, b) in zip(words, _shared_out(_aligner_samples(speech), words), strict=True))


def written_words(transcript: str) -> list[str]:
    """The words of a transcript in any language, without the marks around them.

    Where a script has no spaces, each of its characters counts as a word.
    """
    out: list[str] = []
    for token in re.sub("[-–—]", " ", transcript).split():
        if len(_UNSPACED.findall(token)) > _LONGEST_UNSPACED:
            token = _UNSPACED.sub(r" \g<0> ", token)
        stripped = (re.sub(r"^[\W_]+|[\W_]+$", "", part) for part in token.split())
        out += [part for part in stripped if part]
    return out


def can_follow(transcript: str) -> bool:
    """Whether the aligner can read a transcript: it has words, and next to none holds a letter foreign to English."""
    words = [word.lower() for word in written_words(transcript) if any(letter.isalpha() for letter in word)]
    strange = sum(any(letter.isalpha() and letter not in _KNOWN_LETTERS for letter in word) for word in words)
    return bool(spoken_words(transcript)) and strange <= _STRANGE_WORDS * len(words)


def aligner_installed() -> bool:
    """Whether pocketsphinx (extra `align`) is there."""
    return importlib.util.find_spec("pocketsphinx") is not None


def _aligner_samples(speech: Speech) -> NDArray[np.int16]:
    samples = speech.samples
    if speech.sample_rate != ALIGNER_RATE:
        from scipy.signal import resample_poly

        common = int(np.gcd(speech.sample_rate, ALIGNER_RATE))
        samples = resample_poly(samples, ALIGNER_RATE // common, speech.sample_rate // common)
    return np.round(np.clip(samples, -1, 1) * 32767).astype(np.int16)


def _decoder(wide: bool) -> Any:
    """The aligner in the state of a new one: what it heard before (its running cepstral mean) is forgotten.

    A new one takes 0.3 s to load, this 0.1 ms.
    """
    decoder = _loaded_decoder(wide)
    decoder.reinit_feat()
    return decoder


@functools.lru_cache(maxsize=2)
def _loaded_decoder(wide: bool) -> Any:
    try:
        import pocketsphinx
    except ImportError:
        raise InputError("alignment of a transcript", "needs pocketsphinx, which is not installed",
                         "pip install 'gesticulator[align]'") from None
    return pocketsphinx.Decoder(lm=None, loglevel="FATAL", **(_WIDE_BEAM if wide else {}))


def _know(decoder: Any, words: Sequence[str]) -> None:
    for word in dict.fromkeys(words):
        if decoder.lookup_word(word) is None:
            decoder.add_word(word, letters_to_sounds(word), True)


def _loudness(samples: NDArray[np.int16]) -> NDArray[np.float64]:
    """dB per frame of 10 ms."""
    hop = int(FRAME * ALIGNER_RATE)
    count = max(1, len(samples) // hop)
    frames = np.resize(samples, count * hop).astype(np.float64).reshape(count, hop) / 32768
    return 10 * np.log10((frames**2).mean(axis=1) + 1e-10)


def _loud(samples: NDArray[np.int16]) -> NDArray[np.bool_]:
    """Frames that stand out from the recording's own floor: above a third of the way from floor to speech, in dB."""
    level = _loudness(samples)
    floor, top = np.percentile(level, [5, 95])
    return level > floor + (top - floor) / 3


def pieces(samples: NDArray[np.int16]) -> list[tuple[int, int]]:
    """Cut 16 kHz samples in the middle of pauses into pieces of `LONGEST_PIECE` at most, as sample ranges.

    Where no pause lies within reach the cut falls on the quietest frame of the reach's second half.
    """
    hop, reach = int(FRAME * ALIGNER_RATE), int(LONGEST_PIECE / FRAME)
    level, loud = _loudness(samples), _loud(samples)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], ~loud, [0]]).astype(int))).reshape(-1, 2)
    middles = [int(a + b) // 2 for a, b in edges if (b - a) * FRAME >= SHORTEST_PAUSE]
    cuts = [0]
    while len(level) - cuts[-1] > reach:
        within = [m for m in middles if cuts[-1] + reach // 10 < m <= cuts[-1] + reach]
        quietest = cuts[-1] + reach // 2 + int(np.argmin(level[cuts[-1] + reach // 2:cuts[-1] + reach]))
        cuts.append(within[-1] if within else quietest)
    bounds = [cut * hop for cut in cuts] + [len(samples)]
    return list(itertools.pairwise(bounds))


def _by_pieces(samples: NDArray[np.int16], words: Sequence[str]) -> list[tuple[float, float]] | None:
    """Times for every word, piece after piece; None when words are left over or the chain breaks."""
    decoder = _decoder(wide=False)
    _know(decoder, words)
    found: list[tuple[float, float]] = []
    cut = pieces(samples)
    for start, stop in cut:
        at = len(found)
        ahead = words[at:at + int(_WORDS_PER_SECOND * (stop - start) / ALIGNER_RATE) + 10]
        if not ahead:
            break
        _follow(decoder, ahead, to_the_end=(start, stop) == cut[-1])
        heard = _decode(decoder, samples[start:stop])
        found += [(a + start / ALIGNER_RATE, b + start / ALIGNER_RATE) for _, a, b in heard]
    return found if len(found) == len(words) else None


def _follow(decoder: Any, words: Sequence[str], *, to_the_end: bool) -> None:
    """Let the decoder hear any beginning of the chain `words`, or only the whole of it."""
    goal = len(words) + 1
    steps: list[tuple[Any, ...]] = [(n, n + 1, 1.0, word) for n, word in enumerate(words)]
    steps += [(n, goal, 1.0) for n in range(len(words) + 1) if n == len(words) or not to_the_end]
    decoder.add_fsg("chain", decoder.create_fsg("chain", 0, goal, steps))
    decoder.activate_search("chain")


def _decode(decoder: Any, samples: NDArray[np.int16]) -> list[tuple[str, float, float]]:
    """(word, start, end) in seconds from the piece's start, without fillers and the marks of variants."""
    decoder.start_utt()
    decoder.process_raw(samples.tobytes(), full_utt=True)
    decoder.end_utt()
    if decoder.hyp() is None:
        return []
    segments = decoder.seg()
    return [(re.sub(r"\(\d+\)$", "", segment.word), segment.start_frame * FRAME, (segment.end_frame + 1) * FRAME)
            for segment in (segments or ()) if not segment.word.startswith(("<", "(", "["))]


def _whole(samples: NDArray[np.int16], words: Sequence[str]) -> list[tuple[float, float]] | None:
    """Times for every word from one pass over the whole recording with a wide beam; None when it fails."""
    decoder = _decoder(wide=True)
    _know(decoder, words)
    decoder.set_align_text(" ".join(words))
    heard = _decode(decoder, samples)
    return [(a, b) for _, a, b in heard] if len(heard) == len(words) else None


def _covered(samples: NDArray[np.int16], spans: Sequence[tuple[float, float]]) -> float:
    """The share of the loud frames that lies in words."""
    loud = _loud(samples)
    spoken = np.zeros(len(loud), dtype=bool)
    for start, end in spans:
        spoken[round(start / FRAME):round(end / FRAME)] = True
    return float((loud & spoken).sum() / max(1, loud.sum()))


def _shared_out(samples: NDArray[np.int16], words: Sequence[str]) -> list[tuple[float, float]]:
    """Times by the words' letters over the loud frames alone."""
    loud = np.flatnonzero(_loud(samples))
    if len(loud) == 0:
        loud = np.arange(max(1, len(samples) // int(FRAME * ALIGNER_RATE)))
    share = np.concatenate([[0], np.cumsum([len(word) + 1 for word in words])])
    edges = np.floor(share / share[-1] * len(loud)).astype(int)
    last = len(loud) - 1
    return [(float(loud[min(a, last)] * FRAME), float((loud[min(max(a, b - 1), last)] + 1) * FRAME))
            for a, b in itertools.pairwise(edges)]
