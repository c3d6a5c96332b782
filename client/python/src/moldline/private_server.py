"""Private servers: for the length of a script, on a free port of the loopback interface."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import threading
from pathlib import Path
from typing import IO, Any

from moldline import supervise
from moldline.errors import Unavailable

#: Variable of the environment with the path of the program `moldline`.
BINARY_VARIABLE = "MOLDLINE_BINARY"

#: Seconds for the server to announce its address, and for it to end.
_START = 60.0
_END = 15.0


class PrivateServer:
    """A server in a process of its own, under :mod:`moldline.supervise`, which ends it when this process ends."""

    def __init__(self, command: tuple[str, ...], binary: str | os.PathLike[str] | None) -> None:
        """`command`: the arguments of the program `moldline`, which :func:`program` finds."""
        self._process_id = os.getpid()
        #: The last that the server wrote to its log, once it has ended.
        self._said = ""
        path = program(binary)
        self._log: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  # closed with the server
        arguments = [sys.executable, "-I", supervise.__file__, str(self._process_id), str(path), *command]
        # Settings of other servers in the environment, such as required tokens, are not this one's.
        environment = {name: value for name, value in os.environ.items() if not name.startswith("MOLDLINE_")}
        # In a session of its own: an interrupt from the keyboard is for the script, which then ends the server.
        self._process = subprocess.Popen(
            arguments,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env=environment,
            start_new_session=True,
        )
        #: Address that the server listens on.
        self.address = self._announced()

    def _announced(self) -> str:
        lines: list[bytes] = []
        output = self._process.stdout
        assert output is not None  # Popen made the pipe.
        reader = threading.Thread(target=lambda: lines.append(output.readline()), daemon=True)
        reader.start()
        reader.join(_START)
        if lines and lines[0]:
            announcement: dict[str, Any] = json.loads(lines[0])
            return str(announcement["address"])
        self.close()
        raise Unavailable(f"the server did not start: {self._said or f'no word of it in {_START:.0f} s'}")

    def close(self) -> None:
        """Ends the server, and waits for it. In a forked child it does nothing: the server is the parent's."""
        if os.getpid() != self._process_id or self._log.closed:
            return
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(_END)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._log.seek(0)
        self._said = self._log.read()[-2000:].decode(errors="replace").strip()
        self._log.close()


def program(binary: str | os.PathLike[str] | None = None) -> Path:
    """The program `moldline`: `binary`, or what the variable MOLDLINE_BINARY names, or that beside the interpreter, where
    `pip install` puts it, or that on the PATH.

    Raises `FileNotFoundError` if there is none.
    """
    named = binary if binary is not None else os.environ.get(BINARY_VARIABLE)
    if named:
        path = Path(named)
        if not path.is_file():
            raise FileNotFoundError(f"there is no program {path}")
        return path.resolve()
    name = "moldline.exe" if os.name == "nt" else "moldline"
    for folder in (Path(sys.executable).parent, Path(sysconfig.get_path("scripts"))):
        if os.access(folder / name, os.X_OK):
            return folder / name
    if (found := shutil.which(name)) is not None:
        return Path(found)
    raise FileNotFoundError(
        f"the program {name} is neither beside {sys.executable} nor on the PATH: install it, or name it by"
        f" serve(binary=...) or by the variable {BINARY_VARIABLE}"
    )
