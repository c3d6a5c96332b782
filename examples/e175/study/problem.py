"""The fuel-burn study as an OpenMDAO problem: mesh service, panel service, aircraft, and a driver that can be resumed.

    session -> vertices, areas, points -+-------------------------> aircraft -> fuel, lift, moment, ...
                    |                                                  |
                    +-> panel service -> lift, drag, moment, slopes ---+
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol

import aircraft
import numpy as np
import openmdao.api as om
import slsqp
from formulation import FUEL, OBJECTIVE, Limit
from moldline import Session
from moldline.openmdao import DeformedMesh, om_name
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: What the study follows of the aircraft besides objective and constraints.
RESULTS = (
    *("fuel_weight", "gross_weight", "payload_weight", "empty_weight", "lift", "lift_excess", "pitching_moment"),
    *("wing_loading", "tail_volume", "static_margin", "lift_to_drag", "fuel_fraction", "centre_of_gravity"),
    *("neutral_point", "tail_arm", "wing_area", "wing_aspect_ratio", "tail_area", "tail_aspect_ratio"),
    *("lift_coefficient", "parasite_drag_coefficient", "induced_drag_coefficient"),
)


class Aerodynamics(Protocol):
    """A flow solver: coefficients of :data:`aircraft.AERODYNAMICS` on the mesh's vertices, and their gradients."""

    def coefficients(self, vertices: Array, alpha: float) -> Array:
        """(5,), at an angle of attack in radians."""

    def gradients(self, vertices: Array, alpha: float) -> tuple[Array, Array]:
        """By the vertices, (5, n, 3), per metre, and by the angle of attack, (5,), per radian."""


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
    """The panel service: one solution a design, one adjoint pass for all its outputs."""

    def initialize(self) -> None:
        self.options.declare("aerodynamics", recordable=False)
        self.options.declare("vertices", recordable=False, desc="of the reference mesh")
        self.options.declare("clock", types=Clock, recordable=False)

    def setup(self) -> None:
        self.add_input("vertices", val=self.options["vertices"], units="m")
        self.add_input("angle_of_attack", val=0.0, units="rad")
        for name in aircraft.AERODYNAMICS:
            self.add_output(name)
        self.declare_partials("*", "*")

    def compute(self, inputs: Any, outputs: Any) -> None:
        solve = self.options["aerodynamics"].coefficients
        alpha = inputs["angle_of_attack"].item()
        values = self.options["clock"].time("panel", lambda: solve(np.array(inputs["vertices"]), alpha))
        for name, value in zip(aircraft.AERODYNAMICS, values, strict=True):
            outputs[name] = value

    def compute_partials(self, inputs: Any, partials: Any) -> None:
        solve = self.options["aerodynamics"].gradients
        alpha = inputs["angle_of_attack"].item()
        by_vertices, by_alpha = self.options["clock"].time(
            "panel adjoint", lambda: solve(np.array(inputs["vertices"]), alpha)
        )
        for row, name in enumerate(aircraft.AERODYNAMICS):
            partials[name, "vertices"] = by_vertices[row].reshape(1, -1)
            partials[name, "angle_of_attack"] = by_alpha[row]


class Aircraft(om.ExplicitComponent):  # type: ignore[misc]
    """:func:`aircraft.analyse`, with derivatives by complex steps."""

    def initialize(self) -> None:
        self.options.declare("model", default={}, desc="numbers of aircraft.MODEL to replace")

    def setup(self) -> None:
        for name in aircraft.INPUTS:
            units = None if name in aircraft.AERODYNAMICS else _units(name)
            self.add_input(om_name(name), units=units)
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


def _units(name: str) -> str:
    if name.endswith(".volume"):
        return "m**3"
    return "m**2" if name.endswith("area") else "m"


class SLSQP(om.Driver):  # type: ignore[misc]
    """:func:`slsqp.minimise` as an OpenMDAO driver: it records, resumes and tells how far it is."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        for kind in ("optimization", "inequality_constraints", "equality_constraints", "two_sided_constraints", "gradients"):
            self.supports[kind] = True
        #: Keyword arguments of :func:`slsqp.minimise`.
        self.settings: dict[str, Any] = {}
        #: Gives what is to be kept with each evaluation.
        self.notes: Callable[[], dict[str, Any]] = dict
        self.outcome: slsqp.Outcome | None = None

    def run(self) -> bool:
        start = self.get_design_var_values()
        bounds = self.autoscaler.get_bounds_scaling("design_var")
        limits = self.autoscaler.get_bounds_scaling("constraint")
        constraints = []
        for name in self.get_constraint_values():
            limit = limits[name]
            lower, upper = (limit.equals, limit.equals) if limit.equals is not None else (limit.lower, limit.upper)
            constraints.append(
                slsqp.Constraint(
                    name,
                    -np.inf if lower is None else np.ravel(lower).item(),
                    np.inf if upper is None else np.ravel(upper).item(),
                )
            )
        self.outcome = slsqp.minimise(
            _Functions(self, list(start), [np.size(value) for value in start.values()]),
            _joined(start.values()),
            _joined(bounds[name].lower for name in start),
            _joined(bounds[name].upper for name in start),
            constraints,
            **self.settings,
        )
        return not self.outcome.converged


class _Functions:
    """The driver's problem as :class:`slsqp.Functions`."""

    def __init__(self, driver: SLSQP, names: list[str], sizes: list[int]) -> None:
        self._driver = driver
        self._names = names
        self._ends = np.cumsum(sizes)[:-1]
        #: Where the model is.
        self._at = b""

    def values(self, x: Array) -> tuple[float, Array, dict[str, Any]]:
        driver = self._driver
        for name, value in zip(self._names, np.split(x, self._ends), strict=True):
            driver.set_design_var(name, value)
        driver._problem().model.run_solve_nonlinear()
        driver.iter_count += 1
        self._at = x.tobytes()
        objective = _joined(driver.get_objective_values().values()).item()
        return objective, _joined(driver.get_constraint_values().values()), driver.notes()

    def derivatives(self, x: Array) -> tuple[Array, Array, dict[str, Any]]:
        driver = self._driver
        if self._at != x.tobytes():
            self.values(x)
        responses = [*driver.get_objective_values(), *driver.get_constraint_values()]
        totals = driver._problem().compute_totals(responses, self._names, return_format="array", driver_scaling=True)
        return totals[0].copy(), totals[1:].copy(), driver.notes()


