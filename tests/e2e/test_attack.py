"""A server that an attacker leaves alone: connections, floods and bombs keep nobody out and cut nobody off."""

from __future__ import annotations

import http.client
import json
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import grpc
import moldline
import pytest
from moldline.v1 import mesh_service_pb2

import sphere_and_boom
from server import Server
from sockets import PREFACE, SETTINGS, ask, closed_within, connect, drip, head, many_files, post, within_files

E175 = Path(__file__).parents[2] / "examples/e175"

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
        Server(binary, store=tmp_path / "store", within=within_files(512)) as server,
        server.client() as before,
    ):
        setup = before.create_setup(setup_folder)
        connections = []
        worst = 0.0
        for i in range(min(2000, files // 2)):
            connections.append(connect(server, PREFACE[:12] if i % 2 else b""))
            if i % 200 == 0:
                status, seconds = ask(server)
                assert status == 200
                worst = max(worst, seconds)
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
        assert ask(server)[0] == 200
        assert server.stop() == 0
        assert any("asked to reload" in line for line in server.log)


def test_sighup_exchanges_quotas(binary: Path, setup_folder: Path, tmp_path: Path) -> None:
    """What a tenant has stays; a file that is wrong changes nothing."""
    quotas = tmp_path / "quotas.json"

    def exchange(server: Server, text: str) -> None:
        quotas.write_text(text)
        server.process.send_signal(signal.SIGHUP)
        time.sleep(0.3)

    quotas.write_text('{"format": 1, "tenants": {"local": {"sessions": 1}}}')
    once = moldline.Retry(attempts=1)
    with Server(binary, "--quotas", str(quotas)) as server, server.client(retry=once) as client:
        setup = client.create_setup(setup_folder)
        first = setup.session()
        with pytest.raises(moldline.ResourceExhausted, match="limit is 1"):
            setup.session()
        exchange(server, '{"format": 1, "tenants": {"local": {"sessions": 2}}}')
        second = setup.session()
        for text in ["nonsense", '{"format": 1, "tenants": {"local": {"session": 3}}}']:
            exchange(server, text)
            with pytest.raises(moldline.ResourceExhausted, match="limit is 2"):
                setup.session()
        assert sum("stays as it was" in line for line in server.log) == 2
        exchange(server, '{"format": 1, "tenants": {"local": {"sessions": 1, "setups": 0}}}')
        for session in [first, second]:
            session.deform()
        with pytest.raises(moldline.ResourceExhausted, match="limit is 1"):
            setup.session()
        assert server.stop() == 0


def test_a_server_does_not_start_with_quotas_that_it_cannot_read(binary: Path, tmp_path: Path) -> None:
    serve = [str(binary), "serve", "--store", "memory", "--listen", "127.0.0.1:0", "--quotas", str(tmp_path / "none")]
    refused = subprocess.run(serve, capture_output=True, text=True, timeout=60)
    assert refused.returncode == 1
    assert "quotas" in refused.stderr


def test_an_upload_under_way_is_finished_by_a_drain(binary: Path) -> None:
    """The body still comes for seconds after the signal; its answer is sent, and the exit code is 0."""
    with Server(binary) as server:
        done: list[int] = []
        body = b'{"format": 1, "name": "' + b"a" * 1000
        upload = threading.Thread(target=lambda: done.append(drip(server, body, 4.0)))
        upload.start()
        time.sleep(0.5)
        code = server.stop()
        upload.join()
        assert (done, code) == ([400], 0)


def test_a_drain_that_cuts_something_says_so(binary: Path) -> None:
    with Server(binary, "--drain-timeout", "1") as server:
        fields = ["content-type: application/json", "content-length: 100"]
        connection = connect(server, head(server, "POST /v1/setups", *fields) + b"{")
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
            head(
                server,
                f"POST /v1/sessions/{session.id}/jacobian",
                "content-type: application/json",
                "accept: application/octet-stream",
                f"content-length: {len(body)}",
            )
            + body
        )
        received = connection.recv(1 << 16)
        status, _, rest = received.partition(b"\r\n\r\n")
        assert status.startswith(b"HTTP/1.1 200"), received[:500]
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
        fields = [
            f"authorization: Bearer {reader}",
            "content-type: application/json",
            "content-length: 1000000",
        ]
        connection = connect(server, head(server, "POST /v1/sessions/a/deform", *fields))
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


def test_a_server_whose_store_has_vanished_is_not_ready(binary: Path, tmp_path: Path) -> None:
    with Server(binary, store=tmp_path / "store") as server:
        assert ask(server, "/readyz")[0] == 200
        (tmp_path / "store").rename(tmp_path / "elsewhere")
        end = time.monotonic() + 20
        while ask(server, "/readyz")[0] == 200:
            assert time.monotonic() < end
            time.sleep(0.2)
        assert ask(server)[0] == 200
        (tmp_path / "elsewhere").rename(tmp_path / "store")
        while ask(server, "/readyz")[0] != 200:
            assert time.monotonic() < end
            time.sleep(0.2)
