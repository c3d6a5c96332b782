"""A boom through a wing, with a fairing on their junction: three components that meet in triple points; all triangles.

    python make.py        writes geometry/*.json and mesh.vtu beside this file

Nothing is symmetric. The boom and the fairing are bodies with poles; the fairing's axis is turned out of the boom's.
"""

import json
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import union  # noqa: E402
from bspline import Component  # noqa: E402  (found through union)
from geometry import Station, body, lifting_surface  # noqa: E402

WING = (
    Station(0.0, (0.00, 0.00), (1.00, -0.02), 0.13, 0.02),
    Station(2.0, (0.35, 0.08), (0.95, 0.07), 0.11, 0.02),
)
WING_BREAKS = (0.0, 0.25, 0.5, 1.0, 1.6, 1.8, 2.0)
# boom sections: x, centre z, half width, half height
BOOM = (
    (-0.9, 0.02, 0.000, 0.000),
    (-0.9, 0.02, 0.060, 0.060),
    (-0.7, 0.02, 0.120, 0.120),
    (-0.3, 0.02, 0.150, 0.150),
    (0.3, 0.02, 0.150, 0.150),
    (0.9, 0.02, 0.150, 0.150),
    (1.5, 0.02, 0.110, 0.110),
    (2.1, 0.02, 0.070, 0.070),
    (2.2, 0.02, 0.030, 0.030),
    (2.2, 0.02, 0.000, 0.000),
)
BOOM_Y = 0.6
FAIRING = (
    (-0.34, 0.0, 0.00, 0.00),
    (-0.34, 0.0, 0.10, 0.09),
    (-0.15, 0.0, 0.17, 0.13),
    (0.15, 0.0, 0.17, 0.13),
    (0.34, 0.0, 0.10, 0.09),
    (0.34, 0.0, 0.00, 0.00),
)
FAIRING_CENTRE = (0.42, 0.72, 0.13)
FAIRING_TURN = np.radians(15)  # about z


def components():
    boom = body("body", BOOM, 12)
    boom.control_points[..., 1] += BOOM_Y
    fairing = body("body", FAIRING, 12)
    c, s = np.cos(FAIRING_TURN), np.sin(FAIRING_TURN)
    fairing.control_points = fairing.control_points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + FAIRING_CENTRE
    return [lifting_surface("wing", WING, WING_BREAKS), Component("boom", [boom]), Component("fairing", [fairing])]


def size(x, y, z):
    """Fine at the fairing and the boom's ends, coarser along the wing."""
    to_fairing = np.linalg.norm(np.array([x, y, z]) - FAIRING_CENTRE)
    return min(0.040 + 0.08 * max(0.0, to_fairing - 0.4), 0.032 + 0.15 * (x + 0.9), 0.020 + 0.15 * (2.2 - x), 0.10)


def main():
    made = components()
    (HERE / "geometry").mkdir(exist_ok=True)
    for component in made:
        component.save(HERE / "geometry" / f"{component.name}.json")
    mesh = union.mesh_union(made, size, quads=False, half=False)
    union.write_vtu(HERE / "mesh.vtu", mesh)
    print(json.dumps(union.check(made, mesh, half=False), indent=1))


if __name__ == "__main__":
    main()
