"""HTTP with common tools (requests, numpy, json): the same numbers as over gRPC, to the last bit."""

from __future__ import annotations

import io
import json
import tarfile
import threading
import time
import zipfile
from pathlib import Path
from typing import Any

import moldline
import numpy as np
import pytest
import requests

from server import Server

NPY = {"Accept": "application/x-npy"}
NPZ = {"Accept": "application/x-npz"}


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def npz(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def load(answer: requests.Response) -> Any:
    answer.raise_for_status()
    return np.load(io.BytesIO(answer.content))


def archive(folder: Path, kind: str) -> bytes:
    file = io.BytesIO()
    if kind == "zip":
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed:
            for path in sorted(folder.iterdir()):
                packed.write(path, path.name)
    else:
        with tarfile.open(fileobj=file, mode="w:gz" if kind == "gzip" else "w") as packed:
            for path in sorted(folder.iterdir()):
                packed.add(path, path.name)
    return file.getvalue()


@pytest.fixture
def http(server: Server) -> Any:
    with requests.Session() as session:
        session.headers["Request-Timeout"] = "60"
        yield session


@pytest.fixture
def url(server: Server) -> str:
    return f"http://{server.address}/v1"


@pytest.fixture
def session(http: requests.Session, url: str, setup: moldline.Setup) -> str:
    """The address of a session on a set-up that came over gRPC."""
    opened = http.post(f"{url}/setups/{setup.id}/sessions")
    assert opened.status_code == 201
    return f"{url}/sessions/{opened.json()['session_id']}"


@pytest.mark.parametrize("kind", ["x-tar", "gzip", "zip"])
def test_archives_are_the_set_up_that_their_folder_is(
    http: requests.Session, url: str, setup: moldline.Setup, setup_folder: Path, kind: str
) -> None:
    headers = {"Content-Type": f"application/{kind}"}
    created = http.post(f"{url}/setups", data=archive(setup_folder, kind), headers=headers)
    assert created.status_code == 200, created.text
    assert created.json()["setup_id"] == setup.id


def test_numbers_are_those_of_grpc(http: requests.Session, session: str, setup: moldline.Setup) -> None:
    design = setup.baseline
    design[0] = 0.25
    with setup.session() as other:
        expected = other.deform(design)
        seeds = np.random.default_rng(1).normal(size=(2, setup.vertex_count, 3))
        gradient = other.vjp(vertices=seeds, at=expected).design
        jacobian = other.jacobian(at=expected).vertices
    answer = http.post(f"{session}/deform", data=npy(design), headers=NPY | {"Content-Type": "application/x-npy"})
    np.testing.assert_array_equal(load(answer), expected.vertices)
    at = {"linearisation_id": answer.headers["Moldline-Linearisation-Id"]}

    whole = load(http.post(f"{session}/deform", json={"design": design.tolist()}, headers=NPZ))
    np.testing.assert_array_equal(whole["vertices"], expected.vertices)
    np.testing.assert_array_equal(whole["functions"], [expected.functions[f.name] for f in setup.functions])
    assert json.loads(whole["info.json"])["linearisation_id"] == at["linearisation_id"]

    raw = {"Content-Type": "application/octet-stream", "Accept": "application/octet-stream"}
    shape = ",".join(map(str, seeds.shape))
    answer = http.post(f"{session}/vjp", params=at | {"shape": shape}, data=seeds.tobytes(), headers=raw)
    answer.raise_for_status()
    np.testing.assert_array_equal(np.frombuffer(answer.content).reshape(gradient.shape), gradient)

    # A .npz file brings the design along: no server needs to remember it.
    body = npz(**{"vertices": seeds, "at.design": design})
    answer = http.post(f"{session}/vjp", data=body, headers=NPY | {"Content-Type": "application/x-npz"})
    np.testing.assert_array_equal(load(answer), gradient)

    answer = http.post(f"{session}/jacobian", json={"at": at}, headers=NPY)
    np.testing.assert_array_equal(load(answer), jacobian)


def test_faults_are_named(http: requests.Session, session: str) -> None:
    answer = http.post(f"{session}/deform", data=npy(np.full(3, np.nan)), headers={"Content-Type": "application/x-npy"})
    assert answer.status_code == 400
    assert answer.headers["Content-Type"] == "application/problem+json"
    problem = answer.json()
    assert problem["code"] == "INVALID_ARGUMENT"
    assert problem["violations"][0]["field"] == "design[0]"
    single = npy(np.zeros(3, dtype="f4"))
    answer = http.post(f"{session}/deform", data=single, headers={"Content-Type": "application/x-npy"})
    assert answer.json()["violations"][0]["field"] == "design.dtype"


def test_progress_arrives_while_it_is_made(http: requests.Session, url: str, tmp_path: Path) -> None:
    import sphere_and_boom

    folder = sphere_and_boom.write(tmp_path / "other", length=2.75)
    headers = {"Content-Type": "application/x-tar", "Accept": "text/event-stream"}
    answer = http.post(f"{url}/setups", data=archive(folder, "x-tar"), headers=headers, stream=True)
    lines = [line.decode() for line in answer.iter_lines() if line]
    events = [line.removeprefix("event: ") for line in lines if line.startswith("event: ")]
    assert events[-1] == "created" and set(events[:-1]) == {"progress"}
    created = json.loads(lines[-1].removeprefix("data: "))
    assert http.get(f"{url}/setups/{created['setup_id']}").json()["setup"]["name"] == "sphere and boom"


def test_a_client_that_leaves_takes_its_work_with_it(
    server: Server, session: str, http: requests.Session, url: str
) -> None:
    def leave(design: float) -> None:
        with pytest.raises(requests.exceptions.Timeout):
            requests.post(
                f"{session}/jacobian", json={"at": {"design_point": {"design": [design, 0, 0]}}}, timeout=0.001
            )

    leaving = [threading.Thread(target=leave, args=(0.001 * index,)) for index in range(20)]
    for thread in leaving:
        thread.start()
    for thread in leaving:
        thread.join()
    deadline = time.monotonic() + 20
    while (status := http.get(f"{url}/status").json())["running"] + status["queued"]:
        assert time.monotonic() < deadline, status
        time.sleep(0.02)


def test_readiness_goes_before_the_port(binary: Path) -> None:
    with Server(binary, "--drain-delay", "1") as server:
        at = f"http://{server.address}"
        assert requests.get(f"{at}/readyz", timeout=10).status_code == 200
        server.process.terminate()
        deadline = time.monotonic() + 10
        while requests.get(f"{at}/readyz", timeout=10).status_code != 503:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        # The server is alive and serves others.
        assert requests.get(f"{at}/healthz", timeout=10).status_code == 200
        assert requests.get(f"{at}/v1/status", timeout=10).status_code == 200
        assert server.wait() == 0
