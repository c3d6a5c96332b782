"""The study without OpenMDAO: the chain rule by hand, and SciPy's SLSQP. For readers; it keeps no record.

    python plain.py --binary ../../../target/release/moldline --coarse --problem with

Every design is four calls: Deform (mesh service), Analyze (panel service), and for derivatives the adjoint of each, which
starts from the derivatives of the aircraft's equations.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import moldline
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from aircraft import AERODYNAMICS, GEOMETRY, INPUTS, analyse, derivatives
from formulation import FUEL, OBJECTIVE, OBJECTIVE_WEIGHT, PROBLEMS, Limit
from problem import Aerodynamics
from raymer import POUND_FORCE
from services import services

HERE = Path(__file__).resolve().parent

Array = NDArray[np.float64]


class Point:
    """The aircraft at one design."""

    def __init__(self, session: moldline.Session, flow: Aerodynamics, design: Array) -> None:
        self.session, self.flow = session, flow
        self.mesh = session.deform(design)
        coefficients = flow.coefficients(self.mesh.vertices, 0.0)
        self.state = {name: self.mesh.functions[name] for name in GEOMETRY}
        self.state |= dict(zip(AERODYNAMICS, coefficients, strict=True)) | {"angle_of_attack": 0.0}
        self.results = analyse(self.state)

    def gradients(self, of: Sequence[str]) -> Array:
        """Derivatives with respect to the design variables, a row for each result."""
        rows = derivatives(self.state, of)
        by = {name: np.array([rows[result][k] for result in of]) for k, name in enumerate(INPUTS)}
        # Adjoint of the panel service for its six outputs, then of the mesh service for all results at once.
        by_vertices, _ = self.flow.gradients(self.mesh.vertices, 0.0)
        seeds = sum(np.multiply.outer(by[name], by_vertices[k]) for k, name in enumerate(AERODYNAMICS))
        functions = {name: by[name] for name in GEOMETRY}
        design = self.session.vjp(vertices=seeds, functions=functions, at=self.mesh).design
        assert design is not None
        return design


class Problem:
    """Table 2 in scaled variables, z = (design - baseline) / half of the range; the last point is kept."""

    def __init__(self, session: moldline.Session, flow: Aerodynamics, limits: Sequence[Limit]) -> None:
        self.session, self.flow, self.limits = session, flow, limits
        self.zero = session.setup.baseline
        self.lower, self.upper = session.setup.bounds
        self.reach = (self.upper - self.lower) / 2
        self.of = [OBJECTIVE, *(limit.result for limit in limits)]
        self.scales = np.array([FUEL / OBJECTIVE_WEIGHT, *(limit.scale for limit in limits)])
        self._points: dict[bytes, tuple[Point, Array, list[Array]]] = {}

    def values(self, z: Array) -> Array:
        """Objective and constraints, scaled."""
        return self._at(z)[1]

    def gradients(self, z: Array) -> Array:
        point, _, known = self._at(z)
        if not known:
            known.append(point.gradients(self.of) * self.reach / self.scales[:, np.newaxis])
        return known[0]

    def _at(self, z: Array) -> tuple[Point, Array, list[Array]]:
        if z.tobytes() not in self._points:
            point = Point(self.session, self.flow, self.zero + z * self.reach)
            values = np.array([point.results[name] for name in self.of]) / self.scales
            self._points = {z.tobytes(): (point, values, [])}
        return self._points[z.tobytes()]

    def constraints(self) -> list[dict[str, Any]]:
        """SciPy's form: equations are zero, inequalities are not negative."""
        found: list[dict[str, Any]] = []
        for row, limit in enumerate(self.limits, start=1):
            sides = [("eq", 1.0, limit.lower)]
            if limit.lower != limit.upper:
                sides = [("ineq", 1.0, limit.lower), ("ineq", -1.0, limit.upper)]
            for kind, sign, bound in sides:
                if np.isfinite(bound):
                    found.append({
                        "type": kind,
                        "fun": lambda z, row=row, sign=sign, bound=bound: sign * (self.values(z)[row] - bound),
                        "jac": lambda z, row=row, sign=sign: sign * self.gradients(z)[row],
                    })  # fmt: skip
        return found

    def trimmed(self, steps: int = 5) -> Array:
        """The baseline with all twists and the tail turned until lift is weight and the moment is zero."""
        turns = np.zeros((2, len(self.zero)))
        turns[0, self.session.setup.groups["wing.twist"].entries] = 1.0
        turns[1, self.session.setup.groups["htail.rotation"].entries] = 1.0
        z = np.zeros(len(self.zero))
        for _ in range(steps):
            residuals, matrix = self.values(z)[1:3], self.gradients(z)[1:3] @ turns.T
            z = z - np.linalg.solve(matrix, residuals) @ turns
        return z


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="the moldline program; it is started")
    parser.add_argument("--problem", choices=list(PROBLEMS), default="with", help="static margin or not")
    parser.add_argument("--iterations", type=int, default=25)
    parser.add_argument("--coarse", action="store_true", help="on the mesh of 2,400 cells")
    arguments = parser.parse_args()

    with services(arguments.binary, HERE / "out", coarse=arguments.coarse) as (session, flow):
        problem = Problem(session, flow, PROBLEMS[arguments.problem])

        def tell(z: Array) -> None:
            objective, *constraints = problem.values(z)
            worst = max(max(c.lower - v, v - c.upper) for c, v in zip(problem.limits, constraints, strict=True))
            fuel = objective * problem.scales[0] / POUND_FORCE
            print(f"fuel {fuel:9.1f} lbf, worst constraint {worst:8.1e}", flush=True)

        start = problem.trimmed()
        tell(start)
        found = minimize(
            lambda z: problem.values(z)[0],
            start,
            jac=lambda z: problem.gradients(z)[0],
            bounds=list(
                zip((problem.lower - problem.zero) / problem.reach, (problem.upper - problem.zero) / problem.reach)
            ),
            constraints=problem.constraints(),
            method="SLSQP",
            callback=tell,
            options={"maxiter": arguments.iterations, "ftol": 1e-7},
        )
        print(found.message)
        for variable, value in zip(session.setup.variables, problem.zero + found.x * problem.reach, strict=True):
            print(f"{variable.name:26}{value:10.3f} {variable.unit}")


if __name__ == "__main__":
    main()
