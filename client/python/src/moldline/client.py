"""Client, set-ups and sessions."""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import TracebackType
from typing import Any

import grpc
import numpy as np
from numpy.typing import ArrayLike, NDArray
from tqdm import tqdm

from moldline import arrays, upload
from moldline.errors import InternalError, NotFound, translated
from moldline.mesh import Mesh
from moldline.quality import QualityReport, report_from_wire
from moldline.v1 import mesh_service_pb2 as wire
from moldline.v1 import mesh_service_pb2_grpc

_MAX_MESSAGE = 512 << 20


@dataclass(frozen=True)
class Progress:
    """How far the creation of a set-up has come."""

    #: `receive`, `read`, and then the engine's stages.
    stage: str
    #: Share of the stage, 0 to 1.
    fraction: float
    #: For people.
    message: str


@dataclass(frozen=True)
class Variable:
    """One scalar design variable."""

    #: Such as ``wing.twist[3]``.
    name: str
    #: Of the three numbers and of its entry in a design, such as ``m`` or ``deg``.
    unit: str
    baseline: float
    #: Bounds; may be infinite.
    lower: float
    upper: float


@dataclass(frozen=True)
class VariableGroup:
    """Variables that were declared together."""

    name: str
    #: Their entries of a design.
    entries: slice
    #: Empty for a scalar.
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Deformation:
    """A deformed mesh."""

    #: float64, (n, 3), metres, in the set-up mesh's order; read-only, its memory is the message's.
    vertices: NDArray[np.float64]
    #: Measures of the deformed mesh.
    quality: QualityReport
    #: Measures of every cell, float64, (m,), by name (`aspect_ratio`, `edge_ratio`, `scaled_jacobian`, `skew`); only if
    #: asked for.
    cell_quality: dict[str, NDArray[np.float64]] | None
    #: Largest distance of a seam vertex from one of its components before the smooth projection, metres.
    seam_residual: float
    #: Largest distance of a protected or stationary vertex from a component that it lies on, metres.
    held_residual: float
    #: Largest |Phi| of an active vertex at the end, metres; 0 for a sharp outer mold line.
    projection_residual: float
    #: Most projection steps that a vertex took.
    projection_steps: int
    #: Names this set-up and design in requests for derivatives.
    linearisation_id: str
    #: Seconds that the engine took.
    engine_seconds: float
    #: Seconds that the request waited for the engine.
    queue_seconds: float


class Client:
    """A connection to a server. Safe to use from several threads; close it, or use it in a `with` statement.

    `target`: address such as ``127.0.0.1:50051``, or a `grpc.Channel` of your own (with TLS, credentials,
    interceptors), which is then yours to close.
    `timeout`: seconds that a call other than `create_setup` may take; `None` for no limit.
    """

    def __init__(self, target: str | grpc.Channel = "127.0.0.1:50051", *, timeout: float | None = 600.0) -> None:
        self._own = isinstance(target, str)
        self._channel: grpc.Channel = (
            grpc.insecure_channel(target, options=_channel_options()) if isinstance(target, str) else target
        )
        self._stub: Any = mesh_service_pb2_grpc.MeshServiceStub(self._channel)
        self._timeout = timeout

    def create_setup(
        self,
        path: str | os.PathLike[str],
        *,
        setup_file: str = "",
        progress: bool | Callable[[Progress], None] = False,
        request_id: str | None = None,
        timeout: float | None = None,
    ) -> Setup:
        """Uploads and builds a set-up; the same content again gives the set-up that exists.

        `path`: its folder, or an archive of it (.tar, .tar.gz, .tgz, .zip).
        `setup_file`: the file in it that describes the set-up; the server's usual names if empty.
        `progress`: `True` for a progress bar, or a function that is called with each :class:`Progress`.
        `request_id`: name of this request, so that a retry is recognised; made up if `None`.
        `timeout`: seconds it may take; `None` for no limit.

        Raises :class:`InvalidArgument` naming every field that is wrong.
        """
        request_id = uuid.uuid4().hex if request_id is None else request_id
        messages = upload.messages(path, setup_file, request_id)
        with translated():
            events = self._stub.CreateSetup(messages, timeout=timeout)
            if callable(progress):
                created = _follow(events, progress)
            else:
                with _Bar(enabled=progress) as bar:
                    created = _follow(events, bar)
        return Setup(self, created.setup_id, created.setup, built=created.built)

    def get_setup(self, setup_id: str) -> Setup:
        """The set-up of that id. Raises :class:`NotFound`."""
        response = self._call("GetSetup", wire.GetSetupRequest(setup_id=setup_id))
        return Setup(self, setup_id, response.setup, built=False)

    def close(self) -> None:
        """Closes the connection."""
        if self._own:
            self._channel.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _call(self, method: str, request: Any) -> Any:
        with translated():
            return getattr(self._stub, method)(request, timeout=self._timeout)


