"""`moldline mesh` on a folder without a mesh, and what the other commands make of its result."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import moldline
import numpy as np
import pytest

import sphere_and_boom


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Geometry and set-up file alone."""
    folder = sphere_and_boom.write(tmp_path_factory.mktemp("mesh"))
    (folder / "mesh.msh").unlink()
    return folder


def run(binary: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([binary, *arguments], capture_output=True, text=True, check=False)


def test_a_generated_mesh_deforms(binary: Path, folder: Path, client: moldline.Client) -> None:
    ran = run(binary, "mesh", folder, "--cells", "2000", "--json")
    assert ran.returncode == 0, ran.stderr
    report = json.loads(ran.stdout)
    assert report["symmetric"]
    assert [set(seam["components"]) for seam in report["seams"]] == [{"sphere", "boom"}]
    # The seam is a circle; the polygon in it is shorter by a sixth of the square of half an angle.
    assert report["seams"][0]["length"] == pytest.approx(2 * np.pi * sphere_and_boom.RADIUS, rel=0.02)

    setup = client.create_setup(folder)
    assert setup.cell_count == report["cells"]
    with setup.session() as session:
        moved = session.deform({"boom.translation": 0.1})
        assert moved.quality.total.folded == 0
        # The flat end moves with the boom.
        assert moved.vertices[:, 0].max() == pytest.approx(2.6, abs=1e-12)


def test_the_same_bits_again(binary: Path, folder: Path, tmp_path: Path) -> None:
    for name, threads in (("one.msh", "1"), ("two.msh", "2")):
        ran = run(binary, "mesh", folder, "--cells", "1000", "--threads", threads, "-o", tmp_path / name)
        assert ran.returncode == 0, ran.stderr
    assert (tmp_path / "one.msh").read_bytes() == (tmp_path / "two.msh").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--size", "wing=0.2"], "wing"),
        (["--cells", "3"], "cells = 3"),
        (["-o", "mesh.stl"], ".msh or .vtu"),
    ],
)
def test_refusals_name_the_cause(binary: Path, folder: Path, arguments: list[str], words: str) -> None:
    ran = run(binary, "mesh", folder, *arguments)
    assert ran.returncode != 0
    assert words in ran.stderr
