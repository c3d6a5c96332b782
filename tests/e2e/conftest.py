"""Builds the real binary, and starts real servers for real clients.

`MOLDLINE_BINARY` names a binary to test in place of the one that cargo builds.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import moldline
import pytest

import sphere_and_boom
from server import Server

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def binary() -> Path:
    """The program under test."""
    if named := os.environ.get("MOLDLINE_BINARY"):
        return Path(named).resolve()
    command = ["cargo", "build", "--quiet", "--package", "moldline", "--message-format", "json"]
    built = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
    messages = [json.loads(line) for line in built.stdout.splitlines()]
    return next(Path(m["executable"]) for m in reversed(messages) if m.get("executable"))


@pytest.fixture(scope="session")
def setup_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small set-up: a boom that leaves a sphere."""
    return sphere_and_boom.write(tmp_path_factory.mktemp("sphere-and-boom"))


@pytest.fixture(scope="module")
def server(binary: Path) -> Iterator[Server]:
    """A server that the tests of one module share."""
    with Server(binary, "--threads", "2") as server:
        yield server
        assert server.stop() == 0


@pytest.fixture
def client(server: Server) -> Iterator[moldline.Client]:
    with server.client() as client:
        yield client


@pytest.fixture
def setup(client: moldline.Client, setup_folder: Path) -> moldline.Setup:
    return client.create_setup(setup_folder)
