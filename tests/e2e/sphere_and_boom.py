"""A small set-up whose geometry is known in closed form: a boom (cylinder) along x that leaves a unit sphere.

The mesh is a body of revolution about x: along the sphere from its far pole to the seam, where both surfaces meet,
along the boom, and over its flat end to the axis. Quadrilaterals, with triangles at both poles.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

#: Cells around the axis; also the number of seam vertices.
SECTORS = 24
#: Radius of the boom, m; the sphere's is 1.
RADIUS = 0.4


def profile(rings: int, length: float) -> np.ndarray:
    """(x, r) from pole to pole, without the poles; (k, 2)."""
    seam_angle = np.arccos(RADIUS)  # of (sqrt(1 - r^2), r), from the pole at x = -1, less pi/2
    angles = np.linspace(0, np.pi / 2 + seam_angle, rings + 1)[1:]
    sphere = np.column_stack([-np.cos(angles), np.sin(angles)])
    sphere[-1] = np.sqrt(1 - RADIUS**2), RADIUS
    along = np.linspace(sphere[-1, 0], length, rings + 1)[1:]
    boom = np.column_stack([along, np.full(rings, RADIUS)])
    inward = np.linspace(RADIUS, 0, rings // 3 + 2)[1:-1]
    cap = np.column_stack([np.full(len(inward), length), inward])
    return np.vstack([sphere, boom, cap])


def mesh(rings: int = 12, length: float = 2.5) -> tuple[np.ndarray, list[list[int]]]:
    """Vertices (n, 3), m, and cells, counter-clockwise from outside."""
    turns = 2 * np.pi * np.arange(SECTORS) / SECTORS
    around = np.column_stack([np.sin(turns), np.cos(turns)])
    lines = profile(rings, length)
    body = [[x, r * s, r * c] for x, r in lines for s, c in around]
    vertices = np.array([*body, [-1, 0, 0], [length, 0, 0]])
    nose, end = len(body), len(body) + 1
    cells: list[list[int]] = []
    for sector in range(SECTORS):
        following = (sector + 1) % SECTORS
        cells.append([nose, sector, following])
        for ring in range(len(lines) - 1):
            near, far = ring * SECTORS, (ring + 1) * SECTORS
            cells.append([near + sector, far + sector, far + following, near + following])
        last = (len(lines) - 1) * SECTORS
        cells.append([last + sector, end, last + following])
    return vertices, cells


def document(length: float = 2.5) -> dict[str, Any]:
    """The set-up file's content."""

    def variable(name: str, bound: float) -> dict[str, Any]:
        return {"name": name, "unit": "m", "lower": -bound, "upper": bound}

    def translation(name: str, direction: list[float]) -> dict[str, Any]:
        return {"type": "translation", "components": ["boom"], "direction": direction, "variable": name}

    return {
        "format": 1,
        "name": "sphere and boom",
        "mesh": {"file": "mesh.msh"},
        "components": [
            {"name": "sphere", "primitive": {"type": "sphere", "center": [0, 0, 0], "radius": 1}},
            {
                "name": "boom",
                "primitive": {"type": "cylinder", "start": [0, 0, 0], "end": [length, 0, 0], "radius": RADIUS},
            },
        ],
        "parameterisation": {
            "variables": [variable("boom.translation", 0.5), variable("boom.lift", 0.2), variable("boom.far", 5)],
            "operations": [
                translation("boom.translation", [1, 0, 0]),
                translation("boom.lift", [0, 0, 1]),
                translation("boom.far", [1, 0, 0]),
            ],
        },
    }


def write(
    folder: Path,
    rings: int = 12,
    length: float = 2.5,
    change: Callable[[dict[str, Any], np.ndarray, list[list[int]]], None] = lambda document, vertices, cells: None,
) -> Path:
    """Writes the set-up as JSON with a Gmsh 2.2 mesh. `change` may spoil document, vertices and cells first."""
    folder.mkdir(parents=True, exist_ok=True)
    content = document(length)
    vertices, cells = mesh(rings, length)
    change(content, vertices, cells)
    (folder / "setup.json").write_text(json.dumps(content))
    if "file" in content["mesh"]:
        (folder / "mesh.msh").write_text(_msh(vertices, cells))
    return folder


def _msh(vertices: np.ndarray, cells: list[list[int]]) -> str:
    nodes = [f"{i} {x!r} {y!r} {z!r}" for i, (x, y, z) in enumerate(vertices.tolist(), 1)]
    kinds = {3: 2, 4: 3}
    elements = [
        f"{i} {kinds[len(cell)]} 2 0 1 {' '.join(str(vertex + 1) for vertex in cell)}"
        for i, cell in enumerate(cells, 1)
    ]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", str(len(nodes)), *nodes, "$EndNodes"]
    return "\n".join([*lines, "$Elements", str(len(elements)), *elements, "$EndElements", ""])
