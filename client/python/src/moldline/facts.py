"""Descriptions of set-ups and sessions, known without another call."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline import convert, designs, display
from moldline.designs import Design
from moldline.model import DesignPoint, Function, SessionState, SetupAccess, Variable, VariableGroup
from moldline.v1 import mesh_service_pb2 as wire


class SetupFacts:
    """Description of a set-up."""

    def __init__(self, description: wire.SetupDescription, *, built: bool) -> None:
        #: Hash of its content.
        self.id: str = description.setup_id
        #: Whether the call that returned this created the set-up for the caller.
        self.built = built
        #: Title given by its author.
        self.name: str = description.name
        #: Who may use it.
        self.access: SetupAccess = convert.access(description.access)
        #: Report of the build, as text and as parsed JSON.
        self.report_text: str = description.report_text
        self.report: dict[str, Any] = json.loads(description.report_json)
        #: Design variables, in the order of a design's entries.
        self.variables: tuple[Variable, ...] = tuple(
            Variable(v.name, v.unit, v.baseline, v.lower, v.upper) for v in description.variables
        )
        #: Declared variables by name.
        self.groups: dict[str, VariableGroup] = {group.name: _group(group) for group in description.groups}
        #: Names of the components.
        self.components: tuple[str, ...] = tuple(description.components)
        #: Number of control points of each component.
        self.control_point_counts: dict[str, int] = dict(
            zip(self.components, description.control_point_counts, strict=True)
        )
        #: The scalar outputs besides the vertices.
        self.functions: tuple[Function, ...] = tuple(Function(f.name, f.unit, f.value) for f in description.functions)
        self.vertex_count: int = description.vertex_count
        self.cell_count: int = description.cell_count
        #: Cells of closed pieces that pointed inwards and were turned.
        self.turned_cell_count: int = description.turned_cell_count
        #: Parts of the mesh file that are not in the mesh: `nodes` without cells, `merged_nodes`, `other_cells` than
        #: triangles and quadrilaterals, `collapsed_cells`.
        self.left_out: dict[str, int] = {
            field.name: getattr(description.left_out, field.name) for field in wire.LeftOut.DESCRIPTOR.fields
        }
        #: Seconds that the engine took to build it.
        self.build_seconds: float = description.build_seconds

    def __getstate__(self) -> dict[str, Any]:
        """What goes to other processes: the arrays are fetched again there."""
        return {name: value for name, value in vars(self).items() if name not in ("mesh", "control_points")}

    @property
    def baseline(self) -> NDArray[np.float64]:
        """float64, (number of variables): the design of the reference geometry."""
        return np.array([variable.baseline for variable in self.variables])

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper bounds, float64, (number of variables) each; may be infinite."""
        lower = np.array([variable.lower for variable in self.variables])
        return lower, np.array([variable.upper for variable in self.variables])

    def point(self, design: Design, control_points: Mapping[str, ArrayLike] | None = None) -> DesignPoint:
        """A design with copies of its arrays, which later changes by the caller do not affect; groups become variables.

        Raises `ValueError` as :func:`moldline.designs.normalised`.
        """
        copies = {component: np.array(each, dtype=np.float64) for component, each in (control_points or {}).items()}
        return DesignPoint(designs.normalised(self, design), copies or None)

    def by_function(self, values: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """The columns of `values`, (..., number of functions), by name."""
        return {function.name: values[..., index] for index, function in enumerate(self.functions)}

    def weights(self, weights: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        """Weights by name, each a number or (k,), as one array, (number of functions,) or (k, number of functions)."""
        names = [function.name for function in self.functions]
        if unknown := sorted(set(weights) - set(names)):
            raise ValueError(f"there is no function {', '.join(unknown)}; there are: {', '.join(names)}")
        given = np.broadcast_arrays(*(np.asarray(weight, dtype=np.float64) for weight in weights.values()))
        all_weights = np.zeros((*(given[0].shape if given else ()), len(names)))
        for name, weight in zip(weights, given, strict=True):
            all_weights[..., names.index(name)] = weight
        return all_weights

    def __repr__(self) -> str:
        sizes = f"{self.vertex_count} vertices, {self.cell_count} cells, {len(self.variables)} variables"
        return f"<{type(self).__name__} {self.name!r} {self.id[:12]}: {sizes}>"

    def _repr_html_(self) -> str:
        title = f"{self.name or 'Set-up'}: {self.vertex_count} vertices, {self.cell_count} cells"
        variables = [(v.name, v.baseline, v.lower, v.upper, v.unit) for v in self.variables]
        functions = [(f.name, f.value, f.unit) for f in self.functions]
        return display.table(title, ("variable", "baseline", "lower", "upper", "unit"), variables) + display.table(
            "Functions", ("function", "baseline", "unit"), functions
        )


def _group(group: wire.VariableGroup) -> VariableGroup:
    shape = tuple(group.shape)
    return VariableGroup(group.name, slice(group.first, group.first + int(np.prod(shape))), shape)


class SessionFacts:
    """State of a session, as of the last opening, resumption, update or refresh here."""

    def __init__(self, state: SessionState) -> None:
        #: The stored state.
        self.state = state

    @property
    def id(self) -> str:
        """Id of the session."""
        return self.state.id

    @property
    def label(self) -> str:
        """Descriptive label."""
        return self.state.label

    @property
    def generation(self) -> int:
        """Number of updates."""
        return self.state.generation

    @property
    def design(self) -> DesignPoint:
        """The design that was stored last."""
        return self.state.design or DesignPoint()

    @property
    def updated(self) -> datetime:
        """Time of the last update, UTC."""
        return self.state.updated

    def __repr__(self) -> str:
        label = f" {self.label!r}" if self.label else ""
        return f"<{type(self).__name__} {self.id}{label} of set-up {self.state.setup_id[:12]}: generation {self.generation}>"

    def _repr_html_(self) -> str:
        state = self.state
        rows = [
            ("label", state.label),
            ("set-up", state.setup_id[:12]),
            ("generation", state.generation),
            ("opened", f"{state.created:%Y-%m-%d %H:%M:%S} UTC"),
            ("updated", f"{state.updated:%Y-%m-%d %H:%M:%S} UTC"),
        ]
        return display.table(f"Session {state.id}", ("", ""), rows)
