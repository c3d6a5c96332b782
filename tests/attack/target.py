"""A server under attack: its memory, and how fast its health probe answers meanwhile."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path

import numpy as np

from server import Server
from sockets import ask
from trial import Row

MIB = 1 << 20


class Watch:
    """Largest resident memory of a server and times of its health probe, from here to the end of the block."""

    def __init__(self, server: Server, account: int) -> None:
        self.server, self.account = server, account
        self.largest = 0
        self.times: list[float] = []
        self.failed = 0
        self._end = threading.Event()
        self._threads = [threading.Thread(target=self._look), threading.Thread(target=self._probe)]

    def _look(self) -> None:
        status = Path(f"/proc/{self.server.process.pid}/status")
        while not self._end.wait(0.01):
            with contextlib.suppress(OSError):
                lines = status.read_text().splitlines()
                self.largest = max(
                    [self.largest, *(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))]
                )

    def _probe(self) -> None:
        while not self._end.wait(0.02):
            status, seconds = ask(self.server)
            self.times.append(seconds)
            self.failed += status != 200

    def __enter__(self) -> Watch:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        for thread in self._threads:
            thread.join()

    def rows(self, attack: str) -> list[Row]:
        """What must hold in every attack on an account of so many MiB."""
        alive = self.server.process.poll() is None
        p99 = float(np.percentile(self.times, 99)) if self.times else float("nan")
        return [
            Row(f"{attack}: the process is alive", float(alive), "", "== 1"),
            Row(f"{attack}: largest resident memory", self.largest / 1024, "MiB", f"<= {self.account + 300}"),
            Row(f"{attack}: health probes without an answer", self.failed, "", "== 0"),
            Row(f"{attack}: health p99", 1e3 * p99, "ms", "<= 100", timed=True),
        ]
