"""Deadlines and retries of calls."""

from __future__ import annotations

import math
import random
import time
from dataclasses import dataclass

from moldline.errors import Cancelled, DeadlineExceeded, MoldlineError, ResourceExhausted, Unavailable


@dataclass(frozen=True)
class Retry:
    """Retry policy: exponential backoff with jitter, within the timeout of the call.

    Calls are repeated if the server cannot be reached, or answers that it is stopping (:class:`Unavailable`) or is full and
    names a delay (:class:`ResourceExhausted`): it has not begun with them. All calls are safe to repeat: they change
    nothing, or carry a request id by which the server recognises them.

    A call whose connection broke after it was sent (:attr:`Unavailable.lost`) may be what the server died of. It is repeated
    once, after a longer pause, unless `losses` says otherwise.

    The pause before attempt k + 1 is the delay that the server names, plus a random share of `first_pause * 2^(k-1)`, so
    that clients that failed together do not return together.
    """

    #: Number of attempts, including the first; 1 for no retry; `None` for as many as the timeout allows (without a timeout:
    #: as are made within 10 minutes).
    attempts: int | None = None
    #: Upper bound of the first random pause, seconds.
    first_pause: float = 0.1
    #: Upper bound of all random pauses, seconds.
    longest_pause: float = 5.0
    #: How often a call is repeated whose connection broke after it was sent.
    losses: int = 1


class Deadline:
    """Deadline of an operation over all its calls."""

    def __init__(self, timeout: float) -> None:
        #: Time of the monotonic clock; may be infinite.
        self._end = time.monotonic() + timeout

    @property
    def remaining(self) -> float | None:
        """Seconds from now, not negative; `None` for no limit."""
        return None if math.isinf(self._end) else max(0.0, self._end - time.monotonic())


#: How long a call without a timeout is repeated, seconds.
_PATIENCE = 600.0
#: Pause before a call is repeated whose connection broke, in first pauses.
_AFTER_LOSS = 10.0


class Attempts:
    """Failed attempts of one call."""

    def __init__(self, retry: Retry, deadline: Deadline, server: str) -> None:
        self._retry = retry
        self._deadline = deadline
        self._server = server
        self._began = time.monotonic()
        self._failed = 0
        self._lost = 0
        self._longest = retry.first_pause

    def pause(self, error: MoldlineError) -> float:
        """Seconds to wait before the next attempt; raises `error` if there is to be none."""
        self._failed += 1
        if isinstance(error, Cancelled) and self._deadline.remaining == 0.0:
            # A server may report the deadline as a cancellation.
            raise DeadlineExceeded("the call took longer than its timeout")
        lost = isinstance(error, Unavailable) and error.lost
        self._lost += lost
        pause = (error.retry_after or 0.0) + random.uniform(0.0, self._longest)
        if lost:
            pause += _AFTER_LOSS * self._retry.first_pause
        self._longest = min(2.0 * self._longest, self._retry.longest_pause)
        if not self._again(error) or pause >= self._left():
            raise self._told(error)
        return pause

    def _again(self, error: MoldlineError) -> bool:
        if isinstance(error, Unavailable):
            passes = error.passes and self._lost <= self._retry.losses
        else:
            passes = isinstance(error, ResourceExhausted) and error.retry_after is not None
        return passes and (self._retry.attempts is None or self._failed < self._retry.attempts)

    def _left(self) -> float:
        remaining = self._deadline.remaining
        return self._began + _PATIENCE - time.monotonic() if remaining is None else remaining

    def _told(self, error: MoldlineError) -> MoldlineError:
        """The error, saying what was tried where."""
        times = "once" if self._failed == 1 else f"{self._failed} times"
        if self._lost > 0:
            under = "the call" if self._lost == 1 else f"{self._lost} of the calls"
            what = f"called {times}, and the connection broke under {under}, which the server may have died of"
        elif self._failed > 1 or (isinstance(error, Unavailable) and not error.answered):
            what = f"called {times}"
        else:
            return error
        error.message = f"{error.message} ({self._server}: {what})"
        error.args = (error.message,)
        return error
