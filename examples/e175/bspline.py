"""Tensor-product B-spline patches in numpy: evaluation, closest points, and the JSON form of a component.

A patch is S(u, v) = sum_ij N_i(u) N_j(v) w_ij P_ij / sum_ij N_i(u) N_j(v) w_ij. A component is a list of patches that
close a body, with S_u x S_v pointing out of it. All functions work on arrays of parameters, one entry per point.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

POLE_TOLERANCE = 1e-9  # m; a boundary row shorter than this is a pole


def clamped_knots(breaks, degree=3):
    """Knot vector over the given distinct breaks, with end knots of multiplicity degree + 1."""
    breaks = np.asarray(breaks, float)
    return np.concatenate([[breaks[0]] * degree, breaks, [breaks[-1]] * degree])


def greville(knots, degree):
    """Greville abscissae: the parameter that belongs to each control point."""
    return np.array([knots[i + 1 : i + degree + 1].mean() for i in range(len(knots) - degree - 1)])


def interpolate(knots, degree, values, at=None):
    """Control points of the spline that takes `values` (first axis) at its Greville abscissae, or at `at`."""
    at = greville(knots, degree) if at is None else at
    matrix = BSpline.design_matrix(at, knots, degree).toarray()
    values = np.asarray(values, float)
    return np.linalg.solve(matrix, values.reshape(len(at), -1)).reshape(values.shape)


def basis_functions(knots, degree, x, derivatives=2):
    """Non-zero basis functions at each x: index of the first, and values as [derivative, point, function]."""
    count = len(knots) - degree - 1
    x = np.clip(x, knots[degree], knots[count])
    span = np.clip(np.searchsorted(knots, x, side="right") - 1, degree, count - 1)
    tables = [np.ones((len(x), 1))]  # tables[d][:, r] = N_{span-d+r} of degree d
    for d in range(1, degree + 1):
        table = np.zeros((len(x), d + 1))
        for r in range(d):
            i = span - d + 1 + r
            scaled = tables[-1][:, r] / (knots[i + d] - knots[i])
            table[:, r] += (knots[i + d] - x) * scaled
            table[:, r + 1] += (x - knots[i]) * scaled
        tables.append(table)
    values = [tables[degree]]
    for order in range(1, derivatives + 1):
        if order > degree:
            values.append(np.zeros_like(values[0]))
            continue
        derivative = tables[degree - order]
        for d in range(degree - order + 1, degree + 1):
            raised = np.zeros((len(x), d + 1))
            for r in range(d):
                i = span - d + 1 + r
                slope = d * derivative[:, r] / (knots[i + d] - knots[i])
                raised[:, r] -= slope
                raised[:, r + 1] += slope
            derivative = raised
        values.append(derivative)
    return span - degree, np.stack(values)


@dataclass
class Jet:
    """Position and derivatives of a surface at a list of parameters, each [point, 3]."""

    position: np.ndarray
    u: np.ndarray
    v: np.ndarray
    uu: np.ndarray
    uv: np.ndarray
    vv: np.ndarray

    def where(self, condition, other):
        """Rows of self where the condition holds, of other elsewhere."""
        return Jet(*(np.where(condition[:, None], a, b) for a, b in zip(vars(self).values(), vars(other).values())))

    def take(self, rows):
        return Jet(*(a[rows] for a in vars(self).values()))

    def unit_normal(self):
        n = np.cross(self.u, self.v)
        return n / np.maximum(np.linalg.norm(n, axis=1), 1e-300)[:, None]


@dataclass
class Foot:
    """Closest points: distance >= 0, patch index, parameters and position, one row per query."""

    distance: np.ndarray
    patch: np.ndarray
    u: np.ndarray
    v: np.ndarray
    position: np.ndarray


@dataclass
class Patch:
    """One untrimmed B-spline patch; control_points[i][j] with i along u; weights None if not rational."""

    name: str
    degree_u: int
    degree_v: int
    knots_u: np.ndarray
    knots_v: np.ndarray
    control_points: np.ndarray
    weights: np.ndarray | None = None

    def __post_init__(self):
        self.knots_u, self.knots_v = np.asarray(self.knots_u, float), np.asarray(self.knots_v, float)
        self.control_points = np.asarray(self.control_points, float)
        expected = (len(self.knots_u) - self.degree_u - 1, len(self.knots_v) - self.degree_v - 1, 3)
        if self.control_points.shape != expected:
            raise ValueError(f"{self.name}: control points are {self.control_points.shape}, the knots need {expected}")

    @property
    def domain(self):
        """(u0, u1, v0, v1)"""
        p, q = self.degree_u, self.degree_v
        return self.knots_u[p], self.knots_u[-p - 1], self.knots_v[q], self.knots_v[-q - 1]

    def jet(self, u, v) -> Jet:
        """Position with first and second derivatives."""
        u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        first_u, basis_u = basis_functions(self.knots_u, self.degree_u, u)
        first_v, basis_v = basis_functions(self.knots_v, self.degree_v, v)
        rows = first_u[:, None, None] + np.arange(self.degree_u + 1)[:, None]
        columns = first_v[:, None, None] + np.arange(self.degree_v + 1)
        net = self.control_points[rows, columns]
        if self.weights is not None:
            w = np.asarray(self.weights, float)[rows, columns][..., None]
            net = np.concatenate([net * w, w], axis=-1)
        along_v = np.einsum("nijk,dnj->dnik", net, basis_v)
        value = {
            (a, b): np.einsum("nik,ni->nk", along_v[b], basis_u[a])
            for a, b in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
        }
        if self.weights is not None:
            value = _quotient(value)
        return Jet(*value.values())

    def position(self, u, v):
        return self.jet(np.atleast_1d(u), np.atleast_1d(v)).position

    def split_u(self, at, names):
        """The two halves on either side of the parameter `at`, exactly (knot insertion)."""
        halves = []
        for name, inner in zip(names, (self.knots_u < at, self.knots_u > at)):
            ends = [at] * (self.degree_u + 1)
            knots = np.concatenate(
                [self.knots_u[inner], ends] if self.knots_u[inner][0] < at else [ends, self.knots_u[inner]]
            )
            values = BSpline(self.knots_u, self.control_points, self.degree_u)(greville(knots, self.degree_u))
            net = interpolate(knots, self.degree_u, values)
            halves.append(Patch(name, self.degree_u, self.degree_v, knots, self.knots_v, net))
        return halves

    def reversed_u(self):
        """The same surface with u running backwards, so that the normal changes sides."""
        knots = (self.knots_u[0] + self.knots_u[-1]) - self.knots_u[::-1]
        weights = None if self.weights is None else np.asarray(self.weights)[::-1]
        return Patch(self.name, self.degree_u, self.degree_v, knots, self.knots_v, self.control_points[::-1], weights)

    @cached_property
    def _seeds(self):
        """Sample parameters (pulled off the poles, which carry no parameter information) and a tree of their points."""
        samples = []
        for knots, degree in ((self.knots_u, self.degree_u), (self.knots_v, self.degree_v)):
            breaks = np.unique(knots[degree : len(knots) - degree])
            samples.append(np.unique(np.concatenate([np.linspace(a, b, 7) for a, b in pairwise(breaks)])))
        us, vs = samples
        for end, inner in ((0, 1), (-1, -2)):
            if np.ptp(self.position(np.full(len(vs), us[end]), vs), axis=0).max() < POLE_TOLERANCE:
                us[end] += 0.1 * (us[inner] - us[end])
            if np.ptp(self.position(us, np.full(len(us), vs[end])), axis=0).max() < POLE_TOLERANCE:
                vs[end] += 0.1 * (vs[inner] - vs[end])
        u, v = (grid.ravel() for grid in np.meshgrid(us, vs, indexing="ij"))
        return u, v, cKDTree(self.position(u, v))

    def closest(self, points, within=np.inf, starts=3) -> Foot:
        """Closest points by damped Newton from the nearest samples; beyond `within` only the sample itself (a bound)."""
        points = np.asarray(points, float)
        seed_u, seed_v, tree = self._seeds
        distance, nearest = tree.query(points, k=np.arange(1, starts + 1))
        best = Foot(
            distance[:, 0].copy(),
            np.zeros(len(points), int),
            seed_u[nearest[:, 0]],
            seed_v[nearest[:, 0]],
            tree.data[nearest[:, 0]].copy(),
        )
        rows = np.flatnonzero(distance[:, 0] < within)
        for start in range(starts):
            u, v, x = self.refine(points[rows], seed_u[nearest[rows, start]], seed_v[nearest[rows, start]])
            d = np.linalg.norm(x - points[rows], axis=1)
            better = d < best.distance[rows]
            hit = rows[better]
            best.distance[hit], best.u[hit], best.v[hit], best.position[hit] = (
                d[better],
                u[better],
                v[better],
                x[better],
            )
        return best

    def refine(self, points, u, v, iterations=60):
        """Closest points from the given starts: Newton with damping, inside the domain."""
        u0, u1, v0, v1 = self.domain
        u, v = np.array(u, float), np.array(v, float)
        position = np.zeros_like(points)
        active = np.arange(len(points))
        damping = np.full(len(points), 1e-3)
        jet = self.jet(u, v) if len(points) else None
        for iteration in range(iterations):
            if not len(active):
                break
            r = jet.position - points[active]
            dot = lambda a, b: (a * b).sum(1)
            a, b, c = dot(jet.u, jet.u), dot(jet.u, jet.v), dot(jet.v, jet.v)
            gu, gv = dot(jet.u, r), dot(jet.v, r)
            hessian = a + dot(jet.uu, r), b + dot(jet.uv, r), c + dot(jet.vv, r)
            convex = (hessian[0] > 0) & (hessian[2] > 0) & (hessian[0] * hessian[2] - hessian[1] ** 2 > 1e-10 * a * c)
            a, b, c = (np.where(convex, h, g) for h, g in zip(hessian, (a, b, c)))
            ua, va, lam = u[active], v[active], damping[active]
            hold_u = ((ua <= u0) & (gu > 0)) | ((ua >= u1) & (gu < 0))
            hold_v = ((va <= v0) & (gv > 0)) | ((va >= v1) & (gv < 0))
            a, c, b = a * (1 + lam) + 1e-16, c * (1 + lam) + 1e-16, np.where(hold_u | hold_v, 0, b)
            determinant = a * c - b * b
            next_u = np.clip(ua + np.where(hold_u, 0, -(c * gu - b * gv) / determinant), u0, u1)
            next_v = np.clip(va + np.where(hold_v, 0, -(a * gv - b * gu) / determinant), v0, v1)
            next_jet = self.jet(next_u, next_v)
            closer = dot(next_jet.position - points[active], next_jet.position - points[active]) <= dot(r, r)
            step = np.abs(next_u - ua) + np.abs(next_v - va)
            u[active], v[active] = np.where(closer, next_u, ua), np.where(closer, next_v, va)
            jet = next_jet.where(closer, jet)
            damping[active] = np.where(closer, lam * 0.1, np.minimum(lam * 10 + 1e-6, 1e8))
            done = (step < 1e-15) | (~closer & (lam > 1e4)) | (iteration == iterations - 1)
            position[active[done]] = jet.position[done]
            active, jet = active[~done], jet.take(~done)
        return u, v, position

    def to_dict(self):
        fields = dict(
            name=self.name,
            degree_u=self.degree_u,
            degree_v=self.degree_v,
            knots_u=self.knots_u.tolist(),
            knots_v=self.knots_v.tolist(),
            control_points=self.control_points.tolist(),
        )
        if self.weights is not None:
            fields["weights"] = np.asarray(self.weights).tolist()
        return fields


def _quotient(value):
    """Derivatives of A / w from those of (A, w)."""
    part = {key: (x[:, :3], x[:, 3:]) for key, x in value.items()}
    w = part[0, 0][1]
    s = {(0, 0): part[0, 0][0] / w}
    for key in ((1, 0), (0, 1)):
        s[key] = (part[key][0] - part[key][1] * s[0, 0]) / w
    for key, one, other in (((2, 0), (1, 0), (1, 0)), ((1, 1), (1, 0), (0, 1)), ((0, 2), (0, 1), (0, 1))):
        a, second = part[key]
        s[key] = (a - part[one][1] * s[other] - part[other][1] * s[one] - second * s[0, 0]) / w
    return s


@dataclass
class Component:
    """A closed body of patches."""

    name: str
    patches: list[Patch]

    def closest(self, points, within=np.inf, starts=3) -> Foot:
        """Closest points over all patches."""
        feet = [patch.closest(points, within, starts) for patch in self.patches]
        winner = np.argmin([f.distance for f in feet], axis=0)
        pick = lambda field: np.choose(
            winner if np.ndim(getattr(feet[0], field)) == 1 else winner[:, None], [getattr(f, field) for f in feet]
        )
        return Foot(pick("distance"), winner, pick("u"), pick("v"), pick("position"))

    def save(self, path):
        """Writes the component as JSON, numbers with all their digits."""
        text = json.dumps(
            dict(name=self.name, patches=[p.to_dict() for p in self.patches]), indent=None, separators=(",", ":")
        )
        Path(path).write_text(
            text.replace('{"name"', '\n{"name"').replace(',"control_points"', ',\n"control_points"') + "\n"
        )

    @staticmethod
    def load(path):
        data = json.loads(Path(path).read_text())
        return Component(data["name"], [Patch(**p) for p in data["patches"]])
