"""Data model of the mesh service: arguments and results of both clients, blocking and asyncio."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline import display
from moldline.content import ByContent
from moldline.designs import Design
from moldline.quality import QualityReport


@dataclass(frozen=True)
class Progress:
    """Progress of a long call."""

    #: Name of the stage: of a set-up, `receive`, `read`, `queue`, then the engine's stages; of a Jacobian, `jacobian`.
    stage: str
    #: Fraction of the stage that is done, 0 to 1.
    fraction: float
    #: Description for display.
    message: str


@dataclass(frozen=True)
class Variable:
    """One scalar design variable."""

    #: Such as ``wing.twist[3]``.
    name: str
    #: Unit of its values and bounds, such as ``m`` or ``deg``.
    unit: str
    baseline: float
    #: Bounds; may be infinite.
    lower: float
    upper: float


@dataclass(frozen=True, eq=False, repr=False)
class VariableGroup(ByContent):
    """Variables that were declared together."""

    name: str
    #: Their entries in a design.
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
    #: Value for the reference mesh.
    value: float


#: Who may use a set-up besides its owner: nobody, named tenants, or every tenant of the server.
Visibility = Literal["private", "tenants", "public"]


@dataclass(frozen=True)
class SetupAccess:
    """Access of the caller, and of others, to a set-up."""

    #: Whether the caller has uploaded it.
    owned: bool
    #: For the owner, the chosen visibility; for others, the one that gives them access: `tenants` or `public`.
    visibility: Visibility
    #: Names of tenants; shown to the owner only.
    shared_with: tuple[str, ...]


@dataclass(frozen=True)
class SetupSummary:
    """A set-up in a list."""

    id: str
    name: str
    vertex_count: int
    cell_count: int
    variable_count: int
    #: Time of the first upload, UTC.
    created: datetime
    access: SetupAccess


@dataclass(frozen=True, eq=False, repr=False)
class DesignPoint(ByContent):
    """A requested design: the arguments of :meth:`Session.deform`."""

    design: Design = None
    control_points: Mapping[str, ArrayLike] | None = None


@dataclass(frozen=True, eq=False, repr=False)
class SessionState(ByContent):
    """Stored state of a session."""

    id: str
    setup_id: str
    #: Grows by one with each update.
    generation: int
    #: The design stored last: all variables in order, and external control points. `None` in lists.
    design: DesignPoint | None
    #: Descriptive label.
    label: str
    #: UTC.
    created: datetime
    updated: datetime


@dataclass(frozen=True, eq=False, repr=False)
class Linearisation(ByContent):
    """Point of linearisation: the id of a linearisation on the server, and the design to recompute it from."""

    #: Determined by set-up and design: the same on every server.
    id: str
    #: The requested design, with copies of its arrays.
    point: DesignPoint


@dataclass(frozen=True, eq=False, repr=False)
class Deformation(ByContent):
    """A deformed mesh."""

    #: float64, (n, 3), metres, in the order of the set-up's mesh; a read-only view of the message's memory.
    vertices: NDArray[np.float64]
    #: The scalar outputs by name, each in its unit (:attr:`Setup.functions`).
    functions: dict[str, float]
    #: For derivatives at this design: the `at` of :meth:`Session.jvp`, :meth:`Session.vjp` and :meth:`Session.jacobian`.
    linearisation: Linearisation
    #: Quality of the deformed mesh.
    quality: QualityReport
    #: Quality of every cell, float64, (m,), by name (`aspect_ratio`, `edge_ratio`, `scaled_jacobian`, `skew`), if requested.
    cell_quality: dict[str, NDArray[np.float64]] | None
    #: Largest distance of a seam vertex from one of its components before the smooth projection, metres.
    seam_residual: float
    #: Largest distance of a protected or stationary vertex from a component that it lies on, metres.
    held_residual: float
    #: Largest final |Phi| of an active vertex, metres; 0 for a sharp outer mold line.
    projection_residual: float
    #: Largest number of projection steps of a vertex.
    projection_steps: int
    #: Pairs of cells that pass through each other and did not in the set-up's mesh, at most 1000 (option `on_event`).
    crossing_pairs: int
    #: Seconds in the engine.
    engine_seconds: float = field(compare=False)
    #: Seconds in the queue.
    queue_seconds: float = field(compare=False)

    @property
    def linearisation_id(self) -> str:
        """Id of the linearisation, for requests for derivatives."""
        return self.linearisation.id

    def __repr__(self) -> str:
        worst = self.quality.total
        return (
            f"<Deformation {self.linearisation.id[:12]}: {len(self.vertices)} vertices, {len(self.functions)} functions,"
            f" aspect ratio p95 {worst.aspect_ratio.p95:.3f}, {worst.folded} folded>"
        )

    def _repr_html_(self) -> str:
        functions = display.table("Functions", ("name", "value"), self.functions.items())
        return functions + self.quality._repr_html_()


#: Point of linearisation: the result of `deform`, its `linearisation` or the latter's id, a design as `deform` takes it, or
#: a :class:`DesignPoint`; `None` for the baseline.
At = Deformation | Linearisation | DesignPoint | str | Mapping[str, ArrayLike] | ArrayLike | None


@dataclass(frozen=True, eq=False, repr=False)
class Tangents(ByContent):
    """Changes of the outputs along k directions; without the first axis for a single one."""

    #: float64, (k, n, 3), metres.
    vertices: NDArray[np.float64]
    #: By function: float64, (k,), in its unit.
    functions: dict[str, NDArray[np.float64]]
    #: Seconds in the engine.
    engine_seconds: float = field(compare=False)
    #: Seconds in the queue.
    queue_seconds: float = field(compare=False)


@dataclass(frozen=True, eq=False, repr=False)
class Gradients(ByContent):
    """Gradients of k weighted sums of the outputs; without the first axis for a single one."""

    #: float64, (k, number of variables), per unit of the variable; `None` if not requested.
    design: NDArray[np.float64] | None
    #: By requested component: float64, (k, number of its control points, 3), per metre.
    control_points: dict[str, NDArray[np.float64]]
    #: Seconds in the engine.
    engine_seconds: float = field(compare=False)
    #: Seconds in the queue.
    queue_seconds: float = field(compare=False)


@dataclass(frozen=True, eq=False, repr=False)
class Jacobian(ByContent):
    """Derivatives of all outputs with respect to all design variables."""

    #: float64, (number of variables, n, 3), metres per unit of the variable.
    vertices: NDArray[np.float64]
    #: By function: float64, (number of variables,), its unit per unit of the variable.
    functions: dict[str, NDArray[np.float64]]
    #: Seconds in the engine.
    engine_seconds: float = field(compare=False)
    #: Seconds in the queue.
    queue_seconds: float = field(compare=False)


@dataclass(frozen=True)
class CacheStatus:
    """Usage of a cache of the server."""

    entries: int
    bytes: int
    #: Budget of all tenants together.
    budget_bytes: int
    #: Since the start of the server; 0 unless the caller is an administrator.
    hits: int
    misses: int
    evictions: int


@dataclass(frozen=True)
class Work:
    """A request that is computing or queued."""

    #: Such as `build`, `deform`, `jvp`, `vjp`, `jacobian`.
    kind: str
    tenant: str
    #: Empty if there is none (yet).
    setup_id: str
    session_id: str
    #: Whether it is computing; otherwise it is queued.
    running: bool
    #: Seconds since its arrival, and since its computation began.
    age_seconds: float
    running_seconds: float
    #: Current stage, and fraction of it that is done, where known.
    stage: str
    fraction: float


@dataclass(frozen=True, repr=False)
class Status:
    """Load, caches and store of a server."""

    version: str
    uptime_seconds: float
    #: Whether the figures cover all tenants (for administrators), or the caller's only.
    all_tenants: bool
    #: Requests that are computing and queued, and the limits of both.
    running: int
    queued: int
    running_limit: int
    queued_limit: int
    #: Open sessions.
    sessions: int
    #: Set-ups in memory, and in the store.
    setups_resident: int
    setups_stored: int
    #: Bytes in the store.
    stored_bytes: int
    setup_cache: CacheStatus
    linearisation_cache: CacheStatus
    #: Requests that are computing or queued, oldest first.
    work: tuple[Work, ...]

    def __repr__(self) -> str:
        return (
            f"<Status of version {self.version}: {self.running} of {self.running_limit} computing, {self.queued} waiting,"
            f" {self.sessions} sessions, {self.setups_stored} set-ups, {self.stored_bytes / 1e6:.1f} MB stored>"
        )

    def _repr_html_(self) -> str:
        caches = [(each, getattr(self, each)) for each in ("setup_cache", "linearisation_cache")]
        rows = [
            ("version", self.version),
            ("up, s", self.uptime_seconds),
            ("computing", f"{self.running} of {self.running_limit}"),
            ("waiting", f"{self.queued} of {self.queued_limit}"),
            ("sessions", self.sessions),
            ("set-ups in memory", self.setups_resident),
            ("set-ups stored", self.setups_stored),
            ("stored, MB", self.stored_bytes / 1e6),
            *(
                (f"{name.replace('_', ' ')}, MB", f"{c.bytes / 1e6:.1f} of {c.budget_bytes / 1e6:.1f}")
                for name, c in caches
            ),
        ]
        work = [(w.kind, w.tenant, w.stage, f"{w.fraction:.0%}", w.age_seconds) for w in self.work]
        return display.table("Server", ("", ""), rows) + display.table(
            "Work", ("kind", "tenant", "stage", "done", "age, s"), work
        )
