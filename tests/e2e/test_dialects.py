"""Mesh files as gmsh, meshio and VTK write them in all their options: read right, or refused by name with the way out."""

from __future__ import annotations

import itertools
import json
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
import pytest
import vtk
from numpy.typing import NDArray
from vtk.util.numpy_support import numpy_to_vtk

Points = NDArray[np.float64]
Triangles = NDArray[np.int64]


@dataclass
class Dialect:
    """A file, the number of its vertices and triangles, the volume inside, and a group that it must have."""

    path: Path
    vertices: int
    triangles: int
    volume: float
    group: str | None = None
    #: In place of all that: what the refusal must say.
    refused: str | None = None


def volume(points: Points, triangles: Triangles) -> float:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return float(np.sum(np.einsum("ij,ij->i", a, np.cross(b, c))) / 6)


def ball() -> tuple[Points, Triangles]:
    """An octahedron, twice refined, on the unit sphere."""
    points = [np.array(p, dtype=float) for p in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))]
    cells = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    for _ in range(2):
        middles: dict[tuple[int, int], int] = {}

        def middle(a: int, b: int, middles: dict[tuple[int, int], int] = middles) -> int:
            key = (min(a, b), max(a, b))
            if key not in middles:
                x = points[a] + points[b]
                points.append(x / np.linalg.norm(x))
                middles[key] = len(points) - 1
            return middles[key]

        finer = []
        for a, b, c in cells:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        cells = finer
    return np.array(points), np.array(cells)


def by_vtk(folder: Path) -> Iterator[Dialect]:
    points, cells = ball()
    expected = (len(points), len(cells), volume(points, cells))
    compressors = {
        "none": None,
        "zlib": vtk.vtkZLibDataCompressor,
        "lz4": vtk.vtkLZ4DataCompressor,
        "lzma": vtk.vtkLZMADataCompressor,
    }
    grid = vtk.vtkUnstructuredGrid()
    positions = vtk.vtkPoints()
    positions.SetData(numpy_to_vtk(points, deep=True))
    grid.SetPoints(positions)
    for cell in cells:
        grid.InsertNextCell(vtk.VTK_TRIANGLE, 3, [int(vertex) for vertex in cell])
    group = numpy_to_vtk((points[:, 0] == 0).astype(np.uint8), deep=True)
    group.SetName("group:meridian")
    grid.GetPointData().AddArray(group)
    options = itertools.product(
        ["ascii", "binary", "appended", "raw"], compressors, [32, 64], ["little", "big"], [32, 64]
    )
    for mode, compressor, header, order, identifiers in options:
        path = folder / f"vtk-{mode}-{compressor}-{header}-{order}-{identifiers}.vtu"
        writer = vtk.vtkXMLUnstructuredGridWriter()
        writer.SetInputData(grid)
        writer.SetFileName(str(path))
        {"ascii": writer.SetDataModeToAscii, "binary": writer.SetDataModeToBinary}.get(
            mode, writer.SetDataModeToAppended
        )()
        writer.SetEncodeAppendedData(mode == "appended")
        make = compressors[compressor]
        writer.SetCompressor(make() if make else None)
        writer.SetHeaderTypeToUInt64() if header == 64 else writer.SetHeaderTypeToUInt32()
        writer.SetIdTypeToInt64() if identifiers == 64 else writer.SetIdTypeToInt32()
        writer.SetByteOrderToLittleEndian() if order == "little" else writer.SetByteOrderToBigEndian()
        assert writer.Write() == 1
        refused = "compressor" if compressor in ("lz4", "lzma") else None
        yield Dialect(path, *expected, "meridian", refused)

    surface = vtk.vtkPolyData()
    surface.SetPoints(positions)
    polygons = vtk.vtkCellArray()
    for cell in cells:
        polygons.InsertNextCell(3, [int(vertex) for vertex in cell])
    surface.SetPolys(polygons)
    for binary in (False, True):
        path = folder / f"vtk-{binary}.stl"
        writer = vtk.vtkSTLWriter()
        writer.SetInputData(surface)
        writer.SetFileName(str(path))
        writer.SetFileTypeToBinary() if binary else writer.SetFileTypeToASCII()
        assert writer.Write() == 1
        yield Dialect(path, *expected)


def by_meshio(folder: Path) -> Iterator[Dialect]:
    points, cells = ball()
    expected = (len(points), len(cells), volume(points, cells))
    mesh = meshio.Mesh(points, [("triangle", cells)])
    for binary in (False, True):
        for version in ("gmsh", "gmsh22"):
            path = folder / f"meshio-{version}-{binary}.msh"
            meshio.write(path, mesh, file_format=version, binary=binary)
            yield Dialect(path, *expected)
        path = folder / f"meshio-{binary}.stl"
        meshio.write(path, mesh, binary=binary)
        yield Dialect(path, *expected)
    for header, compression in itertools.product(("UInt32", "UInt64"), (None, "zlib", "lzma")):
        path = folder / f"meshio-{header}-{compression}.vtu"
        meshio.write(path, mesh, binary=True, header_type=header, compression=compression)
        yield Dialect(path, *expected, refused="compressor" if compression == "lzma" else None)
    path = folder / "meshio-ascii.vtu"
    meshio.write(path, mesh, binary=False)
    yield Dialect(path, *expected)


