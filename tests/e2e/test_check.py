"""Checks of derivatives through a real connection: results, agreement with the command, refusals."""

from __future__ import annotations

import json
import math
import subprocess
import time
from pathlib import Path
from typing import Any

import moldline
import numpy as np
import pytest
from moldline.v1 import mesh_service_pb2 as wire

import sphere_and_boom
from server import Server

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def setup_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small set-up with bounds within which the boom leaves the sphere, so that random designs have a mesh."""

    def near(document: dict[str, Any], _vertices: np.ndarray, _cells: list[list[int]]) -> None:
        far = document["parameterisation"]["variables"][2]
        far["lower"], far["upper"] = -0.2, 0.2

    return sphere_and_boom.write(tmp_path_factory.mktemp("near"), change=near)


@pytest.fixture(scope="module")
def command(binary: Path, setup_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, dict]:
    """What `moldline check` prints and writes for two designs."""
    file = tmp_path_factory.mktemp("check") / "check.json"
    arguments = ["check", str(setup_folder), "--designs", "2", "--seed", "5", "--variables", "boom.lift,boom.far"]
    ran = subprocess.run([binary, *arguments, "--json", file], check=True, capture_output=True, text=True)
    return ran.stdout, json.loads(file.read_text())


def test_a_kink_is_told_and_is_no_error(binary: Path, client: moldline.Client, tmp_path: Path) -> None:
    """The wing of the half model has a crease at y = 1.6 m, on which vertices lie at the baseline."""
    folder, file = ROOT / "tests/configurations/half", tmp_path / "check.json"
    arguments = ["check", str(folder), "--variables", "wing.rotation", "--json", str(file)]
    ran = subprocess.run([binary, *arguments], check=True, capture_output=True, text=True)
    check = client.check(folder, variables=["wing.rotation"])
    assert check.to_json() == json.loads(file.read_text())
    (row,) = check.rows
    assert row.central_difference is not None and row.central_difference > 1e-6
    assert row.kink is not None and row.kink.component == "wing"
    assert row.kink.position[1] == pytest.approx(1.6)
    assert check.central_difference_max == row.kink.error <= 1e-6
    assert f"vertex {row.kink.worst_vertex} of `wing`" in ran.stdout


def test_the_service_finds_what_the_command_finds(setup: moldline.Setup, command: tuple[str, dict]) -> None:
    told: list[moldline.Progress] = []
    check = setup.check(2, seed=5, variables=["boom.lift", "boom.far"], progress=told.append)
    printed, written = command
    assert check.to_json() == written
    assert check.table().strip() in printed
    assert check.dot_product_max <= 1e-12
    assert check.dual_max <= 1e-10
    assert check.central_difference_max <= 1e-6
    assert [(row.design, row.variable) for row in check.rows] == [
        (design, variable) for design in (0, 1) for variable in ("boom.lift", "boom.far")
    ]
    assert check.designs[0].design == {variable.name: variable.baseline for variable in setup.variables}
    fractions = [each.fraction for each in told]
    assert fractions == sorted(fractions) and len(fractions) > 10 and 0.9 < fractions[-1] <= 1.0
    assert "design 2 of 2" in told[-1].message


def test_a_given_design_is_the_only_one(client: moldline.Client, setup: moldline.Setup, setup_folder: Path) -> None:
    values = {"boom.translation": 0.2, "boom.lift": 0.1, "boom.far": -0.1}
    by_name = setup.check(design=values, variables=["boom.lift"])
    by_number = client.check(setup_folder, design=list(values.values()), variables=["boom.lift"])
    assert by_name.to_json() == by_number.to_json()
    (only,) = by_name.designs
    assert only.design == values
    (row,) = by_name.rows
    assert row.variable == "boom.lift" and row.central_difference == row.best.error
    # Wide steps are off by their square, narrow ones by rounding.
    assert row.differences[0].error > 10 * row.best.error < row.differences[-1].error


@pytest.mark.parametrize(
    ("fields", "field", "word"),
    [
        ({"designs": 0}, "designs", "1..=16"),
        ({"designs": 17}, "designs", "17"),
        ({"variables": ["boom.lift", "boom.left"]}, "variables[1]", "boom.left"),
        ({"design": [0.0, math.nan, 0.0]}, "design[1]", "NaN"),
        ({"design": {"boom.lift": 1e9}}, "design[1]", "1000000000"),
        ({"design": [0.0, 0.0]}, "design", "3"),
    ],
)
def test_what_does_not_fit_is_refused_by_field(setup: moldline.Setup, fields: dict, field: str, word: str) -> None:
    with pytest.raises(moldline.InvalidArgument) as refused:
        setup.check(**fields)
    (violation,) = refused.value.violations
    assert violation.field == field
    assert word in violation.description


def test_a_set_up_that_there_is_not(client: moldline.Client) -> None:
    with pytest.raises(moldline.NotFound) as refused:
        next(_events(client, wire.CheckRequest(setup_id="none")))
    assert refused.value.violations[0].field == "setup_id"


def test_one_check_at_a_time_and_it_ends_with_its_client(server: Server, setup_folder: Path) -> None:
    with server.client(retry=moldline.Retry(attempts=1)) as client:
        _one_at_a_time(client, client.create_setup(setup_folder))


def _one_at_a_time(client: moldline.Client, setup: moldline.Setup) -> None:
    long = client._stub.Check(wire.CheckRequest(setup_id=client.create_setup(ROOT / "examples/e175").id, designs=16))
    assert next(long).progress.stage == "check"
    with pytest.raises(moldline.ResourceExhausted) as refused:
        setup.check(variables=["boom.lift"])
    assert refused.value.retry_after is not None
    # Other calls are served meanwhile.
    with setup.session() as session:
        assert session.deform().quality.total.folded == 0
    long.cancel()
    deadline = time.monotonic() + 60
    while True:
        try:
            setup.check(variables=["boom.lift"])
            break
        except moldline.ResourceExhausted:
            assert time.monotonic() < deadline, "the check goes on without its client"
            time.sleep(0.1)


def _events(client: moldline.Client, request: wire.CheckRequest):
    from moldline.errors import translated

    with translated():
        yield from client._stub.Check(request)
