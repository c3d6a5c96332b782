"""A server under attack: plain sockets to it, its memory, and how fast its health probe answers meanwhile."""

from __future__ import annotations

import contextlib
import http.client
import resource
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from server import Server
from trial import Row

MIB = 1 << 20


@contextlib.contextmanager
def many_files() -> Iterator[int]:
    """As many open files for this process as the system allows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    yield hard
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def connect(server: Server, first: bytes = b"") -> socket.socket:
    """A connection on which `first` has been sent."""
    host, port = server.address.rsplit(":", 1)
    connection = socket.create_connection((host, int(port)), timeout=30)
    if first:
        connection.sendall(first)
    return connection


def head(server: Server, line: str, *fields: str) -> bytes:
    """The head of a request over HTTP/1.1."""
    return "\r\n".join([f"{line} HTTP/1.1", f"host: {server.address}", *fields, "", ""]).encode()


def ask(server: Server, path: str = "/healthz", timeout: float = 5.0) -> tuple[int, float]:
    """Status and seconds of a GET on a connection of its own; status 0 without an answer."""
    start = time.monotonic()
    connection = http.client.HTTPConnection(server.address, timeout=timeout)
    try:
        connection.request("GET", path)
        status = connection.getresponse().status
    except (OSError, http.client.HTTPException):
        status = 0
    finally:
        connection.close()
    return status, time.monotonic() - start


def closed_within(connections: list[socket.socket], seconds: float) -> int:
    """How many of them the server has closed at the end of that time."""
    end = time.monotonic() + seconds
    left = set(connections)
    while left and time.monotonic() < end:
        for connection in list(left):
            connection.setblocking(False)
            try:
                while connection.recv(1 << 16):
                    pass
                left.discard(connection)
            except BlockingIOError:
                pass
            except OSError:
                left.discard(connection)
        time.sleep(0.2)
    return len(connections) - len(left)


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
