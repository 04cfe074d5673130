"""A plan on another export of its sound (`retimed`): blocks keep their decisions where their beats still fit.

The sounds are aligned by their fingerprints, and every beat is moved (`moved_beats`). A block is kept, with its lexeme,
random keys and edits, if both of its beats have a place, and its length stays within `moved_beats.RATIOS` of what it
was. Between the blocks that are kept, the new sound is cut at its own beats, and the bundle decides. Decisions and
edits are moved together: what was edited stays edited, what was not is replayed.
"""

import itertools
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, cast

import numpy as np

from data_module.controls import FEATURES
from data_module.speech.fingerprint import fingerprint, fingerprint_frames, fingerprint_text
from data_module.speech.sound_map import aligned
from data_module.types import BeatFlag, Blocks, Speech
from gesticulator.bundle.features import SpeechFeatures
from gesticulator.editing.moved_beats import BeatMap, fits
from gesticulator.plan import plan as plans
from gesticulator.plan.checks import LONGEST, SHORTEST, plain_word
from gesticulator.plan.plan import GesturePlan, PlanWord
from gesticulator.sampling.loop import BlockMotion

LEAST_SPEECH = 0.2
"""Least share of the speech that both sounds must have in common."""
_CLOSEST, _LONGEST = 0.2, 0.5
"""Least distance, seconds, of the new sound's beats from the blocks that are kept, and longest block between them. What
is shorter than the first goes to the next block that is kept."""
_NEAR = 0.3
"""Seconds within which a word of a new transcript is the old one."""
_LEAST = 0.02
"""Seconds: shorter ranges are dropped."""


@dataclass(frozen=True)
class Retimed:
    """A plan for the new sound. kept, anew, dropped: numbers of blocks with their old decisions, of blocks that the
    bundle decided, and of old blocks that are gone; losses: a line for each pin, cue or edit that was lost."""

    plan: GesturePlan
    kept: int
    anew: int = 0
    dropped: int = 0
    losses: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"re-timed: {self.kept} blocks kept, {self.anew} decided anew, {self.dropped} dropped"


@dataclass(frozen=True)
class _Piece:
    """A block of the new sound. source: the index of the block that it was, or None if it is to be decided."""

    start: float
    end: float
    flag: plans.Flag
    source: int | None = None
    silent: bool = False


def _exact(time: float, before: float) -> float:
    """A moved time in microseconds; the old one, to the last bit, if it was not moved."""
    return before if abs(time - before) < 1e-9 else round(time, 6)


# ------------------------------------------------------------------------------------------------------ the blocks

def _inside(edges: Sequence[float], start: float, end: float) -> list[tuple[int, float, float]]:
    """Index, start and end of the blocks between two of their edges."""
    return [(at, edges[at], edges[at + 1]) for at in range(bisect_left(edges, start), bisect_left(edges, end))]


