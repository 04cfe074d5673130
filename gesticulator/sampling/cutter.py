"""Incremental cutting of speech into encoded blocks: `BlockCutter`. Files are cut by the same code (`encode_speech`).

Sound is processed in ticks of 20 ms, whatever the sizes of the pieces that are fed, so all sizes give the same bytes.
Sound and features are stored only as long as the next block needs them.
"""

from __future__ import annotations

import copy
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from data_module.blocks import CONTEXT, samples_per_frame, stretch_piece
from data_module.speech import silence
from data_module.speech.audio import SAMPLE_RATE
from data_module.speech.beats import BeatTracker
from data_module.speech.front_ends import FrontEnd
from data_module.speech.onsets import OnsetTracker
from data_module.types import Array, BeatFlag, Blocks, Samples, Speech, Word, knot_times
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Features, SpeechBlock, SpeechFeatures, front_end_for, tempo_column
from gesticulator.bundle.models import system_of

if TYPE_CHECKING:
    from data_module.text.word_vectors import WordEncoder

TICK = 320
"""Samples (20 ms) that are processed at a time, as a microphone delivers them: two frames, two spectra."""
_AT_ONCE = 10 * TICK
"""Samples (0.2 s) that are processed at a time where the result does not depend on it, if there are so many."""
CUTTER_EVERY = 100 * TICK
"""Samples (2 s) between two copies of a cutter: cutting them again takes 20 ms."""
_SAME = 1e-6
"""Largest difference of two equal times, seconds."""
_BEGINNING = 0.2
"""Share of a foreseen block into which the features of the block before reach."""
_WORDS_NEAR = 30.0
"""Seconds around a block in which words are considered: no bridged pause is longer."""


@dataclass(frozen=True)
class _CutBlock:
    """A block of sound. start, end: seconds; flag: why it ends; sound: [L] samples, time-stretched; silent: whether the
    block is in a pause; quiet: [K] whether its frames are; reference: level of the voice known at its end, dBFS;
    onsets: [n] seconds; pitch: [K] as in `SpeechBlock`, or None."""

    start: float
    end: float
    flag: BeatFlag
    sound: Samples
    silent: bool
    quiet: NDArray[np.bool_]
    reference: float
    onsets: Array
    pitch: Array | None = None

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.end - self.start


class _PauseFlags:
    """Whether each frame lies in a pause; the flags of the last frames may still change."""

    def __init__(self) -> None:
        self._tracker, self._final, self._first = silence.PauseTracker(), list[bool](), 0

    def add(self, silent: Sequence[bool]) -> None:
        """Add frames that are silent or not."""
        self._final += self._tracker.step(silent)

    def close(self) -> None:
        """End the recording: all flags become final."""
        self._final += self._tracker.finish()

    @property
    def certain(self) -> int:
        """Number of frames whose flag is final."""
        return self._first + len(self._final)

    def between(self, first: int, last: int) -> NDArray[np.bool_]:
        """Flags of frames first to last - 1. What may become a pause counts as one; later frames get the last flag."""
        flags = self._final + [True] * self._tracker.waiting
        flags += flags[-1:] * (last - self._first - len(flags))
        return np.array(flags[max(first - self._first, 0):last - self._first], dtype=bool)

    def at(self, frames: NDArray[np.int64], ended: bool) -> NDArray[np.bool_]:
        """Flags of these frames; beyond the end of a recording all are true."""
        flags = self.between(self._first, int(frames.max()) + 1)
        if ended:
            flags = np.append(flags[:self.certain - self._first], True)
        return flags[np.clip(frames - self._first, 0, len(flags) - 1)]

    def forget(self, before: int) -> None:
        """Free the memory of the frames before one."""
        old = min(before - self._first, len(self._final))
        if old > 0:
            del self._final[:old]
            self._first += old


