"""A half model, open at the symmetry plane, of patches as other programs write them; quads and triangles.

    python make.py        writes geometry/*.json and mesh.msh (MSH 2.2) beside this file

- `fuselage`: one rational patch, degree 3 along the axis and 2 around it: an exact surface of revolution. Its circle is four
  rational arcs with knots of multiplicity 2 = degree: C0 in the parameter, yet smooth.
- `wing`: one skin patch of degree 3 around the section and 2 along the span, with knots of multiplicity = degree at the
  leading edge (smooth) and at the span stations, where the panels meet at an angle (real creases); and two flat
  caps of degree 3 x 1. The skin meets itself in the sharp trailing edge.
The components are whole; the mesh is the starboard half of their union.
"""

import json
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import union  # noqa: E402
from bspline import Component, Patch, clamped_knots, greville, interpolate  # noqa: E402  (found through union)
from geometry import section_profile  # noqa: E402

# fuselage control sections: x, centre z, radius
FUSELAGE = (
    (0.0, 0.00, 0.00),
    (0.0, 0.00, 0.35),
    (0.6, 0.00, 0.62),
    (1.8, 0.00, 0.70),
    (3.5, 0.00, 0.70),
    (5.0, 0.02, 0.70),
    (6.6, 0.15, 0.45),
    (8.0, 0.30, 0.22),
    (8.2, 0.32, 0.00),
)
# wing stations: y, leading edge x and z, chord, twist in degrees, thickness
WING = ((0.0, 2.6, -0.25, 1.9, 2.0, 0.14), (1.6, 3.1, -0.12, 1.3, 1.0, 0.13), (4.0, 4.2, 0.15, 0.6, -1.0, 0.11))
SECTION_SPANS = 8


def fuselage():
    """Full circle of nine control points in the weights 1, 1/sqrt(2); bottom, port, top, starboard."""
    around = np.array([(0, -1), (-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1)], float)
    weights = np.where(np.arange(9) % 2, np.sqrt(0.5), 1.0)
    sections = np.array(FUSELAGE)
    net = np.empty((len(sections), 9, 3))
    net[:, :, 0] = sections[:, :1]
    net[:, :, 1] = sections[:, 2:] * around[:, 0]
    net[:, :, 2] = sections[:, 1:2] + sections[:, 2:] * around[:, 1]
    knots_u = clamped_knots(np.linspace(0, 1, len(sections) - 2), 3)
    knots_v = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4]) / 4
    return Component("fuselage", [Patch("body", 3, 2, knots_u, knots_v, net, np.tile(weights, (len(sections), 1)))])


def section():
    """Control points (x, z) and knots of the unit section, with a knot of multiplicity 3 at the leading edge."""
    knots, control = section_profile(SECTION_SPANS)
    lower_edge = np.searchsorted(knots, 0.0)
    split = np.concatenate([knots[:lower_edge], [0.0] * 3, knots[lower_edge + 1 :]])
    # the finer spline space holds the curve: take it at the new Greville abscissae
    values = BSpline(knots, control, 3)(greville(split, 3))
    return (split + 1) / 2, interpolate(split, 3, values)


def wing():
    knots_u, profile = section()
    stations = [(-y, *rest) for y, *rest in WING[:0:-1]] + [tuple(s) for s in WING]
    rows = []
    for y, x, z, chord, twist, thickness in stations:
        angle = np.radians(twist)
        px, pz = (profile[:, 0] - 0.25) * chord, profile[:, 1] * thickness * chord
        rows.append(
            np.stack(
                [
                    x + 0.25 * chord + px * np.cos(angle) + pz * np.sin(angle),
                    np.full(len(px), y),
                    z - px * np.sin(angle) + pz * np.cos(angle),
                ],
                -1,
            )
        )
    # straight panels, raised to degree 2: station, middle, station, ...
    net = [rows[0]]
    for inner, outer in pairwise(rows):
        net += [0.5 * (inner + outer), outer]
    net = np.stack(net, axis=1)
    net[0] = net[-1] = 0.5 * (net[0] + net[-1])
    panels = len(stations) - 1
    knots_v = np.concatenate([[0, 0, 0], np.repeat(np.arange(1, panels), 2), [panels] * 3]) / panels
    skin = Patch("skin", 3, 2, knots_u, knots_v, net)

    middle = len(profile) // 2  # the leading edge's control point
    half_knots = knots_u[knots_u <= 0.5]
    half_knots = np.append(half_knots, 0.5)
    caps = []
    for name, side in (("tip_port", 0), ("tip_starboard", -1)):
        low, high = net[: middle + 1, side], net[middle:, side][::-1]
        cap = Patch(name, 3, 1, half_knots, np.array([0.0, 0, 1, 1]), np.stack([low, high], axis=1))
        caps.append(cap if side == -1 else cap.reversed_u())
    return Component("wing", [skin, *caps])


def size(x, y, z):
    """Finer along the wing's span and at the fuselage's ends."""
    return min(
        0.13,
        0.05 + 0.12 * x,
        0.035 + 0.12 * abs(8.2 - x),
        max(0.04, 0.09 - 0.018 * max(0.0, y - 0.7)) + 0.5 * max(0.0, 0.6 - y),
    )


def main():
    made = [fuselage(), wing()]
    (HERE / "geometry").mkdir(exist_ok=True)
    for component in made:
        component.save(HERE / "geometry" / f"{component.name}.json")
    mesh = union.mesh_union(made, size, quads=True, half=True)
    union.write_msh22(HERE / "mesh.msh", mesh)
    print(json.dumps(union.check(made, mesh, half=True), indent=1))


if __name__ == "__main__":
    main()