class _Cutter:
    """Puts the blocks of a plan and of its first generation side by side onto the new sound."""

    def __init__(self, plan: GesturePlan, beats: BeatMap, detected: Blocks) -> None:
        """detected: the blocks of the new sound, cut at its beats."""
        self._beats, self._detected = beats, detected
        self._onsets = {edge for edge, flag in zip(plan.drawn.edges[1:], plan.drawn.flags, strict=True)
                        if flag == "onset"}
        self._flags = plan.drawn.flags, tuple(block.flag for block in plan.blocks)
        self.drawn: list[_Piece] = []
        self.blocks: list[_Piece] = []
        self._cursor, end = 0.0, float(detected.edges[-1])
        drawn = plan.drawn.edges
        # Numbers in files are rounded: the plan ends where its first generation does.
        ends = (0.0, *(block.end for block in plan.blocks[:-1]), drawn[-1])
        # Between two common beats the blocks of both are moved or dropped together, so that edits stay edits of what
        # they were made to.
        for first, last in pairwise(sorted(set(drawn) & set(ends))):
            self._take(_inside(drawn, first, last), _inside(ends, first, last))
        if end - self._cursor >= _CLOSEST or not self.drawn:
            self._fill(end)
        for pieces in (self.drawn, self.blocks):
            pieces[-1] = replace(pieces[-1], end=end)

    def _take(self, *cells: Sequence[tuple[int, float, float]]) -> None:
        """Add the blocks of the first generation and of the plan between two beats, or none if one does not fit."""
        drawn, planned = map(self._moved, cells, self._flags)
        if drawn is None or planned is None:
            return
        start = drawn[0].start
        # Not enough of the first block would be left after what is there already.
        if min(drawn[0].end, planned[0].end) < max(self._cursor, start) + SHORTEST:
            return
        if start - self._cursor >= _CLOSEST or max(drawn[0].end, planned[0].end) - self._cursor > LONGEST:
            self._fill(start)
        for pieces, new in ((self.drawn, drawn), (self.blocks, planned)):
            # Gaps of less than a block go to the block after them.
            pieces += [replace(new[0], start=self._cursor), *new[1:]]
        self._cursor = drawn[-1].end

    def _moved(self, blocks: Sequence[tuple[int, float, float]], flags: Sequence[plans.Flag]) -> list[_Piece] | None:
        """Blocks (index, start, end) in the new sound; None if one of them does not fit."""
        pieces: list[_Piece] = []
        for at, start, end in blocks:
            first, last = (self._beats.place(edge, edge in self._onsets) for edge in (start, end))
            if first is None or last is None or not last.fits or not fits(last.end - first.start, end - start):
                return None
            begin = pieces[-1].end if pieces else _exact(first.start, start)
            pieces.append(_Piece(begin, _exact(last.end, end), flags[at], at))
            if pieces[-1].end - begin < SHORTEST:
                return None
        return pieces

    def _fill(self, end: float) -> None:
        """Add blocks to be decided, from the last block on, cut at the beats of the sound."""
        detected, start = self._detected, self._cursor
        inner = [(float(edge), cast(plans.Flag, BeatFlag(int(flag)).name.lower()))
                 for edge, flag in zip(detected.edges[1:-1], detected.flags[:-1], strict=True)
                 if start + _CLOSEST <= edge <= end - _CLOSEST]
        last_flag: plans.Flag = "boundary" if end == float(detected.edges[-1]) else "even_pseudo"
        edges = [(start, last_flag), *inner, (end, last_flag)]
        for (first, _), (last, flag) in pairwise(edges):
            # Detected beats may lie farther apart than a block may last: pseudo-beats are put between them.
            count = max(int(np.ceil((last - first) / _LONGEST - 1e-6)), 1)
            cuts = [first, *(round(first + (last - first) * part / count, 6) for part in range(1, count)), last]
            for number, (one, two) in enumerate(pairwise(cuts), 1):
                piece = _Piece(one, two, flag if number == count else "even_pseudo", silent=self._silent(one, two))
                self.drawn.append(piece)
                self.blocks.append(piece)
        self._cursor = end

    def _silent(self, start: float, end: float) -> bool:
        """Whether most of a new block lies in silent blocks of the sound."""
        detected = self._detected
        inside = np.minimum(detected.edges[1:], end) - np.maximum(detected.edges[:-1], start)
        return bool(np.maximum(inside, 0.0)[detected.silent].sum() > 0.5 * (end - start))


# ------------------------------------------------------------------------------------------------------ the plan

def drafted(plan: GesturePlan, speech: Speech, features: SpeechFeatures, words: Sequence[PlanWord] | None) -> Retimed:
    """The plan on a new sound, with blocks that are still to be decided (`decided`): their lexemes are None. features:
    of the sound, cut at its beats; words: of a new transcript, or None. `InputError` for a plan without a fingerprint,
    and if the sounds have too little speech in common."""
    if plan.fingerprint is None:
        raise plan.error(("fingerprint",), "is missing, so the new sound cannot be compared with the old one",
                         "make a new plan")
    sounds = aligned(fingerprint_frames(plan.fingerprint), fingerprint(speech))
    if sounds.speech < LEAST_SPEECH:
        raise plan.error(("sound",), f"is {plan.sound.name or 'another sound'}, {plan.sound.duration:.2f} s, and the "
                         f"one that was given has {100 * sounds.speech:.0f} % of its speech",
                         "give another export of it, or make a new plan")
    beats = BeatMap(sounds, plan.drawn, np.unique(np.concatenate(features.onsets)) if features.onsets else np.zeros(0))
    cut = _Cutter(plan, beats, features.blocks)
    drawn = _drawn(plan, cut.drawn, beats)
    # A new block has the random numbers of the generation's block that begins with it, as any other.
    numbers = dict(zip(drawn.edges, _numbers(drawn), strict=False))
    blocks = tuple(
        plans.Block(piece.start, piece.end, None, piece.silent, plans.BlockDraw(
            plan.seed, plan.variation, numbers[piece.start]), piece.flag) if piece.source is None
        else replace(plan.blocks[piece.source], start=piece.start, end=piece.end) for piece in cut.blocks)
    parts, losses = _sections(plan, beats, words, drawn.edges[-1])
    moved = replace(plan, **parts, drawn=drawn, blocks=blocks, source="plan",
                    sound=plans.PlanSound("", speech.duration, speech.sample_rate, plans.sound_hash(speech)),
                    fingerprint=fingerprint_text(sounds.new))
    gone = sorted(set(range(len(plan.blocks))) - {piece.source for piece in cut.blocks})
    anew = sum(piece.source is None for piece in cut.blocks)
    return Retimed(moved, len(blocks) - anew, anew, len(gone), (*losses, *_lost_edits(plan, gone)))