class BlockCutter:
    """Cuts speech at 16 kHz at its beats as it arrives, and encodes each window of three blocks. low: of low latency.
    Otherwise a block is returned once the next block is known, which is the input the models were trained with; with
    it, once its end is known, with a guess in place of the next block (`_foreseen`). It may be set at any time, and
    affects the blocks that were not returned yet."""

    def __init__(self, config: Config, front: FrontEnd | None = None, words: WordEncoder | None = None,
                 start: float = 0.0) -> None:
        """words: encoder of the words that `add_words` will add, or None; start: of the first block, seconds."""
        self._config, self._front, self.low = config, front or front_end_for(config), False
        self._length = config.rhythm.frames * samples_per_frame(SAMPLE_RATE, config.rhythm.fps)
        self._context = round(CONTEXT * SAMPLE_RATE)
        self._words = None if words is None else WordTrack(words, config.selection.words_so_far)
        self._loudness, self._voice = silence.LoudnessTracker(), silence.VoiceLevel()
        self._start, self._pauses, self._quiet = silence.SteadyStart(), _PauseFlags(), _PauseFlags()
        self._onsets = OnsetTracker(SAMPLE_RATE)
        self._beats = BeatTracker(config.rhythm.beats, start)
        self._pending: list[Samples] = []  # less than a tick
        self._waiting = 0
        # Sound from the sample `_from` on; the recording is preceded by silence.
        self._sound, self._from = np.zeros(self._context, np.float32), -self._context
        self._processed = self._frames = self._count = 0
        self._edges: list[tuple[float, BeatFlag]] = [(start, BeatFlag.BOUNDARY)]  # of blocks that are not cut yet
        self._rises: list[float] = []  # onsets of blocks that are not cut yet
        self._pitch = silence.PitchLevel() if system_of(config).VARIES else None  # candidates are chosen by it
        self._cut: list[_CutBlock] = []  # the block before, and those that are not returned yet
        self._ended = self._beats_given = False

    def cut_at(self, beats: Sequence[tuple[float, BeatFlag]]) -> None:
        """Cut at these beats, rising seconds after the last of `uncut` with their flags, and detect none."""
        self._edges, self._beats_given = [self._edges[0], *beats], True

    def fork(self) -> BlockCutter:
        """An independent copy, which shares what never changes."""
        # Deep, but for what is never changed: a copy is taken every few seconds of sound.
        shared: list[object] = [self._config, self._front]
        memo = {id(one): one for one in shared}
        if self._words is not None:
            memo[id(self._words)] = self._words.fork()
        return copy.deepcopy(self, memo)

    @property
    def uncut(self) -> list[float]:
        """Starts of the blocks that were cut and may still be returned or are needed beside those, and of the next
        one, seconds. The first of them was returned already, unless it is the first of the sound."""
        return [*(block.start for block in self._cut), self._edges[0][0]]

    @property
    def returned(self) -> int:
        """Number of blocks that were returned."""
        return self._count

    @property
    def reads(self) -> bool:
        """Whether words can be added."""
        return self._words is not None

    @property
    def lacking(self) -> float:
        """Seconds of sound that fill the next tick; feeding less returns nothing."""
        return (TICK - self._waiting) / SAMPLE_RATE

    @property
    def duration(self) -> float:
        """Seconds of sound so far."""
        return (self._processed + self._waiting) / SAMPLE_RATE

    def add_words(self, words: Sequence[Word], *batch: int) -> Iterator[None]:
        """Add words with their times in the sound, seconds, in steps; they affect the blocks that are returned after
        the last step. batch: texts that a step reads (`WordEncoder.encode_into`)."""
        return iter(()) if self._words is None else self._words.add(words, *batch)

    def feed(self, samples: Samples) -> list[SpeechBlock]:
        """Feed sound, float32 [n] in [-1, 1]; return the blocks that became certain."""
        self._pending.append(samples)
        self._waiting += len(samples)
        out: list[SpeechBlock] = []
        if self._waiting >= TICK:
            sound = np.concatenate(self._pending)
            whole = len(sound) - len(sound) % TICK
            # Only what is returned before the next block is known depends on when that is.
            # Larger steps are faster; the blocks are the same with any size.
            size = TICK if self.low else _AT_ONCE
            for start in range(0, whole, size):
                out += self._tick(sound[start:min(start + size, whole)])
            self._pending, self._waiting = [sound[whole:]], len(sound) - whole
        return out

    def finish(self) -> list[SpeechBlock]:
        """The remaining blocks, at the end of the sound. At least one sample must have been fed."""
        rest = np.concatenate(self._pending) if self._pending else np.zeros(0, np.float32)
        self._pending, self._waiting, self._ended = [], 0, True
        loudness, onsets = self._analyse(rest)
        last = self._onsets.finish()
        self._rises += [time for time, _ in last]
        self._quiet.add(self._start.finish().tolist())
        self._pauses.close()
        self._quiet.close()
        if not self._beats_given:
            self._edges += self._beats.finish(onsets + last, loudness.silent.tolist(), self._processed / SAMPLE_RATE)
        return list(self._ready_blocks())

    def _tick(self, samples: Samples) -> list[SpeechBlock]:
        loudness, onsets = self._analyse(samples)
        if not self._beats_given:
            self._edges += self._beats.step(onsets, loudness.silent.tolist(), self._onsets.known_until,
                                            self._processed / SAMPLE_RATE)
        return list(self._ready_blocks())

    def _analyse(self, samples: Samples) -> tuple[silence.LoudnessStep, list[tuple[float, float]]]:
        """Loudness and onsets that became known by these samples."""
        # Only the sound since the last returned block is held, so this copy is short.
        self._sound = np.concatenate([self._sound, samples])
        self._processed += len(samples)
        loudness = self._loudness.step(silence.frame_levels(samples, SAMPLE_RATE), self._ended)
        self._frames += len(loudness.levels)
        self._voice.feed(loudness)
        self._pauses.add(loudness.silent.tolist())
        self._quiet.add(self._start.step(loudness.levels, loudness.silent).tolist())
        onsets = self._onsets.step(samples, loudness)
        self._rises += [time for time, _ in onsets]
        return loudness, onsets

    def _ready_blocks(self) -> Iterator[SpeechBlock]:
        """Cut and encode the blocks that are certain by now."""
        while len(self._edges) > 1 and self._ready(self._edges[1][0]):
            self._cut.append(self._cut_block(self._edges[0][0], *self._edges[1]))
            del self._edges[0]
            self._rises = [time for time in self._rises if time >= self._edges[0][0] - _SAME]
        while len(self._cut) > (self._count > 0):
            at = int(self._count > 0)
            current, last = self._cut[at], len(self._cut) == at + 1
            if last and not self._ended and not self.low:
                return
            after = self._cut[at + 1] if not last else None if self._ended else self._foreseen(current)
            block = self._encoded(self._cut[0] if at else None, current, after)
            yield replace(block, foreseen=last and not self._ended)
            self._count += 1
            del self._cut[:at]
            self._forget(current.start)

    def _ready(self, end: float) -> bool:
        """Whether sound, onsets and pauses of a block with this end are certain."""
        if self._ended:
            return True
        if self._processed < round(end * SAMPLE_RATE) + self._context + 1 or self._frames < round(end / silence.FRAME):
            return False
        if self._onsets.known_until <= end + _SAME:
            return False
        # The middle or end of a frame may lie one frame beyond.
        return self.low or min(self._pauses.certain, self._quiet.certain) > end / silence.FRAME + 1

    def _cut_block(self, start: float, end: float, flag: BeatFlag) -> _CutBlock:
        ended = self._ended
        frames = knot_times(np.array([start, end]), self._config.rhythm.frames)
        # Pauses are known per frame of 10 ms; a block takes those that begin within it.
        first, last = silence.frame_after(np.array([start, end])).tolist()
        silent = silence.in_pause(self._pauses.between(first, min(last, self._frames) if ended else last))
        begin, stop = (min(round(edge * SAMPLE_RATE), self._processed) - self._from for edge in (start, end))
        pitch = None if self._pitch is None else self._pitch.block(
            self._sound[begin:stop], SAMPLE_RATE, self._config.rhythm.frames)
        return _CutBlock(start, end, flag, self._stretched(start, end, self._length), silent,
                         self._quiet.at(silence.frame_before(frames), ended), self._voice.block(end),
                         np.array([time for time in self._rises if start - _SAME <= time <= end + _SAME]), pitch)

    def _foreseen(self, block: _CutBlock) -> _CutBlock:
        """A guess of the next block: of the same length, with the sound so far, continued by its mirror image; of the
        beginning alone if the models take nothing of a block that is only foreseen."""
        start, end = block.end, block.end + block.duration
        share = _BEGINNING if self._config.ignores_foreseen else 1.0
        sound = self._stretched(start, start + share * block.duration, round(share * self._length))
        steps = np.arange(1, self._config.rhythm.frames + 1) / self._config.rhythm.frames
        first, last = silence.frame_after(np.array([start, end])).tolist()
        return _CutBlock(start, end, BeatFlag.EVEN_PSEUDO, np.pad(sound, (0, self._length - len(sound))),
                         silence.in_pause(self._pauses.between(first, last)),
                         self._quiet.at(silence.frame_before(start + block.duration * steps), False), 0.0, np.zeros(0))

    def _stretched(self, start: float, end: float, length: int) -> Samples:
        first, last = (round(edge * SAMPLE_RATE) for edge in (start, end))
        if self._ended:
            first, last = min(first, self._processed), min(last, self._processed)
        last = max(last, first + 1) + self._context
        # With context on both sides, which time-scaling needs for its overlapping windows.
        piece = self._sound[first - self._context - self._from:last - self._from]
        missing = last - first + self._context - len(piece)
        if missing:  # silence after the end of the recording, or the mirror image of the sound so far
            piece = np.pad(piece, (0, missing), mode="constant" if self._ended else "symmetric")
        return stretch_piece(piece, length, SAMPLE_RATE)

    def _encoded(self, before: _CutBlock | None, block: _CutBlock, after: _CutBlock | None) -> SpeechBlock:
        """The block encoded with its neighbours; a missing neighbour is zeros."""
        none = np.zeros(self._length, np.float32)
        window = np.concatenate([none if part is None else part.sound for part in (before, block, after)])
        levels = self._front.encode(window[None], np.array([block.reference]))
        three = (before or block, block, after or block)
        durations = np.array([part.duration for part in three])
        rhythm = self._config.rhythm
        tempo = tempo_column(durations, rhythm.beats.d_max, rhythm.frames)[1]
        low = np.concatenate([levels.low[0], tempo], axis=-1)
        high = low if levels.high is levels.low else np.concatenate([levels.high[0], tempo], axis=-1)
        text = None if self._words is None else np.concatenate(
            [self._words.rows(part, rhythm.frames, rhythm.fps) for part in (before, block, after)])
        return SpeechBlock(self._count, block.start, block.end, (three[0].duration, block.duration, three[2].duration),
                           (three[0].silent, block.silent, three[2].silent), low, high, text, block.quiet,
                           None if after is None else after.quiet, block.flag, onsets=block.onsets,
                           pitch=block.pitch)

    def _forget(self, start: float) -> None:
        """Free the memory of sound, flags and words before a block that was returned."""
        first = min(round(start * SAMPLE_RATE) - self._context, self._processed)
        if first > self._from:
            self._sound, self._from = self._sound[first - self._from:], first
        for flags in (self._pauses, self._quiet):
            flags.forget(int(start / silence.FRAME) - 1)
        if self._words is not None:
            self._words.forget(start)


