"""Observability: metrics, log lines, traces."""

from __future__ import annotations

import json
import queue
from collections.abc import Iterator
from concurrent import futures
from pathlib import Path

import grpc
import pytest
import requests

from server import Server

EXPORT = "/opentelemetry.proto.collector.trace.v1.TraceService/Export"


@pytest.fixture
def collector() -> Iterator[tuple[str, queue.Queue[bytes]]]:
    """A stand-in for an OpenTelemetry collector; it keeps the spans that it receives."""
    received: queue.Queue[bytes] = queue.Queue()

    def export(request: bytes, context: grpc.ServicerContext) -> bytes:
        received.put(request)
        return b""

    class Collector(grpc.GenericRpcHandler):
        def service(self, details: grpc.HandlerCallDetails) -> grpc.RpcMethodHandler | None:
            return grpc.unary_unary_rpc_method_handler(export) if details.method == EXPORT else None

    server = grpc.server(futures.ThreadPoolExecutor(2), handlers=[Collector()])
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield f"http://127.0.0.1:{port}", received
    server.stop(None)


def test_traces_go_to_the_collector_below_the_callers(binary: Path, collector: tuple[str, queue.Queue[bytes]]) -> None:
    address, received = collector
    trace = "0af7651916cd43dd8448eb211c80319c"
    with Server(binary, "--otlp", address) as server:
        headers = {"traceparent": f"00-{trace}-b7ad6b7169203331-01", "X-Request-Id": "request-77"}
        requests.get(f"http://{server.address}/v1/status", headers=headers, timeout=10).raise_for_status()
        assert server.stop() == 0
    sent = b""
    while not received.empty():
        sent += received.get()
    for part in [b"moldline", b"GetStatus", b"request-77", bytes.fromhex(trace), bytes.fromhex("b7ad6b7169203331")]:
        assert part in sent


def test_a_collector_that_is_not_there_disturbs_nobody(binary: Path) -> None:
    with Server(binary, "--otlp", "http://127.0.0.1:1") as server:
        assert requests.get(f"http://{server.address}/v1/status", timeout=10).status_code == 200
        assert server.stop() == 0


def test_a_line_of_the_log_names_request_and_code(binary: Path) -> None:
    with Server(binary, "--log-format", "json") as server:
        answer = requests.get(
            f"http://{server.address}/v1/sessions/none", headers={"X-Request-Id": "request-78"}, timeout=10
        )
        assert answer.headers["X-Request-Id"] == "request-78"
        assert server.stop() == 0
        lines = [json.loads(line) for line in server.log]
    (line,) = [line for line in lines if line["fields"]["message"] == "request"]
    assert line["fields"]["code"] == "NOT_FOUND"
    span = line["span"]
    assert (span["rpc"], span["request_id"], span["tenant"]) == ("GetSession", "request-78", "local")
    assert span["session"] == "none"


def test_metrics_count_requests(binary: Path) -> None:
    with Server(binary) as server:
        at = f"http://{server.address}"
        for _ in range(3):
            requests.get(f"{at}/v1/setups/none", timeout=10)
        text = requests.get(f"{at}/metrics", timeout=10).text
    assert 'moldline_requests_total{rpc="GetSetup",transport="http",code="NOT_FOUND"} 3' in text
    assert 'moldline_request_duration_seconds_count{rpc="GetSetup",transport="http"} 3' in text
    assert "moldline_sessions 0" in text
