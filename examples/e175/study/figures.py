"""The study's figures, after Figs. 8 to 11 of the paper."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).resolve().parents[3] / "xtask/scripts/demo"))

from render import NO_VERTEX, View, beside, render, text  # the demo's renderer

Array = NDArray[np.float64]

#: Sections are drawn at these fractions of the half span.
STATIONS = (0.15, 0.41, 0.7, 0.95)
#: Pressure coefficients at the ends of the colour scale.
PRESSURE = (-1.2, 0.8)
COLOURS = {"baseline": "#8a8f98", "without": "#c4501f", "with": "#1f5fa8"}
TITLES = {"baseline": "baseline, trimmed", "without": "without static margin", "with": "static margin 5 %"}


@dataclass(frozen=True)
class Shape:
    """A design to draw."""

    vertices: Array
    #: (m, 4); a triangle's fourth entry is NO_VERTEX.
    cells: NDArray[np.uint32]
    #: Name of the component of each cell.
    owner: NDArray[np.str_]
    #: Pressure coefficient of each cell.
    pressure: Array

    def corners(self, chosen: NDArray[np.bool_]) -> Array:
        """(k, 4, 3); triangles repeat a corner."""
        cells = self.cells[chosen]
        return self.vertices[np.where(cells == NO_VERTEX, cells[:, 2:3], cells)]


def convergence(path: Path, runs: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Fig. 8: constraints above, optimality and infeasibility below, a column for each problem."""
    size = (5.5 * len(runs), 6.4)
    figure, axes = plt.subplots(2, len(runs), figsize=size, sharex="col", squeeze=False, layout="constrained")
    for column, (run, iterates) in enumerate(runs.items()):
        above, below = axes[:, column]
        numbers = [iterate["iteration"] for iterate in iterates]
        for name in iterates[0]["constraints"]:
            values = [iterate["constraints"][name] for iterate in iterates]
            above.plot(numbers, values, ".-", label=name.replace("_", " "))
        above.set_title(TITLES[run])
        above.set_yscale("symlog", linthresh=1e-4)
        above.legend(fontsize=7)
        for name in ("optimality", "infeasibility"):
            below.semilogy(numbers, [max(iterate[name], 1e-16) for iterate in iterates], ".-", label=name)
        below.set_xlabel("iteration")
        below.legend(fontsize=8)
        for axis in (above, below):
            axis.grid(alpha=0.3)
    axes[0, 0].set_ylabel("constraints, scaled")
    axes[1, 0].set_ylabel("residuals, scaled")
    _save(figure, path)


def planforms(path: Path, shapes: Mapping[str, Shape]) -> None:
    """Fig. 9: the optimized designs over the baseline, from above."""
    optimised = [name for name in shapes if name != "baseline"]
    figure, axes = plt.subplots(
        1, len(optimised), figsize=(6 * len(optimised), 5.4), sharey=True, squeeze=False, layout="constrained"
    )
    for axis, name in zip(axes[0], optimised, strict=True):
        for each, alpha in (("baseline", 1.0), (name, 0.55)):
            shape = shapes[each]
            upper = shape.corners(_upward(shape))[:, :, 1::-1]
            colour = COLOURS[each]
            axis.add_collection(PolyCollection(upper, facecolor=colour, edgecolor=colour, linewidth=0.2, alpha=alpha))
            axis.plot([], [], color=colour, linewidth=6, label=TITLES[each])
        axis.set_aspect("equal")
        axis.set_xlim(-15.5, 15.5)
        axis.set_ylim(33, -1)
        axis.set_xlabel("y, m")
        axis.legend(loc="lower left", fontsize=8)
    axes[0, 0].set_ylabel("x, m")
    _save(figure, path)


