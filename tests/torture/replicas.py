"""Servers that come and go while the store stays: restarts, and two servers on one object store."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import grpc
import moldline
import numpy as np
from moldline import arrays
from moldline.v1 import mesh_service_pb2 as wire
from moldline.v1 import mesh_service_pb2_grpc

import seaweed
from server import Server
from trial import IMPATIENT, PATIENT, Problem, Row, Trial, bar, different, refused

#: Concurrent updates of the same generation, and repetitions.
CONTENDERS = 8
CONTESTS = 5


def restart(trial: Trial) -> list[Row]:
    """Trial: time from the start of the process to the first Deform of a stored set-up."""
    store = trial.folder / "store"
    with Server(trial.binary, store=store) as server, server.client() as client:
        setup = client.create_setup(trial.scale.setup)
        session = setup.session()
        design = setup.baseline
        expected = session.deform(design)
        build = setup.build_seconds
        assert server.stop() == 0
    request = wire.DeformRequest(session_id=session.id)
    arrays.write(design, request.design)
    seconds, processor, wrong, built = [], [], 0, 0
    with bar("restart", trial.scale.restarts, "restarts") as progress:
        for _ in range(trial.scale.restarts):
            start = time.perf_counter()
            with Server(trial.binary, store=store) as server:
                with grpc.insecure_channel(server.address, [("grpc.max_receive_message_length", -1)]) as channel:
                    answer = mesh_service_pb2_grpc.MeshServiceStub(channel).Deform(request, timeout=60)
                    seconds.append(time.perf_counter() - start)
                    processor.append(processor_time(server))
                assert server.stop() == 0
            wrong += arrays.from_wire(answer.vertices).tobytes() != expected.vertices.tobytes()
            log = "".join(server.log)
            built += "built a set-up" in log or "loaded a set-up" not in log
            progress.update()
    name = f"from the start of the process to the first Deform, {setup.cell_count} cells"
    return [
        Row(name, 1e3 * float(np.median(seconds)), "ms", "<= 300",
            f"median of {len(seconds)}, slowest {1e3 * max(seconds):.0f}; the first build took {1e3 * build:.0f}",
            timed=True),
        Row("of which the server's processor time", 1e3 * float(np.median(processor)), "ms"),
        Row("restarts that factorised again, by the log", built, f"of {len(seconds)}", "== 0"),
        Row("restarts that gave other bits", wrong, f"of {len(seconds)}", "== 0"),
    ]  # fmt: skip


def processor_time(server: Server) -> float:
    """Processor time of the server, s."""
    fields = Path(f"/proc/{server.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def replicas(trial: Trial) -> list[Row]:
    """Two servers on one object store: a session moves from one to the other again and again, and both write at once."""
    steps = trial.scale.steps
    if seaweed.program() is None:
        return [
            Row("two servers: designs unlike those of one", None, f"of {steps}", "== 0", "SeaweedFS is not installed")
        ]
    with ExitStack() as stack:
        objects = stack.enter_context(seaweed.SeaweedFS(trial.folder / "objects"))
        servers = [
            stack.enter_context(Server(trial.binary, store=objects.store, environment=objects.environment))
            for _ in range(2)
        ]
        clients = [stack.enter_context(server.client(retry=PATIENT)) for server in servers]
        setup = clients[0].create_setup(trial.scale.setup)
        problem = Problem.at(setup)
        session_id = setup.session().id
        designs = []
        with bar("two servers", steps, "steps") as progress:
            for step in range(steps):
                # This server knows the session from the store only.
                designs.append(problem.advance(clients[step % 2].resume(session_id)).tobytes())
                progress.update()
        winners = [contest(clients, session_id) for _ in range(CONTESTS)]
        away = outage(objects, servers[0])
        faults = trial.verify(objects.store, objects.environment)
        built = ["built a set-up" in "".join(server.log) for server in servers]
    with Server(trial.binary) as alone, alone.client() as client:
        expected = problem.undisturbed(client, trial.scale.setup, steps)
    return [
        Row("session moved from one server to the other", steps - 1, "times"),
        Row("two servers: designs unlike those of one", different(designs, expected), f"of {steps}", "== 0"),
        Row("two servers: the set-up was built", sum(built), "times", "== 1"),
        Row("updates of one generation of which not exactly one won", sum(won != 1 for won in winners), f"of {CONTESTS}",
            "== 0", f"{CONTENDERS} at once through both servers"),
        *away,
        Row("damaged objects, by `moldline store verify`", len(faults), "objects", "== 0", "; ".join(faults)),
    ]  # fmt: skip


def outage(objects: seaweed.SeaweedFS, server: Server) -> list[Row]:
    """Trial: the object store is killed under a server, and comes back."""
    with server.client(retry=IMPATIENT) as client:
        session = client.resume(client.list_sessions()[0].id)
        expected = session.deform(session.design.design).vertices.tobytes()
        generation = session.generation
        objects.stop()
        answer = refused(lambda: session.update(label="lost"), moldline.Unavailable, "the store does not answer")
        served = session.deform(session.design.design).vertices.tobytes() == expected
        objects.start()
        session.refresh()
        kept = session.generation == generation
        session.update(label="stored")
        return [
            Row(
                "object store killed: updates not refused with a clear error", int(answer != ""), "of 1", "== 0", answer
            ),
            Row("object store killed: known sessions not served from memory", int(not served), "of 1", "== 0"),
            Row("object store back: sessions that lost or gained an update", int(not kept), "of 1", "== 0"),
        ]


def contest(clients: list[moldline.Client], session_id: str) -> int:
    """Number of winners among concurrent updates of one generation."""
    sessions = [clients[number % 2].resume(session_id) for number in range(CONTENDERS)]

    def update(number: int) -> bool:
        try:
            sessions[number].update(label=f"contender {number}")
        except moldline.Aborted:
            return False
        return True

    with ThreadPoolExecutor(CONTENDERS) as pool:
        return sum(pool.map(update, range(CONTENDERS)))
