"""Client of the panel method: subsonic flow over surface meshes, with exact derivatives.

    panels = moldline.panel.Client("127.0.0.1:50052")
    configuration = panels.create_configuration(
        mesh.vertices, mesh.cells, trailing_edges=moldline.panel.Angle(120), cell_groups=moldline.panel.parts(mesh)
    )
    reference = moldline.panel.Reference(area=68.2, chord=3.42, span=23.8, point=(14, 0, 0.9))
    analysis = configuration.analyze(vertices, mach=0.7, alpha=0.02, reference=reference)
    gradient = configuration.vjp({"lift": 1.0}, at=analysis).vertices

Axes: x aft, y starboard, z up; metres and radians. The server keeps no record: what it has dropped, this client sends again.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline import arrays
from moldline.caller import Caller
from moldline.errors import InternalError, NotFound
from moldline.mesh import Mesh, write_cells
from moldline.model import Progress
from moldline.operations import Blocks, Call, Operation
from moldline.progress import Tell, told
from moldline.v1 import array_pb2, panel_service_pb2_grpc
from moldline.v1 import panel_service_pb2 as wire

Array = NDArray[np.float64]
T = TypeVar("T")

#: Scalar outputs, in the order of blocks of them.
COEFFICIENTS = (
    "lift",
    "induced_drag",
    "pressure_lift",
    "pressure_drag",
    "moment",
    "lift_slope",
    "moment_slope",
    "pressure_lift_slope",
    "neutral_point",
)


@dataclass(frozen=True)
class Groups:
    """Trailing edges are the edges with both vertices in one of these vertex groups."""

    names: tuple[str, ...]

    def __init__(self, *names: str) -> None:
        object.__setattr__(self, "names", names)


@dataclass(frozen=True)
class Edges:
    """Trailing edges are these pairs of vertices, uint32, (k, 2)."""

    pairs: ArrayLike


@dataclass(frozen=True)
class Angle:
    """Trailing edges are where the outward normal turns by at least so many degrees, pointing downstream."""

    degrees: float


#: Where wakes leave the surface; `"none"` for bodies without lift.
TrailingEdges = Groups | Edges | Angle | Literal["none"]

#: The plane y = 0: `"none"` solves every cell, `"half"` says that the mesh is one half, `"mirror"` that it has both.
Symmetry = Literal["none", "half", "mirror"]

#: LU in double precision, in single precision with refinement, or GMRES.
Solver = Literal["double", "single", "iterative"]

_SOLVERS = {0: "automatic", 1: "double", 2: "single", 3: "iterative"}


@dataclass(frozen=True)
class Reference:
    """What coefficients refer to: of the whole aircraft, also for a half model."""

    #: m^2.
    area: float
    #: Of the pitching moment, m.
    chord: float
    #: Of rolling and yawing moment, m.
    span: float
    #: About which moments are taken, m.
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Coefficients:
    """Scalar outputs."""

    #: Lift from the circulation of the wakes.
    lift: float
    #: Induced drag from the Trefftz plane.
    induced_drag: float
    #: Lift and drag from the pressure.
    pressure_lift: float
    pressure_drag: float
    #: Pitching moment, nose up positive, from the pressure.
    moment: float
    #: Derivatives by the angle of attack, 1/rad.
    lift_slope: float
    moment_slope: float
    pressure_lift_slope: float
    #: x of the neutral point, m; not a number without lift.
    neutral_point: float


@dataclass(frozen=True)
class Loads:
    """Forces and moments of a part of the surface, from the pressure."""

    #: (3,): along x, y, z, by dynamic pressure and reference area.
    force: Array
    #: (3,): about x, y, z, by span, chord and span as well; the second is nose up.
    moment: Array
    lift: float
    drag: float


@dataclass(frozen=True)
class Sections:
    """Loads along the trailing edges of the solved half."""

    #: uint32, (k, 2): the trailing edge, as vertices.
    edges: NDArray[np.uint32]
    #: (k, 3): its middle, m.
    middles: Array
    #: (k, 2): from its first to its second vertex in y and z, m.
    spans: Array
    #: (k,): section lift coefficient times chord, m.
    loads: Array


@dataclass(frozen=True)
class AnalysisPoint:
    """Where a derivative is taken."""

    #: float64, (n, 3), m; the reference positions if `None`.
    vertices: ArrayLike | None
    mach: float
    #: rad.
    alpha: float
    sideslip: float
    reference: Reference


@dataclass(frozen=True)
class Analysis:
    """The flow at one angle of attack."""

    #: Names configuration, vertices and Mach number; the same at every angle.
    id: str
    #: What was asked for.
    point: AnalysisPoint
    coefficients: Coefficients
    #: Lift coefficient of the wakes: the part of the circulation's lift that acts on them and not on the body.
    wake_lift: float
    #: Lift from the pressure and on the wakes over the lift that momentum demands for the circulation, less one: a measure
    #: of the discretisation.
    disagreement: float
    total: Loads
    #: By name.
    components: Mapping[str, Loads]
    sections: Sections
    #: (m,): pressure coefficient of every cell; empty if it was not wanted.
    cp: Array
    #: (n,): pressure coefficient at every vertex; empty if it was not wanted.
    vertex_cp: Array
    #: Cells where the flow would be supersonic.
    supercritical_cells: int
    #: Of the linear system, relative to its right-hand side.
    residual: float
    #: After each round of refinement, or iteration.
    residuals: tuple[float, ...]
    rounds: int
    #: Whether the server had it solved already.
    reused: bool
    engine_seconds: float = field(compare=False)
    queue_seconds: float = field(compare=False)


#: Where a derivative is taken: an analysis, whose factored system the server then need not make again, or a point.
At = Analysis | AnalysisPoint


@dataclass(frozen=True)
class FlowTangents:
    """Changes of the outputs, along k directions; without the first axis for a single direction."""

    #: By name, (k,) or a number.
    coefficients: Mapping[str, Any]
    #: (k, sections), m.
    section_loads: Array
    #: (k, m).
    cp: Array
    engine_seconds: float
    queue_seconds: float


@dataclass(frozen=True)
class FlowGradients:
    """Gradients of k weighted sums of the outputs; without the first axis for a single one."""

    #: (k, n, 3), per metre.
    vertices: Array
    #: (k,) each, per rad, rad, 1, m^2 and m.
    alpha: Array
    sideslip: Array
    mach: Array
    area: Array
    chord: Array
    #: (k, 3), per metre.
    point: Array
    engine_seconds: float
    queue_seconds: float


class Client(Caller):
    """A connection to `moldline panel serve`. Safe to use from several threads; close it, or use it in a `with` statement.

    Arguments are as those of :class:`moldline.Client`.
    """

    _STUB = panel_service_pb2_grpc.PanelServiceStub

    def create_configuration(
        self,
        vertices: ArrayLike,
        cells: ArrayLike,
        *,
        cell_groups: Mapping[str, ArrayLike] | None = None,
        vertex_groups: Mapping[str, ArrayLike] | None = None,
        symmetry: Symmetry | None = None,
        trailing_edges: TrailingEdges | None = None,
        components: Iterable[str] | None = None,
        solver: Solver | None = None,
        tolerance: float | None = None,
        timeout: float | None = None,
    ) -> Configuration:
        """Checks a mesh and finds what does not change with its vertices. The same content again gives the same one.

        `vertices`: float64, (n, 3), metres: reference positions. Symmetry, trailing edges and wakes are found there.
        `cells`: uint32, (m, 4), as :attr:`moldline.Mesh.cells`.
        `cell_groups`: parts of the surface by name, whose forces are told; :func:`parts` makes them from a mesh.
        `vertex_groups`: vertices by name, for trailing edges.
        `symmetry`: as the reference positions are if `None`.
        `trailing_edges`: by an angle of 120 degrees if `None`.
        `components`: cell groups whose forces are told; all if `None`.
        `solver`: by the size of the system if `None`.
        `tolerance`: residual relative to the right-hand side; 1e-12 if `None`.

        Raises :class:`moldline.InvalidArgument` naming the cell or edge that is wrong,
        :class:`moldline.ResourceExhausted` if an analysis would need more memory than the server gives one.
        """
        request = wire.CreateConfigurationRequest()
        arrays.write(vertices, request.vertices)
        _write_indices(cells, request.cells)
        for groups, target in ((cell_groups, request.cell_groups), (vertex_groups, request.vertex_groups)):
            for name, indices in (groups or {}).items():
                _write_indices(indices, target.add(name=name).indices)
        options = request.options
        options.SetInParent()
        if symmetry is not None:
            options.symmetry = wire.PanelSymmetry.Value(f"PANEL_SYMMETRY_{symmetry.upper()}")
        if trailing_edges is not None:
            _write_trailing_edges(trailing_edges, options.trailing_edges)
        if components is not None:
            options.components.names.extend(components)
            options.components.SetInParent()
        if solver is not None:
            options.solver = wire.PanelSolver.Value(f"PANEL_SOLVER_{solver.upper()}")
        if tolerance is not None:
            options.tolerance = tolerance
        return Configuration(self, self._run(_create(request), timeout), request)

    def get_configuration(self, configuration_id: str, *, timeout: float | None = None) -> Configuration:
        """The configuration of that id. Raises :class:`moldline.NotFound` if the server keeps it no more."""
        return Configuration(self, self._run(_get(configuration_id), timeout), None)


class Configuration:
    """A mesh made ready on the server. Immutable; serves any positions of its vertices."""

    def __init__(
        self, client: Client, description: wire.Configuration, request: wire.CreateConfigurationRequest | None
    ) -> None:
        self._client = client
        self._request = request
        #: Hash of its content.
        self.id: str = description.configuration_id
        self.vertex_count: int = description.vertex_count
        self.cell_count: int = description.cell_count
        #: Unknowns of the linear system.
        self.unknowns: int = description.unknowns
        #: Whether one half is solved for both.
        self.symmetric: bool = description.symmetric
        #: uint32, (k, 2): trailing edges of the solved half, in the order of section loads.
        self.trailing_edges: NDArray[np.uint32] = arrays.from_wire(description.trailing_edges)
        #: uint32: vertices where a trailing edge ends on a body, over which its circulation goes on.
        self.roots: NDArray[np.uint32] = arrays.from_wire(description.roots)
        #: Such as ``single``.
        self.solver: str = _SOLVERS[description.solver]
        #: Bytes that an analysis takes at its peak, about.
        self.memory: int = description.memory_bytes
        #: Names of the parts whose forces are told.
        self.components: tuple[str, ...] = tuple(description.components)

    def analyze(
        self,
        vertices: ArrayLike | None = None,
        *,
        reference: Reference,
        mach: float = 0.0,
        alpha: float = 0.0,
        sideslip: float = 0.0,
        pressures: bool = True,
        progress: bool | Tell = False,
        timeout: float | None = None,
    ) -> Analysis:
        """The flow at one angle of attack. A pure function: a retry is safe.

        `vertices`: float64, (n, 3), metres; the reference positions if `None`.
        `alpha`, `sideslip`: rad.
        `pressures`: whether those of cells and vertices are wanted.
        `progress`: as in :meth:`moldline.Client.create_setup`.

        Raises :class:`moldline.InvalidArgument` naming what is wrong, :class:`moldline.FailedPrecondition` if the method
        fails on these vertices, such as a wake that cuts the body.
        """
        swept = self.sweep(
            [alpha],
            vertices,
            reference=reference,
            mach=mach,
            sideslip=sideslip,
            pressures=pressures,
            progress=progress,
            timeout=timeout,
        )
        return swept[0]

    def sweep(
        self,
        alphas: Sequence[float],
        vertices: ArrayLike | None = None,
        *,
        reference: Reference,
        mach: float = 0.0,
        sideslip: float = 0.0,
        pressures: bool = True,
        progress: bool | Tell = False,
        timeout: float | None = None,
    ) -> list[Analysis]:
        """The same at several angles of attack, for hardly more than the price of one."""
        # The caller may change its array later.
        copied = None if vertices is None else np.array(vertices, dtype=np.float64)
        points = [AnalysisPoint(copied, mach, float(alpha), sideslip, reference) for alpha in alphas]
        request = wire.AnalyzeRequest(configuration_id=self.id, mach=mach, without_pressures=not pressures)
        if copied is not None:
            arrays.write(copied, request.vertices)
        for point in points:
            request.flows.add(alpha=point.alpha, sideslip=sideslip)
        _write_reference(reference, request.reference)
        with told(progress) as tell:
            answer = self._run(_analyze(request, tell), timeout)
        return [_analysis(answer, flow, point) for flow, point in zip(answer.flows, points, strict=True)]

    def jvp(
        self,
        vertices: ArrayLike | None = None,
        *,
        alpha: ArrayLike | None = None,
        sideslip: ArrayLike | None = None,
        mach: ArrayLike | None = None,
        area: ArrayLike | None = None,
        chord: ArrayLike | None = None,
        point: ArrayLike | None = None,
        at: At,
        timeout: float | None = None,
    ) -> FlowTangents:
        """How the outputs change along directions of the inputs: `J v`, exactly. What is `None` is zero.

        `vertices`: float64, (k, n, 3) or (n, 3), m. `point`: (k, 3) or (3,). The others: (k,) or a number.
        `at`: where the derivative is taken.
        """
        blocks = Blocks(self.vertex_count)
        for name, block, dimensions in (
            ("vertices", vertices, 2),
            ("alpha", alpha, 0),
            ("sideslip", sideslip, 0),
            ("mach", mach, 0),
            ("area", area, 0),
            ("chord", chord, 0),
            ("point", point, 1),
        ):
            if block is not None:
                blocks.add(name, block, dimensions)
        return self._run(_jvp(self.id, blocks, at), timeout)

    def vjp(
        self,
        coefficients: Mapping[str, ArrayLike] | ArrayLike | None = None,
        *,
        section_loads: ArrayLike | None = None,
        cp: ArrayLike | None = None,
        at: At,
        timeout: float | None = None,
    ) -> FlowGradients:
        """Gradients of weighted sums of the outputs: `J^T w`, exactly. Several share one pass. What is `None` is zero.

        `coefficients`: weights by name (:data:`COEFFICIENTS`), each a number or (k,), those not named being zero; or all in
        order, (k, 9) or (9,). `section_loads`: (k, sections) or (sections,). `cp`: (k, m) or (m,).
        `at`: where the derivative is taken.
        """
        blocks = Blocks(max(self.vertex_count, self.cell_count))
        if coefficients is not None:
            weights = _weights(coefficients) if isinstance(coefficients, Mapping) else coefficients
            blocks.add("coefficients", weights, 1)
        if section_loads is not None:
            blocks.add("section_loads", section_loads, 1)
        if cp is not None:
            blocks.add("cp", cp, 1)
        return self._run(_vjp(self.id, blocks, at), timeout)

    def write_vtu(self, path: str | os.PathLike[str], analysis: Analysis) -> None:
        """Writes the mesh of an analysis with its pressure coefficients, for ParaView."""
        if self._request is None:
            raise ValueError("this client did not send the mesh: use moldline.write_cells")
        vertices = analysis.point.vertices
        if vertices is None:
            vertices = arrays.from_wire(self._request.vertices)
        cells = arrays.from_wire(self._request.cells)
        write_cells(path, vertices, cells, {"cp": analysis.vertex_cp}, {"cp": analysis.cp})

    def _run(self, operation: Operation[T], timeout: float | None) -> T:
        return self._client._run(_again(operation, self._request, self.id), timeout)


def parts(mesh: Mesh) -> dict[str, NDArray[np.uint32]]:
    """The cells of each component of a mesh, by name: cell groups of a configuration."""
    owned = {
        name: np.flatnonzero(mesh.cell_owner == index).astype(np.uint32) for index, name in enumerate(mesh.components)
    }
    return {name: cells for name, cells in owned.items() if len(cells)}


def _create(request: wire.CreateConfigurationRequest) -> Operation[wire.Configuration]:
    response: wire.CreateConfigurationResponse = yield Call("CreateConfiguration", request)
    return response.configuration


def _get(configuration_id: str) -> Operation[wire.Configuration]:
    response: wire.GetConfigurationResponse = yield Call(
        "GetConfiguration", wire.GetConfigurationRequest(configuration_id=configuration_id)
    )
    return response.configuration


def _again(
    operation: Operation[T], request: wire.CreateConfigurationRequest | None, configuration_id: str
) -> Generator[Call, Any, T]:
    """The operation; a configuration that the server has dropped is sent again, and the call repeated."""
    step, value = operation.send, None
    while True:
        try:
            call = step(value)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]  # What the operation returns is a T.
        try:
            try:
                step, value = operation.send, (yield call)
            except NotFound as error:
                dropped = any(violation.field == "configuration_id" for violation in error.violations)
                if request is None or not dropped:
                    raise
                created = yield from _create(request)
                if created.configuration_id != configuration_id:
                    raise InternalError("the server names the same configuration otherwise") from error
                step, value = operation.send, (yield call)
        except Exception as error:
            step, value = operation.throw, error


def _analyze(request: wire.AnalyzeRequest, tell: Tell) -> Operation[wire.Analysis]:
    analysis: list[wire.Analysis] = []

    def receive(event: wire.AnalyzeResponse) -> None:
        if event.HasField("analysis"):
            analysis[:] = [event.analysis]
        else:
            tell(Progress(event.progress.stage, event.progress.fraction, event.progress.message))

    yield Call("Analyze", request, lambda: receive)
    if not analysis:
        raise InternalError("the server ended without a result")
    return analysis[0]


def _jvp(configuration_id: str, blocks: Blocks, at: At) -> Operation[FlowTangents]:
    parts = []
    for piece in blocks.pieces():
        request = wire.PanelServiceApplyJacobianVectorRequest(configuration_id=configuration_id, at=_at(at))
        for name, block in piece.items():
            arrays.write(block, getattr(request.directions, name))
        parts.append((yield Call("ApplyJacobianVector", request)))
    coefficients = blocks.joined(part.changes.coefficients for part in parts)
    by_name = {name: coefficients[..., index] for index, name in enumerate(COEFFICIENTS)}
    section_loads = blocks.joined(part.changes.section_loads for part in parts)
    return FlowTangents(by_name, section_loads, blocks.joined(part.changes.cp for part in parts), *_seconds(parts))


def _vjp(configuration_id: str, blocks: Blocks, at: At) -> Operation[FlowGradients]:
    parts = []
    for piece in blocks.pieces():
        request = wire.PanelServiceApplyAdjointRequest(configuration_id=configuration_id, at=_at(at))
        for name, block in piece.items():
            arrays.write(block, getattr(request.seeds, name))
        parts.append((yield Call("ApplyAdjoint", request)))
    names = ("vertices", "alpha", "sideslip", "mach", "area", "chord", "point")
    gradients = {name: blocks.joined(getattr(part.gradients, name) for part in parts) for name in names}
    engine, queue = _seconds(parts)
    return FlowGradients(**gradients, engine_seconds=engine, queue_seconds=queue)


def _seconds(parts: list[Any]) -> tuple[float, float]:
    return sum(part.timings.engine_seconds for part in parts), sum(part.timings.queue_seconds for part in parts)


def _at(at: At) -> wire.AnalysisPoint:
    """The id where there is one, and what it names, from which the server makes what it does not hold."""
    message = wire.AnalysisPoint()
    point = at
    if isinstance(at, Analysis):
        message.analysis_id, point = at.id, at.point
    assert isinstance(point, AnalysisPoint)
    message.geometry.mach = point.mach
    message.geometry.SetInParent()
    if point.vertices is not None:
        arrays.write(point.vertices, message.geometry.vertices)
    message.flow.alpha, message.flow.sideslip = point.alpha, point.sideslip
    message.flow.SetInParent()
    _write_reference(point.reference, message.reference)
    return message


def _weights(named: Mapping[str, ArrayLike]) -> Array:
    unknown = [name for name in named if name not in COEFFICIENTS]
    if unknown:
        raise ValueError(f"there is no coefficient {unknown[0]!r}; there are: {', '.join(COEFFICIENTS)}")
    columns = np.broadcast_arrays(*(np.asarray(named.get(name, 0.0), dtype=np.float64) for name in COEFFICIENTS))
    return np.stack(columns, axis=-1)


def _write_reference(reference: Reference, message: wire.FlowReference) -> None:
    message.area, message.chord, message.span = reference.area, reference.chord, reference.span
    message.point.extend(reference.point)


def _write_trailing_edges(edges: TrailingEdges, message: wire.TrailingEdges) -> None:
    if isinstance(edges, Groups):
        message.groups.SetInParent()
        message.groups.names.extend(edges.names)
    elif isinstance(edges, Edges):
        _write_indices(edges.pairs, message.edges)
    elif isinstance(edges, Angle):
        message.angle = edges.degrees
    elif edges == "none":
        message.none.SetInParent()
    else:
        raise ValueError(f'trailing edges are Groups, Edges, Angle or "none", not {edges!r}')


def _write_indices(values: ArrayLike, message: array_pb2.Array) -> None:
    indices = np.asarray(values)
    # Fewer than none cannot be told from very many afterwards.
    if indices.size and (not np.issubdtype(indices.dtype, np.integer) or indices.min() < 0):
        raise ValueError("indices are integers, not negative")
    message.dtype = array_pb2.DATA_TYPE_UINT32
    message.shape.extend(indices.shape)
    message.data = np.ascontiguousarray(indices, dtype="<u4").tobytes()


def _loads(message: wire.Loads) -> Loads:
    return Loads(np.array(message.force), np.array(message.moment), message.lift, message.drag)


def _analysis(answer: wire.Analysis, flow: wire.FlowAnalysis, point: AnalysisPoint) -> Analysis:
    sections = flow.sections
    nothing = np.empty(0)
    return Analysis(
        id=answer.analysis_id,
        point=point,
        coefficients=Coefficients(*(getattr(flow.coefficients, part.name) for part in fields(Coefficients))),
        wake_lift=flow.wake_lift,
        disagreement=flow.disagreement,
        total=_loads(flow.total),
        components={loads.name: _loads(loads) for loads in flow.components},
        sections=Sections(
            edges=arrays.from_wire(sections.edges),
            middles=arrays.from_wire(sections.middles),
            spans=arrays.from_wire(sections.spans),
            loads=arrays.from_wire(sections.loads),
        ),
        cp=arrays.from_wire(flow.cp) if flow.HasField("cp") else nothing,
        vertex_cp=arrays.from_wire(flow.vertex_cp) if flow.HasField("vertex_cp") else nothing,
        supercritical_cells=flow.supercritical_cells,
        residual=answer.residual,
        residuals=tuple(answer.residuals),
        rounds=answer.rounds,
        reused=answer.reused,
        engine_seconds=answer.timings.engine_seconds,
        queue_seconds=answer.timings.queue_seconds,
    )
