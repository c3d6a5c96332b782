"""Connections that say nothing, and the end of a server while all kinds of calls run."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import moldline

import sphere_and_boom
from server import Server
from sockets import PREFACE, ask, closed_within, connect, drip, head, many_files, within_files
from trial import Row


def silent(binary: Path, folder: Path, short: bool) -> list[Row]:
    """Ten times as many silent connections as there are files."""
    count = 2000 if short else 10_000
    setup_folder = sphere_and_boom.write(folder / "setup")
    with (
        many_files(),
        Server(binary, store=folder / "store", within=within_files(1024)) as server,
        server.client() as client,
    ):
        setup = client.create_setup(setup_folder)
        kinds = [b"", PREFACE[:12], head(server, "GET /healthz")[:-4]]
        open_, failed, slowest, stored = [], 0, 0.0, 0
        for i in range(count):
            open_.append(connect(server, kinds[i % len(kinds)]))
            if i % (count // 20) == 0:
                status, seconds = ask(server)
                failed += status != 200
                slowest = max(slowest, seconds)
                with server.client() as other, other.get_setup(setup.id).session() as session:
                    session.update(setup.baseline)
                    stored += 1
        closed = closed_within(open_, 30.0)
    return [
        Row(f"{count} silent connections, 1,024 files: health probes without an answer", failed, "", "== 0"),
        Row("slowest health probe meanwhile", 1e3 * slowest, "ms", "<= 1000", timed=True),
        Row("sessions stored meanwhile by callers that come later", stored, "", "== 20"),
        Row("connections that are still open after 30 s", count - closed, "", "== 0"),
    ]


def drain(binary: Path, folder: Path, short: bool) -> list[Row]:
    """SIGTERM while uploads, deformations and answers are on their way."""
    rounds = 5 if short else 50
    setup_folder = sphere_and_boom.write(folder / "setup")
    cut = wrong = answered = 0
    for _ in range(rounds):
        with Server(binary, "--threads", "2") as server, server.client() as client:
            session = client.create_setup(setup_folder).session()
            stopping = threading.Event()
            outcomes: list[bool] = []

            def deform(
                session: moldline.Session = session, stop: threading.Event = stopping, to: list[bool] = outcomes
            ) -> None:
                while not stop.is_set():
                    try:
                        session.deform()
                        to.append(True)
                    except moldline.MoldlineError:
                        # A call that came after the port was closed is refused, not cut.
                        to.append(stop.is_set())

            def upload(server: Server = server, to: list[bool] = outcomes) -> None:
                body = b'{"format": 1, "name": "' + b"a" * 400
                to.append(drip(server, body, 1.0) == 400)

            workers = [threading.Thread(target=upload) for _ in range(4)] + [
                threading.Thread(target=deform) for _ in range(2)
            ]
            for worker in workers:
                worker.start()
            time.sleep(0.4)
            stopping.set()
            code = server.stop()
            for worker in workers:
                worker.join()
            wrong += code != 0
            cut += outcomes.count(False)
            answered += outcomes.count(True)
    return [
        Row(f"SIGTERM under load, {rounds} rounds: calls cut off", cut, "", "== 0", f"{answered} answered"),
        Row("wrong exit codes", wrong, "", "== 0"),
    ]
