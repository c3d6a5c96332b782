"""Optimises the shape of quads on a B-spline patch, moving vertices along the surface.

Each corner of a quad with edge vectors e1, e2 and target lengths l1, l2 (only their ratio counts) is measured by
m = (|e1|^2/l1^2 + |e2|^2/l2^2) l1 l2 / (2 n.(e1 x e2)), the inverse mean ratio of the map from the target corner: 1 for the
target shape, infinite for a flat one. The sum of m^3 is minimised by L-BFGS over moves in the vertices' tangent planes,
followed by projection, a few times over.
"""

import numpy as np
from scipy.optimize import minimize

import quality

POWER = 3
SMALLEST_GAIN = 2e-4  # of the mean measure in one round; less than that ends the optimisation
OFF_POLE = 1e-6  # in u: where the normal of a pole is taken


def _energy(vertices, normals, cells, target, floor):
    """Sum of m^POWER over all corners, and its gradient [vertex, 3]."""
    total, gradient = 0.0, np.zeros_like(vertices)
    for corner in range(4):
        here, ahead, behind = cells[:, corner], cells[:, (corner + 1) % 4], cells[:, (corner + 3) % 4]
        e1, e2, n = vertices[ahead] - vertices[here], vertices[behind] - vertices[here], normals[here]
        # edges 0 and 2 run along the block's first direction, whose target length is `target` times the other's
        s1, s2 = (1 / target, target) if corner % 2 == 0 else (target, 1 / target)
        twist = (n * np.cross(e1, e2)).sum(1)
        root = np.sqrt(twist**2 + floor**2)
        area = 0.5 * (twist + root)  # stays positive, so that a folded start unfolds
        numerator = (e1 * e1).sum(1) * s1 + (e2 * e2).sum(1) * s2
        m = numerator / (2 * area)
        total += (m**POWER).sum()
        outer = POWER * m ** (POWER - 1)
        along = (outer / area)[:, None]
        against = (outer * m / area * 0.5 * (1 + twist / root))[:, None]
        g1 = along * s1[:, None] * e1 - against * np.cross(e2, n)
        g2 = along * s2[:, None] * e2 - against * np.cross(n, e1)
        for axis in range(3):
            gradient[:, axis] += np.bincount(ahead, g1[:, axis], len(vertices)) + np.bincount(
                behind, g2[:, axis], len(vertices)
            )
            gradient[:, axis] -= np.bincount(here, g1[:, axis] + g2[:, axis], len(vertices))
    return total, gradient


def optimise(patch, u, v, cells, target, fixed, on_meridian, rounds, steps=25, log=None):
    """Parameters (u, v) after optimisation. Cells wind about the outward normal.

    target: wanted ratio of the lengths of edges 0 and 2 over edges 1 and 3, per cell. fixed: vertices that stay.
    on_meridian: vertices that keep their v and y = 0 exactly.
    """
    u, v = u.copy(), v.copy()
    u0, u1, _, _ = patch.domain
    free = ~fixed
    mean = np.inf
    for round_ in range(rounds):
        jet = patch.jet(u, v)
        x, normal = jet.position, patch.jet(np.clip(u, u0 + OFF_POLE, u1 - OFF_POLE), v).unit_normal()
        first = jet.u / np.maximum(np.linalg.norm(jet.u, axis=1), 1e-300)[:, None]
        second = np.cross(normal, first)
        first[fixed] = second[fixed] = second[on_meridian] = 0
        size = np.abs((quality.area_normal(x, cells) * normal[cells[:, 0]]).sum(1))
        floor = 0.02 * size

        def objective(moves, x=x, first=first, second=second, normal=normal, floor=floor):
            a, b = moves.reshape(2, -1, 1)
            value, gradient = _energy(x + a * first + b * second, normal, cells, target, floor)
            return value, np.concatenate([(gradient * first).sum(1), (gradient * second).sum(1)])

        result = minimize(
            objective, np.zeros(2 * len(x)), jac=True, method="L-BFGS-B", options=dict(maxiter=steps, maxcor=20)
        )
        a, b = result.x.reshape(2, -1, 1)
        moved = x + a * first + b * second
        new_u, new_v, _ = patch.refine(moved[free], u[free], v[free])
        u[free] = new_u
        v[free] = np.where(on_meridian[free], v[free], new_v)
        before, mean = mean, (result.fun / (4 * len(cells))) ** (1 / POWER)
        if log:
            log(f"optimise {round_}: mean measure {mean:.4f}, largest move {np.abs(result.x).max():.3f} m")
        if before - mean < SMALLEST_GAIN:
            break
    return u, v
