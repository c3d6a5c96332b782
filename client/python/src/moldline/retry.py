"""How long a call may take, and when it is tried again."""

from __future__ import annotations

import math
import random
import time
from dataclasses import dataclass

from moldline.errors import Cancelled, DeadlineExceeded, MoldlineError, ResourceExhausted, Unavailable


@dataclass(frozen=True)
class Retry:
    """When a call is tried again: with growing pauses, as long as its timeout allows.

    A server that cannot be reached or is about to stop (:class:`Unavailable`) is always worth another try, one that is
    full (:class:`ResourceExhausted`) if it says when, and not before. All calls are safe to repeat: they change nothing,
    or carry a request id by which the server recognises them.

    The pause before attempt k + 1 is what the server asks for, plus a random share of `first_pause * 2^(k-1)`, so that
    those who failed together do not come back together.
    """

    #: How often a call is tried in all; 1 for never again.
    attempts: int = 10
    #: Seconds.
    first_pause: float = 0.1
    #: Seconds beyond which pauses do not grow.
    longest_pause: float = 5.0


class Deadline:
    """The end of the time that a call may take."""

    def __init__(self, timeout: float) -> None:
        #: Of the monotonic clock; may be infinite.
        self._end = time.monotonic() + timeout

    @property
    def remaining(self) -> float | None:
        """Seconds from now, not negative; `None` for no limit."""
        return None if math.isinf(self._end) else max(0.0, self._end - time.monotonic())


class Attempts:
    """Those of one call."""

    def __init__(self, retry: Retry, deadline: Deadline) -> None:
        self._retry = retry
        self._deadline = deadline
        self._failed = 0
        self._longest = retry.first_pause

    def pause(self, error: MoldlineError) -> float:
        """Seconds to wait before the next attempt; raises `error` if there is none."""
        self._failed += 1
        if isinstance(error, Cancelled) and self._deadline.remaining == 0.0:
            # A server that ends a call at its deadline may say so in this way.
            raise DeadlineExceeded("the call took longer than its timeout")
        again = isinstance(error, Unavailable) or (
            isinstance(error, ResourceExhausted) and error.retry_after is not None
        )
        if not again or self._failed >= self._retry.attempts:
            raise error
        pause = (error.retry_after or 0.0) + random.uniform(0.0, self._longest)
        self._longest = min(2.0 * self._longest, self._retry.longest_pause)
        remaining = self._deadline.remaining
        if remaining is not None and pause >= remaining:
            raise error
        return pause