def by_gmsh(folder: Path) -> Iterator[Dialect]:
    try:
        import gmsh
    except OSError as error:  # A library of the window system is missing.
        pytest.skip(f"gmsh cannot be loaded: {error}; install libglu1-mesa, libxft2 and libxcursor1")
    gmsh.initialize(["gmsh", "-v", "0"], interruptible=False)
    try:
        for partitions in (1, 3):
            yield from _by_gmsh(gmsh, folder, partitions)
    finally:
        gmsh.finalize()


def _by_gmsh(gmsh: object, folder: Path, partitions: int) -> Iterator[Dialect]:
    gmsh.clear()  # type: ignore[attr-defined]
    model, option = gmsh.model, gmsh.option  # type: ignore[attr-defined]
    option.setNumber("Mesh.MeshSizeMax", 0.5)
    model.occ.addSphere(0, 0, 0, 1)
    model.occ.synchronize()
    for dimension, name in ((0, "pole"), (1, "meridian"), (2, "skin")):
        tags = [tag for _, tag in model.getEntities(dimension)]
        model.addPhysicalGroup(dimension, tags, name=name)
    model.mesh.generate(2)
    nodes, coordinates, _ = model.mesh.getNodes()
    _, corners = model.mesh.getElementsByType(2)
    index = {int(tag): k for k, tag in enumerate(nodes)}
    triangles = np.array([index[int(tag)] for tag in corners]).reshape(-1, 3)
    points = coordinates.reshape(-1, 3)
    expected = (len(np.unique(triangles)), len(triangles), abs(volume(points, triangles)))
    if partitions > 1:
        model.mesh.partition(partitions)
    for version, binary, parametric, everything in itertools.product((2.0, 2.1, 2.2, 4.0, 4.1), (0, 1), (0, 1), (0, 1)):
        if version == 4.0 and binary:  # Gmsh reads such files, and does not write them.
            continue
        for name, value in (
            ("MshFileVersion", version),
            ("Binary", binary),
            ("SaveParametric", parametric),
            ("SaveAll", everything),
        ):
            option.setNumber(f"Mesh.{name}", value)
        path = folder / f"gmsh-{partitions}-{version}-{binary}-{parametric}-{everything}.msh"
        gmsh.write(str(path))  # type: ignore[attr-defined]
        # With all elements saved, versions 2 forget the groups.
        group = None if everything and version < 4 else "meridian"
        yield Dialect(path, *expected, group)
    for binary in (0, 1):
        option.setNumber("Mesh.Binary", binary)
        path = folder / f"gmsh-{partitions}-{binary}.stl"
        gmsh.write(str(path))  # type: ignore[attr-defined]
        yield Dialect(path, *expected)


def outcome(binary: Path, dialect: Dialect) -> str | None:
    """What is wrong with a dialect, if anything."""
    # Files of single precision are 1e-7 off the sphere.
    options = ["surface_tolerance = 1e-6"]
    if dialect.group is not None:
        options.append(f'protected_groups = ["{dialect.group}"]')
    setup = dialect.path.with_suffix(dialect.path.suffix + ".toml")
    setup.write_text(
        f'format = 1\n[mesh]\nfile = "{dialect.path.name}"\n[[components]]\nname = "ball"\n'
        'primitive = { type = "sphere", center = [0, 0, 0], radius = 1 }\n[options]\n' + "\n".join(options)
    )
    command = [binary, "--log", "error", "setup", "--json", "--setup-file", setup.name, dialect.path.parent]
    run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    if dialect.refused is not None:
        return None if run.returncode == 1 and dialect.refused in run.stderr else f"not refused: {run.stderr}"
    if run.returncode != 0:
        return run.stderr
    report = json.loads(run.stdout)
    found = (report["vertices"], report["triangles"], report["watertight"])
    if found != (dialect.vertices, dialect.triangles, True):
        return f"{found} in place of {dialect}"
    return None if abs(report["volume"] - dialect.volume) < 1e-5 else f"volume {report['volume']}, {dialect.volume}"


@pytest.mark.parametrize(("write", "least"), [(by_vtk, 130), (by_meshio, 13), (by_gmsh, 76)])
def test_files_of_other_programs(
    binary: Path, tmp_path: Path, write: Callable[[Path], Iterator[Dialect]], least: int
) -> None:
    dialects = list(write(tmp_path))
    assert len(dialects) >= least
    with ThreadPoolExecutor(2) as pool:
        outcomes = list(pool.map(lambda dialect: outcome(binary, dialect), dialects))
    wrong = {d.path.name: said for d, said in zip(dialects, outcomes, strict=True) if said is not None}
    assert not wrong, json.dumps(wrong, indent=2)
