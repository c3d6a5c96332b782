"""Overhead of the network: Deform and ApplyAdjoint through a real server, on the E175, with the client over gRPC and with
plain bytes over HTTP.

    python round_trip.py --binary target/release/moldline

One JSON object on each line: name, value, unit, goal. The overhead of a round trip is the caller's time less the engine's
as the server reports it.
"""

from __future__ import annotations

import argparse
import http.client
import json
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import moldline
import numpy as np

E175 = Path(__file__).resolve().parents[3] / "examples/e175"
REPEATS = 15
#: Milliseconds of overhead.
GOALS = {"Deform": "<= 5", "Deform over HTTP": "<= 5", "Deform + ApplyAdjoint": "<= 10"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="the moldline program")
    binary: Path = parser.parse_args().binary
    command = [str(binary), "serve", "--listen", "127.0.0.1:0", "--store", "memory", "--log", "warn"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            address = json.loads(server.stdout.readline())["address"]
            with moldline.Client(address) as client:
                measure(client.create_setup(E175), address)
        finally:
            server.send_signal(signal.SIGTERM)


def measure(setup: moldline.Setup, address: str) -> None:
    size = f"{len(setup.variables)} variables, {setup.cell_count} cells"
    lower, upper = setup.bounds
    finite = np.isfinite(lower) & np.isfinite(upper)
    seed = np.random.default_rng(175).normal(size=(setup.vertex_count, 3))
    with setup.session() as session:
        rows: dict[str, list[tuple[float, float]]] = {}
        for repeat in range(REPEATS + 1):
            design = setup.baseline
            # Another design each time, all close to the baseline.
            design[finite] += 1e-4 * repeat * (upper - lower)[finite]
            deform, result = timed(lambda design=design: session.deform(design))
            adjoint, _ = timed(lambda result=result: session.vjp(vertices=seed, at=result))
            jacobian, _ = timed(lambda result=result: session.jacobian(at=result))
            over_http = over(http.client.HTTPConnection(address), session.id, design, seed)
            # The first call is slower.
            if repeat > 0:
                rows.setdefault("Deform", []).append(deform)
                rows.setdefault("ApplyAdjoint, one seed", []).append(adjoint)
                both = (deform[0] + adjoint[0], deform[1] + adjoint[1])
                rows.setdefault("Deform + ApplyAdjoint", []).append(both)
                rows.setdefault("Jacobian", []).append(jacobian)
                for name, row in over_http.items():
                    rows.setdefault(name, []).append(row)
    for name, seconds in rows.items():
        tell(f"{name}, round trip, {size}", median(whole for whole, _ in seconds), "measured")
        goal = GOALS.get(name, "measured")
        tell(f"{name}, round trip less engine, {size}", median(whole - engine for whole, engine in seconds), goal)


def over(
    connection: http.client.HTTPConnection, session: str, design: np.ndarray, seed: np.ndarray
) -> dict[str, tuple[float, float]]:
    """Seconds of the calls over HTTP and of the engine."""
    media = "application/octet-stream"

    def post(path: str, array: np.ndarray) -> tuple[tuple[float, float], http.client.HTTPResponse]:
        start = time.perf_counter()
        # The array is sent as it lies in memory.
        headers = {"Content-Type": media, "Accept": media, "Content-Length": str(array.nbytes)}
        connection.request("POST", f"/v1/sessions/{session}/{path}", memoryview(array).cast("B"), headers)
        answer = connection.getresponse()
        np.frombuffer(answer.read())
        whole = time.perf_counter() - start
        assert answer.status == 200, answer.status
        engine = answer.headers["Server-Timing"].split("engine;dur=")[1]
        return (whole, 1e-3 * float(engine)), answer

    connection.connect()
    deform, answer = post("deform", np.ascontiguousarray(design))
    identifier = answer.headers["Moldline-Linearisation-Id"]
    adjoint, _ = post(f"vjp?linearisation_id={identifier}", np.ascontiguousarray(seed))
    connection.close()
    return {"Deform over HTTP": deform, "ApplyAdjoint over HTTP": adjoint}


def timed(call: Callable[[], Any]) -> tuple[tuple[float, float], Any]:
    """Seconds of the call and of the engine, and the result."""
    start = time.perf_counter()
    result = call()
    return (time.perf_counter() - start, result.engine_seconds), result


def tell(name: str, seconds: float, goal: str) -> None:
    print(json.dumps({"name": name, "value": 1e3 * seconds, "unit": "ms", "goal": goal}), flush=True)


if __name__ == "__main__":
    main()
