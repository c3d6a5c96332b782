"""One interface to the clients of all languages: a driver process for each, see drivers/README.md."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
DRIVERS = Path(__file__).parent / "drivers"
LANGUAGES = ["python", "python-aio", "rust", "cpp"]

Fields = dict[str, Any]


class Refused(Exception):
    """An error as a client raised, threw or returned it."""

    def __init__(self, error: Fields) -> None:
        super().__init__(f"{error['code']}: {error['message']}")
        self.code: str = error["code"]
        self.message: str = error["message"]
        self.fields: list[str] = [violation["field"] for violation in error["violations"]]
        self.descriptions: list[str] = [violation["description"] for violation in error["violations"]]
        self.retry_after: float | None = error.get("retry_after")


class Client:
    """The client of one language, in a process of its own."""

    def __init__(self, language: str) -> None:
        self.language = language
        self.process = subprocess.Popen(
            _command(language), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8"
        )

    def __call__(self, what: str, **arguments: Any) -> Any:
        """Sends one command to the driver; returns its answer, with numpy arrays. Raises :class:`Refused`."""
        assert self.process.stdin and self.process.stdout
        self.process.stdin.write(json.dumps({"do": what, **_written(arguments)}) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        assert line, f"the {self.language} driver has ended"
        answer = json.loads(line)
        if "error" in answer:
            raise Refused({"violations": [], **answer["error"]})
        return _read(answer["ok"])

    def close(self) -> None:
        assert self.process.stdin and self.process.stdout
        self.process.stdin.close()
        assert self.process.wait(timeout=30) == 0
        self.process.stdout.close()


def _command(language: str) -> list[str]:
    if language.startswith("python"):
        return [sys.executable, str(DRIVERS / "driver.py"), *language.split("-")[1:]]
    name = f"MOLDLINE_DRIVER_{language.upper()}"
    built = {"rust": ROOT / "target/debug/examples/driver", "cpp": ROOT / "target/cpp/moldline-driver"}
    path = Path(os.environ.get(name, built[language]))
    assert path.is_file(), f"there is no {path}: `cargo xtask clients` builds it"
    return [str(path)]


def _written(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        values = np.ascontiguousarray(value)
        data = base64.b64encode(values.tobytes()).decode()
        return {"dtype": values.dtype.str, "shape": values.shape, "data": data}
    if isinstance(value, dict):
        return {name: _written(each) for name, each in value.items()}
    return value


def _read(value: Any) -> Any:
    if isinstance(value, dict):
        if set(value) == {"dtype", "shape", "data"}:
            # Numbers of JSON may be written as 3.0.
            shape = [int(extent) for extent in value["shape"]]
            return np.frombuffer(base64.b64decode(value["data"]), dtype=value["dtype"]).reshape(shape)
        return {name: _read(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_read(each) for each in value]
    return value


def bits(value: Any) -> Any:
    """`value` with arrays replaced by type, shape and bytes, so that equality means the same bits."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, dict):
        return {name: bits(each) for name, each in value.items()}
    if isinstance(value, list):
        return [bits(each) for each in value]
    return value
