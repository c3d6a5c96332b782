"""Conversions between messages of the protocol and :mod:`moldline.panel.model`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from moldline import arrays
from moldline.panel.model import (
    COEFFICIENTS,
    Analysis,
    AnalysisPoint,
    Angle,
    Array,
    At,
    Coefficients,
    Edges,
    Groups,
    LineLeftOut,
    Loads,
    Reference,
    Sections,
    TrailingEdges,
    Warning,
)
from moldline.v1 import array_pb2
from moldline.v1 import panel_service_pb2 as wire


def enumerator(enumeration: Any, prefix: str, word: str) -> Any:
    """The value of an enumeration for a word."""
    values = {name.removeprefix(prefix).lower(): value for name, value in enumeration.items() if value}
    if word not in values:
        raise ValueError(f"{word!r} is not one of {', '.join(values)}")
    return values[word]


def solver(value: int) -> str:
    """The word for a solver."""
    name: str = wire.PanelSolver.Name(value)
    return name.removeprefix("PANEL_SOLVER_").lower() if value else "automatic"


def write_trailing_edges(edges: TrailingEdges, message: wire.TrailingEdges) -> None:
    """Writes the rule that finds trailing edges."""
    if isinstance(edges, Groups):
        message.groups.SetInParent()
        message.groups.names.extend(edges.names)
    elif isinstance(edges, Edges):
        write_indices(edges.pairs, message.edges)
    elif isinstance(edges, Angle):
        message.angle = edges.degrees
    elif edges == "none":
        message.none.SetInParent()
    else:
        raise ValueError(f'trailing edges are Groups, Edges, Angle or "none", not {edges!r}')


def write_indices(values: ArrayLike, message: array_pb2.Array) -> None:
    """Writes `values` as uint32 of the same shape."""
    indices = np.asarray(values)
    # As unsigned integers, negative ones would look like large ones.
    if indices.size and (not np.issubdtype(indices.dtype, np.integer) or indices.min() < 0):
        raise ValueError("indices must be integers that are not negative")
    message.dtype = array_pb2.DATA_TYPE_UINT32
    message.shape.extend(indices.shape)
    message.data = np.ascontiguousarray(indices, dtype="<u4").tobytes()


def write_reference(reference: Reference, message: wire.FlowReference) -> None:
    """Writes reference values."""
    message.area, message.chord, message.span = reference.area, reference.chord, reference.span
    message.point.extend(reference.point)


def at_to_wire(at: At) -> wire.AnalysisPoint:
    """The id, if any, and the vertices and flow, from which the server solves again what it no longer holds."""
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
    write_reference(point.reference, message.reference)
    return message


def weights(named: Mapping[str, ArrayLike]) -> Array:
    """Weights of coefficients by name as one block, (9,) or (k, 9)."""
    unknown = [name for name in named if name not in COEFFICIENTS]
    if unknown:
        raise ValueError(f"there is no coefficient {unknown[0]!r}; there are: {', '.join(COEFFICIENTS)}")
    columns = np.broadcast_arrays(*(np.asarray(named.get(name, 0.0), dtype=np.float64) for name in COEFFICIENTS))
    return np.stack(columns, axis=-1)


def analysis(answer: wire.Analysis, flow: wire.FlowAnalysis, point: AnalysisPoint) -> Analysis:
    """The flow of an answer at the requested point."""
    sections = flow.sections
    nothing = np.empty(0)
    return Analysis(
        id=answer.analysis_id,
        point=point,
        coefficients=Coefficients(*(getattr(flow.coefficients, name) for name in COEFFICIENTS)),
        wake_lift=flow.wake_lift,
        disagreement=flow.disagreement,
        warnings=warnings(flow.warnings),
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


def warnings(messages: Iterable[wire.PanelWarning]) -> tuple[Warning, ...]:
    """Reasons to doubt."""
    return tuple(Warning(message.kind, message.text) for message in messages)


def left_out(message: wire.LineLeftOut) -> LineLeftOut:
    """A line of edges that is no trailing edge."""
    return LineLeftOut(
        arrays.from_wire(message.vertices), message.length, message.width, message.turn, message.reason
    )


def _loads(message: wire.Loads) -> Loads:
    return Loads(np.array(message.force), np.array(message.moment), message.lift, message.drag)
