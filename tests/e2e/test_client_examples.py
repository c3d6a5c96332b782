"""The example programs of the compiled clients do what they say."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import moldline
import numpy as np
import pytest

from clients import ROOT
from server import Server


@pytest.fixture
def optimizer() -> Path:
    path = Path(os.environ.get("MOLDLINE_OPTIMIZER", ROOT / "target/cpp-examples/moldline-optimizer"))
    assert path.is_file(), f"there is no {path}: `cargo xtask clients` builds it"
    return path


def steps(output: str) -> np.ndarray:
    """Value and steepest slope of each accepted design."""
    found = re.findall(r"^ *\d+ +f = (\S+) m\^2 +\|g\| = (\S+)$", output, flags=re.MULTILINE)
    return np.array(found, dtype=float)


def test_the_optimizer_in_cpp_finds_the_mesh_again(optimizer: Path, server: Server, setup_folder: Path) -> None:
    command = [str(optimizer), server.address, str(setup_folder)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    values = steps(run.stdout)[:, 0]
    assert np.all(np.diff(values) < 0)
    assert values[0] > 1.0 and values[-1] < 1e-12


def test_the_optimizer_in_cpp_goes_on_where_it_was_killed(
    optimizer: Path, server: Server, client: moldline.Client, setup_folder: Path
) -> None:
    command = [str(optimizer), server.address, str(setup_folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as killed:
        assert killed.stdout is not None
        lines = [killed.stdout.readline() for _ in range(4)]
        killed.kill()
    session = re.match(r"session (\w+):", lines[0])
    assert session is not None
    last = steps("".join(lines))[-1, 0]
    stored = client.resume(session[1])
    assert stored.generation >= 3
    rest = subprocess.run([str(optimizer), server.address, session[1]], capture_output=True, text=True, check=True)
    values = steps(rest.stdout)[:, 0]
    assert values[0] <= last * (1 + 1e-6), "it began again"
    assert values[-1] < 1e-12
    with pytest.raises(moldline.NotFound):
        client.resume(session[1])


def test_the_sweep_in_rust_has_the_other_clients_numbers(
    server: Server, setup: moldline.Setup, setup_folder: Path
) -> None:
    program = Path(os.environ.get("MOLDLINE_DRIVER_RUST", ROOT / "target/debug/examples/driver")).with_name("sweep")
    command = [str(program), server.address, str(setup_folder), "setup.json", "boom.translation"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    row = re.compile(
        r"^(\S+) m: aspect ratio p95 (\S+), enclosed_volume (\S+) m\^3, its derivative (\S+)$", re.MULTILINE
    )
    told = np.array(row.findall(run.stdout), dtype=float)
    assert told[:, 0].tolist() == [-0.5, -0.25, 0.0, 0.25, 0.5]
    with setup.session() as session:
        for value, ratio, volume, derivative in told:
            moved = session.deform({"boom.translation": value})
            gradient = session.vjp(functions={"enclosed_volume": 1.0}, at=moved).design
            assert (ratio, volume) == (
                round(moved.quality.total.aspect_ratio.p95, 3),
                round(moved.functions["enclosed_volume"], 4),
            )
            assert derivative == round(gradient[0], 5)


def test_the_gradient_over_http_is_the_clients(server: Server, setup: moldline.Setup, setup_folder: Path) -> None:
    script = ROOT / "examples/http/gradient.py"
    command = [sys.executable, str(script), f"http://{server.address}", str(setup_folder), "setup.json"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    told = re.findall(r"^(\S+) +(\S+) m\^2 per m$", run.stdout, flags=re.MULTILINE)
    with setup.session() as session:
        moved = session.deform(0.9 * setup.baseline + 0.1 * setup.bounds[1])
        gradient = session.vjp(vertices=moved.vertices - setup.mesh.vertices, at=moved).design
    assert told == [(v.name, f"{slope:+.12e}") for v, slope in zip(setup.variables, gradient, strict=True)]
