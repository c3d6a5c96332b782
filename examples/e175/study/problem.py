"""The fuel-burn study as an OpenMDAO problem: mesh service, panel service, aircraft, and a driver that can be resumed.

session -> vertices, areas, points -+-------------------------> aircraft -> fuel, lift, moment, ...
                |                                                  |
                +-> panel service -> lift, drag, moment, slopes ---+
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
import openmdao.api as om
from moldline import Session
from moldline.openmdao import DeformedMesh, om_name
from numpy.typing import NDArray

import aircraft
import slsqp
from formulation import FUEL, OBJECTIVE, OBJECTIVE_WEIGHT, Limit

Array = NDArray[np.float64]

#: Results that the study records besides objective and constraints.
RESULTS = (
    *("fuel_weight", "gross_weight", "payload_weight", "empty_weight", "lift", "lift_excess", "pitching_moment"),
    *("wing_loading", "tail_volume", "static_margin", "lift_to_drag", "fuel_fraction", "centre_of_gravity"),
    *("neutral_point", "tail_arm", "wing_area", "wing_aspect_ratio", "tail_area", "tail_aspect_ratio"),
    *("lift_coefficient", "parasite_drag_coefficient", "induced_drag_coefficient"),
)


class Aerodynamics(Protocol):
    """A flow solver: the coefficients of :data:`aircraft.AERODYNAMICS` on the mesh's vertices, and their gradients."""

    def coefficients(self, vertices: Array, alpha: float) -> Array:
        """(6,), at an angle of attack in radians."""

    def gradients(self, vertices: Array, alpha: float) -> tuple[Array, Array]:
        """With respect to the vertices, (6, n, 3), 1/m, and to the angle of attack, (6,), 1/rad."""

    def pressures(self, vertices: Array, alpha: float) -> Array:
        """Pressure coefficient of every cell, for figures."""


