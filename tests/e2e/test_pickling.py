"""Objects of the Python client in other processes: by fork and spawn, joblib and Dask."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import cloudpickle
import moldline
import numpy as np
import pytest

from fake_server import FakeServer
from server import Server
from wing import wing

DESIGNS = [{"boom.translation": value} for value in np.linspace(-0.2, 0.2, 6)]
SECRET = "a-token-that-nobody-may-read"


class Forwarder:
    """Passes connections on to a server, and counts them."""

    def __init__(self, address: str) -> None:
        host, port = address.rsplit(":", 1)
        self._server = (host, int(port))
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self.connections = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            self.connections += 1
            far = socket.create_connection(self._server)
            for source, target in ((near, far), (far, near)):
                threading.Thread(target=self._pump, args=(source, target), daemon=True).start()

    @staticmethod
    def _pump(source: socket.socket, target: socket.socket) -> None:
        try:
            while data := source.recv(1 << 16):
                target.sendall(data)
        except OSError:
            pass
        finally:
            target.close()

    def close(self) -> None:
        self._listener.close()


@pytest.fixture
def forwarder(server: Server) -> Iterator[Forwarder]:
    forwarder = Forwarder(server.address)
    yield forwarder
    forwarder.close()


def volume(setup: moldline.Setup, design: dict[str, float]) -> tuple[int, float]:
    """Process, and the volume at a design."""
    return os.getpid(), setup.deform(design).functions["enclosed_volume"]


def stored(session: moldline.Session, value: float) -> int:
    """Generation after an update."""
    session.refresh()
    session.update({"boom.translation": value})
    return session.generation


def version(client: moldline.Client) -> str:
    return client.status().version


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_processes_share_nothing_but_the_server(
    server: Server, forwarder: Forwarder, setup_folder: Path, method: str
) -> None:
    with moldline.Client(forwarder.address) as client:
        setup = client.create_setup(setup_folder)
        # The parent's connection is in use before the children come and after.
        expected = [volume(setup, design)[1] for design in DESIGNS]
        before = forwarder.connections
        assert before == 1
        with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context(method)) as pool:
            told = list(pool.map(volume, [setup] * len(DESIGNS), DESIGNS))
        assert [each for _, each in told] == expected
        processes = {process for process, _ in told}
        assert os.getpid() not in processes
        assert forwarder.connections - before == len(processes), "one connection a process"
        assert volume(setup, DESIGNS[0])[1] == expected[0]
        assert forwarder.connections - before == len(processes)


def test_a_client_used_by_a_child_that_was_forked_in_mid_use(setup: moldline.Setup) -> None:
    """Objects that a fork copies, without a pickle, while other threads are using them."""
    expected = volume(setup, DESIGNS[0])[1]
    with ThreadPoolExecutor(2) as threads:
        busy = [threads.submit(volume, setup, design) for design in DESIGNS * 5]
        for _ in range(5):
            reader, writer = multiprocessing.get_context("fork").Pipe(False)
            child = multiprocessing.get_context("fork").Process(
                target=lambda writer=writer: writer.send(volume(setup, DESIGNS[0])[1])
            )
            child.start()
            assert reader.poll(60), "the child hangs"
            assert reader.recv() == expected
            child.join()
            assert child.exitcode == 0
        assert [each.result()[1] for each in busy[: len(DESIGNS)]] == [volume(setup, design)[1] for design in DESIGNS]


def test_a_lock_that_the_parent_holds_is_open_in_the_child(setup: moldline.Setup) -> None:
    expected = volume(setup, DESIGNS[0])[1]
    client = setup._client
    fork = multiprocessing.get_context("fork")
    reader, writer = fork.Pipe(False)
    child = fork.Process(target=lambda: writer.send(volume(setup, DESIGNS[0])[1]))
    # As by threads that are connecting or opening a session at this moment.
    with client._lock, client._sessions._lock:
        child.start()
    try:
        assert reader.poll(30), "the child hangs"
        assert reader.recv() == expected
    finally:
        child.kill()
        child.join()


def test_joblib(setup: moldline.Setup) -> None:
    joblib = pytest.importorskip("joblib")
    told = joblib.Parallel(n_jobs=2)(joblib.delayed(volume)(setup, design) for design in DESIGNS)
    assert [each for _, each in told] == [volume(setup, design)[1] for design in DESIGNS]


def test_dask(setup: moldline.Setup) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as dask,
    ):
        told = dask.gather(dask.map(volume, [setup] * len(DESIGNS), DESIGNS))
    assert [each for _, each in told] == [volume(setup, design)[1] for design in DESIGNS]


def test_sessions_continue_elsewhere(setup: moldline.Setup) -> None:
    with setup.session() as session, ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(stored, session, 0.1).result() == 2
        session.refresh()
        assert session.generation == 2 and session.design.design[0] == 0.1
        # Leaving the pool closes neither the session nor the client.
        assert session.deform().vertices.shape == (setup.vertex_count, 3)


def test_copies_of_a_client_are_one_until_it_is_closed(setup: moldline.Setup) -> None:
    for library in (pickle, cloudpickle):
        data = library.dumps(setup)
        assert len(data) < 50_000, "no arrays"
        one, two = pickle.loads(data), pickle.loads(data)
        assert one._client is two._client is not setup._client
        assert one.deform(DESIGNS[0]) == setup.deform(DESIGNS[0])
        assert one.mesh == setup.mesh
        one._client.close()
        with pytest.raises(ValueError, match="the client is closed"):
            two.deform()
        assert pickle.loads(data).deform(DESIGNS[0]) == setup.deform(DESIGNS[0])
        setup.deform()


def test_results_travel(setup: moldline.Setup) -> None:
    result = setup.deform(DESIGNS[0], cell_quality=True)
    for each in (
        result,
        setup.mesh,
        setup.vjp(functions={"enclosed_volume": 1.0}, at=result),
        setup.jacobian(at=result),
    ):
        assert pickle.loads(pickle.dumps(each)) == each
    assert setup.vjp(functions={"enclosed_volume": 1.0}, at=pickle.loads(pickle.dumps(result))).design.shape == (3,)


def test_a_configuration_travels_and_is_sent_again(binary: Path) -> None:
    vertices, cells, _ = wing()
    reference = moldline.panel.Reference(area=8.0, chord=1.0, span=8.0)
    with Server(binary, command=("panel", "serve")) as first, Server(binary, command=("panel", "serve")) as second:
        panels = moldline.panel.Client(first.address)
        configuration = panels.create_configuration(vertices, cells)
        # As after a restart: the other server has never seen it.
        data = pickle.dumps(configuration).replace(first.address.encode(), second.address.encode())
        copy = pickle.loads(data)
        assert copy._client.address == second.address
        assert copy.analyze(reference=reference, alpha=0.1) == configuration.analyze(reference=reference, alpha=0.1)


def test_tokens_stay_where_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MOLDLINE_TOKEN", raising=False)
    file = tmp_path / "token"
    file.write_text(f"{SECRET}\n")
    spawned = multiprocessing.get_context("spawn")

    def sent(server: FakeServer) -> list[str | None]:
        return [call[1].get("authorization") for call in server.calls]

    with FakeServer() as server:
        given = moldline.Client(server.address, token=SECRET)
        assert version(given) == "fake"
        assert SECRET not in repr(given)
        for library in (pickle, cloudpickle):
            with pytest.raises(pickle.PicklingError, match=r"token_file=.*MOLDLINE_TOKEN") as refused:
                library.dumps(given)
            assert SECRET not in str(refused.value)
        by_file = moldline.Client(server.address, token_file=file)
        assert SECRET.encode() not in pickle.dumps(by_file)
        with ProcessPoolExecutor(1, mp_context=spawned) as pool:
            assert pool.submit(version, by_file).result() == "fake"
        monkeypatch.setenv("MOLDLINE_TOKEN", SECRET)
        for client in (moldline.Client(server.address), given):
            assert SECRET.encode() not in pickle.dumps(client)
            with ProcessPoolExecutor(1, mp_context=spawned) as pool:
                assert pool.submit(version, client).result() == "fake"
        assert sent(server) == [f"Bearer {SECRET}"] * 4
        with pytest.raises(ValueError, match="not both"):
            moldline.Client(server.address, token=SECRET, token_file=file)


def test_a_client_of_a_channel_stays(setup: moldline.Setup, server: Server) -> None:
    import grpc

    with grpc.insecure_channel(server.address) as channel:
        client = moldline.Client(channel)
        assert client.get_setup(setup.id).deform() == setup.deform()
        with pytest.raises(pickle.PicklingError, match="give an address"):
            pickle.dumps(client)
