"""What a server has time for: whom it admits, and who is served at lower cost while compute runs short.

**Admission.** The processor time of a second of speech is measured. A newcomer is admitted while the time of all open
streams and of one more, each speaking without a pause, fits into `share` of the time that there is; so a full server
refuses before anybody's latency moves. The first stream is always admitted.

**Downgrading.** Admitted streams may still be late: the machine became slower, or does something else. Then streams are
downgraded one at a time, the lowest priority first: all that have full look-ahead to low look-ahead, then all to
hurried blocks, before the first one to idle motion. One number, `depth`, says how far: with M streams of full
look-ahead among N, step k of the first M is "the k-th lowest of them has low look-ahead", of the next N "the k-th
lowest is hurried", and of the last N "it idles". Restoring is the same number going down, so streams come back in
reverse order.

Low look-ahead saves no computing. Its poses come so much earlier (`Governed.saving`) that a stream may be late by as
much and still keep what its client was promised, so a short shortage costs nothing but the view of the next block.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from gesticulator.serve.pace import CALM, HURRIES, PASSES, Effort

REVIEW_SECONDS = 0.1
"""Interval of `Governor.review`, seconds."""
RESTORE_SECONDS = 2.0
"""Time without lateness after which a step is taken back, seconds."""
LONGEST_RESTORE = 30.0
"""The same at most, after restoring has failed several times: a machine that is always too slow would flap."""
PRIOR_COST = 0.065
"""Processor time of a second of speech in a server, seconds, before any is measured (docs/serve.md)."""
RETRY_SECONDS = 5.0
"""When a client that was refused may try again: streams end at any time, and an autoscaler takes half a minute."""
_MEMORY = 20.0
"""Averaging window of the cost, seconds of speech."""
_SETTLING = 0.02
"""Decrease of the lateness per review, seconds, from which on the backlog is being caught up and no step is needed."""


class Governed(Protocol):
    """A stream as the governor sees it."""

    priority: int
    """Higher ones are downgraded later; of equal ones the newest goes first."""

    @property
    def lateness(self) -> float | None:
        """Seconds of sound that should have been answered; None for a stream that may not be downgraded."""

    @property
    def saving(self) -> float:
        """Seconds by which low look-ahead brings poses earlier; 0 for a stream that has it anyway."""


@dataclass
class Room:
    """Whether another stream is admitted. streams: open ones; capacity: how many fit; load: of one core, as promised to
    the open ones."""

    streams: int
    capacity: int
    load: float
    open: bool
    reason: str = ""


class Governor:
    """Decides for the streams of one compute thread."""

    def __init__(self, share: float, most: int, cost: float = PRIOR_COST,
                 clock: Callable[[], float] = time.monotonic) -> None:
        """share: of the compute thread's time that may be promised, above 1 whatever there is; most: streams at most;
        cost: of a second of speech at full quality, seconds, until it is measured."""
        self.share, self.most, self._clock = share, most, clock
        self._cost, self._weight = cost, _MEMORY / 4
        self.depth = 0
        self._late = 0.0
        self._calm_since = clock()
        self._patience, self._restored = RESTORE_SECONDS, -math.inf

    # ------------------------------------------------------------------------------------------------ admission

    @property
    def cost(self) -> float:
        """Seconds of computing for a second of speech at full quality."""
        return self._cost

    def worked(self, seconds: float, took: float) -> None:
        """Record that `seconds` of speech at full quality took `took` seconds of computing."""
        keep = math.exp(-seconds / _MEMORY)
        weight = keep * self._weight + seconds
        self._cost = (keep * self._weight * self._cost + took) / weight if weight > 0 else self._cost
        self._weight = weight

    def room(self, streams: int) -> Room:
        """Whether a stream beside `streams` open ones is admitted."""
        fits = self.most if self._cost <= 0 else min(self.most, max(1, int(self.share / self._cost + 1e-9)))
        found = Room(streams, fits, streams * self._cost, streams < fits and
                     (self.depth == 0 or streams == 0 or self.share > 1))
        if streams >= self.most:
            found.reason = f"the server has its {self.most} streams"
        elif not found.open:
            found.reason = f"the server has no computing time for a stream beside its {streams}"
        return found

    # ---------------------------------------------------------------------------------------------- downgrading

    def review(self, streams: Sequence[Governed]) -> None:
        """Take a step down or up; called every `REVIEW_SECONDS`."""
        able = self.ranked(streams)
        before_idling = len(able) + len(_long(able))
        most = before_idling + len(able)
        self.depth = min(self.depth, most)
        now = self._clock()
        efforts = [(stream, self.effort(stream, able)) for stream in able]
        if any((stream.lateness or 0.0) > CALM for stream, effort in efforts if effort != Effort.NONE):
            self._calm_since = now
        late = max(((stream.lateness or 0.0) - (0.0 if effort == Effort.FULL else stream.saving)
                    for stream, effort in efforts if effort != Effort.NONE), default=0.0)
        worse = late > self._late - _SETTLING
        self._late = late
        if late > (HURRIES if self.depth < before_idling else PASSES) and worse:
            if now - self._restored < self._patience:
                self._patience = min(2 * self._patience, LONGEST_RESTORE)
            # A tenth of the streams in one review: a sweep over all takes a second, however many there are.
            self.depth = min(self.depth + math.ceil(len(able) / 10), most)
        elif self.depth and now - self._calm_since >= self._patience:
            self.depth -= 1
            self._calm_since = self._restored = now
        elif not self.depth and now - self._restored > LONGEST_RESTORE:
            self._patience = RESTORE_SECONDS

    def ranked(self, streams: Sequence[Governed]) -> list[Governed]:
        """Streams that may be downgraded, in the order in which they are. streams: oldest first."""
        order = [(stream.priority, -number) for number, stream in enumerate(streams)]
        found = sorted(zip(order, streams, strict=True), key=lambda one: one[0])
        return [stream for _, stream in found if stream.lateness is not None]

    def effort(self, stream: Governed, ranked: Sequence[Governed]) -> Effort:
        """How a stream of a ranking is served."""
        if not self.depth or stream not in ranked:
            return Effort.FULL
        rank, count, long = ranked.index(stream), len(ranked), _long(ranked)
        hurried = self.depth - len(long)
        if rank < hurried - count:
            return Effort.NONE
        if rank < hurried:
            return Effort.LESS
        return Effort.LOW if stream in long[:self.depth] else Effort.FULL


def _long(ranked: Sequence[Governed]) -> list[Governed]:
    """Those of a ranking that asked for full look-ahead."""
    return [stream for stream in ranked if stream.saving > 0]
