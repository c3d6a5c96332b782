"""Deforms a mesh and takes a gradient over HTTP: no client, only numpy and the standard library.

    python gradient.py http://127.0.0.1:50051 examples/e175 setup-motions.toml

The objective is half the sum of squares of all displacements; its derivative with respect to the
vertices is the displacements themselves.
"""

from __future__ import annotations

import io
import json
import sys
import tarfile
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np

NPY, NPZ, JSON = "application/x-npy", "application/x-npz", "application/json"


def main(server: str, folder: Path, setup_file: str) -> None:
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w:gz") as tar:
        tar.add(folder, arcname=".")
    path = f"{server}/v1/setups?setup_file={setup_file}"
    created = json.loads(call("POST", path, archive.getvalue(), "application/gzip", JSON)[0])
    setup = f"{server}/v1/setups/{created['setup_id']}"
    variables = created["setup"]["variables"]
    print(f"{created['setup']['name']}: {len(variables)} variables")
    reference = np.load(io.BytesIO(call("GET", f"{setup}?include_mesh=true", accept=NPY)[0]))

    opened = json.loads(call("POST", f"{setup}/sessions", b'{"label": "over HTTP"}', JSON, JSON)[0])
    session = f"{server}/v1/sessions/{opened['session_id']}"
    # A tenth of the way from the baseline to the upper bound.
    design = np.array([0.9 * variable["baseline"] + 0.1 * variable["upper"] for variable in variables])
    answer, headers = call("POST", f"{session}/deform", npy(design), NPY, NPY)
    displacements = np.load(io.BytesIO(answer)) - reference
    print(f"moved up to {np.linalg.norm(displacements, axis=1).max():.3f} m")

    # The id names the linearisation; with the design, a server that has dropped it recomputes it.
    seeds = io.BytesIO()
    np.savez(seeds, **{"vertices": displacements, "at.design": design})
    path = f"{session}/vjp?linearisation_id={headers['Moldline-Linearisation-Id']}"
    gradient = np.load(io.BytesIO(call("POST", path, seeds.getvalue(), NPZ, NPY)[0]))[0]
    for variable, slope in zip(variables, gradient, strict=True):
        print(f"{variable['name']:26} {slope:+.12e} m^2 per {variable['unit']}")
    call("DELETE", session)


def npy(values: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


def call(method: str, url: str, body: bytes | None = None, kind: str = JSON, accept: str = JSON) -> tuple[bytes, Any]:
    """The answer and its headers; errors name the offending field."""
    headers = {"Content-Type": kind, "Accept": accept}
    try:
        with urlopen(Request(url, body, headers, method=method)) as answer:
            return answer.read(), answer.headers
    except HTTPError as error:
        problem = json.load(error)
        raise SystemExit(f"{problem['code']}: {problem['detail']}") from None


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), sys.argv[3])
