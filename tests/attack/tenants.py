"""Tenants that take all the places that they can get, beside one that wants a few."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from pathlib import Path

import moldline
import numpy as np

import sphere_and_boom
from server import Server
from sockets import connect, head
from trial import Row


def token(binary: Path, file: Path, tenant: str, role: str = "user") -> str:
    command = [str(binary), "token", "create", "--tokens", str(file), "--tenant", tenant, "--role", role]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def shares(binary: Path, folder: Path, short: bool) -> list[Row]:
    """One tenant holds as many uploads, queue places and operations as it can."""
    tokens = folder / "tokens.json"
    greedy, modest, reader = (token(binary, tokens, *who) for who in [("greedy",), ("modest",), ("greedy", "reader")])
    setup_folder = sphere_and_boom.write(folder / "setup")
    rows = []
    with Server(binary, "--tokens", str(tokens), "--threads", "2") as server:
        fields = [f"authorization: Bearer {greedy}", "content-type: application/x-tar", "content-length: 100000"]
        uploads = [connect(server, head(server, "POST /v1/setups", *fields)) for _ in range(60)]
        time.sleep(0.5)
        one = moldline.Retry(attempts=1)
        with server.client(token=modest, retry=one) as client, server.client(token=greedy) as other:
            refused = 0
            try:
                setup = client.create_setup(setup_folder)
            except moldline.ResourceExhausted:
                refused = 1
            rows.append(Row("uploads refused beside 60 silent ones of another tenant", refused, "", "== 0"))
            for connection in uploads:
                connection.close()
            setup = client.create_setup(setup_folder)
            theirs = other.create_setup(setup_folder).session()
            session = setup.session()
            alone = times(session, 20 if short else 100)
            stop = threading.Event()

            def flood() -> None:
                while not stop.is_set():
                    try:
                        theirs.deform()
                    except moldline.MoldlineError:
                        time.sleep(0.01)

            floods = [threading.Thread(target=flood) for _ in range(80)]
            for thread in floods:
                thread.start()
            time.sleep(1)
            beside = times(session, 20 if short else 100)
            stop.set()
            for thread in floods:
                thread.join()
        rows.append(
            Row("calls refused beside 80 callers of another tenant", sum(t is None for t in beside), "", "== 0")
        )
        slow = [t for t in beside if t is not None]
        ratio = float(np.percentile(slow, 99) / np.percentile([t for t in alone if t is not None], 99)) if slow else 1e9
        rows.append(Row("p99 of a call beside them, times that alone", ratio, "", "<= 6", timed=True))
        fields = [f"authorization: Bearer {reader}", "content-type: application/json", "content-length: 10000000"]
        answer = connect(server, head(server, "POST /v1/sessions/none/deform", *fields)).recv(4096)
        rows.append(
            Row("status of a reader's deformation, before its body is sent", float(answer.split(b" ")[1]), "", "== 403")
        )
    return rows


def times(session: moldline.Session, count: int) -> list[float | None]:
    """Seconds of deformations; `None` for those refused."""
    all_: list[float | None] = []
    for _ in range(count):
        start = time.monotonic()
        try:
            session.deform()
            all_.append(time.monotonic() - start)
        except moldline.ResourceExhausted:
            all_.append(None)
    return all_


def round_trip(binary: Path, folder: Path, short: bool) -> list[Row]:
    """What a deformation costs besides the engine."""
    with Server(binary, "--threads", "2") as server, server.client() as client:
        session = client.create_setup(sphere_and_boom.write(folder / "setup")).session()
        outside = []
        for _ in range(100 if short else 1000):
            start = time.perf_counter()
            result = session.deform()
            outside.append(time.perf_counter() - start - result.engine_seconds)
    facts = json.dumps({"calls": len(outside)})
    return [
        Row(
            "round trip of a deformation without the engine, median",
            1e3 * float(np.median(outside)),
            "ms",
            "",
            facts,
            timed=True,
        )
    ]
