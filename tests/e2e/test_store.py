"""State that survives a killed server, and its use by another one."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import grpc
import moldline
import numpy as np
import pytest
from moldline import arrays
from moldline.v1 import mesh_service_pb2 as wire
from moldline.v1 import mesh_service_pb2_grpc

import seaweed
from server import Server

Stub = mesh_service_pb2_grpc.MeshServiceStub


@contextmanager
def stub(server: Server) -> Iterator[Stub]:
    with grpc.insecure_channel(server.address, [("grpc.max_receive_message_length", -1)]) as channel:
        yield Stub(channel)


def update(meshes: Stub, session: wire.Session, design: np.ndarray) -> wire.Session:
    request = wire.UpdateSessionRequest(session_id=session.session_id, expected_generation=session.generation)
    arrays.write(design, request.design.design)
    return meshes.UpdateSession(request, timeout=60).session


def deform(meshes: Stub, session: wire.Session) -> wire.DeformResponse:
    request = wire.DeformRequest(session_id=session.session_id, design=session.design.design)
    return meshes.Deform(request, timeout=60)


def test_a_session_goes_on_after_kill_9(binary: Path, setup_folder: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    with Server(binary, store=store) as server, server.client() as client, stub(server) as meshes:
        setup = client.create_setup(setup_folder)
        opened = meshes.OpenSession(wire.OpenSessionRequest(setup_id=setup.id, label="run 7"), timeout=60).session
        stored = update(meshes, opened, setup.baseline + 0.1)
        before = deform(meshes, stored)
        server.process.kill()
        server.process.wait()
    # Two servers at once on the same store.
    with Server(binary, store=store) as one, Server(binary, store=store) as two:
        for server in (one, two):
            with stub(server) as meshes:
                found = meshes.GetSession(wire.GetSessionRequest(session_id=opened.session_id), timeout=60).session
                assert found == stored
                after = deform(meshes, found)
                assert after.vertices == before.vertices
                assert after.linearisation_id == before.linearisation_id
                assert any("loaded a set-up" in line for line in server.log), "it was not built again"
        with stub(one) as meshes:
            update(meshes, stored, setup.baseline)
        with stub(two) as meshes, pytest.raises(grpc.RpcError) as lost:
            update(meshes, stored, setup.baseline)
        assert lost.value.code() == grpc.StatusCode.ABORTED


def test_two_servers_share_an_object_store(binary: Path, setup_folder: Path, tmp_path: Path) -> None:
    if seaweed.program() is None:
        pytest.skip("SeaweedFS is not installed")
    with ExitStack() as stack:
        objects = stack.enter_context(seaweed.SeaweedFS(tmp_path / "objects"))

        def start() -> Server:
            return stack.enter_context(Server(binary, store=objects.store, environment=objects.environment))

        one = start()
        with one.client() as client, stub(one) as meshes:
            setup = client.create_setup(setup_folder)
            opened = meshes.OpenSession(wire.OpenSessionRequest(setup_id=setup.id, label="run 8"), timeout=60).session
            stored = update(meshes, opened, setup.baseline + 0.1)
            before = deform(meshes, stored)
        other = start()
        with stub(one) as here, stub(other) as there:
            found = there.GetSession(wire.GetSessionRequest(session_id=opened.session_id), timeout=60).session
            assert found == stored
            assert deform(there, found).vertices == before.vertices
            assert any("loaded a set-up" in line for line in other.log), "it was not built again"
            update(there, stored, setup.baseline)
            with pytest.raises(grpc.RpcError) as lost:
                update(here, stored, setup.baseline)
            assert lost.value.code() == grpc.StatusCode.ABORTED
        verify = [str(binary), "store", "verify", "--store", objects.store]
        verified = subprocess.run(verify, capture_output=True, env={**os.environ, **objects.environment}, timeout=60)
        assert verified.returncode == 0, verified


def test_gc_says_what_it_would_remove_and_verify_finds_damage(binary: Path, setup_folder: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"

    def run(*options: str) -> subprocess.CompletedProcess[str]:
        command = [str(binary), "store", *options, "--store", str(store)]
        return subprocess.run(command, capture_output=True, text=True, timeout=60)

    with Server(binary, store=store) as server, server.client() as client:
        setup = client.create_setup(setup_folder)
        setup.session().close()
        setup.delete()
    plan = run("gc", "--dry-run", "--grace", "0s")
    assert plan.returncode == 0 and f"setup/{setup.id}" in plan.stdout and "access/local/" in plan.stdout
    count = plan.stdout.splitlines()[-1].removeprefix("would remove ").split()[0]
    assert "removed 0 objects" in run("gc").stdout, "all is younger than the grace period"
    assert f"removed {count} objects" in run("gc", "--grace", "0s").stdout
    assert not list((store / "blob").iterdir())
    assert run("verify").returncode == 0
    with Server(binary, store=store) as server, server.client() as client:
        client.create_setup(setup_folder)
    blob = next((store / "blob").iterdir())
    blob.write_bytes(blob.read_bytes()[:-1])
    damaged = run("verify")
    assert damaged.returncode == 1 and blob.name in damaged.stdout


def test_a_server_collects_its_store(binary: Path, setup_folder: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    with Server(binary, store=store) as server, server.client() as client:
        setup = client.create_setup(setup_folder)
        setup.delete()
    days_ago = time.time() - 3 * 24 * 3600
    for path in store.rglob("*"):
        os.utime(path, (days_ago, days_ago))
    with Server(binary, "--collect-every", "8s", store=store) as server, server.client() as client:
        deadline = time.monotonic() + 60
        while list((store / "blob").iterdir()):
            assert time.monotonic() < deadline, "".join(server.log)
            time.sleep(0.1)
        client.create_setup(setup_folder)
        assert server.stop() == 0
    assert any("collected the store" in line for line in server.log)
    refused = subprocess.run(
        [str(binary), "serve", "--store", str(store), "--collect-grace", "30m"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert refused.returncode != 0 and "less than an hour" in refused.stderr


def test_a_store_that_vanished_is_told(binary: Path, setup_folder: Path, tmp_path: Path) -> None:
    store, aside = tmp_path / "store", tmp_path / "aside"
    missing = subprocess.run(
        [str(binary), "serve", "--store", str(store), "--existing-store"], capture_output=True, text=True, timeout=60
    )
    assert missing.returncode != 0 and not store.exists()
    with Server(binary, store=store) as server, server.client(retry=moldline.Retry(attempts=1)) as client:
        assert store.stat().st_mode & 0o077 == 0
        setup = client.create_setup(setup_folder)
        store.rename(aside)
        for call in (lambda: client.create_setup(setup_folder), lambda: setup.session(), client.status):
            with pytest.raises(moldline.Unavailable, match="vanished"):
                call()
        assert not store.exists()
        aside.rename(store)
        setup.session().close()


@pytest.mark.parametrize("servers", [1, 2])
def test_quotas_hold_for_many_at_once(binary: Path, setup_folder: Path, tmp_path: Path, servers: int) -> None:
    with ExitStack() as stack:
        options = ("--max-sessions", "10")
        places = [stack.enter_context(Server(binary, *options, store=tmp_path / "store")) for _ in range(servers)]
        clients = [stack.enter_context(server.client(retry=moldline.Retry(attempts=1))) for server in places]
        setup = clients[0].create_setup(setup_folder)
        stubs = [stack.enter_context(stub(server)) for server in places]

        def attempt(k: int) -> str:
            call = stubs[k % servers].OpenSession.future(wire.OpenSessionRequest(setup_id=setup.id), timeout=60)
            return "opened" if call.exception() is None else call.code().name

        with ThreadPoolExecutor(16) as pool:
            outcomes = list(pool.map(attempt, range(60)))
        opened = outcomes.count("opened")
        assert opened + outcomes.count("RESOURCE_EXHAUSTED") == 60
        assert opened <= 10 and (servers > 1 or opened == 10)
        assert clients[-1].status().sessions == opened


@pytest.mark.parametrize("command", [["verify"], ["gc", "--dry-run"], ["gc"]], ids=" ".join)
@pytest.mark.parametrize("place", ["missing", "not-a-store", "memory"])
def test_what_is_no_store_is_refused_and_left_as_it_is(
    binary: Path, tmp_path: Path, command: list[str], place: str
) -> None:
    (tmp_path / "not-a-store").mkdir()
    (tmp_path / "not-a-store" / "note.txt").write_text("somebody's")
    before = sorted(tmp_path.rglob("*"))
    run = [str(binary), "store", *command, "--store", place]
    answer = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert answer.returncode == 1 and answer.stdout == ""
    assert f"cannot open the store {place}:" in answer.stderr and "--store" in answer.stderr
    assert sorted(tmp_path.rglob("*")) == before
