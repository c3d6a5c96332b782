"""Operations of the panel service: generators of calls, which :mod:`moldline.panel.client` runs by blocking and
:mod:`moldline.panel.aio` by awaiting."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from moldline import arrays
from moldline.calls import Blocks, Call, Operation, seconds, streamed
from moldline.errors import InternalError, NotFound
from moldline.panel import convert
from moldline.panel.facts import ConfigurationFacts
from moldline.panel.model import (
    COEFFICIENTS,
    Analysis,
    AnalysisPoint,
    At,
    FlowGradients,
    FlowTangents,
    OnDoubt,
    Reference,
    Solver,
    Symmetry,
    TrailingEdges,
)
from moldline.progress import Tell
from moldline.v1 import panel_service_pb2 as wire

T = TypeVar("T")

#: Inputs by name, with the axes of one vector.
_INPUTS = {name: {"vertices": 2, "point": 1}.get(name, 0) for name in wire.FlowInputs.DESCRIPTOR.fields_by_name}


def configuration_request(
    vertices: ArrayLike,
    cells: ArrayLike,
    cell_groups: Mapping[str, ArrayLike] | None,
    vertex_groups: Mapping[str, ArrayLike] | None,
    symmetry: Symmetry | None,
    trailing_edges: TrailingEdges | None,
    components: Iterable[str] | None,
    solver: Solver | None,
    tolerance: float | None,
    merge_tolerance: float | None,
    on_doubt: OnDoubt | None,
) -> wire.CreateConfigurationRequest:
    """The request that creates a configuration, and creates it again if the server has dropped it."""
    request = wire.CreateConfigurationRequest()
    arrays.write(vertices, request.vertices)
    convert.write_indices(cells, request.cells)
    for groups, target in ((cell_groups, request.cell_groups), (vertex_groups, request.vertex_groups)):
        for name, indices in (groups or {}).items():
            convert.write_indices(indices, target.add(name=name).indices)
    options = request.options
    options.SetInParent()
    if symmetry is not None:
        options.symmetry = convert.enumerator(wire.PanelSymmetry, "PANEL_SYMMETRY_", symmetry)
    if trailing_edges is not None:
        convert.write_trailing_edges(trailing_edges, options.trailing_edges)
    if components is not None:
        options.components.names.extend(components)
        options.components.SetInParent()
    if solver is not None:
        options.solver = convert.enumerator(wire.PanelSolver, "PANEL_SOLVER_", solver)
    if tolerance is not None:
        options.tolerance = tolerance
    if merge_tolerance is not None:
        options.merge_tolerance = merge_tolerance
    if on_doubt is not None:
        options.on_doubt = convert.enumerator(wire.PanelOnDoubt, "PANEL_ON_DOUBT_", on_doubt)
    return request


def create(request: wire.CreateConfigurationRequest) -> Operation[wire.Configuration]:
    """Creates a configuration."""
    response: wire.CreateConfigurationResponse = yield Call("CreateConfiguration", request)
    return response.configuration


def get(configuration_id: str) -> Operation[wire.Configuration]:
    """Description of a configuration."""
    response: wire.GetConfigurationResponse = yield Call(
        "GetConfiguration", wire.GetConfigurationRequest(configuration_id=configuration_id)
    )
    return response.configuration


def sweep(
    configuration: ConfigurationFacts,
    alphas: Sequence[float],
    vertices: ArrayLike | None,
    reference: Reference,
    mach: float,
    sideslip: float | Sequence[float],
    pressures: bool,
    tell: Tell,
) -> Operation[list[Analysis]]:
    """The flow in several winds."""
    # A copy, which later changes by the caller do not affect.
    copied = None if vertices is None else np.array(vertices, dtype=np.float64)
    winds = np.broadcast(alphas, sideslip)
    points = [AnalysisPoint(copied, mach, float(alpha), float(sideslip), reference) for alpha, sideslip in winds]
    request = wire.AnalyzeRequest(configuration_id=configuration.id, mach=mach, without_pressures=not pressures)
    if copied is not None:
        arrays.write(copied, request.vertices)
    for point in points:
        request.flows.add(alpha=point.alpha, sideslip=point.sideslip)
    convert.write_reference(reference, request.reference)
    answer = yield from _again(partial(streamed, "Analyze", request, "analysis", tell), configuration)
    if len(answer.flows) != len(points):
        raise InternalError("the server's answer lacks an analysis for each wind")
    return [convert.analysis(answer, flow, point) for flow, point in zip(answer.flows, points)]


def jvp(
    configuration: ConfigurationFacts, directions: Mapping[str, ArrayLike | None], at: At
) -> Operation[FlowTangents]:
    """`J v`, piece after piece."""
    blocks = _blocks(configuration)
    for name, block in directions.items():
        blocks.add(name, block, _INPUTS[name])
    parts = []
    for piece in blocks.pieces():
        request = wire.PanelServiceApplyJacobianVectorRequest(
            configuration_id=configuration.id, at=convert.at_to_wire(at)
        )
        for name, block in piece.items():
            arrays.write(block, getattr(request.directions, name))
        parts.append((yield from _again(partial(_call, "ApplyJacobianVector", request), configuration)))
    coefficients = blocks.joined(part.changes.coefficients for part in parts)
    return FlowTangents(
        coefficients={name: coefficients[..., index] for index, name in enumerate(COEFFICIENTS)},
        section_loads=blocks.joined(part.changes.section_loads for part in parts),
        cp=blocks.joined(part.changes.cp for part in parts),
        **seconds(parts),
    )


def vjp(
    configuration: ConfigurationFacts,
    coefficients: Mapping[str, ArrayLike] | ArrayLike | None,
    section_loads: ArrayLike | None,
    cp: ArrayLike | None,
    at: At,
) -> Operation[FlowGradients]:
    """`J^T w`, piece after piece."""
    blocks = _blocks(configuration)
    weights = convert.weights(coefficients) if isinstance(coefficients, Mapping) else coefficients
    for name, seeds in (("coefficients", weights), ("section_loads", section_loads), ("cp", cp)):
        blocks.add(name, seeds, 1)
    parts = []
    for piece in blocks.pieces():
        request = wire.PanelServiceApplyAdjointRequest(configuration_id=configuration.id, at=convert.at_to_wire(at))
        for name, block in piece.items():
            arrays.write(block, getattr(request.seeds, name))
        parts.append((yield from _again(partial(_call, "ApplyAdjoint", request), configuration)))
    gradients: dict[str, Any] = {
        name: blocks.joined(getattr(part.gradients, name) for part in parts) for name in _INPUTS
    }
    return FlowGradients(**gradients, **seconds(parts))


def _blocks(configuration: ConfigurationFacts) -> Blocks:
    return Blocks(max(configuration.vertex_count, configuration.cell_count))


def _call(method: str, request: Any) -> Operation[Any]:
    return (yield Call(method, request))


def _again(operation: Callable[[], Operation[T]], configuration: ConfigurationFacts) -> Operation[T]:
    """An operation, which is repeated if the server has dropped the configuration and is sent it again."""
    try:
        return (yield from operation())
    except NotFound as error:
        dropped = any(violation.field == "configuration_id" for violation in error.violations)
        if configuration._request is None or not dropped:
            raise
    created = yield from create(configuration._request)
    if created.configuration_id != configuration.id:
        raise InternalError("the server gives the same configuration another id")
    return (yield from operation())
