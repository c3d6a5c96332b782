"""A server that fails on demand and records its calls."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator
from concurrent import futures
from types import TracebackType
from typing import Any

import grpc
import numpy as np
from google.protobuf import any_pb2, duration_pb2
from google.rpc import code_pb2, error_details_pb2, status_pb2
from grpc_status import rpc_status
from moldline.v1 import array_pb2, mesh_service_pb2, mesh_service_pb2_grpc, panel_service_pb2, panel_service_pb2_grpc

wire: Any = mesh_service_pb2
#: Sizes of its one set-up.
VARIABLES, VERTICES = 4, 5
JACOBIAN = np.arange(VARIABLES * VERTICES * 3, dtype=float).reshape(VARIABLES, VERTICES, 3) / 7


def refusal(code: str, retry_after: float | None = None) -> Any:
    """A status with this code and google.rpc details."""
    status = status_pb2.Status(code=code_pb2.Code.Value(code), message=f"{code} on demand")
    if retry_after is not None:
        delay = duration_pb2.Duration()
        delay.FromNanoseconds(round(1e9 * retry_after))
        packed = any_pb2.Any()
        packed.Pack(error_details_pb2.RetryInfo(retry_delay=delay))
        status.details.append(packed)
    return rpc_status.to_status(status)


def contradiction(code: str) -> Any:
    """A status whose text is not that of its details, as gRPC's may be where a deadline passes at both ends at once."""
    status = refusal(code)
    return type(status)(status.code, "another text", status.trailing_metadata)


class FakeServer(mesh_service_pb2_grpc.MeshServiceServicer, panel_service_pb2_grpc.PanelServiceServicer):
    """Answers with one of `refusals` per call, in turn, and then as a real server would."""

    def __init__(self, credentials: grpc.ServerCredentials | None = None, address: str = "127.0.0.1:0") -> None:
        self.refusals: list[Any] = []
        #: Arrival time, metadata, request, remaining seconds and authenticated identities of each call.
        self.calls: list[tuple[float, dict[str, str], Any, float | None, list[bytes]]] = []
        self._server = grpc.server(futures.ThreadPoolExecutor(4))
        mesh_service_pb2_grpc.add_MeshServiceServicer_to_server(self, self._server)
        panel_service_pb2_grpc.add_PanelServiceServicer_to_server(self, self._server)
        if credentials is None:
            port = self._server.add_insecure_port(address)
        else:
            port = self._server.add_secure_port(address, credentials)
        self.address = f"127.0.0.1:{port}"

    @property
    def times(self) -> list[float]:
        return [call[0] for call in self.calls]

    def _came(self, request: Any, context: grpc.ServicerContext) -> None:
        metadata = {key: str(value) for key, value in context.invocation_metadata()}
        identities = list(context.peer_identities() or ())
        self.calls.append((time.monotonic(), metadata, request, context.time_remaining(), identities))

    def _answer(self, request: Any, context: grpc.ServicerContext) -> None:
        self._came(request, context)
        if self.refusals:
            context.abort_with_status(self.refusals.pop(0))

    def GetStatus(self, request: Any, context: grpc.ServicerContext) -> Any:
        self._answer(request, context)
        cache = wire.CacheStatus(budget_bytes=1 << 40)
        work = [wire.Work(kind="build"), wire.Work(kind="vjp")]
        return wire.GetStatusResponse(version="fake", queued=3, linearisation_cache=cache, work=work)

    def ListSetups(self, request: Any, context: grpc.ServicerContext) -> Any:
        self._answer(request, context)
        page = int(request.page_token or 0)
        following = str(page + 1) if page < 2 else ""
        return wire.ListSetupsResponse(setups=[wire.SetupSummary(setup_id=f"set-up {page}")], next_page_token=following)

    def GetSession(self, request: Any, context: grpc.ServicerContext) -> Any:
        return wire.GetSessionResponse(
            session=wire.Session(session_id=request.session_id, setup_id="fake", generation=7)
        )

    def GetSetup(self, request: Any, context: grpc.ServicerContext) -> Any:
        variables = [wire.Variable(name=f"x{index}", unit="m") for index in range(VARIABLES)]
        setup = wire.SetupDescription(
            setup_id="fake",
            report_json="{}",
            variables=variables,
            functions=[wire.Function(name="volume", unit="m^3")],
            vertex_count=VERTICES,
        )
        return wire.GetSetupResponse(setup=setup)

    def UpdateSession(self, request: Any, context: grpc.ServicerContext) -> Any:
        self._answer(request, context)
        generation = request.expected_generation + 1
        return wire.UpdateSessionResponse(session=wire.Session(session_id=request.session_id, generation=generation))

    def Jacobian(self, request: Any, context: grpc.ServicerContext) -> Iterator[Any]:
        """One column for each message; a refusal comes after the second one."""
        self._came(request, context)
        refused = self.refusals.pop(0) if self.refusals else None
        for column in range(VARIABLES):
            if column == 2 and refused is not None:
                context.abort_with_status(refused)
            yield wire.JacobianResponse(
                first=column,
                columns=VARIABLES,
                vertices=_array(JACOBIAN[column : column + 1]),
                functions=_array(np.zeros((1, 1))),
            )

    def GetConfiguration(self, request: Any, context: grpc.ServicerContext) -> Any:
        self._answer(request, context)
        empty = array_pb2.Array(dtype=array_pb2.DATA_TYPE_UINT32, shape=(0,))
        edges = array_pb2.Array(dtype=array_pb2.DATA_TYPE_UINT32, shape=(0, 2))
        configuration = panel_service_pb2.Configuration(
            configuration_id=request.configuration_id, trailing_edges=edges, roots=empty
        )
        return panel_service_pb2.GetConfigurationResponse(configuration=configuration)

    def __enter__(self) -> FakeServer:
        self._server.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.stop(None).wait()


def _array(values: np.ndarray) -> array_pb2.Array:
    return array_pb2.Array(dtype=array_pb2.DATA_TYPE_FLOAT64, shape=values.shape, data=values.tobytes())


class DyingServer:
    """A supervised server that every call kills: connections break as soon as a call has come, and are accepted again."""

    def __init__(self) -> None:
        #: Arrival times of calls.
        self.times: list[float] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = "{}:{}".format(*self._listener.getsockname())

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._die, args=[connection], daemon=True).start()

    def _die(self, connection: socket.socket) -> None:
        with connection, connection.makefile("rb") as incoming:
            # Settings without entries, and their acknowledgement, as every HTTP/2 server sends first.
            connection.sendall(bytes((0, 0, 0, 4, 0, 0, 0, 0, 0)) + bytes((0, 0, 0, 4, 1, 0, 0, 0, 0)))
            assert len(incoming.read(24)) in (0, 24)
            while header := incoming.read(9):
                incoming.read(int.from_bytes(header[:3], "big"))
                if header[3] == 1:  # HEADERS
                    self.times.append(time.monotonic())
                    # Closed with a reset, as by the kernel for a process that was killed.
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                    return

    def __enter__(self) -> DyingServer:
        threading.Thread(target=self._serve, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
