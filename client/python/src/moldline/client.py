"""Client, set-ups and sessions."""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import TracebackType
from typing import Any

import grpc
import numpy as np
from numpy.typing import ArrayLike, NDArray
from tqdm import tqdm

from moldline import arrays, upload
from moldline.check import Check, check_from_wire
from moldline.errors import InternalError, NotFound, translated
from moldline.mesh import Mesh
from moldline.quality import QualityReport, report_from_wire
from moldline.v1 import mesh_service_pb2 as wire
from moldline.v1 import mesh_service_pb2_grpc

_MAX_MESSAGE = 512 << 20
#: Vectors and bytes of one request, within the server's usual limits; larger blocks go in several requests.
_VECTORS = 64
_REQUEST = 32 << 20


@dataclass(frozen=True)
class Progress:
    """How far long work has come."""

    #: `receive`, `read`, and then the engine's stages; `check`.
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
class Function:
    """A scalar output besides the vertices."""

    #: Such as ``wing.wetted_area``.
    name: str
    #: Such as ``m^2``.
    unit: str
    #: For the reference mesh.
    value: float


@dataclass(frozen=True)
class DesignPoint:
    """A design as it was asked for: the arguments of :meth:`Session.deform`."""

    design: Mapping[str, float] | ArrayLike | None = None
    control_points: Mapping[str, ArrayLike] | None = None


@dataclass(frozen=True)
class Linearisation:
    """Where a derivative is taken: what the session keeps of a deformation, and the design to make it again."""

    #: The same for the same set-up and design, on any server.
    id: str
    #: Copies of the arrays that were asked for.
    point: DesignPoint


@dataclass(frozen=True)
class Deformation:
    """A deformed mesh."""

    #: float64, (n, 3), metres, in the set-up mesh's order; read-only, its memory is the message's.
    vertices: NDArray[np.float64]
    #: The scalar outputs by name, each in its unit (:attr:`Setup.functions`).
    functions: dict[str, float]
    #: For derivatives here: the `at` of :meth:`Session.jvp`, :meth:`Session.vjp` and :meth:`Session.jacobian`.
    linearisation: Linearisation
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
    #: Seconds that the engine took.
    engine_seconds: float
    #: Seconds that the request waited for the engine.
    queue_seconds: float

    @property
    def linearisation_id(self) -> str:
        """Names this set-up and design in requests for derivatives."""
        return self.linearisation.id


#: Where a derivative is taken: what `deform` returned, its `linearisation` or the latter's id, a design as `deform` takes
#: it, or a :class:`DesignPoint`; `None` for the baseline.
At = Deformation | Linearisation | DesignPoint | str | Mapping[str, float] | ArrayLike | None


@dataclass(frozen=True)
class Tangents:
    """Changes of the outputs along k directions; without the first axis for a single one."""

    #: float64, (k, n, 3), metres.
    vertices: NDArray[np.float64]
    #: By function: float64, (k,), in its unit.
    functions: dict[str, NDArray[np.float64]]
    #: Seconds that the engine took.
    engine_seconds: float
    #: Seconds that the requests waited for the engine.
    queue_seconds: float


@dataclass(frozen=True)
class Gradients:
    """Gradients of k weighted sums of the outputs; without the first axis for a single one."""

    #: float64, (k, number of variables), per its variable's unit; `None` if not asked for.
    design: NDArray[np.float64] | None
    #: By component, if asked for: float64, (k, number of its control points, 3), per metre.
    control_points: dict[str, NDArray[np.float64]]
    #: Seconds that the engine took.
    engine_seconds: float
    #: Seconds that the requests waited for the engine.
    queue_seconds: float


