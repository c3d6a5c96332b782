"""Closed meshes with known flows, in numpy: float64 (n, 3) vertices in metres, uint32 (m, 4) cells as the client's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render import NO_VERTEX

Array = NDArray[np.float64]
Cells = NDArray[np.uint32]


def sphere(n: int) -> tuple[Array, Cells]:
    """The unit sphere as a cube whose faces have `n` by `n` cells, equal in angle."""
    angle = np.tan(np.pi / 4 * (2 * np.arange(n + 1) / n - 1))
    corners = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            grid = np.empty((n + 1, n + 1, 3))
            grid[..., axis] = side
            grid[..., (axis + 1) % 3], grid[..., (axis + 2) % 3] = np.meshgrid(angle, angle, indexing="ij")
            quads = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 4, 3)
            corners.append(quads if side > 0 else quads[:, ::-1])
    points = np.concatenate(corners).reshape(-1, 3)
    points /= np.linalg.norm(points, axis=1)[:, None]
    _, first, index = np.unique(np.round(points, 9), axis=0, return_index=True, return_inverse=True)
    return points[first], index.reshape(-1, 4).astype(np.uint32)


def globe(n: int) -> tuple[Array, Cells]:
    """The unit sphere by longitude and latitude, 3 `n` around and 2 `n` from pole to pole, which are at z = -1 and 1."""
    theta, phi = np.pi * np.arange(1, 2 * n) / (2 * n), 2 * np.pi * np.arange(3 * n) / (3 * n)
    rings = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.sin(theta), np.sin(phi)),
            np.outer(np.cos(theta), np.ones(3 * n)),
        ],
        axis=-1,
    )
    vertices = np.concatenate([rings.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    index = np.arange(rings.shape[0] * rings.shape[1]).reshape(rings.shape[:2])
    turned = np.roll(index, -1, axis=1)
    none = np.full(3 * n, NO_VERTEX)
    north, south = np.full(3 * n, len(vertices) - 2), np.full(3 * n, len(vertices) - 1)
    cells = [
        np.stack([index[:-1], index[1:], turned[1:], turned[:-1]], axis=-1).reshape(-1, 4),
        np.stack([north, index[0], turned[0], none], axis=-1),
        np.stack([south, turned[-1], index[-1], none], axis=-1),
    ]
    return vertices, np.concatenate(cells).astype(np.uint32)


@dataclass(frozen=True)
class Wing:
    """A wing with NACA 0012 sections, a sharp trailing edge and flat tips. Cells lie closer towards edges and tips."""

    half_span: float = 4.0
    #: Of the share of the half span, -1 to 1, m.
    chord: Callable[[Array], Array] = np.ones_like
    leading_edge: Callable[[Array], Array] = np.zeros_like
    #: Where the tips are cut off, as a share of the half span.
    cut: float = 1.0

    def mesh(self, around: int, along: int) -> tuple[Array, Cells]:
        """`around` cells around the section, `along` along the span; both even."""
        eta = -self.cut * np.cos(np.pi * np.arange(along + 1) / along)
        eta[along // 2] = 0.0
        theta = 2 * np.pi * np.arange(around) / around
        x = 0.5 * (1 + np.cos(theta))
        # The last coefficient makes the trailing edge sharp.
        z = 0.6 * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
        z[[0, around // 2]] = 0.0
        z[: around // 2] *= -1
        chord, edge = self.chord(eta)[:, None], self.leading_edge(eta)[:, None]
        y = np.broadcast_to(self.half_span * eta[:, None], (along + 1, around))
        vertices = np.stack([edge + chord * x, y, chord * z], axis=-1).reshape(-1, 3)
        index = np.arange(len(vertices)).reshape(along + 1, around)
        turned = np.roll(index, -1, axis=1)
        cells = [np.stack([index[:-1], turned[:-1], turned[1:], index[1:]], axis=-1).reshape(-1, 4)]
        lower, upper = np.arange(around // 2 + 1), -np.arange(around // 2 + 1) % around
        for ring, turn in ((index[0], True), (index[-1], False)):
            a, b, c, d = ring[lower[:-1]], ring[lower[1:]], ring[upper[1:]], ring[upper[:-1]]
            # At the two edges of the section a side has no length.
            d = np.where(a == d, NO_VERTEX, d)
            c, d = np.where(b == c, d, c), np.where(b == c, NO_VERTEX, d)
            tip = np.stack([a, b, c, d], axis=-1)
            if turn:
                triangles = tip[:, 3] == NO_VERTEX
                tip[triangles, :3] = tip[triangles, 2::-1]
                tip[~triangles] = tip[~triangles, ::-1]
            cells.append(tip)
        return vertices, np.concatenate(cells).astype(np.uint32)

    def area(self, along: int) -> float:
        """Of the planform of the mesh, m^2."""
        eta = -self.cut * np.cos(np.pi * np.arange(along + 1) / along)
        return float(np.trapezoid(self.chord(eta), self.half_span * eta))
