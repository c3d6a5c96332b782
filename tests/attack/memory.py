"""Attacks on a server's memory: its account has to hold, whatever comes."""

from __future__ import annotations

import gzip
import io
import socket
import tarfile
import threading
import time
from pathlib import Path

import grpc
import moldline
from moldline.v1 import mesh_service_pb2

from server import Server
from sockets import connect, head
from target import MIB, Watch
from trial import E175, Row

#: The server's account, MiB.
ACCOUNT = 1024


def serve(binary: Path) -> Server:
    return Server(binary, "--memory", str(ACCOUNT))


def bodies(binary: Path, _: Path, short: bool) -> list[Row]:
    """Bodies of which 60 of 64 MiB come, and then no more."""
    count = 20 if short else 40
    with serve(binary) as server, Watch(server, ACCOUNT) as watch:
        length = 64 * MIB
        first = head(
            server,
            "POST /v1/sessions/none/deform",
            "content-type: application/octet-stream",
            f"content-length: {length - 8}",
        )
        open_: list[socket.socket] = []

        def send() -> None:
            connection = connect(server, first)
            open_.append(connection)
            piece = bytes(MIB)
            try:
                for _ in range(60):
                    connection.sendall(piece)
            except OSError:
                # Refused on the way.
                pass

        threads = [threading.Thread(target=send) for _ in range(count)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        time.sleep(1)
        rows = watch.rows(f"{count} bodies of 60 of 64 MiB")
        for connection in open_:
            connection.close()
    return rows


def messages(binary: Path, _: Path, short: bool) -> list[Row]:
    """Messages of empty parts, which take many times their bytes when they are decoded."""
    number = mesh_service_pb2.DeformRequest.DESCRIPTOR.fields_by_name["control_points"].number
    message = bytes([number << 3 | 2, 0]) * (31 * MIB)
    codes = []
    with serve(binary) as server, Watch(server, ACCOUNT) as watch, grpc.insecure_channel(server.address) as channel:
        deform = channel.unary_unary(
            "/moldline.v1.MeshService/Deform", request_serializer=bytes, response_deserializer=bytes
        )
        for _ in range(2 if short else 10):
            try:
                deform(message, timeout=60)
            except grpc.RpcError as error:
                codes.append(error.code())
        rows = watch.rows("messages of 62 MiB of empty parts")
    expected = sum(code == grpc.StatusCode.RESOURCE_EXHAUSTED for code in codes)
    return [*rows, Row("such messages that are not refused as such", len(codes) - expected, "", "== 0")]


def unread(binary: Path, _: Path, short: bool) -> list[Row]:
    """Answers of megabytes that their callers ask for and do not read."""
    count = 300 if short else 1000
    with serve(binary) as server, server.client() as client:
        setup = client.create_setup(E175)
        with Watch(server, ACCOUNT) as watch:
            request = head(server, f"GET /v1/setups/{setup.id}?include_mesh=true", "accept: application/json")
            open_ = []
            for _ in range(count):
                connection = socket.socket()
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                host, port = server.address.rsplit(":", 1)
                connection.connect((host, int(port)))
                connection.sendall(request)
                open_.append(connection)
            time.sleep(3 if short else 10)
            rows = watch.rows(f"{count} unread answers")
            for connection in open_:
                connection.close()
        time.sleep(0.5)
        served = setup.session().deform().vertices.shape[0]
    return [*rows, Row("vertices deformed afterwards", served, "", "== 14926")]


def archive(name: str, content: bytes) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as tar:
        entry = tarfile.TarInfo(name)
        entry.size = len(content)
        tar.addfile(entry, io.BytesIO(content))
    return gzip.compress(buffer.getvalue(), 6)


def documents(binary: Path, _: Path, short: bool) -> list[Row]:
    """Documents of short lists, which take many times their bytes when they are read."""
    rows = []
    size = 40 if short else 160
    text = {"toml": (b"a = [", b"]"), "json": (b'{"a": [', b"0]}")}
    for kind, (before, after) in text.items():
        upload = archive(f"setup.{kind}", before + b"[0]," * (size * MIB // 4) + after)
        with serve(binary) as server, Watch(server, ACCOUNT) as watch:
            connection = connect(
                server,
                head(server, "POST /v1/setups", "content-type: application/gzip", f"content-length: {len(upload)}"),
            )
            connection.sendall(upload)
            status = connection.recv(1 << 16).split(b" ")[1].decode()
            rows += watch.rows(f"{size} MiB of {kind}")
            rows.append(Row("its status", float(status), "", ">= 400"))
    return rows


def builds(binary: Path, _: Path, short: bool) -> list[Row]:
    """A build whose systems do not fit the account, and several that do only one after the other."""
    refused = 0
    with (
        serve(binary) as server,
        server.client(retry=moldline.Retry(attempts=1)) as client,
        Watch(server, ACCOUNT) as watch,
    ):
        files = {path.relative_to(E175).as_posix(): path.read_bytes() for path in E175.rglob("*") if path.is_file()}
        text = files["setup-motions.toml"].decode()
        for count in [20_000] if short else [20_000, 10_000, 8_000]:
            options = f'[options]\ntraining_vertices = {count}\npropagation = "absolute"\n'
            changed = text.replace("[options]\n", options) if "[options]" in text else f"{text}\n{options}"
            folder = Path(_) / str(count)
            for name, content in {**files, "setup-motions.toml": changed.encode()}.items():
                target = folder / name
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)
            try:
                client.create_setup(folder, setup_file="setup-motions.toml")
            except moldline.ResourceExhausted:
                refused += 1
        rows = watch.rows("builds of 20,000 training vertices")
    return [*rows, Row("builds beyond the account that are refused", refused, "", ">= 1")]
