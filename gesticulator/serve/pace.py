"""How late the work on a stream is, and what to do about it.

A client plays its sound by a clock. `Pace` follows the farthest that it can have played: it plays a second in a second,
and never more than it sent. Sound that waits and must have been played already is late. A microphone has played all
that it sent; a synthesiser that sent an answer at once is far from it, and its sound is not late while it waits.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from enum import StrEnum

HURRIES, CALM = 0.3, 0.15
"""Seconds late from which blocks are drawn at less cost, and below which they are drawn as well as can be again: a
block lasts 0.3 s, and who is less late than that has the next one to catch up in."""
PASSES = 1.0
"""Seconds late from which what waits is passed over, where it would not be caught up within `CATCHES_UP`: in a low
latency stream poses wait for about as long anyhow."""
CATCHES_UP = 1.0
"""Seconds."""
_FAST = 1.02
"""Seconds that a client's clock is taken to go by in one of ours. One that is fast by 1 % sends 36 s more than an hour
of sound in an hour: held to be ahead by them, it would be 36 s late before that is noticed. What a synthesiser is
ahead by a minute is held to be 59 s."""
_MEMORY = 1.0
"""Seconds of sound over which the time of the work is taken: three blocks."""


class Effort(StrEnum):
    """What is done with sound: all that can be, less, or nothing: it is passed over."""

    FULL = "full"
    LESS = "less"
    NONE = "none"


class Pace:
    """Of one stream, see the module. A client's clock may be slow, or fast by 2 %, for ever."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """clock: gives seconds."""
        self._clock, self._last = clock, clock()
        self._ahead = 0.0  # seconds that were sent and cannot have been played at `_last`
        self._hurried = False
        self._took = self._worked = 0.0  # seconds of work, and of the sound that it was for, since she hurries

    def arrived(self, seconds: float) -> None:
        """So much more was sent to be played."""
        self._ahead = self.ahead + seconds
        self._last = self._clock()

    def forget(self) -> None:
        """What was sent is not played any more."""
        self._ahead = 0.0

    @property
    def ahead(self) -> float:
        """Seconds that were sent and cannot have been played yet."""
        return max(0.0, self._ahead - _FAST * (self._clock() - self._last))

    def late(self, waiting: float) -> float:
        """Of so many seconds of sound that wait, those that must have been played."""
        return max(0.0, waiting - self.ahead)

    def worked(self, seconds: float, took: float) -> None:
        """Work on so much sound took so long, the turns of other streams included."""
        share = math.exp(-seconds / _MEMORY)
        self._took, self._worked = share * self._took + took, share * self._worked + seconds

    def effort(self, waiting: float) -> Effort:
        """What to do next, with so many seconds of sound waiting."""
        late = self.late(waiting)
        hurried = late > (CALM if self._hurried else HURRIES)
        if hurried and not self._hurried:
            self._took = self._worked = 0.0  # how long it takes at full cost says nothing of the time at less
        self._hurried = hurried
        if not hurried:
            return Effort.FULL
        # More sound comes while what waits is worked on: late * took / (worked - took) seconds until it is done.
        left = self._worked - self._took
        hopeless = self._worked > 0 and late * self._took > CATCHES_UP * left
        return Effort.NONE if late > PASSES and hopeless else Effort.LESS
