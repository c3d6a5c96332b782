"""scipy's side of the interpolation benchmark: `python rbf.py FOLDER`, after the Rust side has written its data there.

Evaluates the same cubic interpolant with scipy's RBFInterpolator, whose coefficients are precomputed, and prints one JSON
object: the median seconds of an evaluation, and how far the two agree (largest difference over the largest value).
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np
from scipy.interpolate import RBFInterpolator

REPEATS = 5


def main() -> None:
    folder = Path(sys.argv[1])
    centres, points, data, values = (
        np.fromfile(folder / f"{name}.f64", dtype="<f8").reshape(-1, 3)
        for name in ("centres", "points", "data", "values")
    )
    interpolant = RBFInterpolator(centres, data, kernel="cubic", degree=1)
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        expected = interpolant(points)
        seconds.append(time.perf_counter() - start)
    difference = float(np.abs(values - expected).max() / np.abs(expected).max())
    print(json.dumps({"milliseconds": 1e3 * median(seconds), "difference": difference}))


if __name__ == "__main__":
    main()
