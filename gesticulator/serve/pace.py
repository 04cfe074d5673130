"""Measures how late the processing of a stream is, and decides how to catch up.

A client plays its audio by a clock. `Pace` tracks the upper bound of what it can have played: a second per second, and
never more than it sent. Queued audio that must have been played already is late. A microphone has played everything it
sent; a synthesiser that sent an answer at once has not, and its queued audio is not late.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from enum import StrEnum

HURRIES, CALM = 0.3, 0.15
"""Delays in seconds above which blocks are generated at lower cost, and below which at full quality again: a block
lasts 0.3 s, so a smaller delay can be caught up within the next."""
PASSES = 1.0
"""Delay in seconds above which queued audio is skipped if it cannot be caught up within `CATCHES_UP`: poses of a
low-latency stream wait about as long anyway."""
CATCHES_UP = 1.0
_FAST = 1.02
"""Assumed speed of a client's clock relative to ours. A clock fast by 1 % sends 36 s more than an hour of audio in an
hour; if that counted as ahead, it would be 36 s late before being noticed. A synthesiser ahead by a minute counts as 59
s ahead."""
_MEMORY = 1.0
"""Averaging window of the processing time, seconds of audio: three blocks."""


class Effort(StrEnum):
    """How audio is processed: as the client asked, with low look-ahead, at lower cost (and with low look-ahead), or not
    at all."""

    FULL = "full"
    LOW = "low"
    LESS = "less"
    NONE = "none"


class Pace:
    """The pace of one stream, see the module. A client's clock may be slow, or fast by up to 2 %, indefinitely."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._last = clock, clock()
        self._ahead = 0.0  # seconds sent that cannot have been played at `_last`
        self._hurried = False
        self._took = self._worked = 0.0  # seconds of processing, and of processed audio

    def arrived(self, seconds: float) -> None:
        """More audio was sent, to be played."""
        self._ahead = self.ahead + seconds
        self._last = self._clock()

    def forget(self) -> None:
        """Audio sent so far will not be played."""
        self._ahead = 0.0

    @property
    def ahead(self) -> float:
        """Seconds sent that cannot have been played yet."""
        return max(0.0, self._ahead - _FAST * (self._clock() - self._last))

    def late(self, waiting: float) -> float:
        """Of `waiting` seconds of queued audio, those that must have been played."""
        return max(0.0, waiting - self.ahead)

    def worked(self, seconds: float, took: float) -> None:
        """Record that processing `seconds` of audio took `took` seconds, including waiting for other streams."""
        share = math.exp(-seconds / _MEMORY)
        self._took, self._worked = share * self._took + took, share * self._worked + seconds

    def effort(self, waiting: float) -> Effort:
        """The effort for the next piece, with `waiting` seconds of audio queued."""
        late = self.late(waiting)
        hurried = late > (CALM if self._hurried else HURRIES)
        if hurried and not self._hurried:
            self._took = self._worked = 0.0  # the time at full quality does not predict that at lower cost
        self._hurried = hurried
        if not hurried:
            return Effort.FULL
        # More audio arrives while the queue is processed: it takes late * took / (worked - took) seconds to catch up.
        left = self._worked - self._took
        hopeless = self._worked > 0 and late * self._took > CATCHES_UP * left
        return Effort.NONE if late > PASSES and hopeless else Effort.LESS
