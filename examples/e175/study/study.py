"""The fuel-burn study: both problems of the paper's Sec. V on a mesh service and a panel service.

    python study.py --binary ../../../target/release/moldline --out out     both problems
    python study.py ... --resume                                            continues a killed run
    python study.py ... --coarse --iterations 3 --no-pictures               a quick look

Writes report.json, report.html with its pictures, and for each problem the record of its evaluations.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import moldline
import numpy as np
from numpy.typing import NDArray

import aircraft
import report
import slsqp
from formulation import FUEL, OBJECTIVE, PROBLEMS
from problem import Aerodynamics, Study
from raymer import POUND_FORCE
from services import services

HERE = Path(__file__).resolve().parent

Array = NDArray[np.float64]


#: The choices that matter most, varied on the coarse mesh.
VARIANTS: dict[str, dict[str, float]] = {
    "as it is": {},
    "engines weighed": {"engines_weighed": 1.0},
    "tail arm between the quarter chords": {"tail_arm_offset": 0.0},
    "no drag of the upswept tail": {"upsweep": 0.0},
}


class Progress:
    """A line for every iterate."""

    HEADING = (
        f"{'':>4}{'fuel, lbf':>11}{'worst constraint':>28}{'optimality':>12}{'evaluations':>13}"
        f"{'mesh, s':>9}{'panel, s':>10}{'p95':>7}{'folded':>8}"
    )

    def __init__(self, title: str) -> None:
        print(f"\n{title}\n{self.HEADING}", flush=True)

    def __call__(self, iterate: slsqp.Iterate) -> None:
        notes = [iterate.notes[of].get("service_seconds", {}) for of in ("values", "derivatives")]
        mesh, panel = (
            sum(seconds for note in notes for name, seconds in note.items() if name.startswith(service))
            for service in ("mesh", "panel")
        )
        quality = iterate.notes["values"]["quality"]
        worst = f"{iterate.worst} {iterate.infeasibility:.1e}"
        print(
            f"{iterate.number:>4}{iterate.objective * FUEL / POUND_FORCE:>11.1f}{worst:>28}{iterate.optimality:>12.1e}"
            f"{iterate.evaluations:>13}{mesh:>9.2f}{panel:>10.2f}{quality['aspect_ratio_p95']:>7.2f}{quality['folded']:>8}"
            + ("   from the record" if iterate.replayed else ""),
            flush=True,
        )


def trimmed_baseline(study: Study, path: Path, resume: bool) -> None:
    """Puts the study at the trimmed baseline, which is kept in a file so that a resumed run starts at the same bits."""
    if resume and path.exists():
        study.set_variables(json.loads(path.read_text()))
    else:
        study.trim()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(study.get_variables()) + "\n")


def solve(
    name: str,
    session: moldline.Session,
    flow: Aerodynamics,
    out: Path,
    *,
    iterations: int,
    resume: bool,
    angle_of_attack: bool = False,
    model: Mapping[str, float] | None = None,
) -> tuple[Study, slsqp.Outcome]:
    """One problem, from the trimmed baseline."""
    study = Study(session, flow, PROBLEMS[name], angle_of_attack=angle_of_attack, model=model)
    suffix = "-alpha" if angle_of_attack else ""
    trimmed_baseline(study, out / f"baseline{suffix}.json", resume)
    outcome = study.run(
        iterations=iterations,
        record=out / f"{name}{suffix}.jsonl",
        resume=resume,
        description={"setup": session.setup.id, "model": dict(model or {})},
        tell=Progress(f"{name} static margin"),
    )
    return study, outcome


def check_derivatives(study: Study, x: Array, step: float = 1e-3) -> dict[str, float]:
    """Largest error of each response's derivatives with respect to all variables, over its largest derivative.

    Against central differences of fourth order through both services; `step` of half a variable's range.
    """
    names = [OBJECTIVE, *(limit.result for limit in study.limits)]
    gradient, jacobian, _ = study.derivatives(x)
    exact = np.vstack([gradient, jacobian])
    differences = np.empty_like(exact)
    for k in range(len(x)):
        at = []
        for shift in (-2, -1, 1, 2):
            moved = x.copy()
            moved[k] += shift * step
            objective, constraints, _ = study.values(moved)
            at.append(np.array([objective, *constraints]))
        differences[:, k] = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * step)
    errors = np.abs(exact - differences).max(axis=1) / np.abs(exact).max(axis=1)
    return dict(zip(names, errors.tolist(), strict=True))


def sensitivities(study: Study, iterates: list[slsqp.Iterate]) -> list[dict[str, Any]]:
    """Sensitivity of the fuel to the model's choices: relative change for a relative change of each number.

    Of the trimmed baseline, and of the optimum, where lift, moment and the active constraints are kept: the derivative of
    the optimum is that of the Lagrangian. Numbers that are zero are changed by one.
    """
    responses = [OBJECTIVE, *(limit.result for limit in study.limits)]
    rows = []
    first, last = iterates[0], iterates[-1]
    scales = np.array([limit.scale for limit in study.limits])
    by: dict[str, Array] = {}
    for at, iterate in (("baseline", first), ("optimum", last)):
        state = iterate.notes["values"]["state"]
        slopes = aircraft.derivatives(state, responses, aircraft.CHOICES, study.model)
        multipliers = study.trim_multipliers(iterate) if at == "baseline" else iterate.multipliers
        by[at] = slopes[OBJECTIVE] - sum(
            multiplier * FUEL / scale * slopes[limit.result]
            for multiplier, scale, limit in zip(multipliers, scales, study.limits, strict=True)
        )
        by[at] = by[at] / (iterate.objective * FUEL)
    for k, (name, choice) in enumerate(aircraft.CHOICES.items()):
        size = choice.value or 1.0
        rows.append({"name": name, **{at: float(changes[k] * size) for at, changes in by.items()}})
    return sorted(rows, key=lambda row: -abs(row["optimum"]))


def summary(iterate: slsqp.Iterate, names: list[str], variables: list[str]) -> dict[str, Any]:
    """An iterate for the report."""
    notes = iterate.notes["values"]
    return {
        "iteration": iterate.number,
        "fuel_weight": iterate.objective * FUEL,
        "infeasibility": iterate.infeasibility,
        "worst": iterate.worst,
        "optimality": iterate.optimality,
        "evaluations": iterate.evaluations,
        "constraints": dict(zip(names, iterate.constraints.tolist(), strict=True)),
        "multipliers": dict(zip(names, iterate.multipliers.tolist(), strict=True)),
        "seconds": notes["seconds"] + iterate.notes["derivatives"]["seconds"],
        "service_seconds": {of: iterate.notes[of].get("service_seconds", {}) for of in ("values", "derivatives")},
        "quality": notes["quality"],
        "results": notes["results"],
        "design": dict(zip(variables, notes["design"], strict=True)),
        "angle_of_attack": notes["angle_of_attack"],
    }


def shape(session: moldline.Session, flow: Aerodynamics, iterate: slsqp.Iterate) -> report.Shape:
    """An iterate for the figures."""
    notes = iterate.notes["values"]
    vertices = session.deform(np.array(notes["design"])).vertices
    mesh = session.setup.mesh
    return report.Shape(
        vertices=np.array(vertices),
        cells=np.asarray(mesh.cells),
        owner=np.array(mesh.components)[np.asarray(mesh.cell_owner)],
        pressure=flow.pressures(vertices, notes["angle_of_attack"]),
    )


def variants(binary: Path, out: Path, *, iterations: int, resume: bool) -> list[dict[str, Any]]:
    """The optima with other choices, on the coarse mesh."""
    rows = []
    with services(binary, out, coarse=True) as (session, flow):
        for title, model in VARIANTS.items():
            for name in PROBLEMS:
                print(f"\nvariant: {title}", flush=True)
                folder = out / "variants" / title.replace(" ", "-")
                _, outcome = solve(name, session, flow, folder, iterations=iterations, resume=resume, model=model)
                first, last = (outcome.iterates[k].notes["values"] for k in (0, -1))
                rows.append({
                    "variant": title,
                    "problem": name,
                    "converged": outcome.converged,
                    "baseline": first["results"],
                    "optimum": last["results"],
                    "travel_ft": last["design"][session.setup.groups["wing.translation"].entries][0],
                })  # fmt: skip
    return rows


def goals(problems: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The study's goals, and whether they are reached."""
    rows: list[dict[str, Any]] = []

    def goal(name: str, value: float, least: float, most: float, unit: str = "1") -> None:
        rows.append(
            {
                "name": name,
                "value": float(value),
                "least": least,
                "most": most,
                "unit": unit,
                "reached": bool(least <= value <= most),
            }
        )

    for name, problem in problems.items():
        first, last = problem["iterates"][0], problem["iterates"][-1]
        start, end = first["results"], last["results"]
        goal(f"{name}: feasibility", last["infeasibility"], 0.0, 1e-6)
        goal(f"{name}: optimality", last["optimality"], 0.0, 1e-4)
        goal(f"{name}: iterations", last["iteration"], 0, 40)
        goal(f"{name}: lift residual", abs(end["lift_excess"]) / POUND_FORCE, 0.0, 10.0, "lbf")
        goal(f"{name}: moment residual", abs(end["pitching_moment"]) / (POUND_FORCE * report.FOOT), 0.0, 10.0, "lbf ft")
        goal(f"{name}: fuel", 100 * (end["fuel_weight"] / start["fuel_weight"] - 1), -22.0, -15.0, "%")
        goal(f"{name}: wing aspect ratio at its bound", end["wing_aspect_ratio"], 10.45, 10.55)
        goal(f"{name}: tail area at its bound", end["tail_area"] / report.FOOT**2, 187.0, 189.0, "ft^2")
        goal(f"{name}: wing loading", end["wing_loading"] / report.POUNDS_PER_SQUARE_FOOT, 99.5, 100.01, "lbf/ft^2")
        folded = max(i["quality"]["folded"] + i["quality"]["inverted"] for i in problem["iterates"])
        goal(f"{name}: folded or inverted cells of any iterate", folded, 0, 0)
        goal(
            f"{name}: largest p95 of the aspect ratio",
            max(i["quality"]["aspect_ratio_p95"] for i in problem["iterates"]),
            1.0,
            2.2,
        )
        if name == "without":
            goal("baseline: fuel fraction", start["fuel_fraction"], 0.244 * 0.95, 0.244 * 1.05)
            goal("baseline: lift to drag", start["lift_to_drag"], 11.55 * 0.95, 11.55 * 1.05)
            goal("baseline: lift coefficient", start["lift_coefficient"], 0.326 * 0.95, 0.326 * 1.05)
        if "derivative_errors" in problem:
            for where, errors in problem["derivative_errors"].items():
                goal(f"{name}: derivatives, {where}", max(errors.values()), 0.0, 1e-5)
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="the moldline program; it is started")
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder to write to")
    parser.add_argument(
        "--problems", nargs="+", choices=list(PROBLEMS), default=list(PROBLEMS), help="static margin or not"
    )
    parser.add_argument("--iterations", type=int, default=40, help="at most so many")
    parser.add_argument("--coarse", action="store_true", help="on the mesh of 2,400 cells")
    parser.add_argument("--resume", action="store_true", help="take what the records in the folder have")
    parser.add_argument("--angle-of-attack", action="store_true", help="as a variable too")
    parser.add_argument("--check", action="store_true", help="compare all derivatives with differences (long)")
    parser.add_argument(
        "--variants", action="store_true", help="also with other choices of the model, on the coarse mesh"
    )
    parser.add_argument("--no-pictures", action="store_true", help="leave the pictures out")
    arguments = parser.parse_args()
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    begun = time.perf_counter()
    found: dict[str, Any] = {}
    shapes: dict[str, report.Shape] = {}
    with services(arguments.binary, out, coarse=arguments.coarse) as (session, flow):
        cells = session.setup.cell_count
        variables = [variable.name for variable in session.setup.variables]
        for name in arguments.problems:
            started = time.perf_counter()
            study, outcome = solve(
                name,
                session,
                flow,
                out,
                iterations=arguments.iterations,
                resume=arguments.resume,
                angle_of_attack=arguments.angle_of_attack,
            )
            names = [limit.result for limit in study.limits]
            found[name] = {
                "converged": outcome.converged,
                "message": outcome.message,
                "seconds": time.perf_counter() - started,
                "iterates": [summary(iterate, names, variables) for iterate in outcome.iterates],
                "sensitivities": sensitivities(study, outcome.iterates),
            }
            print(f"{outcome.message}; {found[name]['seconds']:.0f} s", flush=True)
            ends = {"start": outcome.iterates[0], "optimum": outcome.iterates[-1]}
            if arguments.check:
                found[name]["derivative_errors"] = {
                    where: check_derivatives(study, np.clip(iterate.x, -0.99, 0.99)) for where, iterate in ends.items()
                }
            if not arguments.no_pictures:
                shapes.setdefault("baseline", shape(session, flow, ends["start"]))
                shapes[name] = shape(session, flow, ends["optimum"])
    others = []
    if arguments.variants:
        others = variants(arguments.binary, out, iterations=arguments.iterations, resume=arguments.resume)
    result = {
        "cells": cells,
        "cores": os.cpu_count(),
        "seconds": time.perf_counter() - begun,
        "problems": found,
        "variants": others,
        "goals": goals(found),
    }
    (out / "report.json").write_text(json.dumps(result, indent=1) + "\n")
    report.write(out, result, shapes)
    print("\n" + report.text(result) + f"\n\nwritten to {out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
