"""Servers killed at random times; everything acknowledged must survive."""

from __future__ import annotations

import itertools
import threading
import time

import moldline
import numpy as np

from server import Server
from trial import PATIENT, Problem, Row, Trial, bar, different

WRITERS = 4
#: Updates of each of a writer's sessions.
UPDATES = 5
#: Seconds for the optimization to reach as many designs as there were kills.
PATIENCE = 120


class Writer(threading.Thread):
    """Uploads set-ups, opens sessions, stores designs, closes some; records every acknowledgement."""

    def __init__(self, trial: Trial, address: str, number: int, stopping: threading.Event) -> None:
        super().__init__(daemon=True)
        self._trial, self._number, self._stopping = trial, number, stopping
        self._client = moldline.Client(address, retry=PATIENT)
        #: Names of set-ups by id.
        self.setups: dict[str, str] = {}
        #: By id: generation and design that were stored last, and whether it was closed.
        self.sessions: dict[str, tuple[int, bytes, bool]] = {}
        self.updates = 0
        self.error: Exception | None = None

    def run(self) -> None:
        random = np.random.default_rng(self._number)
        try:
            with self._client:
                for count in itertools.count():
                    if self._stopping.is_set():
                        return
                    name = f"writer {self._number}, set-up {count}"
                    setup = self._client.create_setup(self._trial.writer_setup(name))
                    self.setups[setup.id] = name
                    session = setup.session(label=name)
                    self._remember(session)
                    for _ in range(UPDATES):
                        session.update(setup.baseline + random.uniform(-0.1, 0.1, len(setup.variables)))
                        self._remember(session)
                        self.updates += 1
                    if count % 3 == 2:
                        session.close()
                        self._remember(session, closed=True)
        except Exception as error:
            self.error = error

    def _remember(self, session: moldline.Session, closed: bool = False) -> None:
        self.sessions[session.id] = (session.generation, np.asarray(session.design.design).tobytes(), closed)


class Optimizer(threading.Thread):
    """Runs until it is stopped; returns the acknowledged designs."""

    def __init__(self, problem: Problem, address: str, session_id: str, stopping: threading.Event) -> None:
        super().__init__(daemon=True)
        self._problem, self._session_id, self._stopping = problem, session_id, stopping
        self._client = moldline.Client(address, retry=PATIENT)
        self.designs: list[bytes] = []
        self.error: Exception | None = None

    def run(self) -> None:
        try:
            with self._client:
                session = self._client.resume(self._session_id)
                while not self._stopping.is_set():
                    self.designs.append(self._problem.advance(session).tobytes())
        except Exception as error:
            self.error = error


def kill(trial: Trial) -> list[Row]:
    """Trial: kills under load."""
    scale, store = trial.scale, trial.folder / "store"
    pauses = np.random.default_rng()
    options = ["--max-setups", "100000", "--max-sessions", "100000", "--log", "warn"]
    server = Server(trial.binary, *options, store=store)
    faults: list[str] = []
    try:
        with server.client() as client:
            setup = client.create_setup(scale.setup)
            problem = Problem.at(setup)
            optimized = setup.session(label="optimization").id
        stopping = threading.Event()
        writers = [Writer(trial, server.address, number, stopping) for number in range(WRITERS)]
        optimizer = Optimizer(problem, server.address, optimized, stopping)
        for thread in (*writers, optimizer):
            thread.start()
        with bar("kill -9", scale.kills, "kills") as progress:
            for _ in range(scale.kills):
                time.sleep(pauses.uniform(0.2, 1) * scale.between)
                server.process.kill()
                server.wait()
                faults += trial.verify(store)
                server = Server(trial.binary, "--listen", server.address, *options, store=store)
                progress.update()
                acknowledged = sum(writer.updates for writer in writers)
                progress.set_postfix_str(f"{acknowledged} updates, {len(optimizer.designs)} designs acknowledged")
        # A slow machine has a longer run, not one without steps.
        end = time.monotonic() + PATIENCE
        while len(optimizer.designs) < scale.kills and optimizer.is_alive() and time.monotonic() < end:
            time.sleep(0.1)
        stopping.set()
        for thread in (*writers, optimizer):
            thread.join(timeout=300)
        clients: list[Writer | Optimizer] = [*writers, optimizer]
        failures = [one.error for one in clients if one.error is not None or one.is_alive()]
        with server.client() as client:
            lost_setups, lost_sessions = lost(client, writers)
        faults += trial.verify(store)
        # Another server, with empty memory.
        with Server(trial.binary, "--log", "warn") as other, other.client() as client:
            expected = problem.undisturbed(client, scale.setup, len(optimizer.designs))
    finally:
        server.process.kill()
        server.wait()
    setups = sum(len(writer.setups) for writer in writers)
    sessions = sum(len(writer.sessions) for writer in writers)
    updates = sum(writer.updates for writer in writers)
    return [
        Row(f"kill -9 of the server under {WRITERS} writers and an optimization", scale.kills, "kills"),
        Row("acknowledged set-ups that were lost", lost_setups, f"of {setups}", "== 0"),
        Row("acknowledged sessions that were lost or differ", lost_sessions, f"of {sessions}", "== 0", f"{updates} updates"),
        Row("damaged objects, by `moldline store verify` after each kill", len(set(faults)), "objects", "== 0",
            "; ".join(faults[:3])),
        Row("clients that saw an error", len(failures), "clients", "== 0", "; ".join(map(str, failures[:3]))),
        Row("optimization: designs unlike those of an undisturbed run", different(optimizer.designs, expected),
            f"of {len(expected)}", "== 0"),
        Row("designs acknowledged to the optimization", len(expected), "designs", f">= {scale.kills}"),
    ]  # fmt: skip


def lost(client: moldline.Client, writers: list[Writer]) -> tuple[int, int]:
    """Acknowledged set-ups and sessions that are missing or have changed."""
    setups = sessions = 0
    names = {summary.id: summary.name for summary in client.list_setups()}
    open_sessions = {state.id for state in client.list_sessions()}
    for writer in writers:
        for setup_id, name in writer.setups.items():
            setups += names.get(setup_id) != name or client.get_setup(setup_id).name != name
        for session_id, (generation, design, closed) in writer.sessions.items():
            if closed or session_id not in open_sessions:
                sessions += closed == (session_id in open_sessions)
                continue
            session = client.resume(session_id)
            sessions += (session.generation, np.asarray(session.design.design).tobytes()) != (generation, design)
    return setups, sessions
