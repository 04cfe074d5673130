"""What became of a plan that was moved onto another export of its sound: `RetimingReport`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["MovedBlocks", "MovedItem", "RetimingReport"]

MOST_LINES = 8
"""Most runs of kept blocks that are printed one by one; at another tempo every few blocks have a shift of their own."""
SAME_SHIFT = 0.02
"""Seconds: blocks whose shifts differ by less are reported together."""


@dataclass(frozen=True)
class MovedBlocks:
    """Consecutive blocks. start, end: seconds of the new sound, or of the old one for blocks that were dropped; by:
    seconds by which the first was moved; count: of the blocks."""

    start: float
    end: float
    count: int
    by: float = 0.0


@dataclass(frozen=True)
class MovedItem:
    """A pin, a cue or an edit. time: seconds of the old sound; now: of the new one, or None if it was lost."""

    what: str
    time: float
    now: float | None = None


@dataclass(frozen=True)
class RetimingReport:
    """What became of a plan on another export of its sound.

    same_speech: share of the old speech that was found in the new sound, 0 to 1. kept: blocks with their lexemes, by
    runs of one shift; anew: blocks that the bundle decided, in seconds of the new sound; dropped: blocks that are gone,
    in seconds of the old sound. moved: pins and cues; edited: edits of blocks that are gone. words_lost: words whose
    sound is gone.
    """

    same_speech: float = 1.0
    kept: tuple[MovedBlocks, ...] = ()
    anew: tuple[MovedBlocks, ...] = ()
    dropped: tuple[MovedBlocks, ...] = ()
    moved: tuple[MovedItem, ...] = ()
    edited: tuple[MovedItem, ...] = ()
    words_lost: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return {**asdict(self), "blocks_kept": _count(self.kept), "blocks_anew": _count(self.anew),
                "blocks_dropped": _count(self.dropped)}

    @property
    def losses(self) -> tuple[str, ...]:
        """A line for each pin, cue or edit that was lost."""
        return tuple(f"the {item.what} at {item.time:.2f} s is lost: its sound is gone or is another one"
                     for item in (*self.moved, *self.edited) if item.now is None)

    def lines(self) -> tuple[str, ...]:
        """The report as text; losses are not repeated."""
        out = [f"re-timed: {_blocks(_count(self.kept))} kept, {_count(self.anew)} decided anew, "
               f"{_count(self.dropped)} dropped"]
        if len(self.kept) > MOST_LINES:
            shifts = [run.by for run in self.kept]
            out.append(f"kept blocks are moved by {min(shifts):+.2f} to {max(shifts):+.2f} s")
        else:
            out += [f"{_seconds(run)}: {_blocks(run.count)} kept, "
                    + (f"moved by {run.by:+.2f} s" if abs(run.by) >= 0.005 else "not moved") for run in self.kept]
        out += [f"decided anew: {', '.join(map(_seconds, self.anew))}"] * bool(self.anew)
        out += [f"dropped, in the old sound: {', '.join(map(_seconds, self.dropped))}"] * bool(self.dropped)
        out += [f"{item.what}: {item.time:.2f} s -> {item.now:.2f} s" for item in self.moved
                if item.now is not None and abs(item.now - item.time) >= 0.005]
        if self.words_lost:
            out.append(f"{self.words_lost} words are gone; give the new text to have those of the new sound")
        return tuple(out)


def _seconds(run: MovedBlocks) -> str:
    return f"{run.start:.2f}-{run.end:.2f} s"


def _count(runs: Iterable[MovedBlocks]) -> int:
    return sum(run.count for run in runs)


def _blocks(count: int) -> str:
    return f"{count} block" + "s" * (count != 1)


def runs_of(blocks: Iterable[tuple[float, float, float]]) -> tuple[MovedBlocks, ...]:
    """Blocks (start, end, shift) joined into runs: each begins where the one before ends, with the same shift."""
    runs: list[MovedBlocks] = []
    for start, end, by in blocks:
        last = runs[-1] if runs else None
        if last is not None and abs(start - last.end) < 1e-6 and abs(by - last.by) < SAME_SHIFT:
            runs[-1] = MovedBlocks(last.start, round(end, 6), last.count + 1, last.by)
        else:
            runs.append(MovedBlocks(round(start, 6), round(end, 6), 1, round(by, 6)))
    return tuple(runs)
