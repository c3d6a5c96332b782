"""Kills servers, fills and spoils their disks, overloads them, and moves sessions from one to another.

    cargo xtask torture [--short]

Prints a table of results beside the goals, and writes it as JSON. Fails if a goal is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests" / "e2e"))

import disk  # noqa: E402
import kill  # noqa: E402
import load  # noqa: E402
import replicas  # noqa: E402
import trial  # noqa: E402
from trial import Row, Scale, Trial  # noqa: E402

TRIALS: dict[str, Callable[[Trial], list[Row]]] = {
    "kill": kill.kill,
    "disk": disk.full,
    "damage": disk.damaged,
    "load": load.load,
    "restart": replicas.restart,
    "two servers": replicas.replicas,
}


def run(name: str, binary: Path, folder: Path, scale: Scale) -> list[Row]:
    """One trial, in a folder of its own."""
    folder.mkdir(parents=True)
    return TRIALS[name](Trial(binary.resolve(), folder, scale))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="the moldline program")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "torture.json", help="file to write to")
    parser.add_argument("--short", action="store_true", help="less of everything: three minutes at most")
    parser.add_argument("--only", choices=TRIALS, action="append", help="only this trial; several times for several")
    arguments = parser.parse_args()
    results: dict[str, list[Row]] = {}
    seconds: dict[str, float] = {}
    folder = Path(tempfile.mkdtemp(prefix="moldline-torture-"))
    try:
        scale = (trial.short if arguments.short else trial.whole)(folder)
        for name in arguments.only or TRIALS:
            print(f"==> {name}", flush=True)
            start = time.perf_counter()
            try:
                results[name] = run(name, arguments.binary, folder / name.replace(" ", "-"), scale)
            except Exception:
                traceback.print_exc()
                results[name] = [Row("the trial came to its end", 0, "", "== 1", "see the messages above")]
            seconds[name] = time.perf_counter() - start
            table(results[name])
            print(f"    {name}: {seconds[name]:.0f} s", flush=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    rows = [row for of in results.values() for row in of]
    missed = [row for row in rows if row.reached is False]
    open_ = [row for row in rows if row.value is None]
    facts: dict[str, Any] = {"short": arguments.short, "cores": os.cpu_count(), "seconds": seconds}
    trials = {name: [row.document() for row in of] for name, of in results.items()}
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps({**facts, "trials": trials}, indent=1) + "\n")
    print(f"\n{sum(row.reached is True for row in rows)} goals reached, {len(missed)} missed, {len(open_)} not measured; "
          f"figures in {arguments.out}")  # fmt: skip
    for row in missed:
        print(f"  missed: {row.name} = {row.value:g} {row.unit}, goal {row.goal}. {row.note}")
    return 1 if missed else 0


def table(rows: list[Row]) -> None:
    """The table for the terminal."""
    for row in rows:
        mark = {True: "reached", False: "MISSED", None: ""}[row.reached]
        value = "not measured" if row.value is None else f"{row.value:.4g}"
        print(f"    {row.name:<70} {value:>12} {row.unit:<9} {row.goal:<8} {mark:<8} {row.note}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
