"""What clients ask with and are answered: plain data, the same for the client that waits and for asyncio."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline.quality import QualityReport


@dataclass(frozen=True)
class Progress:
    """How far something long has come."""

    #: Of a set-up: `receive`, `read`, `queue`, and then the engine's stages. `jacobian` of a Jacobian.
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


#: Who may use a set-up besides its owner: nobody, tenants that are named, or every tenant of the server.
Visibility = Literal["private", "tenants", "public"]


@dataclass(frozen=True)
class SetupAccess:
    """What a set-up is to the caller."""

    #: Whether the caller has uploaded it.
    owned: bool
    #: To the owner: what was chosen. To others: `tenants` or `public`, whichever lets them use it.
    visibility: Visibility
    #: Tenants; to the owner only.
    shared_with: tuple[str, ...]


@dataclass(frozen=True)
class SetupSummary:
    """A set-up in a list."""

    id: str
    name: str
    vertex_count: int
    cell_count: int
    variable_count: int
    #: When it was first uploaded, UTC.
    created: datetime
    access: SetupAccess


@dataclass(frozen=True)
class DesignPoint:
    """A design as it was asked for: the arguments of :meth:`Session.deform`."""

    design: Mapping[str, float] | ArrayLike | None = None
    control_points: Mapping[str, ArrayLike] | None = None


@dataclass(frozen=True)
class SessionState:
    """A session as the server has stored it."""

    id: str
    setup_id: str
    #: Grows by one with each update.
    generation: int
    #: As stored last: all variables in order, and the control points that were given. `None` in lists.
    design: DesignPoint | None
    #: For people.
    label: str
    #: UTC.
    created: datetime
    updated: datetime


@dataclass(frozen=True)
class Linearisation:
    """Where a derivative is taken: what the server keeps of a deformation, and the design to make it again."""

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


@dataclass(frozen=True)
class CacheStatus:
    """Use of one of the server's caches."""

    entries: int
    bytes: int
    #: The server's, for all tenants.
    budget_bytes: int
    #: Since the server started; for administrators, others see 0.
    hits: int
    misses: int
    evictions: int


@dataclass(frozen=True)
class Work:
    """A request that computes, or waits for it."""

    #: Such as `build`, `deform`, `jvp`, `vjp`, `jacobian`.
    kind: str
    tenant: str
    #: Empty where there is none (yet).
    setup_id: str
    session_id: str
    #: Whether it computes; otherwise it waits.
    running: bool
    #: Seconds since it came, and since it computes.
    age_seconds: float
    running_seconds: float
    #: How far it has come, where that is known.
    stage: str
    fraction: float


@dataclass(frozen=True)
class Status:
    """What the server does and holds."""

    version: str
    uptime_seconds: float
    #: Whether the figures are those of all tenants (for administrators), or of the caller's only.
    all_tenants: bool
    #: Requests that compute and that wait for it, and how many may.
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
    #: Longest first.
    work: tuple[Work, ...]