class WordTrack:
    """The words that were added so far, and their vectors."""

    def __init__(self, encoder: WordEncoder, so_far: bool = False) -> None:
        """so_far: see `WordEncoder.encode`."""
        self._encoder, self._so_far = encoder, so_far
        self._words: list[tuple[float, int, Word, Features]] = []  # by their start
        self._count = 0

    def add(self, words: Sequence[Word], *batch: int) -> Iterator[None]:
        """Add words with their times in the sound, seconds, in steps; the words of one call are encoded together."""
        vectors = np.zeros((len(words), self._encoder.width), np.float32)
        yield from self._encoder.encode_into(vectors, words, self._so_far, *batch)
        for word, vector in zip(words, vectors, strict=True):
            row = np.append(vector, np.float32(0.0)).astype(np.float32)
            insort(self._words, (word.start, self._count, word, row))
            self._count += 1

    def fork(self) -> WordTrack:
        """An independent copy; words and vectors are never changed."""
        twin = copy.copy(self)
        twin._words = list(self._words)
        return twin

    def rows(self, block: _CutBlock | None, frames: int, fps: float) -> Features:
        """[K, d + 1] the word vectors of a block's frames, and whether a frame has no word."""
        from data_module.text.word_vectors import word_frames  # only where words are read

        out = np.zeros((frames, self._encoder.width + 1), np.float32)
        out[:, -1] = 1.0
        if block is None:
            return out
        first, last = (bisect_left(self._words, (edge, -1)) for edge in (
            block.start - _WORDS_NEAR, block.end + _WORDS_NEAR))
        # A word may begin before the block and sound into it.
        near = self._words[first:last]
        blocks = Blocks(np.array([block.start, block.end]), np.zeros(1, np.int8), np.zeros(1, bool), frames, fps)
        words = word_frames([word for *_, word, _ in near], blocks)[0]
        for row in np.flatnonzero(words >= 0):
            out[row] = near[words[row]][3]
        return out

    def forget(self, before: float) -> None:
        """Free the memory of the words that no block after `before` seconds can need."""
        # Twice the reach: `rows` of a block that was cut earlier may still look for words.
        del self._words[:bisect_left(self._words, (before - 2 * _WORDS_NEAR, -1))]


