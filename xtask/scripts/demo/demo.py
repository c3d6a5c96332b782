"""Deforms the E175 through a real server: the motions of Figs. 6 and 7, and the variables of Table 2 of the paper.

    cargo xtask demo

Writes report.json, a .vtu file for each case and pictures, and prints the quality beside the paper's figures and the
missed goals. A missed goal is no failure: machines differ.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import moldline
import numpy as np
from tqdm import tqdm

import pictures

ROOT = Path(__file__).resolve().parents[3]
E175 = ROOT / "examples" / "e175"

MOLD_LINES = ("sharp", "smooth")
#: Worst case of the paper.
PAPER = {"p95": 2.2, "above_5_percent": 0.14, "inverted": 0}

#: Wing translation (m) and rotation of wing and tail (degrees) of the corners of Fig. 6, in the order of a path.
CORNERS = {"p5p10": (5, 10), "p5m10": (5, -10), "m5m10": (-5, -10), "m5p10": (-5, 10)}
#: Fuselage diameter and wing translation of Fig. 7.
DIAMETERS = {
    "d150": (1.5, 0),
    "d070": (0.7, 0),
    "m5d150": (1.5, -5),
    "p5d150": (1.5, 5),
    "m5d070": (0.7, -5),
    "p5d070": (0.7, 5),
}
#: Points on each of the four ways from corner to corner.
POINTS = 5
SEED = 175
#: Progress bars need a terminal.
BARS = sys.stderr.isatty()


def motion(translation: float, rotation: float) -> dict[str, float]:
    return {"wing.translation": translation, "wing.rotation": rotation, "htail.rotation": rotation}


CASES: dict[str, dict[str, float]] = {
    "baseline": {},
    **{name: motion(*values) for name, values in CORNERS.items()},
    **{name: {"fuselage.diameter_ratio": d, "wing.translation": t} for name, (d, t) in DIAMETERS.items()},
}


def path_points() -> dict[str, dict[str, float]]:
    """Points between the corners of Fig. 6, once around."""
    around = [*CORNERS, next(iter(CORNERS))]
    points = {}
    for start, end in pairwise(around):
        for k in range(1, POINTS + 1):
            at = np.array(CORNERS[start]) + k / (POINTS + 1) * (np.array(CORNERS[end]) - CORNERS[start])
            points[f"{start}-{end}-{k}"] = motion(*map(float, at))
    return points


def table_2_designs(setup: moldline.Setup) -> dict[str, np.ndarray]:
    """Every variable at both bounds, and random corners of their box."""
    designs = {}
    for k, variable in enumerate(setup.variables):
        for side, value in (("lower", variable.lower), ("upper", variable.upper)):
            designs[f"{variable.name} {side}"] = setup.baseline
            designs[f"{variable.name} {side}"][k] = value
    lower, upper = setup.bounds
    random = np.random.default_rng(SEED)
    for k in range(50):
        designs[f"corner {k + 1}"] = np.where(random.random(len(lower)) < 0.5, lower, upper)
    return designs


class Server:
    """`moldline serve`, or another service of the program's, on a free port of the loopback interface."""

    def __init__(
        self, binary: Path, log: Path, *options: str, command: tuple[str, ...] = ("serve", "--store", "memory")
    ) -> None:
        self._log = log.open("w")
        arguments = [str(binary), *command, "--listen", "127.0.0.1:0", *options]
        self._process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=self._log, text=True)
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"the server did not start; its log is {log}")
        self.address: str = json.loads(line)["address"]

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._log.close()


def setup_folder(setup_file: str, mold_line: str, out: Path, source: Path = E175, **options: float) -> Path:
    """A set-up folder with the example's files and another outer mold line."""
    folder = out / "setups" / "-".join([Path(setup_file).stem, mold_line, *(f"{v:g}" for v in options.values())])
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(source / "geometry", folder / "geometry")
    shutil.copy(source / "mesh.msh", folder)
    choices = "".join(f"{name} = {value!r}\n" for name, value in options.items())
    text = (E175 / setup_file).read_text()
    if "[options]" in text:
        raise SystemExit(f"{setup_file} already has [options], which this script would override")
    (folder / "setup.toml").write_text(f'{text}\n[options]\nouter_mold_line = "{mold_line}"\n{choices}')
    return folder


def measured(result: moldline.Deformation, length: float) -> dict[str, Any]:
    """Quality measures of one deformation."""
    total = result.quality.total
    return {
        "p95": total.aspect_ratio.p95,
        "max": total.aspect_ratio.max,
        "above_5_percent": total.aspect_ratio.above_5_percent,
        "edge_ratio_p95": total.edge_ratio.p95,
        "edge_ratio_max": total.edge_ratio.max,
        "min_scaled_jacobian": total.min_scaled_jacobian,
        "min_angle_deg": total.min_angle,
        "max_angle_deg": total.max_angle,
        "skew_p95": total.skew_p95,
        "folded": total.folded,
        "inverted": total.inverted,
        "seam_residual_relative": result.seam_residual / length,
        "held_residual_relative": result.held_residual / length,
        "projection_residual_relative": result.projection_residual / length,
        "projection_steps": result.projection_steps,
        "engine_ms": 1e3 * result.engine_seconds,
        "components": {name: asdict(summary) for name, summary in result.quality.components.items()},
    }


