"""Validation of the panel method on known flows: closed forms, published results, refinement, consistency, time.

    cargo xtask validate-panel

Writes validation.json and pictures to `--out`, and the page validation.md with its pictures to `--docs` if given.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib
import moldline
import moldline.panel
import numpy as np
from moldline.panel import Analysis, Configuration, Reference
from scipy.integrate import quad

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE.parent / "demo"))

from demo import E175, Server  # noqa: E402
from meshes import Array, Cells, Wing, globe, sphere  # noqa: E402
from pictures import beside  # noqa: E402
from render import NO_VERTEX, View, colour_bar, ramp, render  # noqa: E402

#: Angle of attack of the wings.
ALPHA = np.radians(5.0)


@dataclass(frozen=True)
class Row:
    """A result and the bounds of its goal."""

    name: str
    value: float
    unit: str
    least: float | None = None
    most: float | None = None
    #: Published value, of another code or from a closed form.
    peer: float | None = None

    @property
    def reached(self) -> bool | None:
        if self.least is None and self.most is None:
            return None
        return (self.least is None or self.value >= self.least) and (self.most is None or self.value <= self.most)


class Validation:
    """The cases, one after the other, against one panel service."""

    def __init__(self, panels: moldline.panel.Client, progress: Callable[[str], None]) -> None:
        self.panels = panels
        self.tell = progress
        self.rows: list[Row] = []
        self.tables: dict[str, list[dict[str, float]]] = {}
        self.curves: dict[str, Any] = {}

    def row(self, name: str, value: float, unit: str = "1", **limits: float) -> None:
        self.rows.append(Row(name, float(value), unit, **limits))
        self.tell(f"{name}: {value:.6g}")

    def configuration(self, mesh: tuple[Array, Cells], **options: Any) -> Configuration:
        return self.panels.create_configuration(*mesh, **options)

    def ellipsoids(self) -> None:
        """Closed forms: on an ellipsoid in a stream along an axis, velocity is the tangential part of a constant vector."""
        long = "ellipsoid 3 : 1 : 0.6"
        cases = {
            "sphere": (sphere, (8, 16, 32), (1.0, 1.0, 1.0)),
            "sphere by longitude and latitude": (globe, (8, 16, 32), (1.0, 1.0, 1.0)),
            long: (sphere, (8, 16, 32), (3.0, 1.0, 0.6)),
        }
        for name, (mesh, sizes, axes) in cases.items():
            table = []
            for n in sizes:
                points, cells = mesh(n)
                configuration = self.configuration((points * axes, cells), trailing_edges="none")
                found = configuration.analyze(reference=Reference(area=1.0, chord=1.0, span=1.0))
                middles = cell_means(points, cells)
                error = np.abs(found.cp - ellipsoid_pressure(axes, middles))
                row = {"cells": len(cells), "rms": float(np.sqrt(np.mean(error**2))), "largest": float(error.max())}
                if mesh is globe:
                    row["largest away from poles"] = float(error[np.abs(middles[:, 2]) < 0.8].max())
                table.append(row)
            self.tables[name] = table
            most = {"most": 0.004, "peer": 0.0066} if name == "sphere" else {}
            self.row(f"{name}, {table[1]['cells']:,} cells: rms error of C_p", table[1]["rms"], **most)
            for error_name in list(table[0])[1:]:
                order = np.log2(table[1][error_name] / table[2][error_name])
                least = {"least": 1.9} if "poles" in error_name else {}
                self.row(f"{name}: order of convergence, {error_name}", order, **least)

    def wing(self, name: str, wing: Wing, span: float, grids: tuple[tuple[int, int], ...]) -> list[Analysis]:
        """A wing on several grids: lift, drag, and lift by pressure and on the wake against that by circulation."""
        table, analyses = [], []
        for around, along in grids:
            area = wing.area(along)
            reference = Reference(area=area, chord=area / span, span=span, point=(0.25, 0.0, 0.0))
            configuration = self.configuration(wing.mesh(around, along))
            found = configuration.analyze(reference=reference, alpha=ALPHA)
            lift, drag = found.coefficients.lift, found.coefficients.induced_drag
            analyses.append(found)
            table.append({
                "around": around,
                "along": along,
                "C_L": lift,
                "C_Di": drag,
                "span efficiency": lift**2 / (np.pi * span**2 / area * drag),
                "C_L from pressure": found.coefficients.pressure_lift,
                "C_L on the wake": found.wake_lift,
                "lifts apart, %": 100 * found.disagreement,
                "C_Di from pressure": found.coefficients.pressure_drag,
            })  # fmt: skip
        self.tables[name] = table
        worst = max(abs(row["lifts apart, %"]) for row in table[1:])
        self.row(f"{name}: pressure and wake against circulation", worst, "%", most=1.0)
        return analyses

    def wings(self) -> None:
        """Wings of NACA 0012 sections at 5 degrees."""
        grids = ((32, 20), (60, 40), (100, 60))
        self.wing("rectangular wing", Wing(), 8.0, grids)
        row = self.tables["rectangular wing"][1]
        self.row("rectangular wing, 60 x 40: C_L", row["C_L"], least=0.99 * 0.4315, most=1.01 * 0.4315, peer=0.4315)
        self.row(
            "rectangular wing, 60 x 40: span efficiency",
            row["span efficiency"],
            least=0.94,
            most=1.0,
            peer=lifting_line(8.0),
        )
        drag = 0.00738
        self.row("rectangular wing, 60 x 40: C_Di", row["C_Di"], least=0.98 * drag, most=1.02 * drag, peer=drag)

        swept = Wing(3.0, leading_edge=lambda eta: 3.0 * np.tan(np.radians(35.0)) * np.abs(eta))
        self.wing("wing swept by 35 degrees, aspect ratio 6", swept, 6.0, grids)

        def chord(eta: Array) -> Array:
            return np.sqrt(1 - eta**2)

        # The quarter chord is straight. The last hundredths of the span are cut off, where cells would taper to nothing.
        elliptic = Wing(4.0, chord, lambda eta: -0.25 * chord(eta), cut=0.98)
        analyses = self.wing("elliptic wing", elliptic, 8.0 * elliptic.cut, grids)
        for row in self.tables["elliptic wing"][1:]:
            name = f"elliptic wing, {row['around']} x {row['along']}: span efficiency"
            self.row(name, row["span efficiency"], least=0.99, most=1.01, peer=1.0)
        sections = analyses[-1].sections
        self.curves["elliptic wing"] = (sections.middles[:, 1] / 4.0, sections.loads)

    def aircraft(self, setup: moldline.Setup, mach: float) -> None:
        """The E175: agreement, time, memory."""
        mesh = setup.mesh
        configuration = self.panels.create_configuration(
            mesh.vertices, mesh.cells, cell_groups=moldline.panel.parts(mesh)
        )
        functions = {function.name: function.value for function in setup.functions}
        reference = Reference(
            area=functions["wing.planform_area"],
            chord=functions["wing.mean_aerodynamic_chord"],
            span=functions["wing.span"],
            point=(14.0, 0.0, 0.95),
        )
        name = f"E175, {configuration.cell_count:,} cells"
        alphas = np.radians([0.0, 2.0, 4.0])
        stages: dict[str, float] = {}

        def note(step: moldline.Progress) -> None:
            stages.setdefault(step.stage, time.perf_counter())

        begun = time.perf_counter()
        analyses = configuration.sweep(alphas, reference=reference, mach=mach, progress=note)
        seconds = time.perf_counter() - begun
        table = []
        for alpha, found in zip(alphas, analyses, strict=True):
            of = found.coefficients
            table.append({
                "alpha, deg": float(np.degrees(alpha)),
                "C_L": of.lift,
                "C_L from pressure": of.pressure_lift,
                "C_L on the wake": found.wake_lift,
                "lifts apart, %": 100 * found.disagreement,
                "C_Di": of.induced_drag,
                "C_M": of.moment,
                "neutral point, m": of.neutral_point,
            })  # fmt: skip
        self.tables[f"{name}, Mach {mach:g}"] = table
        worst = max(abs(row["lifts apart, %"]) for row in table)
        self.row(f"{name}: pressure and wake against circulation", worst, "%", most=1.0)
        self.row(f"{name}: three angles with all forces, with the transfer", seconds, "s", most=12.0)
        self.row(f"{name}: memory, as reported", configuration.memory / 1e9, "GB", most=1.5)
        at = analyses[1]
        solution = analyses[0].engine_seconds
        for count in (1, 6):
            weights = np.eye(9)[:count]
            gradient = configuration.vjp(weights if count > 1 else weights[0], at=at)
            ratio = gradient.engine_seconds / solution
            self.row(f"{name}: adjoint of {count} over the solution", ratio, most=1.0 if count == 1 else 2.0)
        pairs = configuration.unknowns**2
        assembly = stages["factorisation"] - stages["influence"]
        self.row(
            f"{name}: matrix and right-hand sides, by pairs with both kernels and both images",
            1e9 * assembly / pairs,
            "ns",
            most=40.0,
        )
        self.row(f"{name}: the whole solution, by pairs", 1e9 * solution / pairs, "ns")
        self.curves["E175"] = (mesh, at)


def cell_means(points: Array, cells: Cells) -> Array:
    """Means of the corners."""
    corners = cells != NO_VERTEX
    return np.asarray(
        (points[np.where(corners, cells, 0)] * corners[..., None]).sum(axis=1) / corners.sum(axis=1)[:, None]
    )


def lifting_line(aspect_ratio: float, slope: float = 2 * np.pi, terms: int = 200) -> float:
    """Span efficiency of a rectangular wing without twist by Prandtl's lifting line; `slope`: that of its section, 1/rad."""
    theta = np.pi * (np.arange(terms) + 0.5) / (2 * terms)
    n = 2 * np.arange(terms) + 1
    mu = slope / (4 * aspect_ratio)
    matrix = np.sin(np.outer(theta, n)) * (mu * n + np.sin(theta)[:, None])
    a = np.linalg.solve(matrix, mu * np.sin(theta))
    return float(1 / np.sum(n * (a / a[0]) ** 2))