def _joined(values: Iterable[Any]) -> Array:
    return np.concatenate([np.ravel(value) for value in values])


class Study:
    """The OpenMDAO problem on a session and a flow solver.

    `limits`: constraints, such as `formulation.PROBLEMS["with"]`. `angle_of_attack`: whether it is a variable too, as it is
    not in the paper. `model`: numbers of `aircraft.MODEL` to replace.
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
        self.clock = Clock()
        self.mesh = Mesh(session=session, functions=aircraft.GEOMETRY, clock=self.clock)
        self.problem = om.Problem(reports=False)
        group = self.problem.model
        group.add_subsystem("mesh", self.mesh, promotes=["*"])
        flow = Flow(aerodynamics=aerodynamics, vertices=setup.mesh.vertices, clock=self.clock)
        group.add_subsystem("flow", flow, promotes=["*"])
        group.add_subsystem("aircraft", Aircraft(model=dict(model or {})), promotes=["*"])

        baseline = setup.baseline
        lower, upper = setup.bounds
        #: Names of the variables in OpenMDAO, and their entries in a design of the mesh service.
        self.variables = {om_name(each.name): each.entries for each in setup.groups.values()}
        for name, entries in self.variables.items():
            middle = baseline[entries]
            reach = (upper[entries] - lower[entries]) / 2
            group.add_design_var(name, lower=lower[entries], upper=upper[entries], ref0=middle, ref=middle + reach)
        if angle_of_attack:
            limit, reach = ANGLE_OF_ATTACK
            group.add_design_var("angle_of_attack", lower=-limit, upper=limit, ref0=0.0, ref=reach)
        group.add_objective(OBJECTIVE, ref=FUEL)
        for limit in self.limits:
            sides = (
                {"equals": limit.lower * limit.scale}
                if limit.lower == limit.upper
                else {
                    side: value * limit.scale
                    for side, value in (("lower", limit.lower), ("upper", limit.upper))
                    if np.isfinite(value)
                }
            )
            group.add_constraint(limit.result, ref=limit.scale, **sides)

        self.driver = SLSQP()
        self.driver.notes = self.notes
        self.problem.driver = self.driver
        self.problem.setup(mode="rev")

    def notes(self) -> dict[str, Any]:
        """Seconds in the services since the last call, and what is known of the present design."""
        return {
            "service_seconds": self.clock.read(),
            "quality": self.mesh.quality(),
            "design": self.design().tolist(),
            "angle_of_attack": self.problem.get_val("angle_of_attack").item(),
            "results": {name: self.problem.get_val(name).item() for name in RESULTS},
            "state": {name: self.problem.get_val(om_name(name)).item() for name in aircraft.INPUTS},
        }

    def design(self) -> Array:
        """Of the mesh service."""
        return _joined(self.problem.get_val(name) for name in self.variables)

    def set_design(self, design: Array) -> None:
        for name, entries in self.variables.items():
            self.problem.set_val(name, design[entries].reshape(self.problem.get_val(name).shape))

    def trim(self, *, tolerance: float = 1e-9, steps: int = 12) -> None:
        """Turns the whole wing (all twists by as much) and the tail until lift is weight and the moment is zero.

        With the angle of attack in place of the twists, if that is a variable. Newton's method with the exact derivatives.
        """
        wing = "angle_of_attack" if "angle_of_attack" in self.problem.model.get_design_vars() else "wing:twist"
        wrt, of = [wing, "htail:rotation"], ["lift_excess", "pitching_moment"]
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
        raise RuntimeError(f"the aircraft is not trimmed after {steps} steps; residuals {residuals}")

    def run(self, **settings: Any) -> slsqp.Outcome:
        """Minimises the fuel from the present design on; `settings` of :func:`slsqp.minimise`."""
        self.driver.settings = settings
        self.problem.run_driver()
        assert self.driver.outcome is not None
        return self.driver.outcome


#: Bound of the angle of attack where it is a variable, and by how much it is scaled, rad.
ANGLE_OF_ATTACK = (np.radians(8.0), np.radians(5.0))
