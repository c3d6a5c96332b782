"""Plots the sweeps of `cargo run --release -p moldline-check --example smoothness`: motion of vertices and its derivative.

python xtask/scripts/smoothness/plot.py [out/smoothness/smoothness.json] [docs/images/smoothness.png]
"""

import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np


def main() -> None:
    source = Path(sys.argv[1] if len(sys.argv) > 1 else "out/smoothness/smoothness.json")
    target = Path(sys.argv[2] if len(sys.argv) > 2 else "out/smoothness/smoothness.png")
    sweeps = [sweep for sweep in json.loads(source.read_text()) if sweep["outer_mold_line"] == "smooth"]
    figure, axes = plt.subplots(2, len(sweeps), figsize=(4.2 * len(sweeps), 6), sharex="col", layout="constrained")
    for column, sweep in enumerate(sweeps):
        values = np.array(sweep["values"])
        for course in sweep["vertices"]:
            side = np.sign(values - values[len(values) // 2])
            axes[0, column].plot(values, side * course["moved"], lw=1)
            derivative = np.linalg.norm(np.array(course["derivative"]), axis=1)
            axes[1, column].plot(values, derivative, lw=1, label=f"vertex {course['vertex']}")
        axes[0, column].set_title(f"{sweep['variable']}: {len(sweep['jumps'])} jumps")
        axes[1, column].set_xlabel(f"{sweep['variable']} [{sweep['unit']}]")
        axes[1, column].legend(fontsize="xx-small")
    axes[0, 0].set_ylabel("distance from mid-range place, signed [m]")
    axes[1, 0].set_ylabel("length of the derivative [m / unit]")
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=110)


if __name__ == "__main__":
    main()
