"""Conversions between messages of the protocol and :mod:`moldline.model`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import datetime, timezone
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moldline import arrays
from moldline.mesh import Mesh
from moldline.model import (
    CacheStatus,
    Deformation,
    DesignPoint,
    Function,
    Linearisation,
    SessionState,
    SetupAccess,
    SetupSummary,
    Status,
    Visibility,
    Work,
)
from moldline.quality import report_from_wire
from moldline.v1 import mesh_service_pb2 as wire

_VISIBILITIES: dict[Visibility, wire.Visibility] = {
    "private": wire.VISIBILITY_PRIVATE,
    "tenants": wire.VISIBILITY_TENANTS,
    "public": wire.VISIBILITY_PUBLIC,
}


def access(message: wire.SetupAccess) -> SetupAccess:
    """Who may use a set-up."""
    names = {value: name for name, value in _VISIBILITIES.items()}
    return SetupAccess(message.owned, names.get(message.visibility, "private"), tuple(message.shared_with))


def write_sharing(visibility: Visibility | None, shared_with: Iterable[str], message: Any) -> None:
    """Writes the fields `visibility` and `shared_with`."""
    if visibility is not None:
        if visibility not in _VISIBILITIES:
            raise ValueError(f"visibility is {visibility!r}, expected one of {', '.join(_VISIBILITIES)}")
        message.visibility = _VISIBILITIES[visibility]
    message.shared_with.extend(shared_with)


def setup_summary(message: wire.SetupSummary) -> SetupSummary:
    """An entry of a list of set-ups."""
    return SetupSummary(
        id=message.setup_id,
        name=message.name,
        vertex_count=message.vertex_count,
        cell_count=message.cell_count,
        variable_count=message.variable_count,
        created=_time(message.created_time),
        access=access(message.access),
    )


def mesh(message: wire.Mesh, components: tuple[str, ...]) -> Mesh:
    """A reference mesh."""
    return Mesh(
        vertices=arrays.from_wire(message.vertices),
        cells=arrays.from_wire(message.cells),
        cell_owner=arrays.from_wire(message.cell_owner),
        seam=arrays.from_wire(message.seam).astype(bool),
        components=components,
    )


def control_points(messages: Iterable[wire.ControlPoints]) -> dict[str, NDArray[np.float64]]:
    """Control points by component."""
    return {each.component: arrays.from_wire(each.points) for each in messages}


def session_state(message: wire.Session) -> SessionState:
    """A session's record."""
    design = None
    if message.HasField("design"):
        values = arrays.from_wire(message.design.design) if message.design.HasField("design") else None
        design = DesignPoint(values, control_points(message.design.control_points) or None)
    return SessionState(
        id=message.session_id,
        setup_id=message.setup_id,
        generation=message.generation,
        design=design,
        label=message.label,
        created=_time(message.created_time),
        updated=_time(message.updated_time),
    )


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, timezone.utc)


def write_point(point: DesignPoint, message: Any) -> None:
    """Writes the fields `design` or `named`, and `control_points`, of a point made by :meth:`SetupFacts.point`."""
    if isinstance(point.design, Mapping):
        message.named.SetInParent()
        message.named.values.update(point.design)
    elif point.design is not None:
        arrays.write(point.design, message.design)
    for component, points in (point.control_points or {}).items():
        arrays.write(points, message.control_points.add(component=component).points)


def deformation(message: wire.DeformResponse, point: DesignPoint, known: Iterable[Function]) -> Deformation:
    """The answer to a Deform of `point`; `known` are the set-up's functions."""
    values = arrays.from_wire(message.functions).tolist()
    return Deformation(
        vertices=arrays.from_wire(message.vertices),
        functions={function.name: value for function, value in zip(known, values, strict=True)},
        linearisation=Linearisation(message.linearisation_id, point),
        quality=report_from_wire(message.quality),
        cell_quality=_cell_quality(message.cell_quality) if message.HasField("cell_quality") else None,
        seam_residual=message.residuals.seam,
        held_residual=message.residuals.held,
        projection_residual=message.residuals.projection,
        projection_steps=message.residuals.projection_steps,
        crossing_pairs=message.residuals.crossing_pairs,
        engine_seconds=message.timings.engine_seconds,
        queue_seconds=message.timings.queue_seconds,
    )


def _cell_quality(quality: wire.CellQuality) -> dict[str, NDArray[np.float64]]:
    names = ("aspect_ratio", "edge_ratio", "scaled_jacobian", "skew")
    return {name: arrays.from_wire(getattr(quality, name)) for name in names}


def status(message: wire.GetStatusResponse) -> Status:
    """The server's status."""
    return Status(
        version=message.version,
        uptime_seconds=message.uptime_seconds,
        all_tenants=message.all_tenants,
        running=message.running,
        queued=message.queued,
        running_limit=message.running_limit,
        queued_limit=message.queued_limit,
        sessions=message.sessions,
        setups_resident=message.setups_resident,
        setups_stored=message.setups_stored,
        stored_bytes=message.stored_bytes,
        setup_cache=_cache(message.setup_cache),
        linearisation_cache=_cache(message.linearisation_cache),
        work=tuple(_work(each) for each in message.work),
    )


def _cache(c: wire.CacheStatus) -> CacheStatus:
    return CacheStatus(c.entries, c.bytes, c.budget_bytes, c.hits, c.misses, c.evictions)


def _work(w: wire.Work) -> Work:
    return Work(
        kind=w.kind,
        tenant=w.tenant,
        setup_id=w.setup_id,
        session_id=w.session_id,
        running=w.running,
        age_seconds=w.age_seconds,
        running_seconds=w.running_seconds,
        stage=w.stage,
        fraction=w.fraction,
    )
