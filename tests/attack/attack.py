"""Attacks a server as somebody would who has a token, or none: silent connections, bodies that never end, messages that
grow when they are decoded, answers that nobody reads, builds that need too much, tenants that take all places.

    cargo xtask attack [--short]

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

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests" / "e2e"))
sys.path.append(str(ROOT / "tests" / "torture"))

import cancellation  # noqa: E402
import closed  # noqa: E402
import connections  # noqa: E402
import memory  # noqa: E402
import tenants  # noqa: E402
from torture import table  # noqa: E402
from trial import Row  # noqa: E402

#: Attacks by name: each gets the program, an empty folder, and whether to be short.
ATTACKS: dict[str, Callable[[Path, Path, bool], list[Row]]] = {
    "silent connections": connections.silent,
    "drain": connections.drain,
    "bodies": memory.bodies,
    "messages": memory.messages,
    "unread answers": memory.unread,
    "documents": memory.documents,
    "builds": memory.builds,
    "tenants": tenants.shares,
    "round trip": tenants.round_trip,
    "deadlines": cancellation.cancelled,
    "closed sessions": closed.sessions,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="the moldline program")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "attack.json", help="file to write to")
    parser.add_argument("--short", action="store_true", help="less of everything: two minutes at most")
    parser.add_argument("--only", choices=ATTACKS, action="append", help="only this attack; several times for several")
    arguments = parser.parse_args()
    results: dict[str, list[Row]] = {}
    folder = Path(tempfile.mkdtemp(prefix="moldline-attack-"))
    try:
        for name in arguments.only or ATTACKS:
            print(f"==> {name}", flush=True)
            start = time.perf_counter()
            own = folder / name.replace(" ", "-")
            own.mkdir()
            try:
                results[name] = ATTACKS[name](arguments.binary.resolve(), own, arguments.short)
            except Exception:
                traceback.print_exc()
                results[name] = [Row("the attack came to its end", 0, "", "== 1", "see the messages above")]
            table(results[name])
            print(f"    {name}: {time.perf_counter() - start:.0f} s", flush=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    missed = [row for rows in results.values() for row in rows if row.reached is False]
    attacks = {name: [row.document() for row in rows] for name, rows in results.items()}
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(
        json.dumps({"short": arguments.short, "cores": os.cpu_count(), "attacks": attacks}, indent=1) + "\n"
    )
    print(f"\n{len(missed)} goals missed; figures in {arguments.out}")
    for row in missed:
        print(f"  missed: {row.name} = {row.value:g} {row.unit}, goal {row.goal}. {row.note}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
