"""A server that an attacker leaves alone: connections, floods and bombs keep nobody out and cut nobody off."""

from __future__ import annotations

import contextlib
import http.client
import json
import resource
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import grpc
import moldline
import pytest
from moldline.v1 import mesh_service_pb2

import sphere_and_boom
from server import Server

E175 = Path(__file__).parents[2] / "examples/e175"

# A shell that lowers the limit of open files, and becomes the server.
FEW_FILES = ("bash", "-c", 'ulimit -n 512; exec "$@"', "server")


@contextlib.contextmanager
def many_files() -> Iterator[int]:
    """As many open files for this process as the system allows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    yield hard
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def connect(server: Server, first: bytes = b"") -> socket.socket:
    host, port = server.address.rsplit(":", 1)
    connection = socket.create_connection((host, int(port)), timeout=30)
    if first:
        connection.sendall(first)
    return connection


def probe(server: Server, path: str = "/healthz", timeout: float = 2.0) -> int:
    connection = http.client.HTTPConnection(server.address, timeout=timeout)
    connection.request("GET", path)
    status = connection.getresponse().status
    connection.close()
    return status


def closed_within(connections: list[socket.socket], seconds: float) -> int:
    """How many of them the server has closed at the end of that time."""
    end = time.monotonic() + seconds
    left = set(connections)
    while left and time.monotonic() < end:
        for connection in list(left):
            connection.setblocking(False)
            try:
                while connection.recv(4096):
                    pass
                left.discard(connection)
            except BlockingIOError:
                pass
            except OSError:
                left.discard(connection)
        time.sleep(0.2)
    return len(connections) - len(left)


PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
SETTINGS = bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
SILENCES = {
    "nothing": b"",
    "half a preface": PREFACE[:12],
    "a preface": PREFACE + SETTINGS,
    "half a head": b"GET /healthz HTTP/1.1\r\nhost: a",
}


@pytest.mark.parametrize("first", SILENCES.values(), ids=SILENCES)
def test_connections_that_say_nothing_are_closed(server: Server, first: bytes) -> None:
    connections = [connect(server, first) for _ in range(20)]
    assert closed_within(connections, 30.0) == 20


def test_silent_connections_keep_nobody_out(binary: Path, setup_folder: Path, tmp_path: Path) -> None:
    """More silent connections than there are files: health answers, and the store works."""
    with (
        many_files() as files,
        Server(binary, store=tmp_path / "store", within=FEW_FILES) as server,
        server.client() as before,
    ):
        setup = before.create_setup(setup_folder)
        connections = []
        worst = 0.0
        for i in range(min(2000, files // 2)):
            connections.append(connect(server, PREFACE[:12] if i % 2 else b""))
            if i % 200 == 0:
                start = time.monotonic()
                assert probe(server) == 200
                worst = max(worst, time.monotonic() - start)
        assert worst < 2.0
        with setup.session() as session, server.client() as after:
            session.update(setup.baseline)
            assert after.get_setup(setup.id).id == setup.id
        assert closed_within(connections, 30.0) == len(connections)
        assert server.stop() == 0


def test_sighup_does_not_stop_a_server(binary: Path) -> None:
    with Server(binary) as server:
        server.process.send_signal(signal.SIGHUP)
        time.sleep(0.2)
        assert probe(server) == 200
        assert server.stop() == 0
        assert any("asked to reload" in line for line in server.log)


def slow_upload(server: Server, body: bytes, seconds: float, done: list[int]) -> None:
    connection = http.client.HTTPConnection(server.address, timeout=60)
    connection.putrequest("POST", "/v1/setups")
    connection.putheader("content-type", "application/json")
    connection.putheader("content-length", str(len(body)))
    connection.endheaders()
    pieces = 20
    for i in range(pieces):
        connection.send(body[i * len(body) // pieces : (i + 1) * len(body) // pieces])
        time.sleep(seconds / pieces)
    done.append(connection.getresponse().status)


def test_an_upload_under_way_is_finished_by_a_drain(binary: Path) -> None:
    """The body still comes for seconds after the signal; its answer is sent, and the exit code is 0."""
    with Server(binary) as server:
        done: list[int] = []
        upload = threading.Thread(
            target=slow_upload, args=(server, b'{"format": 1, "name": "' + b"a" * 1000, 4.0, done)
        )
        upload.start()
        time.sleep(0.5)
        code = server.stop()
        upload.join()
        assert (done, code) == ([400], 0)


def test_a_drain_that_cuts_something_says_so(binary: Path) -> None:
    with Server(binary, "--drain-timeout", "1") as server:
        head = b"POST /v1/setups HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n"
        connection = connect(server, head + b"content-length: 100\r\n\r\n{")
        time.sleep(0.5)
        assert server.stop() == 1
        assert any("cut off" in line for line in server.log)
        connection.close()


def test_an_answer_that_is_read_slowly_is_finished_by_a_drain(binary: Path) -> None:
    """An answer larger than the buffers of both ends, read for seconds after the signal."""
    with Server(binary) as server, server.client() as client:
        session = client.create_setup(E175).session()
        linearised = session.deform()
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
        host, port = server.address.rsplit(":", 1)
        connection.connect((host, int(port)))
        body = json.dumps({"at": {"linearisation_id": linearised.linearisation_id}}).encode()
        connection.sendall(
            f"POST /v1/sessions/{session.id}/jacobian HTTP/1.1\r\nhost: {server.address}\r\n"
            "content-type: application/json\r\naccept: application/octet-stream\r\n"
            f"content-length: {len(body)}\r\n\r\n".encode()
            + body
        )
        received = connection.recv(1 << 16)
        head, _, rest = received.partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200"), received[:500]
        server.process.terminate()
        start = time.monotonic()
        size = len(rest)
        while piece := connection.recv(1 << 16):
            size += len(piece)
            if time.monotonic() - start < 3.0:
                time.sleep(0.05)
        assert size >= 24 * linearised.vertices.shape[0] * len(session.setup.variables)
        assert server.wait() == 0


def test_web_pages_do_not_reach_a_server_on_loopback(server: Server) -> None:
    """Neither by a name of their own that leads here, nor by a simple request to another origin."""
    host = server.address
    for fields, expected in [
        ({"host": host}, 200),
        ({"host": "attacker.example"}, 403),
        ({"host": host, "origin": "https://attacker.example"}, 403),
        ({"host": host, "origin": f"http://{host}"}, 200),
    ]:
        connection = http.client.HTTPConnection(server.address, timeout=10)
        connection.request("GET", "/v1/status", headers=fields)
        assert connection.getresponse().status == expected, fields
        connection.close()


def test_probes_and_metrics_have_a_port_of_their_own(binary: Path, tmp_path: Path) -> None:
    tokens = tmp_path / "tokens.json"
    create = [str(binary), "token", "create", "--tokens", str(tokens), "--tenant", "anna", "--role", "reader"]
    reader = subprocess.run(create, check=True, capture_output=True, text=True).stdout.strip()
    with Server(binary, "--tokens", str(tokens), "--admin-listen", "127.0.0.1:0") as server:
        admin = json.loads(server.process.stdout.readline())["address"]
        for path, expected in [("/healthz", 200), ("/readyz", 200), ("/metrics", 200), ("/v1/status", 404)]:
            connection = http.client.HTTPConnection(admin, timeout=10)
            connection.request("GET", path)
            answer = connection.getresponse()
            body = answer.read()
            assert answer.status == expected, path
            assert path != "/metrics" or b"moldline_memory_limit_bytes" in body
            connection.close()
        # A role is checked before a body comes.
        head = f"POST /v1/sessions/a/deform HTTP/1.1\r\nhost: {server.address}\r\nauthorization: Bearer {reader}\r\n"
        connection = connect(
            server, f"{head}content-type: application/json\r\ncontent-length: 1000000\r\n\r\n".encode()
        )
        assert connection.recv(4096).startswith(b"HTTP/1.1 403")
        connection.close()


def test_a_token_file_that_others_may_read_is_refused(binary: Path, tmp_path: Path) -> None:
    tokens = tmp_path / "tokens.json"
    create = [str(binary), "token", "create", "--tokens", str(tokens), "--tenant", "anna", "--role", "user"]
    subprocess.run(create, check=True, capture_output=True)
    tokens.chmod(0o644)
    serve = [str(binary), "serve", "--store", "memory", "--listen", "127.0.0.1:0", "--tokens", str(tokens)]
    refused = subprocess.run(serve, capture_output=True, text=True, timeout=60)
    assert refused.returncode == 1
    assert "chmod 600" in refused.stderr


def test_names_of_any_length_come_back_short(server: Server, setup_folder: Path) -> None:
    name = "n" * 1_000_000
    status, body = post(server, f"/v1/sessions/{'s' * 5000}/deform", json.dumps({"design": {name: 1.0}}).encode())
    assert (status, len(body) < 2000) == (404, True)
    with server.client() as client:
        session = client.create_setup(setup_folder).session()
    status, body = post(server, f"/v1/sessions/{session.id}/deform", json.dumps({"design": {name: 1.0}}).encode())
    assert (status, len(body) < 10_000) == (400, True)
    assert not any(len(line) > 10_000 for line in server.log)


def test_a_component_with_a_long_name_is_refused(server: Server, tmp_path: Path) -> None:
    def rename(document: dict[str, Any], *_: object) -> None:
        document["components"][0]["name"] = "c" * 70_000

    with server.client() as client, pytest.raises(moldline.InvalidArgument) as refused:
        client.create_setup(sphere_and_boom.write(tmp_path / "long", change=rename))
    assert "256" in str(refused.value)


def test_messages_that_grow_when_they_are_decoded_are_refused(server: Server) -> None:
    number = mesh_service_pb2.DeformRequest.DESCRIPTOR.fields_by_name["control_points"].number
    with grpc.insecure_channel(server.address) as channel:
        deform = channel.unary_unary("/moldline.v1.MeshService/Deform", bytes, bytes)
        with pytest.raises(grpc.RpcError) as refused:
            deform(bytes([number << 3 | 2, 0]) * (1 << 20), timeout=30)
        assert refused.value.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
        with pytest.raises(grpc.RpcError) as refused:
            deform(b"\xff" * 100, timeout=30)
        assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT
        with pytest.raises(grpc.RpcError) as refused:
            deform(bytes(65 << 20), timeout=30)
        assert refused.value.code() == grpc.StatusCode.RESOURCE_EXHAUSTED


def post(server: Server, path: str, body: bytes) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(server.address, timeout=30)
    connection.request("POST", path, body, {"content-type": "application/json"})
    answer = connection.getresponse()
    status, content = answer.status, answer.read()
    connection.close()
    return status, content


def test_a_server_whose_store_has_vanished_is_not_ready(binary: Path, tmp_path: Path) -> None:
    with Server(binary, store=tmp_path / "store") as server:
        assert probe(server, "/readyz") == 200
        (tmp_path / "store").rename(tmp_path / "elsewhere")
        end = time.monotonic() + 20
        while probe(server, "/readyz") == 200:
            assert time.monotonic() < end
            time.sleep(0.2)
        assert probe(server, "/healthz") == 200
        (tmp_path / "elsewhere").rename(tmp_path / "store")
        while probe(server, "/readyz") != 200:
            assert time.monotonic() < end
            time.sleep(0.2)