def _numbers(drawn: plans.DrawnBlocks) -> Sequence[int]:
    return drawn.numbers or range(len(drawn.lexemes))


def _drawn(plan: GesturePlan, pieces: Sequence[_Piece], beats: BeatMap) -> plans.DrawnBlocks:
    """The first generation on the new sound: kept blocks with their numbers, new ones with numbers that none has."""
    old, known = plan.drawn, _numbers(plan.drawn)
    # Beyond all numbers in use: an undone edit may name one that no block has now.
    fresh = itertools.count(max(*known, *(block.draw.block for block in plan.blocks)) + 1)
    numbers = tuple(next(fresh) if piece.source is None else known[piece.source] for piece in pieces)
    times = old.keyed_at or old.edges
    keyed_at = tuple(piece.start if piece.source is None else times[piece.source] for piece in pieces)
    starts = tuple(piece.start for piece in pieces)
    lexemes: tuple[Any, ...] = tuple(None if piece.source is None else old.lexemes[piece.source] for piece in pieces)
    return plans.DrawnBlocks((0.0, *(piece.end for piece in pieces)), tuple(piece.flag for piece in pieces),
                       tuple(piece.silent if piece.source is None else old.silent[piece.source] for piece in pieces),
                       lexemes, _knobs(old.knobs, beats), () if numbers == tuple(range(len(numbers))) else numbers,
                       () if keyed_at == starts else keyed_at)


def decided(draft: GesturePlan, generated: Sequence[BlockMotion]) -> GesturePlan:
    """The plan with the decisions of its first generation [N] in the new blocks."""
    drawn = draft.drawn
    by_start = {start: block.block for start, block in zip(drawn.edges, generated, strict=False)}
    new = {start for start, lexeme in zip(drawn.edges, drawn.lexemes, strict=False) if lexeme is None}
    return replace(draft, drawn=replace(drawn, lexemes=tuple(block.lexeme for block in generated)),
                   blocks=tuple(replace(by_start[block.start], start=block.start, end=block.end, silent=block.silent)
                                if block.start in new else block for block in draft.blocks))


def _lost_edits(plan: GesturePlan, gone: Sequence[int]) -> list[str]:
    """A line for each edited block among those that are gone."""
    edited = plans.edited_blocks(plan)
    return [_lost("edit of the block", block.start) for at, block in enumerate(plan.blocks) if at in gone
            and (edited[at] or block.locked or block.mirror or block.intensity != 1.0)]


# ------------------------------------------------------------------------------------------------- the other times

