"""A rectangular wing for the panel service."""

from __future__ import annotations

import numpy as np


def wing(around: int = 16, stations: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The starboard half of a rectangular NACA 0012 wing of aspect ratio 8 with a flat tip: vertices, cells and
    trailing edge."""
    theta = 2 * np.pi * np.arange(around) / around
    x = 0.5 * (1 + np.cos(theta))
    t = 0.6 * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    t[[0, around // 2]] = 0
    section = np.column_stack([x, np.where(theta < np.pi, -t, t)])
    y = 4 * np.sin(0.5 * np.pi * np.arange(stations + 1) / stations)
    vertices = np.array([[px, py, pz] for py in y for px, pz in section])

    def at(i: int, j: int) -> int:
        return j * around + i % around

    cells = [[at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)] for j in range(stations) for i in range(around)]
    for i in range(around // 2):
        ring = [at(i, stations), at(i + 1, stations), at(around - i - 1, stations), at(around - i, stations)]
        ring = list(dict.fromkeys(ring))
        cells.append([*ring, 0xFFFFFFFF] if len(ring) == 3 else ring)
    return vertices, np.array(cells, dtype=np.uint32), np.array([at(0, j) for j in range(stations + 1)])
