"""Life of a server, from the first probe to the exit code."""

from __future__ import annotations

import subprocess
import threading
import time
from pathlib import Path

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase

from server import Server


def health(server: Server, service: str) -> int:
    with grpc.insecure_channel(server.address) as channel:
        request = health_pb2.HealthCheckRequest(service=service)
        return health_pb2_grpc.HealthStub(channel).Check(request, timeout=10).status


@pytest.mark.parametrize("service", ["", "moldline.v1.MeshService"])
def test_health_is_serving(server: Server, service: str) -> None:
    assert health(server, service) == health_pb2.HealthCheckResponse.SERVING


def test_reflection_names_the_service_and_its_messages(server: Server) -> None:
    with grpc.insecure_channel(server.address) as channel:
        database = ProtoReflectionDescriptorDatabase(channel)
        services = set(database.get_services())
        assert {"moldline.v1.MeshService", "grpc.health.v1.Health"} <= services
        file = database.FindFileContainingSymbol("moldline.v1.MeshService")
        methods = {method.name for method in file.service[0].method}
        assert methods >= {"CreateSetup", "GetSetup", "Deform", "ApplyJacobianVector", "ApplyAdjoint", "Jacobian"}


def test_the_bound_address_is_the_one_line_on_standard_output(binary: Path) -> None:
    with Server(binary) as server:
        assert server.announcement["event"] == "listening"
        assert not server.address.endswith(":0")
        assert server.stop() == 0
        assert server.process.stdout.read() == ""
        assert any("no authentication" in line for line in server.log)


def test_an_address_that_others_reach_is_refused_unless_it_is_said(binary: Path) -> None:
    command = [str(binary), "serve", "--listen", "0.0.0.0:0"]
    refused = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert refused.returncode == 1
    assert "--insecure-listen" in refused.stderr
    assert refused.stdout == ""


def test_sigterm_lets_what_runs_finish(binary: Path, setup_folder: Path) -> None:
    """Readiness goes first, then the port; the answer under way still arrives, and the exit code is 0."""
    with Server(binary, "--drain-delay", "0.5") as server, server.client() as client:
        session = client.create_setup(setup_folder).session()
        expected = session.deform().vertices.tobytes()
        answers: list[bytes] = []
        stopping = threading.Event()

        def work() -> None:
            while not stopping.is_set():
                answers.append(session.deform().vertices.tobytes())

        workers = [threading.Thread(target=work) for _ in range(4)]
        for worker in workers:
            worker.start()
        server.process.terminate()
        time.sleep(0.1)
        # The port is open for one probe interval, in which probes see that it is not ready.
        assert health(server, "") == health_pb2.HealthCheckResponse.NOT_SERVING
        stopping.set()
        for worker in workers:
            worker.join()
        assert server.wait() == 0
        assert answers and set(answers) == {expected}
        assert any("stopped" in line for line in server.log)


def test_a_health_watch_does_not_hold_up_the_end(binary: Path) -> None:
    with Server(binary) as server, grpc.insecure_channel(server.address) as channel:
        watch = health_pb2_grpc.HealthStub(channel).Watch(health_pb2.HealthCheckRequest(service=""))
        assert next(watch).status == health_pb2.HealthCheckResponse.SERVING
        start = time.monotonic()
        assert server.stop() == 0
        assert time.monotonic() - start < 15, "the drain timeout of 30 s was waited for"
