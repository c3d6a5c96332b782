"""SciPy's SLSQP with additions for long runs: a record of every evaluation, progress, and a measure of optimality.

SLSQP keeps its state in work arrays that cannot be saved. It is, however, deterministic: given the same values and
derivatives at the same points it takes the same path, bit by bit. So each evaluation is written to a file as soon as it is
known, and a run that was killed is resumed from its beginning from the file, which costs nothing; the services are
called again only from where the file ends.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, minimize

Array = NDArray[np.float64]

#: Distance within which a bound or limit may have a multiplier, in scaled units.
NEAR = 1e-3


@dataclass(frozen=True)
class Constraint:
    """lower <= value <= upper, in scaled units; an equation if both are equal."""

    name: str
    lower: float
    upper: float

    def violation(self, value: float) -> float:
        return max(self.lower - value, value - self.upper, 0.0)


class Functions(Protocol):
    """Objective and constraints in scaled variables."""

    def values(self, x: Array) -> tuple[float, Array, dict[str, Any]]:
        """Objective, constraints, and notes to keep with them (numbers, text)."""

    def derivatives(self, x: Array) -> tuple[Array, Array, dict[str, Any]]:
        """Gradient of the objective; of the constraints, a row each; notes."""


@dataclass(frozen=True)
class Iterate:
    """A point that SLSQP accepted."""

    number: int
    x: Array
    objective: float
    constraints: Array
    #: Of the objective; of the constraints, a row each.
    gradient: Array
    jacobian: Array
    #: Largest violation of a constraint, scaled.
    infeasibility: float
    #: Name of that constraint.
    worst: str
    #: See :func:`stationarity`.
    optimality: float
    #: Multipliers of the constraints: change of the optimal objective for a unit of their limit, scaled.
    multipliers: Array
    #: Points that were evaluated so far, those of the record included.
    evaluations: int
    notes: dict[str, Any]
    #: Whether all evaluations so far came from the record.
    replayed: bool


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    converged: bool
    message: str
    iterates: list[Iterate] = field(default_factory=list)


class RecordMismatch(Exception):
    """The file records a run of another problem."""


class Record:
    """Evaluations in a file of JSON lines; numbers are written so that they come back with the same bits."""

    def __init__(self, path: Path | None, description: dict[str, Any], *, resume: bool) -> None:
        self._values: dict[bytes, dict[str, Any]] = {}
        self._derivatives: dict[bytes, dict[str, Any]] = {}
        self._file = None
        if path is None:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        kept = self._read(path, description) if resume and path.exists() else 0
        # A last line that a kill truncated is dropped.
        self._file = path.open("r+b" if kept else "wb")
        self._file.truncate(kept)
        self._file.seek(kept)
        if not kept:
            self._write(description)

    def _read(self, path: Path, description: dict[str, Any]) -> int:
        """Bytes of whole lines."""
        kept = 0
        for number, line in enumerate(path.read_bytes().splitlines(keepends=True)):
            if not line.endswith(b"\n"):
                break
            entry = json.loads(line)
            if number == 0 and entry != json.loads(json.dumps(description)):
                raise RecordMismatch(f"{path} records another problem; give another folder, or do not resume")
            if number > 0:
                self._keep(entry)
            kept += len(line)
        return kept

    def _keep(self, entry: dict[str, Any]) -> None:
        table = self._values if "objective" in entry else self._derivatives
        table[np.array(entry["x"]).tobytes()] = entry

    def _write(self, entry: dict[str, Any]) -> None:
        if self._file is not None:
            self._file.write(json.dumps(entry).encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())

    def add(self, entry: dict[str, Any]) -> dict[str, Any]:
        self._keep(entry)
        self._write(entry)
        return entry

    def values(self, x: Array) -> dict[str, Any] | None:
        return self._values.get(x.tobytes())

    def derivatives(self, x: Array) -> dict[str, Any] | None:
        return self._derivatives.get(x.tobytes())

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


def stationarity(
    x: Array,
    gradient: Array,
    jacobian: Array,
    values: Array,
    constraints: Sequence[Constraint],
    lower: Array,
    upper: Array,
) -> tuple[float, Array]:
    """How far the conditions of Karush, Kuhn and Tucker are from being met at best, and the constraints' multipliers.

    The multipliers are the least-squares ones among those of the right sign; only limits and bounds that are nearly reached
    have one. Returns the largest entry of the Lagrangian's gradient or of the products of multipliers and
    slacks, whichever is more.
    """
    columns, low, high, slack = [], [], [], []
    rows = [*jacobian, *np.eye(len(x))]
    limits = [(c.lower, c.upper) for c in constraints] + list(zip(lower, upper, strict=True))
    chosen = []
    for k, (row, value, (least, most)) in enumerate(zip(rows, [*values, *x], limits, strict=True)):
        if value <= least + NEAR or value >= most - NEAR:
            chosen.append(k)
            columns.append(row)
            low.append(-np.inf if value >= most - NEAR else 0.0)
            high.append(np.inf if value <= least + NEAR else 0.0)
            slack.append(min(abs(value - least), abs(most - value)) if least < most else 0.0)
    multipliers = np.zeros(len(rows))
    gap = 0.0
    if columns:
        found = lsq_linear(np.array(columns).T, gradient, bounds=(low, high), method="bvls", tol=1e-14)
        multipliers[chosen] = found.x
        gap = float(np.abs(found.x * slack).max())
    left = gradient - np.array(rows).T @ multipliers
    return max(float(np.abs(left).max()), gap), multipliers[: len(constraints)]


def minimise(
    functions: Functions,
    start: Array,
    lower: Array,
    upper: Array,
    constraints: Sequence[Constraint],
    *,
    feasible: float = 1e-6,
    optimal: float = 1e-4,
    iterations: int = 40,
    weight: float = 1.0,
    record: Path | None = None,
    resume: bool = False,
    description: dict[str, Any] | None = None,
    tell: Callable[[Iterate], None] = lambda iterate: None,
) -> Outcome:
    """Minimises in scaled variables, until no constraint is violated by more than `feasible` and :func:`stationarity` is at
    most `optimal`.

    `weight`: factor of the objective inside SLSQP. It begins with the unit matrix for the Lagrangian's second
    derivatives, so that the weight decides how far its first steps go; no result depends on it.
    `record`: file that evaluations are written to. `resume`: whether it is read first. `description`: of the problem; a
    record with another one is refused. `tell`: called with every iterate.
    """
    table = Record(
        record,
        {
            "start": start.tolist(),
            "lower": lower.tolist(),
            "upper": upper.tolist(),
            "constraints": [[c.name, c.lower, c.upper] for c in constraints],
            **(description or {}),
        },
        resume=resume,
    )
    points: set[bytes] = set()
    replayed = True
    iterates: list[Iterate] = []

    def values(x: Array) -> dict[str, Any]:
        nonlocal replayed
        # -0 and 0 are one point.
        x = np.clip(x, lower, upper) + 0.0
        points.add(x.tobytes())
        known = table.values(x)
        if known is None:
            replayed = False
            begun = time.perf_counter()
            objective, of_constraints, notes = functions.values(x)
            notes = {"seconds": time.perf_counter() - begun, **notes}
            known = table.add(
                {"x": x.tolist(), "objective": float(objective), "constraints": of_constraints.tolist(), "notes": notes}
            )
        return known

    def derivatives(x: Array) -> dict[str, Any]:
        nonlocal replayed
        x = np.clip(x, lower, upper) + 0.0
        known = table.derivatives(x)
        if known is None:
            replayed = False
            values(x)
            begun = time.perf_counter()
            gradient, jacobian, notes = functions.derivatives(x)
            notes = {"seconds": time.perf_counter() - begun, **notes}
            known = table.add(
                {"x": x.tolist(), "gradient": gradient.tolist(), "jacobian": jacobian.tolist(), "notes": notes}
            )
        return known

    def accept(x: Array) -> None:
        of, by = values(x), derivatives(x)
        at = np.array(of["constraints"])
        violations = [c.violation(value) for c, value in zip(constraints, at, strict=True)]
        worst = int(np.argmax(violations)) if violations else 0
        gradient, jacobian = np.array(by["gradient"]), np.array(by["jacobian"])
        optimality, multipliers = stationarity(x, gradient, jacobian, at, constraints, lower, upper)
        iterate = Iterate(
            number=len(iterates),
            x=np.array(of["x"]),
            objective=of["objective"],
            constraints=at,
            gradient=gradient,
            jacobian=jacobian,
            infeasibility=max(violations, default=0.0),
            worst=constraints[worst].name if violations else "",
            optimality=optimality,
            multipliers=multipliers,
            evaluations=len(points),
            notes={"values": of["notes"], "derivatives": by["notes"]},
            replayed=replayed,
        )
        iterates.append(iterate)
        tell(iterate)
        if iterate.infeasibility <= feasible and optimality <= optimal:
            raise StopIteration

    def of_kind(kind: str) -> dict[str, Any]:
        """SciPy's form: equations = 0, inequalities >= 0."""
        rows, signs, shifts = [], [], []
        for row, c in enumerate(constraints):
            if kind == "eq" and c.lower == c.upper:
                rows, signs, shifts = [*rows, row], [*signs, 1.0], [*shifts, -c.lower]
            elif kind == "ineq" and c.lower != c.upper:
                for limit, sign in ((c.lower, 1.0), (c.upper, -1.0)):
                    if np.isfinite(limit):
                        rows, signs, shifts = [*rows, row], [*signs, sign], [*shifts, -sign * limit]
        sign, shift = np.array(signs), np.array(shifts)
        return {
            "type": kind,
            "fun": lambda x: sign * np.array(values(x)["constraints"])[rows] + shift,
            "jac": lambda x: sign[:, None] * np.array(derivatives(x)["jacobian"])[rows],
            "size": len(rows),
        }

    try:
        try:
            accept(start)
        except StopIteration:
            return Outcome(True, "the start is optimal", iterates)
        kinds = [of_kind(kind) for kind in ("eq", "ineq")]
        found = minimize(
            lambda x: weight * values(x)["objective"],
            start,
            method="SLSQP",
            jac=lambda x: weight * np.array(derivatives(x)["gradient"]),
            bounds=list(zip(lower, upper, strict=True)),
            constraints=[{k: v for k, v in kind.items() if k != "size"} for kind in kinds if kind["size"]],
            callback=accept,
            # SLSQP's own criterion would stop it early; ours is checked after every iteration.
            options={"maxiter": iterations, "ftol": 1e-14},
        )
    finally:
        table.close()
    last = iterates[-1]
    converged = last.infeasibility <= feasible and last.optimality <= optimal
    return Outcome(converged, "converged" if converged else str(found.message), iterates)