def _sections(plan: GesturePlan, beats: BeatMap, words: Sequence[PlanWord] | None, duration: float
                   ) -> tuple[dict[str, Any], list[str]]:
    """The parts of a plan with times, moved, for `dataclasses.replace`; and a line for each pin and cue that is lost.
    words: those of a new transcript, or None to move the old ones; duration: seconds that the blocks will cover."""
    # Words come first: cues at words are looked for among those that are left, or among the new ones.
    now = tuple(words) if words is not None else _spans(plan.words, beats, duration)
    cues, pins, losses = list[plans.GestureCue](), [], []
    for cue in plan.cues:
        before = _said(cue, plan.words)
        moved = _cue(cue, before, beats, now, duration)
        if moved is None:
            losses.append(_lost(f"cue {cue.gesture}" + (f" at \"{cue.word}\"" if cue.word else ""), before or 0.0))
        else:
            cues.append(moved)
    for pin in plan.pins:
        time = beats.moment(pin.time)
        if time is None:
            losses.append(_lost(f"pin of {pin.joint}", pin.time))
        else:
            hold = max(beats.anywhere(pin.time + pin.hold) - time, 0.0) if pin.hold else 0.0
            pins.append(replace(pin, time=min(beats.at(pin.time), duration), hold=round(hold, 6)))
    settings = dict(plan.made_by.get("settings", {}))
    for name in (f"hand_{feature}" for feature in FEATURES):
        if isinstance(settings.get(name), dict):
            times, values = _points(settings[name]["times"], settings[name]["values"], beats)
            settings[name] = {"times": list(times), "values": list(values)}
    return {
        "words": now, "cues": tuple(cues), "pins": tuple(pins), "knobs": _knobs(plan.knobs, beats),
        "units": _spans(plan.units, beats, duration), "meanings": _spans(plan.meanings, beats, duration),
        "curves": tuple(plans.KnobCurve(curve.knob, *_points(curve.times, curve.values, beats))
                        for curve in plan.curves),
        "made_by": {**plan.made_by, "settings": settings}}, losses


def _lost(item: str, time: float) -> str:
    """The line about a pin, a cue or an edit at a time of the old sound, seconds, that has no place in the new one."""
    return f"the {item} at {time:.2f} s is lost: its sound is gone or is another one"


def _spans(records: Sequence[Any], beats: BeatMap, duration: float) -> tuple[Any, ...]:
    """Words, units, phases or meanings, without those of which little is left."""
    out = []
    for record in records:
        times = {name: min(beats.at(getattr(record, name)), duration) for name in ("start", "end", "time")
                 if getattr(record, name, None) is not None}
        # What was cut in the middle is not what the plan had.
        middle = beats.moment((record.start + record.end) / 2)
        if middle is not None and times["end"] - times["start"] >= min(_LEAST, record.end - record.start):
            inner = {"phases": _spans(record.phases, beats, duration)} if hasattr(record, "phases") else {}
            out.append(replace(record, **times, **inner))
    return tuple(out)


def _said(cue: plans.GestureCue, words: Sequence[PlanWord]) -> float | None:
    """Seconds at which a cue stands in the old sound; None for one at a word that is not said."""
    if cue.time is not None:
        return cue.time
    spoken = [word.start for word in words if plain_word(word.text) == plain_word(cue.word or "")]
    return spoken[cue.occurrence - 1] if len(spoken) >= cue.occurrence else None


def _cue(cue: plans.GestureCue, before: float | None, beats: BeatMap, words: Sequence[PlanWord], duration: float
         ) -> plans.GestureCue | None:
    """A cue in the new sound; None for a lost one."""
    if before is None:
        return cue  # reported when the plan is rendered, as before
    now = beats.moment(before)
    if now is None or cue.time is not None:
        return None if now is None else replace(cue, time=min(beats.at(before), duration))
    # A cue names the n-th occurrence, and n changes when earlier ones are cut: the word is found by its time.
    equal = [word for word in words if plain_word(word.text) == plain_word(cue.word or "")]
    distance, occurrence = min(((abs(word.start - now), at) for at, word in enumerate(equal, 1)), default=(_NEAR, 0))
    return replace(cue, occurrence=occurrence) if distance < _NEAR else None


def _knobs(knobs: plans.PlanKnobs, beats: BeatMap) -> plans.PlanKnobs:
    """Knobs with their ranges of stillness moved."""
    ranges = ((beats.at(start), beats.at(end)) for start, end in knobs.hold_still)
    return replace(knobs, hold_still=tuple(range_ for range_ in ranges if range_[1] - range_[0] >= _LEAST))


def _points(times: Sequence[float], values: Sequence[float], beats: BeatMap
            ) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The points of a curve; of points that meet in a cut the first remains, as a plan's points must rise."""
    points: dict[float, float] = {}
    for time, value in zip(times, values, strict=True):
        points.setdefault(beats.at(time), value)
    return tuple(points), tuple(points.values())
