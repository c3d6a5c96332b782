"""Meshes for pyvista and meshio, and pictures."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import meshio
import moldline
import numpy as np
import pytest
from moldline.panel import Reference

from server import Server
from wing import wing

pyvista = pytest.importorskip("pyvista")


@pytest.fixture
def moved(setup: moldline.Setup) -> moldline.Deformation:
    return setup.deform({"boom.translation": 0.3}, cell_quality=True)


@pytest.fixture(scope="module")
def configuration(binary: Path) -> Iterator[moldline.panel.Configuration]:
    with Server(binary, command=("panel", "serve")) as server, moldline.panel.Client(server.address) as panels:
        yield panels.create_configuration(*wing()[:2])


@pytest.fixture(scope="session")
def can_draw() -> None:
    """Skips where VTK cannot draw without a display; it may end the process there, and so is tried in another one."""
    code = "import pyvista as p; q = p.Plotter(off_screen=True); q.add_mesh(p.Cube()); q.screenshot(return_img=True)"
    if subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=120, check=False).returncode != 0:
        pytest.skip("VTK cannot draw here")


def corners(cells: np.ndarray) -> list[list[int]]:
    return [[int(v) for v in cell if v != 0xFFFFFFFF] for cell in cells]


def test_pyvista_has_the_cells_in_their_order(setup: moldline.Setup, moved: moldline.Deformation) -> None:
    mesh = setup.mesh
    quality = moved.cell_quality["aspect_ratio"]
    surface = mesh.to_pyvista(moved, point_data={"travel": moved.vertices - mesh.vertices}, cell_data={"q": quality})
    assert isinstance(surface, pyvista.PolyData)
    assert [list(cell.point_ids) for cell in surface.cell] == corners(mesh.cells)
    assert {len(cell) for cell in corners(mesh.cells)} == {3, 4}, "the mesh has both shapes"
    assert np.array_equal(surface.points, moved.vertices) and surface.points.dtype == np.float64
    assert np.array_equal(surface.cell_data["owner"], mesh.cell_owner)
    assert np.array_equal(surface.point_data["seam"], mesh.seam)
    assert np.array_equal(surface.cell_data["q"], quality)
    assert list(surface.field_data["components"]) == list(mesh.components)
    # What VTK makes of them: a closed surface with the server's volume.
    assert surface.is_manifold
    assert surface.triangulate().volume == pytest.approx(moved.functions["enclosed_volume"], rel=1e-2)
    assert np.allclose(surface.cell_quality("aspect_ratio")["aspect_ratio"], quality, rtol=1e-10)
    surface.points[:] = 0.0
    assert np.any(moved.vertices != 0.0), "the copy is the caller's"


def test_meshio_writes_and_reads_them(setup: moldline.Setup, moved: moldline.Deformation, tmp_path: Path) -> None:
    mesh = setup.mesh
    number = np.arange(len(mesh.cells), dtype=float)
    out = mesh.to_meshio(moved, cell_data={"number": number})
    for name in ("mesh.vtu", "mesh.vtk"):
        meshio.write(tmp_path / name, out)
        back = meshio.read(tmp_path / name)
        assert np.array_equal(back.points, moved.vertices)
        found: dict[int, list[int]] = {}
        for block, numbers in zip(back.cells, back.cell_data["number"], strict=True):
            found |= {int(n): [int(v) for v in cell] for n, cell in zip(numbers, block.data, strict=True)}
        assert [found[index] for index in range(len(number))] == corners(mesh.cells)


def test_a_mesh_of_one_shape_and_one_without_cells() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])

    def of(cells: list[list[int]]) -> moldline.Mesh:
        count = len(cells)
        cells_array = np.array(cells, dtype=np.uint32).reshape(count, 4)
        return moldline.Mesh(points, cells_array, np.zeros(count, np.uint32), np.zeros(3, bool), ("one",))

    triangle = of([[0, 1, 2, 0xFFFFFFFF]])
    assert triangle.to_pyvista().n_cells == 1 and [b.type for b in triangle.to_meshio().cells] == ["triangle"]
    assert of([]).to_pyvista().n_cells == 0 and of([]).to_meshio().cells == []


def test_an_analysis_has_its_pressures(configuration: moldline.panel.Configuration) -> None:
    analysis = configuration.analyze(reference=Reference(area=8.0, chord=1.0, span=8.0), alpha=0.05)
    surface = configuration.to_pyvista(analysis)
    vertices, cells, _ = wing()
    assert [list(cell.point_ids) for cell in surface.cell] == corners(cells)
    assert np.array_equal(surface.points, vertices)
    assert np.array_equal(surface.cell_data["cp"], analysis.cp)
    assert np.array_equal(surface.point_data["cp"], analysis.vertex_cp)


def test_wrong_fields_are_refused_by_name(setup: moldline.Setup, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="field is 'colour', expected components, seam"):
        setup.mesh.plot("colour", path=tmp_path / "a.png")
    with pytest.raises(ValueError, match=r"the field has shape \(7,\), expected"):
        setup.mesh.plot(np.zeros(7), path=tmp_path / "a.png")
    with pytest.raises(ValueError, match="view is 'below', expected one of iso"):
        setup.mesh.plot(view="below", path=tmp_path / "a.png")
    with pytest.raises(ValueError, match=r"written as \.png"):
        setup.mesh.plot(path=tmp_path / "a.jpg")
    with pytest.raises(ValueError, match=r"vertices have shape \(3, 3\), the mesh has"):
        setup.mesh.to_pyvista(np.zeros((3, 3)))
    assert not list(tmp_path.glob("*.png"))


@pytest.mark.usefixtures("can_draw")
def test_pictures_show_what_is_asked_for(setup: moldline.Setup, moved: moldline.Deformation, tmp_path: Path) -> None:
    mesh = setup.mesh
    gradient = setup.vjp(functions={"enclosed_volume": 1.0}, at=moved, control_points=["boom"])
    assert gradient.design is not None
    fields = {
        "components": "components",
        "seam": "seam",
        "quality": "quality",
        "displacement": "displacement",
        "cells": moved.cell_quality["skew"],
        "vertices": moved.vertices[:, 0],
        "vectors": moved.vertices - mesh.vertices,
    }
    pictures = {}
    for name, field in fields.items():
        path = tmp_path / f"{name}.png"
        assert mesh.plot(field, vertices=moved, path=path, size=(320, 240)) is None
        pictures[name] = np.asarray(pyvista.read(path).active_scalars).reshape(240, 320, -1)
    for name, picture in pictures.items():
        assert len(np.unique(picture.reshape(-1, picture.shape[-1]), axis=0)) > 20, f"{name} is blank"
        assert all(name == other or not np.array_equal(picture, each) for other, each in pictures.items()), name
    views = [tmp_path / f"{view}.png" for view in ("iso", "top", "side", "front")]
    for path in views:
        mesh.plot(path=path, view=path.stem, size=(320, 240), edges=False)
    assert len({path.read_bytes() for path in views}) == 4
