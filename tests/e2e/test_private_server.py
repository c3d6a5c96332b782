"""Servers for the length of a script."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import moldline
import moldline.panel
import pytest
from moldline.private_server import program

#: Starts a server, tells its address, and waits; arguments: the binary.
SCRIPT = """
import moldline, multiprocessing, sys, time
client = moldline.serve(binary=sys.argv[1])
client.status()
if "fork" in sys.argv:
    multiprocessing.get_context("fork").Process(target=time.sleep, args=(20,), daemon=True).start()
print(client.address, flush=True)
if "wait" in sys.argv:
    time.sleep(120)
"""


def answers(address: str) -> bool:
    with moldline.Client(address, retry=moldline.Retry(attempts=1), timeout=5.0) as client:
        try:
            client.status()
        except moldline.Unavailable:
            return False
        return True


def becomes(condition: Callable[[], bool], seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.1)
    return False


def test_a_server_lives_as_long_as_its_client(
    binary: Path, setup_folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    # What is set for other servers does not count.
    monkeypatch.setenv("MOLDLINE_LISTEN", "127.0.0.1:1")
    monkeypatch.setenv("MOLDLINE_TOKENS", str(tmp_path / "nothing"))
    with moldline.serve("--threads", "1", binary=binary, timeout=100.0) as client:
        assert client.address.startswith("127.0.0.1:")
        assert client.create_setup(setup_folder).deform().vertices.shape[1] == 3
        with moldline.serve(binary=binary) as other:
            assert other.address != client.address and other.list_setups() == []
            assert answers(client.address)
        assert not answers(other.address)
    assert not answers(client.address)
    client.close()


def test_a_store_outlives_the_server(binary: Path, setup_folder: Path, tmp_path: Path) -> None:
    with moldline.serve(binary=binary, store=tmp_path / "store") as client:
        setup_id = client.create_setup(setup_folder).id
    with moldline.serve(binary=binary, store=tmp_path / "store") as client:
        assert [each.id for each in client.list_setups()] == [setup_id]


def test_the_panel_service_likewise(binary: Path) -> None:
    with moldline.panel.serve(binary=binary) as panels, pytest.raises(moldline.NotFound):
        panels.get_configuration("none")


@pytest.mark.parametrize("how", ["end", "interrupt", "kill", "kill with a forked child"])
def test_it_ends_with_its_process(binary: Path, how: str) -> None:
    words = [] if how == "end" else ["wait"]
    words += ["fork"] if "fork" in how else []
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(binary), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as script:
        assert script.stdout is not None
        address = script.stdout.readline().strip()
        if how != "end":
            assert answers(address)
            script.send_signal(signal.SIGINT if how == "interrupt" else signal.SIGKILL)
        assert becomes(lambda: not answers(address)), "the server lives on"


@pytest.mark.skipif(sys.platform != "linux", reason="needs a signal on the parent's death")
def test_it_ends_with_its_supervisor(binary: Path) -> None:
    with moldline.serve(binary=binary) as client:
        assert answers(client.address) and client._server is not None
        client._server._process.kill()
        assert becomes(lambda: not answers(client.address)), "the server lives on"


def test_a_forked_child_leaves_it_to_its_parent(binary: Path) -> None:
    with moldline.serve(binary=binary) as client:
        client.status()
        child = os.fork()
        if child == 0:
            client.close()
            os._exit(0)
        os.waitpid(child, 0)
        time.sleep(0.6)
        assert answers(client.address)


def test_a_server_that_does_not_start_says_why(binary: Path) -> None:
    with pytest.raises(moldline.Unavailable, match=r"the server did not start: (.|\n)*--no-such-option"):
        moldline.serve("--no-such-option", binary=binary)


def test_the_program_is_found(binary: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOLDLINE_BINARY", str(binary))
    assert program() == binary
    with pytest.raises(FileNotFoundError, match="there is no program"):
        program(tmp_path / "missing")
    monkeypatch.delenv("MOLDLINE_BINARY")
    beside = tmp_path / "environment" / "bin"
    elsewhere = tmp_path / "elsewhere"
    monkeypatch.setattr(sys, "executable", str(beside / "python"))
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(beside))
    monkeypatch.setenv("PATH", str(elsewhere))
    with pytest.raises(FileNotFoundError, match="MOLDLINE_BINARY"):
        program()
    for folder in (elsewhere, beside):
        folder.mkdir(parents=True)
        (folder / "moldline").symlink_to(binary)
        assert program() == folder / "moldline"