@dataclass(frozen=True)
class Jacobian:
    """Derivatives of all outputs by all design variables."""

    #: float64, (number of variables, n, 3), metres per the variable's unit.
    vertices: NDArray[np.float64]
    #: By function: float64, (number of variables,), its unit per the variable's.
    functions: dict[str, NDArray[np.float64]]
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
            created = _follow(events, "created", progress)
        return Setup(self, created.setup_id, created.setup, built=created.built)

    def get_setup(self, setup_id: str) -> Setup:
        """The set-up of that id. Raises :class:`NotFound`."""
        response = self._call("GetSetup", wire.GetSetupRequest(setup_id=setup_id))
        return Setup(self, setup_id, response.setup, built=False)

    def check(
        self, setup: Setup | str | os.PathLike[str], designs: int = 1, **options: Any
    ) -> Check:
        """Checks the derivatives of a set-up, or of that in a folder or an archive; see :meth:`Setup.check`."""
        if not isinstance(setup, Setup):
            setup = self.create_setup(setup, progress=options.get("progress", False))
        return setup.check(designs, **options)

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
        #: How many control points each component has.
        self.control_point_counts: dict[str, int] = dict(
            zip(self.components, description.control_point_counts, strict=True)
        )
        #: The scalar outputs besides the vertices.
        self.functions: tuple[Function, ...] = tuple(Function(f.name, f.unit, f.value) for f in description.functions)
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

    @cached_property
    def control_points(self) -> dict[str, NDArray[np.float64]]:
        """By component: float64, (number of its control points, 3), metres, at the baseline; fetched once.

        Patch after patch, the second parameter fastest.
        """
        request = wire.GetSetupRequest(setup_id=self.id, include_control_points=True)
        response = self._client._call("GetSetup", request)
        return {each.component: arrays.from_wire(each.points) for each in response.control_points}

    def check(
        self,
        designs: int = 1,
        *,
        design: Mapping[str, float] | ArrayLike | None = None,
        variables: Iterable[str] = (),
        seed: int = 1,
        progress: bool | Callable[[Progress], None] = False,
        timeout: float | None = None,
    ) -> Check:
        """Checks the derivatives: products against their transposes, dual numbers and central differences.

        `designs`: at how many designs: the baseline, then random ones far from it.
        `design`: the only design to check at, in their place, as :meth:`Session.deform` takes it.
        `variables`: names of variables or of groups of them, to be compared with dual numbers and central differences;
        all if empty.
        `seed`: of the random designs and vectors.
        `progress`: `True` for a progress bar, or a function that is called with each :class:`Progress`.
        `timeout`: seconds it may take; `None` for no limit. It is minutes of work for the E175.

        Raises :class:`InvalidArgument` naming what is wrong, :class:`ResourceExhausted` while another check is under way.
        """
        request = wire.CheckRequest(setup_id=self.id, seed=seed, variables=variables)
        if design is None:
            request.designs = designs
        elif isinstance(design, Mapping):
            request.named.SetInParent()
            request.named.values.update({name: float(value) for name, value in design.items()})
        else:
            request.design.CopyFrom(arrays.to_wire(design))
        with translated():
            report = _follow(self._client._stub.Check(request, timeout=timeout), "report", progress)
        return check_from_wire(report, tuple(variable.name for variable in self.variables))

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
        point = _copied(design, control_points)
        request = wire.DeformRequest(session_id=self.id, include_cell_quality=cell_quality)
        _write_point(point, request)
        response = self.setup._client._call("Deform", request)
        return Deformation(
            vertices=arrays.from_wire(response.vertices),
            functions=dict(zip(self._function_names(), arrays.from_wire(response.functions).tolist(), strict=True)),
            linearisation=Linearisation(response.linearisation_id, point),
            quality=report_from_wire(response.quality),
            cell_quality=_cell_quality(response.cell_quality) if cell_quality else None,
            seam_residual=response.residuals.seam,
            held_residual=response.residuals.held,
            projection_residual=response.residuals.projection,
            projection_steps=response.residuals.projection_steps,
            engine_seconds=response.timings.engine_seconds,
            queue_seconds=response.timings.queue_seconds,
        )

    def jvp(
        self,
        directions: ArrayLike | None = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        at: At = None,
    ) -> Tangents:
        """How the outputs change along directions of the inputs: `J v`, exactly.

        `directions`: of the design variables, float64, (k, number of variables) or (number of variables,), every entry in
        its variable's unit; `None` for zero.
        `control_points`: of the control points of some components, by name, float64, (k, number of its control points, 3)
        or without the first axis, metres, on top of what `directions` does to them. Where `at` gives a component's
        control points, the design does not move that component.
        `at`: see :data:`At`.

        Raises :class:`InvalidArgument` naming the entry that is wrong, :class:`NotFound` for the id of a linearisation
        that the session does not keep any more.
        """
        blocks: dict[str, NDArray[np.float64]] = {}
        single: set[bool] = set()
        if directions is not None:
            blocks["directions"] = _block(directions, 1, single)
        for component, vectors in (control_points or {}).items():
            blocks[f"control_points[{component!r}]"] = _block(vectors, 2, single)
        components = list(control_points or {})
        parts = []
        for start, end in self._pieces(blocks):
            request = wire.ApplyJacobianVectorRequest(session_id=self.id)
            for name, block in blocks.items():
                if name == "directions":
                    request.design.CopyFrom(arrays.to_wire(block[start:end]))
                else:
                    component = components[len(request.control_points)]
                    request.control_points.add(component=component, vectors=arrays.to_wire(block[start:end]))
            parts.append(self._product("ApplyJacobianVector", request, at))
        vertices = _joined([part.vertices for part in parts], single)
        functions = _joined([part.functions for part in parts], single)
        return Tangents(vertices, self._by_function(functions), *_seconds(parts))

    def vjp(
        self,
        *,
        vertices: ArrayLike | None = None,
        functions: Mapping[str, ArrayLike] | ArrayLike | None = None,
        at: At = None,
        design: bool = True,
        control_points: Iterable[str] = (),
    ) -> Gradients:
        """Gradients of weighted sums of the outputs by the inputs: `J^T w`, exactly. One seed costs as much as k in part.

        `vertices`: weights of the vertices' coordinates, float64, (k, n, 3) or (n, 3), such as the derivative of an
        objective by them, per metre; `None` for zero.
        `functions`: weights of the functions, by name, each a number or float64, (k,), those not named being zero; or
        float64, (k, number of functions) or (number of functions,), in the order of :attr:`Setup.functions`.
        `at`: see :data:`At`.
        `design`: whether gradients by the design variables are wanted.
        `control_points`: components by whose control points gradients are wanted too.

        Raises as :meth:`jvp`.
        """
        blocks: dict[str, NDArray[np.float64]] = {}
        single: set[bool] = set()
        if vertices is not None:
            blocks["vertices"] = _block(vertices, 2, single)
        if functions is not None:
            weights = self._weights(functions) if isinstance(functions, Mapping) else functions
            blocks["functions"] = _block(weights, 1, single)
        control_points = list(control_points)
        parts = []
        for start, end in self._pieces(blocks):
            request = wire.ApplyAdjointRequest(
                session_id=self.id, include_design=design, control_points_of=control_points
            )
            for name, block in blocks.items():
                getattr(request, name).CopyFrom(arrays.to_wire(block[start:end]))
            parts.append(self._product("ApplyAdjoint", request, at))
        by_component = {
            component: _joined([part.control_points[index].vectors for part in parts], single)
            for index, component in enumerate(control_points)
        }
        by_design = _joined([part.design for part in parts], single) if design else None
        return Gradients(by_design, by_component, *_seconds(parts))

    def jacobian(self, *, at: At = None, progress: bool = False) -> Jacobian:
        """Derivatives of all outputs by all design variables, exactly; received in blocks into one array.

        `at`: see :data:`At`.
        `progress`: whether to show a progress bar.

        Raises as :meth:`jvp`.
        """
        shape = (len(self.setup.variables), self.setup.vertex_count, 3)
        vertices = np.empty(shape)
        functions = np.empty((shape[0], len(self.setup.functions)))
        parts: list[Any] = []

        def receive(request: wire.JacobianRequest) -> None:
            parts.clear()
            received = 0
            client = self.setup._client
            with translated(), _Bar(enabled=progress) as bar:
                for part in client._stub.Jacobian(request, timeout=client._timeout):
                    columns = slice(part.first, part.first + part.vertices.shape[0])
                    vertices[columns] = arrays.from_wire(part.vertices)
                    functions[columns] = arrays.from_wire(part.functions)
                    # Their arrays are not needed any more.
                    part.ClearField("vertices")
                    part.ClearField("functions")
                    parts.append(part)
                    bar(Progress("jacobian", columns.stop / part.columns, f"column {columns.stop} of {part.columns}"))
                    received = columns.stop
            if received != shape[0]:
                raise InternalError("the server ended before the last column")

        self._at(receive, wire.JacobianRequest(session_id=self.id), at)
        return Jacobian(vertices, self._by_function(functions), *_seconds(parts))

    def _product(self, method: str, request: Any, at: At) -> Any:
        return self._at(lambda request: self.setup._client._call(method, request), request, at)

    def _at(self, call: Callable[[Any], Any], request: Any, at: At) -> Any:
        """Calls with `request` at `at`: by id where there is one, and by design where the session has dropped it."""
        if isinstance(at, Deformation):
            at = at.linearisation
        if isinstance(at, str):
            request.at.linearisation_id = at
            return call(request)
        if isinstance(at, Linearisation):
            request.at.linearisation_id = at.id
            try:
                return call(request)
            except NotFound as error:
                if not any(violation.field == "at.linearisation_id" for violation in error.violations):
                    raise
                at = at.point
        point = at if isinstance(at, DesignPoint) else DesignPoint(at)
        request.at.design_point.SetInParent()
        _write_point(point, request.at.design_point)
        return call(request)

    def _pieces(self, blocks: Mapping[str, NDArray[np.float64]]) -> Iterator[tuple[int, int]]:
        """Ranges of vectors that fit one request."""
        counts = {name: len(block) for name, block in blocks.items()}
        if not counts:
            raise ValueError("there is nothing to multiply with: give directions or seeds")
        if len(set(counts.values())) > 1:
            raise ValueError(f"all blocks have to have as many vectors, these have {counts}")
        count = next(iter(counts.values()))
        points = self.setup.vertex_count + sum(self.setup.control_point_counts.values())
        step = max(1, min(_VECTORS, _REQUEST // (24 * points)))
        # Without any vector there is still a request, which is refused.
        return ((start, min(start + step, count)) for start in range(0, max(count, 1), step))

    def _function_names(self) -> list[str]:
        return [function.name for function in self.setup.functions]

    def _by_function(self, values: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        return {name: values[..., index] for index, name in enumerate(self._function_names())}

    def _weights(self, weights: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        names = self._function_names()
        if unknown := sorted(set(weights) - set(names)):
            raise ValueError(f"there is no function {', '.join(unknown)}; there are: {', '.join(names)}")
        given = np.broadcast_arrays(*(np.asarray(weight, dtype=np.float64) for weight in weights.values()))
        all_weights = np.zeros((*(given[0].shape if given else ()), len(names)))
        for name, weight in zip(weights, given, strict=True):
            all_weights[..., names.index(name)] = weight
        return all_weights

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


def _copied(design: Mapping[str, float] | ArrayLike | None, points: Mapping[str, ArrayLike] | None) -> DesignPoint:
    """The design with arrays of its own, so that later changes of the caller's do not reach it."""
    if isinstance(design, Mapping):
        design = {name: float(value) for name, value in design.items()}
    elif design is not None:
        design = np.array(design, dtype=np.float64)
    copies = {component: np.array(each, dtype=np.float64) for component, each in (points or {}).items()}
    return DesignPoint(design, copies or None)


def _write_point(point: DesignPoint, message: Any) -> None:
    """Writes the fields `design` or `named`, and `control_points`."""
    if isinstance(point.design, Mapping):
        message.named.SetInParent()
        message.named.values.update({name: float(value) for name, value in point.design.items()})
    elif point.design is not None:
        message.design.CopyFrom(arrays.to_wire(point.design))
    for component, points in (point.control_points or {}).items():
        message.control_points.add(component=component, points=arrays.to_wire(points))


def _block(vectors: ArrayLike, dimensions: int, single: set[bool]) -> NDArray[np.float64]:
    """`vectors` as a block, with a first axis; `single` remembers whether there was none."""
    block = np.asarray(vectors, dtype=np.float64)
    single.add(block.ndim == dimensions)
    return block[np.newaxis] if block.ndim <= dimensions else block


def _joined(parts: list[Any], single: set[bool]) -> NDArray[np.float64]:
    """The blocks of all parts as one; its only vector, if all that was given had no first axis."""
    blocks = [arrays.from_wire(part) for part in parts]
    block: NDArray[np.float64] = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
    return block[0] if single == {True} else block


def _seconds(parts: list[Any]) -> tuple[float, float]:
    """Of the engine, and in the queue."""
    return sum(part.timings.engine_seconds for part in parts), sum(part.timings.queue_seconds for part in parts)


def _cell_quality(quality: wire.CellQuality) -> dict[str, NDArray[np.float64]]:
    names = ("aspect_ratio", "edge_ratio", "scaled_jacobian", "skew")
    return {name: arrays.from_wire(getattr(quality, name)) for name in names}


def _group(group: wire.VariableGroup) -> VariableGroup:
    shape = tuple(group.shape)
    return VariableGroup(group.name, slice(group.first, group.first + int(np.prod(shape))), shape)


def _follow(events: Iterator[Any], result: str, progress: bool | Callable[[Progress], None]) -> Any:
    """The field `result` of the last event, progress being told meanwhile."""
    with _Bar(enabled=progress is True) as bar:
        tell = progress if callable(progress) else bar
        for event in events:
            if event.HasField(result):
                return getattr(event, result)
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