def ellipsoid_pressure(axes: tuple[float, float, float], points: Array) -> Array:
    """C_p where the unit sphere's `points`, scaled by the semi-axes, meet the ellipsoid; the stream is along x."""
    squares = np.array(axes) ** 2

    def integrand(t: float) -> float:
        return float(1 / ((squares[0] + t) * np.sqrt(np.prod(squares + t))))

    share = np.prod(axes) * quad(integrand, 0.0, np.inf, epsabs=1e-13, epsrel=1e-12)[0]
    normals = points / np.linalg.norm(points, axis=1)[:, None] / axes
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    velocity = np.array([2 / (2 - share), 0.0, 0.0])
    tangential = velocity - (normals @ velocity)[:, None] * normals
    return np.asarray(1 - np.sum(tangential**2, axis=1))


def draw(found: Validation, folder: Path) -> None:
    """Errors against the size of cells, the load of the elliptic wing, the pressure on the E175."""
    figure, (errors, load) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    for name, kinds in (
        ("sphere", ("rms", "largest")),
        ("sphere by longitude and latitude", ("largest away from poles",)),
        ("ellipsoid 3 : 1 : 0.6", ("rms", "largest")),
    ):
        table = found.tables[name]
        size = [row["cells"] ** -0.5 for row in table]
        for kind in kinds:
            errors.loglog(size, [row[kind] for row in table], "o-" if kind == "rms" else "s--", label=f"{name}, {kind}")
    ends = np.array(errors.get_xlim())
    errors.loglog(ends, 2.0 * ends**2, ":", color="grey", label="second order")
    errors.set(xlabel="cells$^{-1/2}$", ylabel="error of $C_p$", title="Closed forms")
    errors.legend(fontsize=7, loc="lower right")
    eta, loads = found.curves["elliptic wing"]
    eta, loads = np.concatenate([-eta, eta]), np.concatenate([loads, loads])
    order = np.argsort(eta)
    fine = np.linspace(-1, 1, 400)
    ideal = found.tables["elliptic wing"][-1]["C_L"] * np.sqrt(1 - fine**2)
    load.plot(fine, ideal, color="grey", label="ellipse of the same lift")
    load.plot(eta[order], loads[order], ".", label="sections")
    load.set(
        xlabel="share of the half span",
        ylabel="section lift coefficient times chord, m",
        title="Elliptic wing, 5 degrees",
    )
    load.legend(fontsize=8)
    figure.savefig(folder / "panel-closed-forms.png", dpi=110)
    plt.close(figure)

    mesh, analysis = found.curves["E175"]
    low, high = -1.0, 0.6
    colours = ramp(analysis.cp, low, high)
    owner = np.asarray(mesh.cell_owner)
    centre = tuple((mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2)
    above = View(centre, (-0.6, -0.9, 1.1), 21.0)
    below = View(centre, (-0.6, -0.9, -1.1), 21.0)
    images = [render(mesh.vertices, mesh.cells, owner, colours, view, (1200, 860), line=0.0) for view in (above, below)]
    colour_bar(images[0], low, high, "C_p, Mach 0.7, 2 degrees")
    beside(images, 2).save(folder / "panel-e175.png")


def page(found: Validation) -> str:
    """The page validation.md."""
    lines = [
        "# Validation of the panel method",
        "",
        "Written by `cargo xtask validate-panel`: measured on 2 cores, through `moldline panel serve` and its Python "
        "client, beside the goals and published values.",
        "",
        "| quantity | result | unit | goal | published | reached |",
        "|---|---|---|---|---|---|",
    ]
    lines += [f"| {' | '.join(cells)} |" for cells in map(printed, found.rows)]
    lines += ["", "![closed forms](images/panel-closed-forms.png)", "", "![E175](images/panel-e175.png)", ""]
    for name, table in found.tables.items():
        lines += [f"## {name[0].upper()}{name[1:]}", "", f"| {' | '.join(table[0])} |", "|---" * len(table[0]) + "|"]
        lines += [f"| {' | '.join(f'{value:.5g}' for value in row.values())} |" for row in table]
        lines.append("")
    return "\n".join([*lines, (HERE / "remarks.md").read_text()])


def printed(row: Row) -> list[str]:
    if row.least is not None and row.most is not None:
        goal = f"{row.least:.4g} to {row.most:.4g}"
    elif row.least is not None:
        goal = f">= {row.least:.4g}"
    else:
        goal = "" if row.most is None else f"<= {row.most:.4g}"
    peer = "" if row.peer is None else f"{row.peer:.4g}"
    return [row.name, f"{row.value:.4g}", row.unit, goal, peer, {None: "", True: "yes", False: "**no**"}[row.reached]]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="the moldline program; it is started")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--docs", type=Path, help="folder of the documents, to write validation.md to")
    arguments = parser.parse_args()
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    with (
        Server(arguments.binary, out / "mesh-service.log") as mesh_server,
        Server(arguments.binary, out / "panel-service.log", command=("panel", "serve")) as panel_server,
        moldline.Client(mesh_server.address) as meshes,
        moldline.panel.Client(panel_server.address) as panels,
    ):
        found = Validation(panels, lambda line: print(line, flush=True))
        found.ellipsoids()
        found.wings()
        found.aircraft(meshes.create_setup(E175), mach=0.7)
    report = {
        "cores": os.cpu_count(),
        "rows": [asdict(row) | {"reached": row.reached} for row in found.rows],
        "tables": found.tables,
    }
    (out / "validation.json").write_text(json.dumps(report, indent=1) + "\n")
    draw(found, out)
    if arguments.docs:
        (arguments.docs / "validation.md").write_text(page(found))
        draw(found, arguments.docs / "images")
    missed = [row.name for row in found.rows if row.reached is False]
    print(
        f"\n{sum(row.reached is True for row in found.rows)} goals reached, {len(missed)} missed: {'; '.join(missed)}"
    )
    print(f"written to {out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