class Clock:
    """Seconds spent in each service since it was last read."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}

    def time(self, name: str, call: Callable[[], Any]) -> Any:
        begun = time.perf_counter()
        try:
            return call()
        finally:
            self._seconds[name] = self._seconds.get(name, 0.0) + time.perf_counter() - begun

    def read(self) -> dict[str, float]:
        seconds, self._seconds = self._seconds, {}
        return seconds


class Mesh(DeformedMesh):
    """The mesh service; keeps the quality of the last mesh and the time that it took."""

    def initialize(self) -> None:
        super().initialize()
        self.options.declare("clock", types=Clock, recordable=False)

    def compute(self, inputs: Any, outputs: Any) -> None:
        self.options["clock"].time("mesh", lambda: super(Mesh, self).compute(inputs, outputs))

    def compute_jacvec_product(self, inputs: Any, d_inputs: Any, d_outputs: Any, mode: str) -> None:
        product = super().compute_jacvec_product
        self.options["clock"].time("mesh adjoint", lambda: product(inputs, d_inputs, d_outputs, mode))

    def quality(self) -> dict[str, float]:
        """Of the last mesh."""
        if self._last is None:
            return {}
        total = self._last.quality.total
        return {
            "aspect_ratio_p95": total.aspect_ratio.p95,
            "aspect_ratio_max": total.aspect_ratio.max,
            "above_5_percent": total.aspect_ratio.above_5_percent,
            "min_scaled_jacobian": total.min_scaled_jacobian,
            "folded": total.folded,
            "inverted": total.inverted,
        }


class Flow(om.ExplicitComponent):  # type: ignore[misc]  # OpenMDAO has no types.
    """The panel service: one solution for each design, one adjoint pass for all its outputs."""

    def initialize(self) -> None:
        self.options.declare("aerodynamics", recordable=False)
        self.options.declare("vertices", recordable=False, desc="of the reference mesh")
        self.options.declare("clock", types=Clock, recordable=False)

    def setup(self) -> None:
        self.add_input("vertices", val=self.options["vertices"], units="m")
        self.add_input("angle_of_attack", val=0.0, units="rad")
        for name in aircraft.AERODYNAMICS:
            self.add_output(om_name(name), units=_units(name))
        self.declare_partials("*", "*")

    def compute(self, inputs: Any, outputs: Any) -> None:
        solve = self.options["aerodynamics"].coefficients
        alpha = inputs["angle_of_attack"].item()
        values = self.options["clock"].time("panel", lambda: solve(np.array(inputs["vertices"]), alpha))
        for name, value in zip(aircraft.AERODYNAMICS, values, strict=True):
            outputs[om_name(name)] = value

    def compute_partials(self, inputs: Any, partials: Any) -> None:
        solve = self.options["aerodynamics"].gradients
        alpha = inputs["angle_of_attack"].item()
        by_vertices, by_alpha = self.options["clock"].time(
            "panel adjoint", lambda: solve(np.array(inputs["vertices"]), alpha)
        )
        for row, name in enumerate(aircraft.AERODYNAMICS):
            partials[om_name(name), "vertices"] = by_vertices[row].reshape(1, -1)
            partials[om_name(name), "angle_of_attack"] = by_alpha[row]


class Aircraft(om.ExplicitComponent):  # type: ignore[misc]
    """:func:`aircraft.analyse`, with derivatives by complex steps."""

    def initialize(self) -> None:
        self.options.declare("model", default={}, desc="numbers of aircraft.MODEL to replace")

    def setup(self) -> None:
        for name in aircraft.INPUTS:
            self.add_input(om_name(name), val=0.0 if name == "angle_of_attack" else 1.0, units=_units(name))
        for name in RESULTS:
            self.add_output(name)
        self.declare_partials("*", "*")

    def compute(self, inputs: Any, outputs: Any) -> None:
        results = aircraft.analyse(self._state(inputs), self.options["model"])
        for name in RESULTS:
            outputs[name] = results[name]

    def compute_partials(self, inputs: Any, partials: Any) -> None:
        rows = aircraft.derivatives(self._state(inputs), RESULTS, model=self.options["model"])
        for result, row in rows.items():
            for name, value in zip(aircraft.INPUTS, row, strict=True):
                partials[result, om_name(name)] = value

    @staticmethod
    def _state(inputs: Any) -> dict[str, float]:
        return {name: inputs[om_name(name)].item() for name in aircraft.INPUTS}


def _units(name: str) -> str | None:
    """Of an input of the aircraft."""
    if name == "angle_of_attack":
        return "rad"
    if name in aircraft.AERODYNAMICS and name != "flow.neutral_point":
        return None
    if name.endswith(".volume"):
        return "m**3"
    return "m**2" if name.endswith("area") else "m"


class Study:
    """The OpenMDAO problem on a session and a flow solver. `problem` has its variables and constraints declared, so that any
    OpenMDAO driver can run it; :meth:`run` minimises with :mod:`slsqp`, which records and resumes.

    `limits`: constraints, such as `formulation.PROBLEMS["with"]`. `angle_of_attack`: whether it is a variable too, unlike in
    the paper. `model`: numbers of `aircraft.MODEL` to replace.
    """

    def __init__(
        self,
        session: Session,
        aerodynamics: Aerodynamics,
        limits: Sequence[Limit],
        *,
        angle_of_attack: bool = False,
        model: Mapping[str, float] | None = None,
    ) -> None:
        setup = session.setup
        self.limits = tuple(limits)
        self.model = dict(model or {})
        self.clock = Clock()
        self.mesh = Mesh(session=session, functions=aircraft.GEOMETRY, clock=self.clock)
        self.problem = om.Problem(reports=False)
        group = self.problem.model
        group.add_subsystem("mesh", self.mesh, promotes=["*"])
        flow = Flow(aerodynamics=aerodynamics, vertices=setup.mesh.vertices, clock=self.clock)
        group.add_subsystem("flow", flow, promotes=["*"])
        group.add_subsystem("aircraft", Aircraft(model=self.model), promotes=["*"])

        lower, upper = setup.bounds
        #: Names of the mesh service's variables in OpenMDAO, and their entries in a design.
        self._entries = {om_name(each.name): each.entries for each in setup.groups.values()}
        #: By name: lower and upper bound, value that is scaled to 0, change that is scaled to 1.
        self._variables = {
            name: (lower[at], upper[at], setup.baseline[at], (upper[at] - lower[at]) / 2)
            for name, at in self._entries.items()
        }
        if angle_of_attack:
            bound, reach = (np.array([value]) for value in ANGLE_OF_ATTACK)
            self._variables["angle_of_attack"] = (-bound, bound, np.zeros(1), reach)
        for name, (low, high, zero, reach) in self._variables.items():
            group.add_design_var(name, lower=low, upper=high, ref0=zero, ref=zero + reach)
        group.add_objective(OBJECTIVE, ref=FUEL)
        for limit in self.limits:
            low, high = limit.lower * limit.scale, limit.upper * limit.scale
            sides = {"lower": low, "upper": high} if np.isfinite(high) else {"lower": low}
            group.add_constraint(limit.result, ref=limit.scale, **({"equals": low} if low == high else sides))
        self.problem.setup(mode="rev")

    def notes(self) -> dict[str, Any]:
        """Seconds in the services since the last call, and notes about the present design."""
        design = np.empty(sum(at.stop - at.start for at in self._entries.values()))
        for name, at in self._entries.items():
            design[at] = self.problem.get_val(name).ravel()
        return {
            "service_seconds": self.clock.read(),
            "quality": self.mesh.quality(),
            "design": design.tolist(),
            "angle_of_attack": self.problem.get_val("angle_of_attack").item(),
            "results": {name: self.problem.get_val(name).item() for name in RESULTS},
            "state": {name: self.problem.get_val(om_name(name)).item() for name in aircraft.INPUTS},
        }

    def get_variables(self) -> dict[str, Any]:
        """By name, as lists of numbers that come back with the same bits."""
        return {name: self.problem.get_val(name).tolist() for name in self._variables}

    def set_variables(self, values: Mapping[str, Any]) -> None:
        """Sets the variables to a result of :meth:`get_variables`."""
        for name, value in values.items():
            self.problem.set_val(name, np.array(value))

    def trim(self, *, tolerance: float = 1e-9, steps: int = 12) -> None:
        """Turns the whole wing (all twists by as much) and the tail until lift is weight and the moment is zero.

        With the angle of attack in place of the twists, if that is a variable. Newton's method with the exact derivatives.
        """
        wrt, of = [self._trimmed_by, "htail:rotation"], list(TRIM)
        scales = {limit.result: limit.scale for limit in self.limits}
        for _ in range(steps):
            self.problem.run_model()
            residuals = np.array([self.problem.get_val(name).item() / scales[name] for name in of])
            if np.abs(residuals).max() <= tolerance:
                return
            totals = self.problem.compute_totals(of, wrt)
            matrix = np.array([[totals[name, by].sum() / scales[name] for by in wrt] for name in of])
            for by, step in zip(wrt, np.linalg.solve(matrix, -residuals), strict=True):
                self.problem.set_val(by, self.problem.get_val(by) + step)
        raise RuntimeError(f"the aircraft cannot be trimmed after {steps} steps; residuals {residuals}")

    def trim_multipliers(self, iterate: slsqp.Iterate) -> Array:
        """Change of the objective for a unit of each constraint, all scaled, with the aircraft kept in trim (:meth:`trim`);
        zero for constraints that do not concern trim."""
        names = [limit.result for limit in self.limits]
        rows = [names.index(name) for name in TRIM]
        starts = np.cumsum([0, *(len(zero) for _, _, zero, _ in self._variables.values())])
        entries = dict(zip(self._variables, pairwise(starts), strict=False))
        columns = [slice(*entries[name]) for name in (self._trimmed_by, "htail:rotation")]
        matrix = np.array([[iterate.jacobian[row, at].sum() for at in columns] for row in rows])
        multipliers = np.zeros(len(names))
        multipliers[rows] = np.linalg.solve(matrix.T, [iterate.gradient[at].sum() for at in columns])
        return multipliers

    @property
    def _trimmed_by(self) -> str:
        return "angle_of_attack" if "angle_of_attack" in self._variables else "wing:twist"

    def run(self, **settings: Any) -> slsqp.Outcome:
        """Minimises the fuel from the present design on; `settings` of :func:`slsqp.minimise`."""
        low, high, zero, reach = (np.concatenate(each) for each in zip(*self._variables.values(), strict=True))
        constraints = [slsqp.Constraint(limit.result, limit.lower, limit.upper) for limit in self.limits]
        start = np.concatenate([self.problem.get_val(name).ravel() for name in self._variables])
        bounds = ((low - zero) / reach, (high - zero) / reach)
        return slsqp.minimise(self, (start - zero) / reach, *bounds, constraints, weight=OBJECTIVE_WEIGHT, **settings)

    def values(self, x: Array) -> tuple[float, Array, dict[str, Any]]:
        """Of :class:`slsqp.Functions`."""
        ends = np.cumsum([len(zero) for _, _, zero, _ in self._variables.values()])[:-1]
        for (name, (_, _, zero, reach)), part in zip(self._variables.items(), np.split(x, ends), strict=True):
            self.problem.set_val(name, (zero + part * reach).reshape(self.problem.get_val(name).shape))
        self.problem.run_model()
        self._at = x.tobytes()
        constraints = [self.problem.get_val(limit.result).item() / limit.scale for limit in self.limits]
        return self.problem.get_val(OBJECTIVE).item() / FUEL, np.array(constraints), self.notes()

    def derivatives(self, x: Array) -> tuple[Array, Array, dict[str, Any]]:
        """Of :class:`slsqp.Functions`."""
        if self._at != x.tobytes():
            self.values(x)
        of = [OBJECTIVE, *(limit.result for limit in self.limits)]
        totals = self.problem.compute_totals(of, list(self._variables), return_format="array")
        scales = np.array([FUEL, *(limit.scale for limit in self.limits)])
        reach = np.concatenate([reach for *_, reach in self._variables.values()])
        scaled = totals * reach / scales[:, np.newaxis]
        return scaled[0], scaled[1:], {"service_seconds": self.clock.read()}

    #: The point at which the model was evaluated last.
    _at = b""


#: Residuals of trim.
TRIM = ("lift_excess", "pitching_moment")
#: Bound of the angle of attack where it is a variable, and the change that is scaled to 1, rad.
ANGLE_OF_ATTACK = (np.radians(8.0), np.radians(5.0))
