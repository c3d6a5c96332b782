"""Makes the E175: geometry/*.json, mesh.msh and report.json.

python make.py --cells 15000                  the committed example
python make.py --cells 100000 --out build     a fine mesh, elsewhere
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import check
import geometry
import mesh

HERE = Path(__file__).resolve().parent


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=15000, help="cells of the whole mesh, about (default 15000)")
    parser.add_argument("--out", type=Path, default=HERE, help="folder to write to (default: the example's own)")
    parser.add_argument("--verbose", action="store_true", help="report the progress of the mesh optimisation")
    arguments = parser.parse_args()

    start = time.perf_counter()
    say = lambda text: print(f"{time.perf_counter() - start:7.1f} s  {text}", flush=True)
    (arguments.out / "geometry").mkdir(parents=True, exist_ok=True)

    components = geometry.build()
    for component in components:
        component.save(arguments.out / "geometry" / f"{component.name}.json")
    say("geometry written")

    made = mesh.build(
        components, mesh.Counts.for_cells(arguments.cells), say if arguments.verbose else lambda text: None
    )
    path = arguments.out / "mesh.msh"
    mesh.write_msh(path, made)
    say(f"mesh of {len(made.cells)} cells written to {path}")

    report = check.report(components, made, path)
    (arguments.out / "report.json").write_text(json.dumps(report, indent=1) + "\n")
    total = report["quality"]["total"]["aspect_ratio"]
    say(
        f"checked: aspect ratio p95 {total['p95']:.3f}, max {total['max']:.2f}; failures: {report['failures'] or 'none'}"
    )
    return 1 if report["failures"] else 0


if __name__ == "__main__":
    sys.exit(main())
