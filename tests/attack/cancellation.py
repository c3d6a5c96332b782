"""Calls whose deadline passes at a random moment of their work: the processors are free soon after."""

from __future__ import annotations

import contextlib
import os
import random
import time
from collections.abc import Callable
from pathlib import Path

import moldline
import numpy as np
from moldline.panel import AnalysisPoint, Reference

from server import Server
from trial import E175, Row

#: In which work has to end, s.
GRACE = 0.5
#: Over which processors are looked at afterwards, s.
WINDOW = 0.5


def processor_seconds(server: Server) -> float:
    """What the server has used so far."""
    fields = Path(f"/proc/{server.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def busy_after(server: Server, call: Callable[[float], object], seconds: float) -> float | None:
    """Processor seconds that a call uses after its deadline and the grace; `None` if it was finished before."""
    try:
        call(seconds)
    except moldline.MoldlineError:
        pass
    else:
        return None
    time.sleep(GRACE)
    before = processor_seconds(server)
    time.sleep(WINDOW)
    return processor_seconds(server) - before


def table(server: Server, calls: dict[str, tuple[Callable[[float], object], float]], rounds: int) -> list[Row]:
    """A row for each call, with its usual duration."""
    rows = []
    chance = random.Random(14)
    for name, (call, duration) in calls.items():
        used = [busy_after(server, call, chance.uniform(0.0, 1.0) * duration) for _ in range(rounds)]
        cut = [seconds for seconds in used if seconds is not None]
        worst = max(cut, default=0.0)
        note = f"{len(cut)} of {rounds} were cut"
        # The probes of the store, and one tick of the clock.
        rows.append(Row(f"{name}: processors in {WINDOW} s, after {GRACE} s", worst, "s", "<= 0.05", note, timed=True))
    return rows


def seconds_of(call: Callable[[float], object], most: float = 120.0) -> float:
    """How long a call takes, or the most that it is given."""
    start = time.monotonic()
    with contextlib.suppress(moldline.MoldlineError):
        call(most)
    return time.monotonic() - start


def cancelled(binary: Path, folder: Path, short: bool) -> list[Row]:
    """Both services, on the E175: builds, deformations, products, checks; preparations, analyses, products."""
    rounds = 4 if short else 15
    most = 10.0 if short else 60.0
    once = moldline.Retry(attempts=1)
    rows = []
    with Server(binary, "--fast-known-uploads") as server, server.client(retry=once) as client:
        setup = client.create_setup(E175)
        session = setup.session()
        design = setup.baseline
        session.deform(design)
        numbers = iter(range(10**6))

        def build(timeout: float) -> object:
            """Of a set-up that is new each time."""
            copy = folder / "copy"
            if not copy.exists():
                copy.mkdir()
                for path in E175.iterdir():
                    if path.name != "setup.toml":
                        (copy / path.name).symlink_to(path)
            text = (E175 / "setup.toml").read_text()
            (copy / "setup.toml").write_text(text.replace('name = "', f'name = "{next(numbers)} ', 1))
            return client.create_setup(copy, setup_file="setup.toml", timeout=timeout)

        calls = {
            "build": build,
            "deformation": lambda timeout: session.deform(design, timeout=timeout),
            "Jacobian": lambda timeout: session.jacobian(at=design, timeout=timeout),
            "check": lambda timeout: setup.check(timeout=timeout),
        }
        rows += table(server, {name: (call, seconds_of(call, most)) for name, call in calls.items()}, rounds)
        vertices, cells = setup.mesh.vertices, setup.mesh.cells
    with (
        Server(binary, command=("panel", "serve")) as server,
        moldline.panel.Client(server.address, retry=once) as panels,
    ):
        configuration = panels.create_configuration(vertices, cells)
        reference = Reference(area=68.2, chord=3.42, span=23.82)
        numbers = iter(range(10**6))

        def moved() -> np.ndarray:
            """Vertices of another flow each time."""
            return vertices * (1.0 + 1e-6 * next(numbers))

        def at() -> AnalysisPoint:
            return AnalysisPoint(vertices=moved(), reference=reference, mach=0.5, alpha=0.02, sideslip=0.0)

        direction = np.ones((4, *vertices.shape))
        calls = {
            "preparation": lambda timeout: panels.create_configuration(moved(), cells, timeout=timeout),
            "analysis": lambda timeout: configuration.analyze(
                moved(), reference=reference, mach=0.5, alpha=0.02, timeout=timeout
            ),
            "analysis and forward product": lambda timeout: configuration.jvp(direction, at=at(), timeout=timeout),
            "analysis and adjoint product": lambda timeout: configuration.vjp({"lift": 1.0}, at=at(), timeout=timeout),
        }
        rows += table(server, {name: (call, seconds_of(call, most)) for name, call in calls.items()}, rounds)
    return rows
