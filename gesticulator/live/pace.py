"""How late a stream is, and how much to compute for it.

A client plays its audio by a clock. `Pace` tracks the upper bound of what it can have played: a second per second, and
never more than it sent. Queued audio that must have been played already is late. A microphone has played everything it
sent; a synthesiser that sent an answer at once has not, and its queued audio is not late.
"""

import math
import time
from collections.abc import Callable
from enum import StrEnum

LATE_SECONDS, ON_TIME_SECONDS = 0.15, 0.05
"""Delays above which blocks are generated at lower cost, and below which at full quality again: half a block, which the
next one can catch up."""
SKIP_SECONDS = 0.15
"""Delay above which queued audio is skipped if it cannot be caught up within `CATCH_UP_SECONDS`. Poses of a low-latency
stream wait for 0.6 s of audio anyway; the delay comes on top."""
CATCH_UP_SECONDS = 1.0
"""Time to catch up that is accepted; a machine that stalled for 3 s has caught up by then at a quarter of real time."""
REST_SECONDS = 2.0
"""Time for which a stream that skips goes on skipping. The character rests for the length of a pause rather than
stopping and starting several times a second, and the other streams are on time meanwhile."""
_FASTEST_CLOCK = 1.02
"""Assumed speed of a client's clock relative to the server's. A clock fast by 1 % sends 36 s more than an hour of audio
in an hour; if that counted as ahead, it would be 36 s late before being noticed. A synthesiser ahead by a minute counts
as 59 s ahead."""
_WINDOW_SECONDS = 1.0
"""Averaging window of the processing time, in audio: three blocks."""


class Effort(StrEnum):
    """How audio is processed: as the client asked, at lower cost and with low look-ahead, or not at all."""

    FULL = "full"
    LESS = "less"
    NONE = "none"


class Pace:
    """The pace of one stream, see the module. A client's clock may be slow, or fast by up to 2 %, indefinitely."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._last = clock, clock()
        self._ahead = 0.0  # seconds sent that cannot have been played at `_last`
        self._late = False
        self._computing = self._computed = 0.0  # seconds of computing, and of the audio that was computed
        self._rests_until = -math.inf

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
        return max(0.0, self._ahead - _FASTEST_CLOCK * (self._clock() - self._last))

    def late(self, waiting: float) -> float:
        """Of `waiting` seconds of queued audio, those that must have been played."""
        return max(0.0, waiting - self.ahead)

    def worked(self, seconds: float, elapsed: float) -> None:
        """Record that processing `seconds` of audio took `elapsed` seconds, including waiting for other streams."""
        # Exponential average over audio time, whatever the size of the pieces.
        weight = math.exp(-seconds / _WINDOW_SECONDS)
        self._computing = weight * self._computing + elapsed
        self._computed = weight * self._computed + seconds

    def effort(self, waiting: float) -> Effort:
        """The effort for the next piece, with `waiting` seconds of audio queued."""
        if self._clock() < self._rests_until:
            return Effort.NONE
        seconds = self.late(waiting)
        # Two bounds, so that a stream at the limit does not change its effort at each piece.
        late = seconds > (ON_TIME_SECONDS if self._late else LATE_SECONDS)
        if late and not self._late:
            self._computing = self._computed = 0.0  # the time at full quality does not predict that at lower cost
        self._late = late
        if not late:
            return Effort.FULL
        # More audio arrives while the queue is processed, so catching up takes
        # seconds * computing / (computed - computing).
        hopeless = self._computed > 0 \
            and seconds * self._computing > CATCH_UP_SECONDS * (self._computed - self._computing)
        if seconds <= SKIP_SECONDS or not hopeless:
            return Effort.LESS
        self._rests_until = self._clock() + REST_SECONDS
        return Effort.NONE
