"""The sessions that a client opens for calls without one."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from moldline import forks


class OwnSessions:
    """One session of each set-up and process, opened when it is needed. A child process leaves its parent's alone."""

    def __init__(self) -> None:
        self._lock = forks.Lock()
        self._process = os.getpid()
        self._by_setup: dict[str, Any] = {}

    def find(self, setup_id: str, opened: Callable[[], Any]) -> Any:
        """The session of a set-up."""
        with self._lock:
            if self._process != os.getpid():
                self._process, self._by_setup = os.getpid(), {}
            if setup_id not in self._by_setup:
                self._by_setup[setup_id] = opened()
            return self._by_setup[setup_id]

    def taken(self) -> list[Any]:
        """All sessions, which are no longer kept here: to be closed."""
        with self._lock:
            sessions = list(self._by_setup.values()) if self._process == os.getpid() else []
            self._by_setup = {}
            return sessions
