"""Operations of the mesh service: generators of calls, which :mod:`moldline.client` runs by blocking and
:mod:`moldline.aio` by awaiting."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline import arrays, convert, upload
from moldline.calls import Blocks, Call, Operation, seconds, streamed
from moldline.check import Check, check_from_wire
from moldline.designs import Design
from moldline.errors import InternalError, NotFound
from moldline.facts import SetupFacts
from moldline.mesh import Mesh
from moldline.model import (
    At,
    Deformation,
    DesignPoint,
    Gradients,
    Jacobian,
    Linearisation,
    Progress,
    SessionState,
    SetupAccess,
    SetupSummary,
    Status,
    Tangents,
    Visibility,
)
from moldline.progress import Tell
from moldline.v1 import mesh_service_pb2 as wire


def create_setup(
    path: str | os.PathLike[str],
    setup_file: str,
    request_id: str | None,
    visibility: Visibility | None,
    shared_with: Iterable[str],
    tell: Tell,
) -> Operation[wire.CreatedSetup]:
    """Uploads and builds a set-up."""
    header = wire.SetupHeader(request_id=_request_id(request_id), setup_file=setup_file)
    convert.write_sharing(visibility, shared_with, header)
    files = upload.files(path, header)
    created: wire.CreatedSetup = yield from streamed(
        "CreateSetup", lambda: upload.messages(header, files), "created", tell
    )
    return created


def get_setup(setup_id: str) -> Operation[wire.SetupDescription]:
    """Description of a set-up."""
    response: wire.GetSetupResponse = yield Call("GetSetup", wire.GetSetupRequest(setup_id=setup_id))
    return response.setup


def mesh(setup: SetupFacts) -> Operation[Mesh]:
    """The reference mesh."""
    response = yield Call("GetSetup", wire.GetSetupRequest(setup_id=setup.id, include_mesh=True))
    return convert.mesh(response.mesh, setup.components)


def control_points(setup: SetupFacts) -> Operation[dict[str, NDArray[np.float64]]]:
    """Control points of the baseline."""
    response = yield Call("GetSetup", wire.GetSetupRequest(setup_id=setup.id, include_control_points=True))
    return convert.control_points(response.control_points)


def list_setups() -> Operation[list[SetupSummary]]:
    """The set-ups of all pages."""
    setups: list[SetupSummary] = []
    request = wire.ListSetupsRequest()
    while True:
        page = yield Call("ListSetups", request)
        setups += map(convert.setup_summary, page.setups)
        if not page.next_page_token:
            return setups
        request = wire.ListSetupsRequest(page_token=page.next_page_token)


def share_setup(setup_id: str, visibility: Visibility, shared_with: Iterable[str]) -> Operation[SetupAccess]:
    """Changes who else may use a set-up."""
    request = wire.ShareSetupRequest(setup_id=setup_id)
    convert.write_sharing(visibility, shared_with, request)
    response = yield Call("ShareSetup", request)
    return convert.access(response.access)


def delete_setup(setup_id: str) -> Operation[None]:
    """Gives up a set-up; idempotent."""
    yield from _gone(Call("DeleteSetup", wire.DeleteSetupRequest(setup_id=setup_id)))


def check(
    setup: SetupFacts,
    designs: int,
    design: Design,
    variables: Iterable[str],
    seed: int,
    tell: Tell,
) -> Operation[Check]:
    """Checks the derivatives of a set-up."""
    request = wire.CheckRequest(setup_id=setup.id, seed=seed, variables=variables)
    if design is None:
        request.designs = designs
    else:
        convert.write_point(setup.point(design), request)
    report = yield from streamed("Check", request, "report", tell)
    return check_from_wire(report, tuple(variable.name for variable in setup.variables))


def open_session(setup_id: str, label: str, request_id: str | None) -> Operation[SessionState]:
    """Opens a session."""
    request = wire.OpenSessionRequest(setup_id=setup_id, label=label, request_id=_request_id(request_id))
    response = yield Call("OpenSession", request)
    return convert.session_state(response.session)


def get_session(session_id: str) -> Operation[SessionState]:
    """State of a session."""
    response = yield Call("GetSession", wire.GetSessionRequest(session_id=session_id))
    return convert.session_state(response.session)


def resume(session_id: str) -> Operation[tuple[SessionState, wire.SetupDescription]]:
    """State of a session, and description of its set-up."""
    state = yield from get_session(session_id)
    return state, (yield from get_setup(state.setup_id))


def list_sessions() -> Operation[list[SessionState]]:
    """The sessions of all pages."""
    sessions: list[SessionState] = []
    request = wire.ListSessionsRequest()
    while True:
        page = yield Call("ListSessions", request)
        sessions += map(convert.session_state, page.sessions)
        if not page.next_page_token:
            return sessions
        request = wire.ListSessionsRequest(page_token=page.next_page_token)


def update_session(
    setup: SetupFacts,
    state: SessionState,
    design: Design,
    points: Mapping[str, ArrayLike] | None,
    label: str | None,
) -> Operation[SessionState]:
    """Stores design and label on top of the generation of `state`."""
    request = wire.UpdateSessionRequest(
        session_id=state.id, expected_generation=state.generation, label=label, request_id=_request_id(None)
    )
    if design is not None or points is not None:
        request.design.SetInParent()
        convert.write_point(setup.point(design, points), request.design)
    response = yield Call("UpdateSession", request)
    return convert.session_state(response.session)


def close_session(session_id: str) -> Operation[None]:
    """Closes a session; idempotent."""
    yield from _gone(Call("CloseSession", wire.CloseSessionRequest(session_id=session_id)))


def status() -> Operation[Status]:
    """Status of the server."""
    response = yield Call("GetStatus", wire.GetStatusRequest())
    return convert.status(response)


def deform(
    setup: SetupFacts,
    session_id: str,
    design: Design,
    points: Mapping[str, ArrayLike] | None,
    cell_quality: bool,
) -> Operation[Deformation]:
    """The mesh at a design."""
    point = setup.point(design, points)
    request = wire.DeformRequest(session_id=session_id, include_cell_quality=cell_quality)
    convert.write_point(point, request)
    response = yield Call("Deform", request)
    return convert.deformation(response, point, setup.functions)


def jvp(
    setup: SetupFacts,
    session_id: str,
    directions: ArrayLike | None,
    points: Mapping[str, ArrayLike] | None,
    at: At,
) -> Operation[Tangents]:
    """`J v`, piece after piece."""
    blocks = Blocks(_points(setup))
    blocks.add("directions", directions, 1)
    points = points or {}
    for component, vectors in points.items():
        blocks.add(f"control_points[{component!r}]", vectors, 2)
    parts = []
    for piece in blocks.pieces():
        request = wire.ApplyJacobianVectorRequest(session_id=session_id, at=_at(setup, at))
        if directions is not None:
            arrays.write(piece["directions"], request.design)
        for component in points:
            vectors = piece[f"control_points[{component!r}]"]
            arrays.write(vectors, request.control_points.add(component=component).vectors)
        parts.append((yield Call("ApplyJacobianVector", request)))
    vertices = blocks.joined(part.vertices for part in parts)
    functions = blocks.joined(part.functions for part in parts)
    return Tangents(vertices, setup.by_function(functions), **seconds(parts))


def vjp(
    setup: SetupFacts,
    session_id: str,
    vertices: ArrayLike | None,
    functions: Mapping[str, ArrayLike] | ArrayLike | None,
    at: At,
    design: bool,
    control_points: Iterable[str],
) -> Operation[Gradients]:
    """`J^T w`, piece after piece."""
    blocks = Blocks(_points(setup))
    blocks.add("vertices", vertices, 2)
    blocks.add("functions", setup.weights(functions) if isinstance(functions, Mapping) else functions, 1)
    control_points = list(control_points)
    parts = []
    for piece in blocks.pieces():
        request = wire.ApplyAdjointRequest(
            session_id=session_id, at=_at(setup, at), include_design=design, control_points_of=control_points
        )
        for name, block in piece.items():
            arrays.write(block, getattr(request, name))
        parts.append((yield Call("ApplyAdjoint", request)))
    by_component = {
        component: blocks.joined(part.control_points[index].vectors for part in parts)
        for index, component in enumerate(control_points)
    }
    by_design = blocks.joined(part.design for part in parts) if design else None
    return Gradients(by_design, by_component, **seconds(parts))


def jacobian(setup: SetupFacts, session_id: str, at: At, tell: Tell) -> Operation[Jacobian]:
    """The Jacobian, its columns received into one array."""
    shape = (len(setup.variables), setup.vertex_count, 3)
    vertices = np.empty(shape)
    functions = np.empty((shape[0], len(setup.functions)))
    received = np.zeros(shape[0], dtype=bool)
    parts: list[wire.JacobianResponse] = []

    def receive(part: wire.JacobianResponse) -> None:
        columns = slice(part.first, part.first + part.vertices.shape[0])
        vertices[columns] = arrays.from_wire(part.vertices)
        functions[columns] = arrays.from_wire(part.functions)
        received[columns] = True
        # Releases the arrays, which have been copied.
        part.ClearField("vertices")
        part.ClearField("functions")
        parts.append(part)
        tell(Progress("jacobian", columns.stop / part.columns, f"column {columns.stop} of {part.columns}"))

    def receiver() -> Callable[[wire.JacobianResponse], None]:
        received[:] = False
        parts.clear()
        return receive

    yield Call("Jacobian", wire.JacobianRequest(session_id=session_id, at=_at(setup, at)), receiver)
    if not received.all():
        raise InternalError("the server ended before the last column")
    return Jacobian(vertices, setup.by_function(functions), **seconds(parts))


def _points(setup: SetupFacts) -> int:
    return setup.vertex_count + sum(setup.control_point_counts.values())


def _request_id(given: str | None) -> str:
    return uuid.uuid4().hex if given is None else given


def _gone(call: Call) -> Operation[None]:
    """Ignores that there is nothing to remove: an earlier attempt whose answer was lost may have removed it."""
    with suppress(NotFound):
        yield call


def _at(setup: SetupFacts, at: At) -> wire.LinearisationPoint:
    """The id, if any, and the design, from which the server recomputes a linearisation that it no longer holds."""
    point = wire.LinearisationPoint()
    if isinstance(at, Deformation):
        at = at.linearisation
    if isinstance(at, str):
        point.linearisation_id = at
        return point
    if isinstance(at, Linearisation):
        point.linearisation_id = at.id
        at = at.point
    point.design_point.SetInParent()
    given = setup.point(at.design, at.control_points) if isinstance(at, DesignPoint) else setup.point(at)
    convert.write_point(given, point.design_point)
    return point
