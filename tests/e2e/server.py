"""The real server in a process of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any

import moldline


class Server:
    """A running `moldline serve` on a free port of the loopback interface; its store is temporary unless one is named.

    `command`: arguments in place of `serve`.
    `environment`: variables besides those of this process.
    `within`: a program and its arguments that runs the server as itself, such as `nsenter`.
    """

    def __init__(
        self,
        binary: Path,
        *options: str,
        store: Path | str = "memory",
        command: tuple[str, ...] | None = None,
        environment: Mapping[str, str] = MappingProxyType({}),
        within: tuple[str, ...] = (),
    ) -> None:
        listen = [] if "--listen" in options else ["--listen", "127.0.0.1:0"]
        arguments = [*within, str(binary), *(command or ("serve", "--store", str(store))), *listen, *options]
        self.process = subprocess.Popen(
            arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, **environment}
        )
        self.log: list[str] = []
        self._reader = threading.Thread(target=self._read_log, daemon=True)
        self._reader.start()
        line = self.process.stdout.readline()
        assert line, f"the server did not start:\n{''.join(self.log)}"
        self.announcement = json.loads(line)
        self.address: str = self.announcement["address"]

    def _read_log(self) -> None:
        # Read continuously, so that the server never blocks on a full pipe.
        for line in self.process.stderr:
            self.log.append(line)

    def client(self, **options: Any) -> moldline.Client:
        return moldline.Client(self.address, **options)

    def stop(self) -> int:
        """Asks it to stop, and returns its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.wait()

    def wait(self) -> int:
        code = self.process.wait(timeout=60)
        self._reader.join()
        return code

    def __enter__(self) -> Server:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.wait()
        self.process.stdout.close()
        self.process.stderr.close()
