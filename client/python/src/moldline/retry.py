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

    Calls are retried if the server cannot be reached or is stopping (:class:`Unavailable`), or if it is full and names a
    delay (:class:`ResourceExhausted`). All calls are safe to repeat: they change nothing, or carry a request id by which
    the server recognises them.

    The pause before attempt k + 1 is the delay that the server names, plus a random share of `first_pause * 2^(k-1)`, so
    that clients that failed together do not return together.
    """

    #: Number of attempts, including the first; 1 for no retry.
    attempts: int = 10
    #: Upper bound of the first random pause, seconds.
    first_pause: float = 0.1
    #: Upper bound of all random pauses, seconds.
    longest_pause: float = 5.0


class Deadline:
    """Deadline of an operation over all its calls."""

    def __init__(self, timeout: float) -> None:
        #: Time of the monotonic clock; may be infinite.
        self._end = time.monotonic() + timeout

    @property
    def remaining(self) -> float | None:
        """Seconds from now, not negative; `None` for no limit."""
        return None if math.isinf(self._end) else max(0.0, self._end - time.monotonic())


class Attempts:
    """Failed attempts of one call."""

    def __init__(self, retry: Retry, deadline: Deadline) -> None:
        self._retry = retry
        self._deadline = deadline
        self._failed = 0
        self._longest = retry.first_pause

    def pause(self, error: MoldlineError) -> float:
        """Seconds to wait before the next attempt; raises `error` if there is to be none."""
        self._failed += 1
        if isinstance(error, Cancelled) and self._deadline.remaining == 0.0:
            # A server may report the deadline as a cancellation.
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
