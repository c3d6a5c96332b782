"""More concurrent sessions, deforming and taking gradients, than the server has time and memory for."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import moldline
import numpy as np

from server import Server
from trial import IMPATIENT, Row, Trial, bar

#: Requests of each kind that measure the time without load.
ALONE = 10
MIB = 1 << 20


@dataclass
class User:
    """One session, which sends its next request after the previous answer."""

    session: moldline.Session
    number: int
    #: Seconds by kind of request.
    seconds: dict[str, list[float]] = field(default_factory=lambda: {"Deform": [], "ApplyAdjoint": []})
    refused: int = 0
    errors: list[str] = field(default_factory=list)

    def work(self, requests: int | None, end: float) -> None:
        """Sends so many requests, or until the end."""
        setup = self.session.setup
        random = np.random.default_rng(self.number)
        lower, upper = setup.bounds
        width = np.where(np.isfinite(lower) & np.isfinite(upper), upper - lower, 0.0)
        deformation = None
        while (requests is None or requests > 0) and time.monotonic() < end:
            kind = "Deform" if deformation is None or random.random() < 0.5 else "ApplyAdjoint"
            start = time.perf_counter()
            try:
                if deformation is None or kind == "Deform":
                    deformation = self.session.deform(setup.baseline + width * random.uniform(-0.02, 0.02, len(width)))
                else:
                    self.session.vjp(vertices=deformation.vertices, at=deformation)
            except moldline.ResourceExhausted as error:
                self.refused += 1
                time.sleep(error.retry_after or 0.1)
                continue
            except Exception as error:
                self.errors.append(f"{type(error).__name__}: {error}")
                continue
            self.seconds[kind].append(time.perf_counter() - start)
            requests = None if requests is None else requests - 1


def load(trial: Trial) -> list[Row]:
    """Trial: overload."""
    scale = trial.scale
    setups, linearisations = scale.memory
    options = ["--setup-memory", str(setups), "--linearisation-memory", str(linearisations), "--log", "warn"]
    with Server(trial.binary, *options, store=trial.folder / "store") as server:
        with server.client(retry=IMPATIENT) as client:
            setup = client.create_setup(scale.setup)
            users = [User(setup.session(label=f"user {number}"), number) for number in range(scale.sessions)]
            alone = User(setup.session(label="alone"), scale.sessions)
            alone.work(2 * ALONE, end=time.monotonic() + 600)
            expected = {kind: float(np.mean(of)) for kind, of in alone.seconds.items()}
            start = time.monotonic()
            threads = [
                threading.Thread(target=user.work, args=(None, start + scale.seconds), daemon=True) for user in users
            ]
            for thread in threads:
                thread.start()
            with bar(f"{len(users)} sessions", scale.seconds, "s") as progress:
                while (passed := time.monotonic() - start) < scale.seconds:
                    time.sleep(0.5)
                    progress.update(time.monotonic() - start - passed)
                    answers = sum(len(of) for user in users for of in user.seconds.values())
                    progress.set_postfix_str(f"{answers} answers, {memory(server, 'VmRSS') // MIB} MiB")
            for thread in threads:
                thread.join(timeout=120)
            stuck = sum(thread.is_alive() for thread in threads)
            took = time.monotonic() - start
            caches = client.status()
        peak = memory(server, "VmHWM") / MIB
    seconds = {kind: [s for user in users for s in user.seconds[kind]] for kind in expected}
    everything = np.concatenate(list(seconds.values()))
    # Waiting time of each if all are served in turn and each request takes as long as it does alone.
    shares = {kind: len(of) / len(everything) for kind, of in seconds.items()}
    fair = len(users) * sum(shares[kind] * expected[kind] for kind in expected)
    by_user = [sum(map(len, user.seconds.values())) for user in users]
    errors = [error for user in users for error in user.errors]
    budgets = setups + linearisations
    held = caches.linearisation_cache
    rows = [
        Row(f"{len(users)} sessions, Deform and ApplyAdjoint", took, "s", "", f"{len(everything)} answers"),
        Row("errors other than RESOURCE_EXHAUSTED", len(errors) + stuck, "errors", "== 0",
            "; ".join(sorted(set(errors))[:3])),
        Row("refused with RESOURCE_EXHAUSTED", sum(user.refused for user in users), "requests"),
        Row("sessions without any answer", by_user.count(0), "sessions", "== 0"),
        Row("p99 over fair share", float(np.quantile(everything, 0.99)) / fair, "1", "<= 3", f"a fair share is {fair:.2f} s",
            timed=True),
        Row("largest resident set of the server", peak, "MiB", f"<= {budgets}", f"budgets {setups} + {linearisations} MiB"),
        Row("linearisations held", held.bytes / MIB, "MiB", f"<= {held.budget_bytes / MIB:g}", f"{held.evictions} dropped"),
        Row("fewest answers of a session over most", min(by_user) / max(by_user), "1"),
    ]  # fmt: skip
    for kind, of in seconds.items():
        quantiles = ", ".join(f"p{100 * q:g} {np.quantile(of, q):.2f} s" for q in (0.5, 0.9, 0.99, 1))
        rows.append(Row(f"{kind}, alone", 1e3 * expected[kind], "ms", "", f"under load {quantiles}"))
    return rows


def memory(server: Server, key: str) -> int:
    """`VmRSS` or `VmHWM` of the server's process, bytes."""
    lines = Path(f"/proc/{server.process.pid}/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(f"{key}:"))
