"""Data model of the panel service: arguments and results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline import display
from moldline.content import ByContent

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Groups:
    """Trailing edges are the edges with both vertices in one of these vertex groups."""

    names: tuple[str, ...]

    def __init__(self, *names: str) -> None:
        object.__setattr__(self, "names", names)


@dataclass(frozen=True, eq=False, repr=False)
class Edges(ByContent):
    """Trailing edges are these pairs of vertices, uint32, (k, 2)."""

    pairs: ArrayLike


@dataclass(frozen=True)
class Angle:
    """Trailing edges point downstream, and the outward normal turns across them by at least this angle (60 to 180)."""

    degrees: float


#: Trailing edges, where wakes leave the surface; `"none"` for bodies without lift.
TrailingEdges = Groups | Edges | Angle | Literal["none"]

#: Symmetry with respect to the plane y = 0: every cell is solved; the mesh is one half; or it has both, and one is solved.
Symmetry = Literal["none", "half", "mirror"]

#: Answers that contradict themselves: refused, or given with a warning.
OnDoubt = Literal["refuse", "warn"]

#: Solver of the linear system: LU in double precision, in single precision with refinement, or GMRES.
Solver = Literal["double", "single", "iterative"]


@dataclass(frozen=True)
class Warning:
    """A reason to doubt a configuration or an answer."""

    #: Of a configuration ``no_wake`` or ``left_out``; of an answer ``near_pass``, ``lift``, ``drag``, ``span_efficiency``,
    #: ``stagnation`` or ``circulation``.
    kind: str
    #: What is wrong, where, and the way out.
    text: str


@dataclass(frozen=True, eq=False, repr=False)
class LineLeftOut(ByContent):
    """A line of edges that looks like a trailing edge, but was not taken as one."""

    #: uint32: its vertices in order.
    vertices: NDArray[np.uint32]
    #: m.
    length: float
    #: Length as seen along the flow, m.
    width: float
    #: Angle by which the outward normal turns across it, degrees: the mean.
    turn: float
    #: ``flat``, ``smooth``, ``along_the_flow``, ``base`` or ``not_named``.
    reason: str


@dataclass(frozen=True)
class Reference:
    """Reference values of the coefficients: of the whole aircraft, also for a half model."""

    #: Reference area, m^2.
    area: float
    #: Reference length of the pitching moment, m.
    chord: float
    #: Reference length of rolling and yawing moment, m.
    span: float
    #: Moment reference point, m.
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
    #: Pitching moment from the pressure, nose up positive.
    moment: float
    #: Derivatives with respect to the angle of attack, 1/rad.
    lift_slope: float
    moment_slope: float
    pressure_lift_slope: float
    #: x of the neutral point, m; not a number without lift.
    neutral_point: float


#: Names of the scalar outputs, in the order of blocks of them.
COEFFICIENTS = tuple(each.name for each in fields(Coefficients))


@dataclass(frozen=True, eq=False, repr=False)
class Loads(ByContent):
    """Force and moment coefficients of a part of the surface, from the pressure."""

    #: (3,): force along x, y, z over dynamic pressure and reference area.
    force: Array
    #: (3,): moment about x, y, z over dynamic pressure, reference area, and span, chord and span; the second is nose up.
    moment: Array
    lift: float
    drag: float


@dataclass(frozen=True, eq=False, repr=False)
class Sections(ByContent):
    """Loads along the trailing edges of the solved half."""

    #: uint32, (k, 2): the trailing edges, as pairs of vertices.
    edges: NDArray[np.uint32]
    #: (k, 3): their midpoints, m.
    middles: Array
    #: (k, 2): y and z of the vector from first to second vertex, m.
    spans: Array
    #: (k,): section lift coefficient times chord, m.
    loads: Array


@dataclass(frozen=True, eq=False, repr=False)
class AnalysisPoint(ByContent):
    """Point of linearisation: vertices and flow."""

    #: float64, (n, 3), m; the reference positions if `None`.
    vertices: ArrayLike | None
    mach: float
    #: Angle of attack, rad.
    alpha: float
    #: Sideslip, rad; positive if the wind comes from starboard.
    sideslip: float
    reference: Reference


@dataclass(frozen=True, eq=False, repr=False)
class Analysis(ByContent):
    """The flow in one wind."""

    #: Determined by configuration, vertices and Mach number: the same in every wind.
    id: str
    #: The requested vertices (a copy) and flow.
    point: AnalysisPoint
    coefficients: Coefficients
    #: Lift coefficient of the wakes: the part of the circulation's lift that acts on them and not on the body.
    wake_lift: float
    #: A measure of the discretisation error: lift from the pressure and on the wakes, over the lift that momentum requires
    #: for the circulation, minus one.
    disagreement: float
    #: Reasons to doubt the answer.
    warnings: tuple[Warning, ...]
    total: Loads
    #: By name.
    components: Mapping[str, Loads]
    sections: Sections
    #: (m,): pressure coefficient of every cell; empty if not requested.
    cp: Array
    #: (n,): pressure coefficient at every vertex; empty if not requested.
    vertex_cp: Array
    #: Number of cells where the flow would be supersonic.
    supercritical_cells: int
    #: Residual of the linear system relative to its right-hand side.
    residual: float
    #: The same after each round of refinement, or iteration.
    residuals: tuple[float, ...]
    #: Number of rounds of refinement, or iterations.
    rounds: int
    #: Whether the server had the solution already.
    reused: bool = field(compare=False)
    #: Seconds in the engine.
    engine_seconds: float = field(compare=False)
    #: Seconds in the queue.
    queue_seconds: float = field(compare=False)

    def __repr__(self) -> str:
        c = self.coefficients
        return (
            f"<Analysis {self.id[:12]} at Mach {self.point.mach:.4g}, alpha {self.point.alpha:.4g} rad: lift {c.lift:.5f},"
            f" induced drag {c.induced_drag:.6f}, moment {c.moment:.5f}>"
        )

    def _repr_html_(self) -> str:
        units = {"neutral_point": "m", **{name: "1/rad" for name in COEFFICIENTS if name.endswith("slope")}}
        coefficients = [(name, getattr(self.coefficients, name), units.get(name, "1")) for name in COEFFICIENTS]
        parts = [(name, part.lift, part.drag, part.moment[1]) for name, part in self.components.items()]
        title = f"Flow at Mach {self.point.mach:.4g}, alpha {self.point.alpha:.4g} rad"
        return display.table(title, ("coefficient", "value", "unit"), coefficients) + display.table(
            "Parts, from the pressure", ("part", "lift", "drag", "moment"), parts
        )


#: Point of linearisation: an analysis, which is best since the server holds its factored system, or vertices and flow.
At = Analysis | AnalysisPoint


@dataclass(frozen=True, eq=False, repr=False)
class FlowTangents(ByContent):
    """Changes of the outputs along k directions; without the first axis for a single direction."""

    #: By name, (k,) or a number.
    coefficients: Mapping[str, Any]
    #: (k, sections), m.
    section_loads: Array
    #: (k, m).
    cp: Array
    #: Seconds in the engine.
    engine_seconds: float = field(compare=False)
    #: Seconds in the queue.
    queue_seconds: float = field(compare=False)


@dataclass(frozen=True, eq=False, repr=False)
class FlowGradients(ByContent):
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
    #: Seconds in the engine.
    engine_seconds: float = field(compare=False)
    #: Seconds in the queue.
    queue_seconds: float = field(compare=False)
