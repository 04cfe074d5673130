"""Speech as it arrives to blocks as the models hear them: `BlockCutter`. A file goes the same way (`encode_speech`).

Sound is taken in ticks of 50 ms, whatever the pieces that it comes in, and all that follows depends on the ticks alone;
so any pieces give the same bytes. Behind a block are kept only the sound and the features that the next one needs.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module.blocks import CONTEXT, samples_per_frame, stretch_piece
from data_module.errors import InputError
from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.beats import BeatTracker
from data_module.speech.front_ends import FrontEnd
from data_module.speech.onsets import OnsetTracker
from data_module.speech.silence import (
    FRAME,
    STEP,
    LoudnessStep,
    LoudnessTracker,
    PauseTracker,
    SteadyStart,
    VoiceLevel,
    frame_after,
    frame_before,
    frame_levels,
    in_pause,
)
from data_module.types import Array, BeatFlag, Blocks, Samples, Speech, Word
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Features, SpeechBlock, SpeechFeatures, front_end_for, tempo_column

if TYPE_CHECKING:
    from data_module.text.word_vectors import WordEncoder

LATENCIES = ("full", "low")
"""What is waited for, see `BlockCutter`."""
TICK = 800
"""Samples (50 ms) that are taken at a time: half a step of the noise floor, five spectra."""
_STEP_SAMPLES = round(STEP * FRAME * SAMPLE_RATE)
_SAME = 1e-6
"""Seconds between two times that are one."""
_WORDS_NEAR = 30.0
"""Seconds around a block in which words are looked for: no pause that is bridged is longer."""
_NOTHING = LoudnessStep(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, bool))


@dataclass(frozen=True)
class _CutBlock:
    """A block of sound that was cut: seconds, why it ends, its sound stretched [L], whether it is silent, whether its
    frames are [K], how loud the voice was known to be at its end, dBFS, and its onsets [n]."""

    start: float
    end: float
    flag: BeatFlag
    sound: Samples
    silent: bool
    quiet: NDArray[np.bool_]
    reference: float
    onsets: Array

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.end - self.start


class _Flags:
    """Whether frames lie in a pause, those that are certain and those that are not, from some frame on."""

    def __init__(self) -> None:
        self._tracker, self._known, self._first = PauseTracker(), list[bool](), 0

    def add(self, silent: Sequence[bool]) -> None:
        """Some more silent frames."""
        self._known += self._tracker.step(silent)

    def close(self) -> None:
        """Nothing follows."""
        self._known += self._tracker.finish()

    @property
    def certain(self) -> int:
        """Frames that are certain."""
        return self._first + len(self._known)

    def between(self, first: int, last: int) -> NDArray[np.bool_]:
        """Of the frames from `first` to before `last`; a silence that may become a pause counts as one, and what was
        not heard yet as what was heard last."""
        known = self._known + [True] * self._tracker.waiting
        known += known[-1:] * (last - self._first - len(known))
        return np.array(known[max(first - self._first, 0):last - self._first], dtype=bool)

    def at(self, frames: NDArray[np.int64], ended: bool) -> NDArray[np.bool_]:
        """Of these frames; past the end of a recording all is silent."""
        known = self.between(self._first, int(frames.max()) + 1)
        if ended:
            known = np.append(known[:self.certain - self._first], True)
        return known[np.clip(frames - self._first, 0, len(known) - 1)]

    def forget(self, before: int) -> None:
        """Let go of the frames before one."""
        old = min(before - self._first, len(self._known))
        if old > 0:
            del self._known[:old]
            self._first += old


class BlockCutter:
    """Cuts speech at its beats as it arrives, at 16 kHz, and encodes each window of three blocks.

    latency: "full" gives a block when the block after it is known, which the models were taught to hear. "low" gives it
    as soon as its end is known; for the block after stands what was heard of it by then, see `_foreseen`.
    """

    def __init__(self, config: Config, front: FrontEnd | None = None, words: WordEncoder | None = None,
                 latency: str = "full", start: float = 0.0) -> None:
        """words: where words will be told (`add_words`); start: seconds of sound that no block is wanted of."""
        if latency not in LATENCIES:
            raise InputError(f"latency {latency!r}", "is unknown", f"choose among {', '.join(LATENCIES)}")
        self._config, self._front, self.latency = config, front or front_end_for(config), latency
        self._low = latency == "low"
        self._length = config.rhythm.frames * samples_per_frame(SAMPLE_RATE, config.rhythm.fps)
        self._context = round(CONTEXT * SAMPLE_RATE)
        self._words = None if words is None else WordTrack(words, config.text.bridge)
        self._loudness, self._voice, self._start = LoudnessTracker(), VoiceLevel(), SteadyStart()
        self._pauses, self._quiet = _Flags(), _Flags()
        self._onsets, self._beats = OnsetTracker(SAMPLE_RATE), BeatTracker(config.rhythm.beats, start)
        self._pending: list[Samples] = []  # what does not fill a tick yet
        self._waiting = 0
        # Sound from the sample `_from` on; silence lies before the recording.
        self._sound, self._from = np.zeros(self._context, np.float32), -self._context
        self._heard = self._levels = self._frames = self._count = 0
        self._edges: list[tuple[float, BeatFlag]] = [(start, BeatFlag.BOUNDARY)]  # of blocks that are not cut yet
        self._rises: list[float] = []  # onsets of blocks that are not cut yet
        self._cut: list[_CutBlock] = []  # the block before, and those that are not given yet
        self._ended = self._told = False

    def cut_at(self, beats: Sequence[tuple[float, BeatFlag]]) -> None:
        """Cut at these beats, rising seconds with why they stand there, and look for none; before anything is fed."""
        self._edges += beats
        self._told = True

    @property
    def reads(self) -> bool:
        """Words will be told."""
        return self._words is not None

    @property
    def lacking(self) -> float:
        """Seconds of sound until the next tick is full; less than that changes nothing."""
        return (TICK - self._waiting) / SAMPLE_RATE

    @property
    def duration(self) -> float:
        """Seconds of sound so far."""
        return (self._heard + self._waiting) / SAMPLE_RATE

    def add_words(self, words: Sequence[Word]) -> None:
        """What is said, at seconds of the sound; they count for the blocks that are given from now on."""
        if self._words is not None:
            self._words.add(words)

    def feed(self, samples: Samples) -> list[SpeechBlock]:
        """The blocks that are certain by some more sound, float32 [n] in [-1, 1]."""
        self._pending.append(samples)
        self._waiting += len(samples)
        out: list[SpeechBlock] = []
        if self._waiting >= TICK:
            sound = np.concatenate(self._pending)
            whole = len(sound) - len(sound) % TICK
            for start in range(0, whole, TICK):
                out += self._tick(sound[start:start + TICK])
            self._pending, self._waiting = [sound[whole:]], len(sound) - whole
        return out

    def finish(self) -> list[SpeechBlock]:
        """The blocks that are left; no sound follows. At least one was fed."""
        left = np.concatenate(self._pending) if self._pending else np.zeros(0, np.float32)
        self._pending, self._waiting, self._ended = [], 0, True
        heard, onsets = self._hear(left)
        onsets += self._onsets.finish()
        self._rises += [time for time, _ in onsets]
        self._quiet.add(self._start.finish().tolist())
        self._pauses.close()
        self._quiet.close()
        if not self._told:
            self._edges += self._beats.finish(onsets, heard.silent.tolist(), self._heard / SAMPLE_RATE)
        return list(self._given())

    def _tick(self, samples: Samples) -> list[SpeechBlock]:
        heard, onsets = self._hear(samples)
        self._rises += [time for time, _ in onsets]
        if not self._told:
            self._edges += self._beats.step(onsets, heard.silent.tolist(), self._onsets.known_until,
                                            self._heard / SAMPLE_RATE)
        return list(self._given())

    def _hear(self, samples: Samples) -> tuple[LoudnessStep, list[tuple[float, float]]]:
        """Loudness and onsets by some more sound; all of what is left where it has ended."""
        self._sound = np.concatenate([self._sound, samples])
        self._heard += len(samples)
        new = self._heard - self._levels
        heard = _NOTHING
        if new and (new >= _STEP_SAMPLES or self._ended):
            levels = frame_levels(self._sound[self._levels - self._from:self._heard - self._from], SAMPLE_RATE)
            self._levels = self._heard
            heard = self._loudness.step(levels)
            self._frames += len(levels)
            self._voice.feed(heard)
            self._pauses.add(heard.silent.tolist())
            self._quiet.add(self._start.step(levels, heard.silent).tolist())
        return heard, self._onsets.step(samples, heard)

    def _given(self) -> Iterator[SpeechBlock]:
        """Cut what can be cut, and give what can be given."""
        while len(self._edges) > 1 and self._ready(self._edges[1][0]):
            self._cut.append(self._cut_block(self._edges[0][0], *self._edges[1]))
            del self._edges[0]
            self._rises = [time for time in self._rises if time >= self._edges[0][0] - _SAME]
        while len(self._cut) > (self._count > 0):
            at = int(self._count > 0)
            own, last = self._cut[at], len(self._cut) == at + 1
            if last and not self._ended and not self._low:
                return
            after = self._cut[at + 1] if not last else None if self._ended else self._foreseen(own)
            block = self._encoded(self._cut[0] if at else None, own, after)
            yield replace(block, foreseen=last and not self._ended)
            self._count += 1
            del self._cut[:at]
            self._forget(own.start)

    def _ready(self, end: float) -> bool:
        """Whether all is certain that is told of a block with this end."""
        if self._ended:
            return True
        if self._heard < round(end * SAMPLE_RATE) + self._context + 1 or self._frames < round(end / FRAME):
            return False
        if self._onsets.known_until <= end + _SAME:
            return False
        # A frame's middle or end may lie a frame beyond.
        return self._low or min(self._pauses.certain, self._quiet.certain) > end / FRAME + 1

    def _cut_block(self, start: float, end: float, flag: BeatFlag) -> _CutBlock:
        ended = self._ended
        frames = Blocks(np.array([start, end]), np.zeros(1, np.int8), np.zeros(1, bool), self._config.rhythm.frames,
                        self._config.rhythm.fps).knot_times
        first, last = frame_after(np.array([start, end])).tolist()
        silent = in_pause(self._pauses.between(first, min(last, self._frames) if ended else last))
        return _CutBlock(start, end, flag, self._stretched(start, end), silent,
                         self._quiet.at(frame_before(frames), ended), self._voice.block(end),
                         np.array([time for time in self._rises if start - _SAME <= time <= end + _SAME]))

    def _foreseen(self, own: _CutBlock) -> _CutBlock:
        """The block after one: as long as this, at its own pace as far as it was heard, and from there on backwards."""
        start, end = own.end, own.end + own.duration
        share = np.arange(1, self._config.rhythm.frames + 1) / self._config.rhythm.frames
        first, last = frame_after(np.array([start, end])).tolist()
        return _CutBlock(start, end, BeatFlag.EVEN_PSEUDO, self._stretched(start, end),
                         in_pause(self._pauses.between(first, last)),
                         self._quiet.at(frame_before(start + own.duration * share), False), 0.0, np.zeros(0))

    def _stretched(self, start: float, end: float) -> Samples:
        first, last = (round(edge * SAMPLE_RATE) for edge in (start, end))
        if self._ended:
            first, last = min(first, self._heard), min(last, self._heard)
        last = max(last, first + 1) + self._context
        piece = self._sound[first - self._context - self._from:last - self._from]
        missing = last - first + self._context - len(piece)
        if missing:  # silence follows the end
            piece = np.pad(piece, (0, missing), mode="constant" if self._ended else "symmetric")
        return stretch_piece(piece, self._length, SAMPLE_RATE)

    def _encoded(self, before: _CutBlock | None, own: _CutBlock, after: _CutBlock | None) -> SpeechBlock:
        """The block with its neighbours; zeros beyond the ends."""
        none = np.zeros(self._length, np.float32)
        window = np.concatenate([none if part is None else part.sound for part in (before, own, after)])
        levels = self._front.encode(window[None], np.array([own.reference]))
        three = (before or own, own, after or own)
        durations = np.array([part.duration for part in three])
        rhythm = self._config.rhythm
        tempo = tempo_column(durations, rhythm.beats.d_max, rhythm.frames)[1]
        low = np.concatenate([levels.low[0], tempo], axis=-1)
        high = low if levels.high is levels.low else np.concatenate([levels.high[0], tempo], axis=-1)
        text = None
        if self._words is not None:
            text = np.concatenate([self._words.rows(part, rhythm.frames, rhythm.fps) for part in (before, own, after)])
        return SpeechBlock(self._count, own.start, own.end, (three[0].duration, own.duration, three[2].duration),
                           (three[0].silent, own.silent, three[2].silent), low, high, text, own.quiet,
                           None if after is None else after.quiet, own.flag, onsets=own.onsets)

    def _forget(self, start: float) -> None:
        """Let go of the sound and the flags before a block that was given."""
        first = min(round(start * SAMPLE_RATE) - self._context, self._levels)
        if first > self._from:
            self._sound, self._from = self._sound[first - self._from:], first
        for flags in (self._pauses, self._quiet):
            flags.forget(int(start / FRAME) - 1)
        if self._words is not None:
            self._words.forget(start)


class WordTrack:
    """The words of a speech, as they become known, and their vectors."""

    def __init__(self, encoder: WordEncoder, bridge: float) -> None:
        self._encoder, self._bridge = encoder, bridge
        self._words: list[tuple[float, int, Word]] = []  # by their start
        self._vectors: dict[int, Features] = {}
        self._next = 0

    def add(self, words: Sequence[Word]) -> None:
        """Some more words, at seconds of the sound; those that are told together are read together."""
        for word, vector in zip(words, self._encoder.encode(words), strict=True):
            insort(self._words, (word.start, self._next, word))
            self._vectors[self._next] = np.append(vector, np.float32(0.0)).astype(np.float32)
            self._next += 1

    def rows(self, block: _CutBlock | None, frames: int, fps: float) -> Features:
        """[K, d + 1] the vectors of the words on the frames of a block, and the flag of the empty word."""
        from data_module.text.word_vectors import word_frames  # only where words are read

        out = np.zeros((frames, self._encoder.width + 1), np.float32)
        out[:, -1] = 1.0
        if block is None:
            return out
        first, last = (bisect_left(self._words, (edge, -1)) for edge in (
            block.start - _WORDS_NEAR, block.end + _WORDS_NEAR))
        near = self._words[first:last]
        own = Blocks(np.array([block.start, block.end]), np.zeros(1, np.int8), np.zeros(1, bool), frames, fps)
        found = word_frames([word for *_, word in near], own, self._bridge)[0]
        for row in np.flatnonzero(found >= 0):
            out[row] = self._vectors[near[found[row]][1]]
        return out

    def forget(self, before: float) -> None:
        """Let go of the words that no block from these seconds on can hear."""
        old = bisect_left(self._words, (before - 2 * _WORDS_NEAR, -1))
        for _, number, _ in self._words[:old]:
            del self._vectors[number]
        del self._words[:old]


def encode_speech(speech: Speech, config: Config, front: FrontEnd | None = None, words: WordEncoder | None = None,
                  blocks: Blocks | None = None) -> SpeechFeatures:
    """Cut speech (16 kHz) into blocks and encode every window of three; with `words`, the text it carries too.

    blocks: to cut it into, where they are decided already.
    """
    read = words if speech.words is not None else None
    cutter = BlockCutter(config, front, read)
    cutter.add_words(speech.words or ())
    if blocks is not None:
        cutter.cut_at([(float(edge), BeatFlag(int(flag)))
                       for edge, flag in zip(blocks.edges[1:], blocks.flags, strict=True)])
    found = gathered([*cutter.feed(speech.samples), *cutter.finish()], config)
    return found if blocks is None else replace(found, blocks=blocks)


def gathered(found: Sequence[SpeechBlock], config: Config) -> SpeechFeatures:
    """The blocks of a whole speech in one."""
    edges: Array = np.array([*(block.start for block in found), found[-1].end])
    low = np.stack([block.low for block in found])
    high = low if found[0].high is found[0].low else np.stack([block.high for block in found])
    text = None if found[0].text is None else np.stack([block.text for block in found if block.text is not None])
    blocks = Blocks(edges, np.array([block.flag for block in found], np.int8),
                    np.array([block.silent[1] for block in found]), config.rhythm.frames, config.rhythm.fps)
    return SpeechFeatures(blocks, low, high, text, np.stack([block.quiet for block in found]),
                          tuple(block.onsets for block in found))