def sections(path: Path, shapes: Mapping[str, Shape]) -> None:
    """Fig. 10: sections of the wing, each shape's from its own leading edge, in fractions of its chord."""
    figure, axes = plt.subplots(2, 2, figsize=(11, 5.2), sharex=True, sharey=True, layout="constrained")
    for axis, station in zip(axes.ravel(), STATIONS, strict=True):
        for name, shape in shapes.items():
            lines = _section(shape, station)[:, :, [0, 2]]
            corner = lines.reshape(-1, 2)
            leading, trailing = corner[corner[:, 0].argmin()], corner[corner[:, 0].argmax()]
            scaled = (lines - leading) / (trailing[0] - leading[0])
            axis.add_collection(LineCollection(scaled, color=COLOURS[name], linewidth=1.6))
            axis.plot([], [], color=COLOURS[name], label=TITLES[name])
        axis.set_title(f"{100 * station:g} % of the half span", fontsize=9)
        axis.set_xlim(-0.03, 1.03)
        axis.set_ylim(-0.2, 0.17)
        axis.set_aspect("equal")
        axis.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=8)
    figure.supxlabel("x / c")
    figure.supylabel("z / c")
    _save(figure, path)


def pressures(path: Path, shapes: Mapping[str, Shape]) -> None:
    """Fig. 11: pressure coefficients from above, from below and from the front."""
    scale = matplotlib.colormaps["RdYlBu"]
    views = {
        "from above": View((16.0, 0.0, 1.0), (0.0, 0.0, 1.0), 33.0, up=(-1.0, 0.0, 0.0)),
        "from below": View((16.0, 0.0, 1.0), (0.0, 0.0, -1.0), 33.0, up=(-1.0, 0.0, 0.0)),
        "from ahead": View((16.0, 0.0, 1.0), (-0.72, 0.55, 0.42), 22.0),
    }
    images = []
    for row, (where, view) in enumerate(views.items()):
        for name, shape in shapes.items():
            share = np.clip((shape.pressure - PRESSURE[0]) / (PRESSURE[1] - PRESSURE[0]), 0, 1)
            colours = scale(share)[:, :3]
            owner = np.unique(shape.owner, return_inverse=True)[1].astype(np.uint32)
            image = render(
                shape.vertices, shape.cells, owner, colours, view, (620, 640 if row < 2 else 420), line=0, seam_line=0
            )
            text(image, (14, 12), f"{TITLES[name]}, {where}", 20)
            images.append(image)
    count = len(shapes)
    rows = [beside(images[k * count : (k + 1) * count], count) for k in range(len(views))]
    figure, axes = plt.subplots(
        len(rows), 1, figsize=(rows[0].width / 130, sum(r.height for r in rows) / 130),
        height_ratios=[r.height for r in rows], layout="constrained",
    )  # fmt: skip
    for axis, picture in zip(axes, rows, strict=True):
        axis.imshow(picture)
        axis.axis("off")
    norm = matplotlib.colors.Normalize(*PRESSURE)
    figure.colorbar(matplotlib.cm.ScalarMappable(norm, scale), ax=axes, label="pressure coefficient", shrink=0.5)
    _save(figure, path, dpi=130)


def _upward(shape: Shape) -> NDArray[np.bool_]:
    corners = shape.corners(np.ones(len(shape.cells), bool))
    diagonals = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    return np.asarray(np.cross(*diagonals)[:, 2] > 0)


def _section(shape: Shape, station: float) -> Array:
    """Where the plane at a fraction of the half span cuts the wing's cells: (k, 2, 3)."""
    corners = shape.corners(shape.owner == "wing")
    y = station * corners[:, :, 1].max()
    cuts = []
    for side in range(4):
        a, b = corners[:, side], corners[:, (side + 1) % 4]
        crosses = (a[:, 1] <= y) != (b[:, 1] <= y)
        share = (y - a[:, 1]) / np.where(crosses, b[:, 1] - a[:, 1], 1.0)
        cuts.append(np.where(crosses[:, None], a + share[:, None] * (b - a), np.nan))
    points = np.stack(cuts, axis=1)
    found = ~np.isnan(points[:, :, 0])
    through = found.sum(axis=1) == 2
    return points[through][found[through]].reshape(-1, 2, 3)


def _save(figure: plt.Figure, path: Path, dpi: int = 160) -> None:
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