class Setup:
    """A set-up on the server: geometry, mesh, design variables and options. Immutable, and shared by all its users."""

    def __init__(self, client: Client, setup_id: str, description: wire.SetupDescription, *, built: bool) -> None:
        self._client = client
        #: Hash of its content.
        self.id = setup_id
        #: Whether the call that returned this built it.
        self.built = built
        #: The title its author gave it.
        self.name: str = description.name
        #: What was found, as text and as parsed JSON.
        self.report_text: str = description.report_text
        self.report: dict[str, Any] = json.loads(description.report_json)
        #: In the order of a design's entries.
        self.variables: tuple[Variable, ...] = tuple(
            Variable(v.name, v.unit, v.baseline, v.lower, v.upper) for v in description.variables
        )
        #: Declared variables by name.
        self.groups: dict[str, VariableGroup] = {group.name: _group(group) for group in description.groups}
        #: Names of the components.
        self.components: tuple[str, ...] = tuple(description.components)
        self.vertex_count: int = description.vertex_count
        self.cell_count: int = description.cell_count
        #: Seconds that the engine took to build it.
        self.build_seconds: float = description.build_seconds

    @property
    def baseline(self) -> NDArray[np.float64]:
        """float64, (number of variables): the design of the reference geometry."""
        return np.array([variable.baseline for variable in self.variables])

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper bounds, float64, (number of variables) each; may be infinite."""
        lower = np.array([variable.lower for variable in self.variables])
        return lower, np.array([variable.upper for variable in self.variables])

    @cached_property
    def mesh(self) -> Mesh:
        """The reference mesh, fetched once."""
        request = wire.GetSetupRequest(setup_id=self.id, include_mesh=True)
        mesh = self._client._call("GetSetup", request).mesh
        return Mesh(
            vertices=arrays.from_wire(mesh.vertices),
            cells=arrays.from_wire(mesh.cells),
            cell_owner=arrays.from_wire(mesh.cell_owner),
            seam=arrays.from_wire(mesh.seam).astype(bool),
            components=self.components,
        )

    def session(self, *, request_id: str | None = None) -> Session:
        """Opens a session; use it in a `with` statement, or close it."""
        request_id = uuid.uuid4().hex if request_id is None else request_id
        request = wire.OpenSessionRequest(setup_id=self.id, request_id=request_id)
        return Session(self, self._client._call("OpenSession", request).session_id)

    def __repr__(self) -> str:
        sizes = f"{self.vertex_count} vertices, {self.cell_count} cells, {len(self.variables)} variables"
        return f"<Setup {self.name!r} {self.id[:12]}: {sizes}>"


class Session:
    """Work on one set-up, apart from all other sessions."""

    def __init__(self, setup: Setup, session_id: str) -> None:
        #: The set-up.
        self.setup = setup
        #: Name of the session on the server.
        self.id = session_id

    def deform(
        self,
        design: Mapping[str, float] | ArrayLike | None = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        cell_quality: bool = False,
    ) -> Deformation:
        """The mesh at a design. A pure function: the same design gives the same bytes, and a retry is safe.

        `design`: values by name, the others staying at their baseline; or float64, (number of variables), every
        entry in its variable's unit; `None` for the baseline.
        `control_points`: by component name, float64, (number of its control points, 3), metres: geometry from
        elsewhere, in place of what the design makes of the component.
        `cell_quality`: whether the measures of every cell are wanted too.

        Raises :class:`InvalidArgument` naming the entry that is wrong, :class:`FailedPrecondition` if the mesh cannot
        follow.
        """
        request = wire.DeformRequest(session_id=self.id, include_cell_quality=cell_quality)
        if isinstance(design, Mapping):
            request.named.SetInParent()
            request.named.values.update({name: float(value) for name, value in design.items()})
        elif design is not None:
            request.design.CopyFrom(arrays.to_wire(design))
        for component, points in (control_points or {}).items():
            request.control_points.add(component=component, points=arrays.to_wire(points))
        response = self.setup._client._call("Deform", request)
        return Deformation(
            vertices=arrays.from_wire(response.vertices),
            quality=report_from_wire(response.quality),
            cell_quality=_cell_quality(response.cell_quality) if cell_quality else None,
            seam_residual=response.residuals.seam,
            held_residual=response.residuals.held,
            projection_residual=response.residuals.projection,
            projection_steps=response.residuals.projection_steps,
            linearisation_id=response.linearisation_id,
            engine_seconds=response.timings.engine_seconds,
            queue_seconds=response.timings.queue_seconds,
        )

    def close(self) -> None:
        """Closes the session; closing it again does nothing."""
        try:
            self.setup._client._call("CloseSession", wire.CloseSessionRequest(session_id=self.id))
        except NotFound:
            pass

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _channel_options() -> list[tuple[str, int]]:
    return [
        ("grpc.max_receive_message_length", _MAX_MESSAGE),
        ("grpc.max_send_message_length", _MAX_MESSAGE),
        # Two clients in one process are two connections.
        ("grpc.use_local_subchannel_pool", 1),
    ]


def _cell_quality(quality: wire.CellQuality) -> dict[str, NDArray[np.float64]]:
    names = ("aspect_ratio", "edge_ratio", "scaled_jacobian", "skew")
    return {name: arrays.from_wire(getattr(quality, name)) for name in names}


def _group(group: wire.VariableGroup) -> VariableGroup:
    shape = tuple(group.shape)
    return VariableGroup(group.name, slice(group.first, group.first + int(np.prod(shape))), shape)


def _follow(events: Iterator[wire.CreateSetupResponse], tell: Callable[[Progress], None]) -> wire.CreatedSetup:
    for event in events:
        if event.HasField("created"):
            return event.created
        tell(Progress(event.progress.stage, event.progress.fraction, event.progress.message))
    raise InternalError("the server ended without a result")


class _Bar:
    """A progress bar for each stage in turn."""

    def __init__(self, *, enabled: bool) -> None:
        layout = "{desc:<50} {percentage:3.0f}%|{bar:30}| {elapsed}"
        self._bar = tqdm(total=1.0, disable=not enabled, bar_format=layout, leave=False)

    def __call__(self, progress: Progress) -> None:
        self._bar.set_description_str(progress.message, refresh=False)
        self._bar.n = progress.fraction
        self._bar.refresh()

    def __enter__(self) -> _Bar:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()
