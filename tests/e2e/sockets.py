"""Plain sockets to a server: connections that say what they like, and requests without a client."""

from __future__ import annotations

import contextlib
import http.client
import resource
import socket
import time
from collections.abc import Iterator

from server import Server

#: What every HTTP/2 connection begins with, and an empty SETTINGS frame.
PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
SETTINGS = bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])


def within_files(count: int) -> tuple[str, ...]:
    """A shell that lowers the limit of open files, and becomes the server."""
    return ("bash", "-c", f'ulimit -n {count}; exec "$@"', "server")


@contextlib.contextmanager
def many_files() -> Iterator[int]:
    """As many open files for this process as the system allows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    yield hard
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def connect(server: Server, first: bytes = b"") -> socket.socket:
    """A connection on which `first` has been sent."""
    host, port = server.address.rsplit(":", 1)
    connection = socket.create_connection((host, int(port)), timeout=30)
    if first:
        connection.sendall(first)
    return connection


def head(server: Server, line: str, *fields: str) -> bytes:
    """The head of a request over HTTP/1.1."""
    return "\r\n".join([f"{line} HTTP/1.1", f"host: {server.address}", *fields, "", ""]).encode()


def ask(server: Server, path: str = "/healthz", timeout: float = 5.0) -> tuple[int, float]:
    """Status and seconds of a GET on a connection of its own; status 0 without an answer."""
    start = time.monotonic()
    connection = http.client.HTTPConnection(server.address, timeout=timeout)
    try:
        connection.request("GET", path)
        status = connection.getresponse().status
    except (OSError, http.client.HTTPException):
        status = 0
    finally:
        connection.close()
    return status, time.monotonic() - start


def closed_within(connections: list[socket.socket], seconds: float) -> int:
    """How many of them the server has closed at the end of that time."""
    end = time.monotonic() + seconds
    left = set(connections)
    while left and time.monotonic() < end:
        for connection in list(left):
            connection.setblocking(False)
            try:
                while connection.recv(1 << 16):
                    pass
                left.discard(connection)
            except BlockingIOError:
                pass
            except OSError:
                left.discard(connection)
        time.sleep(0.2)
    return len(connections) - len(left)


def post(server: Server, path: str, body: bytes) -> tuple[int, bytes]:
    """Status and content of the answer to a JSON document."""
    connection = http.client.HTTPConnection(server.address, timeout=30)
    connection.request("POST", path, body, {"content-type": "application/json"})
    answer = connection.getresponse()
    status, content = answer.status, answer.read()
    connection.close()
    return status, content


def drip(server: Server, body: bytes, seconds: float) -> int:
    """Status of an upload whose body takes so many seconds; 0 if it is cut off."""
    pieces = 20
    connection = http.client.HTTPConnection(server.address, timeout=60)
    try:
        connection.putrequest("POST", "/v1/setups")
        connection.putheader("content-type", "application/json")
        connection.putheader("content-length", str(len(body)))
        connection.endheaders()
        for i in range(pieces):
            connection.send(body[i * len(body) // pieces : (i + 1) * len(body) // pieces])
            time.sleep(seconds / pieces)
        return connection.getresponse().status
    except (OSError, http.client.HTTPException):
        return 0
    finally:
        connection.close()