def worst(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The worst of each measure over deformations, and the number of failures."""
    done = [row for row in rows if "error" not in row]
    largest = (
        "p95", "max", "above_5_percent", "edge_ratio_p95", "edge_ratio_max", "folded", "inverted",
        "seam_residual_relative", "held_residual_relative", "projection_residual_relative",
    )  # fmt: skip
    return {
        "deformations": len(rows),
        "failed": len(rows) - len(done),
        **{key: max((row[key] for row in done), default=None) for key in largest},
        "min_scaled_jacobian": min((row["min_scaled_jacobian"] for row in done), default=None),
        "engine_ms_median": median(row["engine_ms"] for row in done) if done else None,
    }


class Demo:
    """One run: its server, its reports, its pictures to come."""

    def __init__(self, client: moldline.Client, out: Path) -> None:
        self.client = client
        self.out = out
        self.setups: dict[str, Any] = {}
        self.drawings: list[pictures.Drawing] = []

    def create(self, setup_file: str, mold_line: str) -> moldline.Setup:
        print(f"\n{setup_file}, {mold_line} outer mold line", flush=True)
        if mold_line == "sharp":
            setup = self.client.create_setup(E175, setup_file=setup_file, progress=BARS)
        else:
            setup = self.client.create_setup(setup_folder(setup_file, mold_line, self.out), progress=BARS)
        self.setups[f"{Path(setup_file).stem}-{mold_line}"] = {
            "name": setup.name,
            "seconds": setup.build_seconds,
            "variables": len(setup.variables),
            "report": setup.report,
        }
        return setup

    def deform(
        self, setup: moldline.Setup, designs: dict[str, Any], folder: Path | None = None, mold_line: str = ""
    ) -> dict[str, dict[str, Any]]:
        """Numbers by case; meshes into `folder` if given."""
        rows: dict[str, dict[str, Any]] = {}
        with setup.session() as session:
            for name, design in tqdm(designs.items(), desc="deform", unit="design", leave=False, disable=None):
                try:
                    result = session.deform(design, cell_quality=folder is not None)
                except moldline.MoldlineError as error:
                    rows[name] = {"error": str(error)}
                    continue
                rows[name] = measured(result, setup.report["length"])
                if folder is not None:
                    folder.mkdir(parents=True, exist_ok=True)
                    path = folder / f"{name}.vtu"
                    moldline.write_vtu(path, setup.mesh, vertices=result.vertices, cell_data=result.cell_quality)
                    self.drawings.append(
                        pictures.Drawing(
                            name, mold_line, folder, np.array(result.vertices), setup.mesh, result.cell_quality, design
                        )
                    )
        return rows


def same_bytes(binary: Path, client: moldline.Client, setup: moldline.Setup, folder: Path, out: Path) -> bool:
    """Whether the hardest case gives the same bytes twice, and on a server with one thread."""
    design = CASES["p5p10"]
    with setup.session() as session:
        first, second = (session.deform(design).vertices.tobytes() for _ in range(2))
    with Server(binary, out / "server-1-thread.log", "--threads", "1") as server:
        with moldline.Client(server.address) as other:
            with other.create_setup(folder, progress=BARS).session() as session:
                alone = session.deform(design).vertices.tobytes()
    return first == second == alone


HEADINGS = f"{'case':<22}{'p95':>7}{'max':>7}{'>5 [%]':>8}{'edges p95':>11}{'min SJ':>8}{'folded':>8}{'inverted':>9}"
HEADINGS += f"{'seam/L':>10}{'held/L':>10}{'Phi/L':>10}{'ms':>7}"


def line(name: str, row: dict[str, Any]) -> str:
    if "error" in row:
        return f"{name:<22}failed: {row['error']}"
    if row["p95"] is None:
        return f"{name:<22}nothing was deformed"
    text = f"{name:<22}{row['p95']:>7.3f}{row['max']:>7.2f}{row['above_5_percent']:>8.3f}{row['edge_ratio_p95']:>11.3f}"
    text += f"{row['min_scaled_jacobian']:>8.3f}{row['folded']:>8}{row['inverted']:>9}"
    for residual in ("seam", "held", "projection"):
        text += f"{row[f'{residual}_residual_relative']:>10.1e}"
    milliseconds = row.get("engine_ms", row.get("engine_ms_median"))
    return f"{text}{milliseconds:>7.0f}" + (f"   {row['failed']} FAILED" if row.get("failed") else "")


def goals(report: dict[str, Any]) -> list[dict[str, Any]]:
    """Goals and results."""
    rows: list[dict[str, Any]] = []

    def at_most(name: str, value: float | None, limit: float, unit: str) -> None:
        reached = value is not None and value <= limit
        rows.append({"name": name, "value": value, "unit": unit, "goal": f"<= {limit:g}", "reached": reached})

    for mold_line in MOLD_LINES:
        motions = report["worst"][f"motions-{mold_line}"]
        at_most(f"motions, {mold_line}: Verdict aspect ratio p95", motions["p95"], 1.9, "1")
        at_most(f"motions, {mold_line}: above 5", motions["above_5_percent"], 0.02, "%")
        at_most(f"motions, {mold_line}: folded cells", motions["folded"], 0, "cells")
        at_most(f"motions, {mold_line}: inverted cells", motions["inverted"], 0, "cells")
        at_most(f"motions, {mold_line}: failed", motions["failed"], 0, "designs")
        table_2 = report["worst"][f"table-2-{mold_line}"]
        at_most(f"Table 2, {mold_line}: Verdict aspect ratio p95", table_2["p95"], 1.9, "1")
        at_most(f"Table 2, {mold_line}: above 5", table_2["above_5_percent"], 0.02, "%")
        at_most(f"Table 2, {mold_line}: folded cells", table_2["folded"], 0, "cells")
        at_most(f"Table 2, {mold_line}: inverted cells", table_2["inverted"], 0, "cells")
        at_most(f"Table 2, {mold_line}: failed", table_2["failed"], 0, "designs")
        both = (motions, table_2)
        for name, key, limit in (
            ("seam vertices off their components", "seam", 1e-10),
            ("active vertices, Phi", "projection", 1e-10),
            ("protected vertices off their components", "held", 1e-12),
        ):
            values = [row[f"{key}_residual_relative"] for row in both if row[f"{key}_residual_relative"] is not None]
            at_most(f"{mold_line}: {name}", max(values, default=None), limit, "lengths")
        at_most(f"{mold_line}: Deform, engine, median", motions["engine_ms_median"], 100, "ms")
        at_most(f"{mold_line}: set-up", report["setups"][f"setup-motions-{mold_line}"]["seconds"], 5, "s")
        same = report["identical_bytes"][mold_line]
        rows.append({
            "name": f"{mold_line}: identical bytes twice, and with 1 and all threads", "value": same, "unit": "",
            "goal": "true", "reached": same,
        })  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="the moldline program")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "demo", help="folder to write to")
    parser.add_argument("--no-pictures", action="store_true", help="leave the pictures out")
    arguments = parser.parse_args()
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()

    report: dict[str, Any] = {
        "paper": PAPER,
        "cores": os.cpu_count(),
        "seed": SEED,
        "cases": {},
        "paths": {},
        "table_2": {},
        "worst": {},
        "identical_bytes": {},
    }
    with Server(arguments.binary, out / "server.log") as server, moldline.Client(server.address) as client:
        demo = Demo(client, out)
        for mold_line in MOLD_LINES:
            setup = demo.create("setup-motions.toml", mold_line)
            folder = out if mold_line == "sharp" else out / mold_line
            cases = report["cases"][mold_line] = demo.deform(setup, CASES, folder, mold_line)
            paths = report["paths"][mold_line] = demo.deform(setup, path_points())
            report["worst"][f"motions-{mold_line}"] = worst([*cases.values(), *paths.values()])
            source = setup_folder("setup-motions.toml", mold_line, out)
            report["identical_bytes"][mold_line] = same_bytes(arguments.binary, client, setup, source, out)
        for mold_line in MOLD_LINES:
            setup = demo.create("setup.toml", mold_line)
            table_2 = report["table_2"][mold_line] = demo.deform(setup, table_2_designs(setup))
            report["worst"][f"table-2-{mold_line}"] = worst(list(table_2.values()))
        report["setups"] = demo.setups
    shutil.rmtree(out / "setups")
    report["goals"] = goals(report)
    report["seconds"] = time.perf_counter() - start
    (out / "report.json").write_text(json.dumps(report, indent=1) + "\n")

    for mold_line in MOLD_LINES:
        print(
            f"\n{mold_line} outer mold line: aspect ratio (Verdict), edges (longest/shortest), scaled Jacobian\n{HEADINGS}"
        )
        for name, row in report["cases"][mold_line].items():
            print(line(name, row))
        print(line("worst of cases, paths", report["worst"][f"motions-{mold_line}"]))
        print(line("worst of Table 2", report["worst"][f"table-2-{mold_line}"]))
    print(f"{'paper, worst case':<22}{'<2.2':>7}{'':>7}{'<0.14':>8}{'':>11}{'':>8}{'':>8}{'0':>9}")

    if not arguments.no_pictures:
        with ProcessPoolExecutor() as pool:
            jobs = pool.map(pictures.draw, demo.drawings)
            for _ in tqdm(jobs, desc="pictures", total=len(demo.drawings), unit="case", leave=False, disable=None):
                pass
        pictures.overview(out, ["baseline", *CORNERS, "d150", "d070"])

    missed = [goal for goal in report["goals"] if not goal["reached"]]
    print(
        f"\n{len(report['goals']) - len(missed)} of {len(report['goals'])} goals reached; numbers in {out / 'report.json'}"
    )
    for goal in missed:
        print(f"  missed: {goal['name']} = {goal['value']} {goal['unit']}, goal {goal['goal']}")


if __name__ == "__main__":
    main()
