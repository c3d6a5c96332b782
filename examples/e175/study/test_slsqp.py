"""The optimizer on problems with known solutions, and its resumption."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slsqp
from slsqp import Constraint, minimise, stationarity

# Hock and Schittkowski, Test Examples for Nonlinear Programming Codes, No. 71.
CONSTRAINTS = [Constraint("product", 25.0, np.inf), Constraint("squares", 40.0, 40.0)]
LOWER, UPPER = np.full(4, 1.0), np.full(4, 5.0)
START = np.array([1.0, 5.0, 5.0, 1.0])
SOLUTION = [1.0, 4.74299963, 3.82114998, 1.37940829]


class Problem71:
    """Counts evaluations; can be killed in the middle."""

    def __init__(self, fails_after: int | None = None) -> None:
        self.evaluations = 0
        self.fails_after = fails_after

    def values(self, x: np.ndarray) -> tuple[float, np.ndarray, dict[str, Any]]:
        if self.evaluations == self.fails_after:
            raise KeyboardInterrupt
        self.evaluations += 1
        return x[0] * x[3] * x[:3].sum() + x[2], np.array([x.prod(), (x**2).sum()]), {}

    def derivatives(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
        gradient = np.full(4, x[0] * x[3]) * [1, 1, 1, 0] + [x[3] * x[:3].sum(), 0, 1, x[0] * x[:3].sum()]
        return gradient, np.array([x.prod() / x, 2 * x]), {}


def solve(functions: Problem71, **options: Any) -> slsqp.Outcome:
    return minimise(functions, START, LOWER, UPPER, CONSTRAINTS, **options)


def test_finds_the_published_solution() -> None:
    outcome = solve(Problem71(), optimal=1e-7, feasible=1e-9)
    last = outcome.iterates[-1]
    assert outcome.converged
    np.testing.assert_allclose(last.x, SOLUTION, rtol=1e-7)
    assert last.objective == pytest.approx(17.0140173, abs=1e-6)
    # Published multipliers of the two constraints.
    np.testing.assert_allclose(last.multipliers, [0.552293, -0.161469], atol=2e-5)


def test_multipliers_are_the_change_of_the_optimum() -> None:
    for row, shift in ((0, 1e-3), (1, 1e-3)):
        ends = []
        for sign in (-1, 1):
            moved = list(CONSTRAINTS)
            c = moved[row]
            moved[row] = Constraint(c.name, c.lower + sign * shift, c.upper + sign * shift)
            outcome = minimise(Problem71(), START, LOWER, UPPER, moved, optimal=1e-8, feasible=1e-10)
            ends.append(outcome.iterates[-1].objective)
        multipliers = solve(Problem71(), optimal=1e-8, feasible=1e-10).iterates[-1].multipliers
        assert (ends[1] - ends[0]) / (2 * shift) == pytest.approx(multipliers[row], rel=1e-4)


def test_a_killed_run_goes_on_with_the_same_iterates(tmp_path: Path) -> None:
    whole = solve(Problem71(), record=tmp_path / "whole.jsonl")
    count = Problem71()
    solve(count)
    for kill in range(1, count.evaluations):
        path = tmp_path / f"{kill}.jsonl"
        with pytest.raises(KeyboardInterrupt):
            solve(Problem71(fails_after=kill), record=path)
        rest = Problem71()
        resumed = solve(rest, record=path, resume=True)
        assert rest.evaluations == count.evaluations - kill
        assert [i.x.tobytes() for i in resumed.iterates] == [i.x.tobytes() for i in whole.iterates]
        assert [i.optimality for i in resumed.iterates] == [i.optimality for i in whole.iterates]
        assert resumed.iterates[0].replayed and not resumed.iterates[-1].replayed


def test_half_a_line_is_forgotten(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    whole = solve(Problem71(), record=path)
    text = path.read_bytes()
    path.write_bytes(text[:-20])
    rest = Problem71()
    again = solve(rest, record=path, resume=True)
    assert again.iterates[-1].x.tobytes() == whole.iterates[-1].x.tobytes()
    assert len(path.read_bytes().splitlines()) == len(text.splitlines())


def test_the_record_of_another_problem_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    solve(Problem71(), record=path)
    with pytest.raises(slsqp.RecordMismatch, match="another problem"):
        solve(Problem71(), record=path, resume=True, description={"mesh": "finer"})
    # Without resuming it is begun anew.
    assert solve(Problem71(), record=path, description={"mesh": "finer"}).converged


def test_stationarity_knows_signs() -> None:
    """A gradient that pushes into a bound is stationary, one that pulls away is not."""
    x, bounds = np.array([0.0, 0.5]), (np.zeros(2), np.ones(2))
    none = np.zeros((0, 2)), np.zeros(0), []
    assert stationarity(x, np.array([3.0, 0.0]), *none, *bounds)[0] == pytest.approx(0.0, abs=1e-15)
    assert stationarity(x, np.array([-3.0, 0.0]), *none, *bounds)[0] == pytest.approx(3.0)
    assert stationarity(x, np.array([3.0, 0.2]), *none, *bounds)[0] == pytest.approx(0.2)
    limit = np.array([[0.0, 2.0]]), np.array([1.0])
    at_lower, at_upper = [Constraint("c", 1.0, 5.0)], [Constraint("c", -5.0, 1.0)]
    free = np.array([0.3, 0.5])
    optimality, multipliers = stationarity(free, np.array([0.0, 4.0]), *limit, at_lower, *bounds)
    assert (optimality, multipliers[0]) == (pytest.approx(0.0, abs=1e-14), pytest.approx(2.0))
    assert stationarity(free, np.array([0.0, 4.0]), *limit, at_upper, *bounds)[0] == pytest.approx(4.0)