def encode_speech(speech: Speech, config: Config, front: FrontEnd | None = None, words: WordEncoder | None = None,
                  blocks: Blocks | None = None, cutters: list[BlockCutter] | None = None) -> SpeechFeatures:
    """Cut speech (16 kHz) into blocks and encode every window of three; with `words`, its text too. blocks: cut the
    speech into these instead of detecting beats. cutters: receives a copy of the cutter before every `CUTTER_EVERY`
    samples, from which parts can be cut again (`editing.render.Recutter`)."""
    # Without words the audio-only models are used, which take no rows of text.
    read = words if speech.words is not None else None
    cutter = BlockCutter(config, front, read)
    deque(cutter.add_words(speech.words or ()), maxlen=0)
    if blocks is not None:
        cutter.cut_at([(float(edge), BeatFlag(int(flag)))
                       for edge, flag in zip(blocks.edges[1:], blocks.flags, strict=True)])
    parts: list[SpeechBlock] = []
    for at in range(0, len(speech.samples), CUTTER_EVERY):
        if cutters is not None:
            cutters.append(cutter.fork())
        parts += cutter.feed(speech.samples[at:at + CUTTER_EVERY])
    features = gathered([*parts, *cutter.finish()], config)
    return features if blocks is None else replace(features, blocks=blocks)


def gathered(parts: Sequence[SpeechBlock], config: Config) -> SpeechFeatures:
    """The features of a whole speech, from those of its blocks."""
    edges: Array = np.array([*(block.start for block in parts), parts[-1].end])
    low = np.stack([block.low for block in parts])
    high = low if parts[0].high is parts[0].low else np.stack([block.high for block in parts])
    text, pitch = ([row for row in rows if row is not None] for rows in (
        [block.text for block in parts], [block.pitch for block in parts]))
    blocks = Blocks(edges, np.array([block.flag for block in parts], np.int8),
                    np.array([block.silent[1] for block in parts]), config.rhythm.frames, config.rhythm.fps)
    return SpeechFeatures(blocks, low, high, np.stack(text) if text else None,
                          np.stack([block.quiet for block in parts]), tuple(block.onsets for block in parts),
                          np.stack(pitch) if pitch else None)
