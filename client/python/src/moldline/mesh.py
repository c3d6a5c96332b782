"""Surface meshes, and their VTK files."""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline import pictures
from moldline.content import ByContent

if TYPE_CHECKING:
    from moldline.model import Deformation

#: Fourth entry of a triangle.
NO_VERTEX = np.uint32(0xFFFFFFFF)


@dataclass(frozen=True, eq=False, repr=False)
class Mesh(ByContent):
    """A surface mesh of triangles and quadrilaterals."""

    #: float64, (n, 3), metres.
    vertices: NDArray[np.float64]
    #: uint32, (m, 4): vertices of each cell, counter-clockwise from outside; a triangle's fourth is 0xFFFFFFFF.
    cells: NDArray[np.uint32]
    #: uint32, (m,): index into `components` of the component that owns the cell.
    cell_owner: NDArray[np.uint32]
    #: bool, (n,): whether the vertex lies on a seam of two components.
    seam: NDArray[np.bool_]
    #: Names of the components.
    components: tuple[str, ...]

    @property
    def triangles(self) -> NDArray[np.bool_]:
        """bool, (m,): which cells are triangles."""
        return np.asarray(self.cells[:, 3] == NO_VERTEX)

    def blocks(self) -> list[Block]:
        """The cells by shape, triangles first, without the mark in the place of a triangle's fourth vertex."""
        return blocks(self.cells)

    def moved(self, vertices: ArrayLike | Deformation) -> Mesh:
        """The same mesh with other vertices, float64, (n, 3), metres, or with those of a deformation."""
        points = np.asarray(getattr(vertices, "vertices", vertices), dtype=np.float64)
        if points.shape != self.vertices.shape:
            raise ValueError(f"vertices have shape {points.shape}, the mesh has {self.vertices.shape}")
        return replace(self, vertices=points)

    def to_pyvista(
        self,
        vertices: ArrayLike | Deformation | None = None,
        point_data: Mapping[str, ArrayLike] | None = None,
        cell_data: Mapping[str, ArrayLike] | None = None,
    ) -> Any:
        """The mesh as a `pyvista.PolyData`, with owner and seam, and what else is given; needs ``moldline[plot]``.

        `vertices`: float64, (n, 3), metres, or a deformation, in place of the mesh's own.
        `point_data`, `cell_data`: arrays by name, of first extent n or m.
        """
        return pictures.to_pyvista(self if vertices is None else self.moved(vertices), point_data, cell_data)

    def to_meshio(
        self,
        vertices: ArrayLike | Deformation | None = None,
        point_data: Mapping[str, ArrayLike] | None = None,
        cell_data: Mapping[str, ArrayLike] | None = None,
    ) -> Any:
        """The mesh as a `meshio.Mesh`, triangles first; the arguments are those of :meth:`to_pyvista`."""
        return pictures.to_meshio(self if vertices is None else self.moved(vertices), point_data, cell_data)

    def plot(
        self,
        field: str | ArrayLike = "components",
        *,
        vertices: ArrayLike | Deformation | None = None,
        path: str | os.PathLike[str] | None = None,
        title: str = "",
        edges: bool = True,
        view: pictures.View = "iso",
        size: tuple[int, int] = (1200, 800),
        limits: tuple[float, float] | None = None,
    ) -> Any:
        """Shows the mesh, or writes a picture of it; needs ``moldline[plot]``.

        `field`: what the colours show: ``components``, ``seam``, ``quality`` (aspect ratio of the cells), ``displacement``
        (of `vertices` from the mesh's own, metres); or an array: (m,) of the cells, such as an analysis's `cp`, (n,) of the
        vertices, or (n, 3) of vectors at the vertices, such as a gradient, of which the part along the normal is shown.
        `vertices`: float64, (n, 3), metres, or a deformation, in place of the mesh's own.
        `path`: picture to write (.png), without a display; `None` opens a window, or a picture in a notebook.
        `title`: name beside the colours. `limits`: least and largest value of the colours.
        `edges`: whether to draw the cells' edges. `view`: `iso`, `top`, `side` or `front`. `size`: pixels.

        Returns the `pyvista.Plotter` if no `path` is given.
        """
        return pictures.plot(self, field, vertices, path, title, edges, view, size, limits)

    def __repr__(self) -> str:
        triangles = int(self.triangles.sum())
        cells = f"{triangles} triangles, {len(self.cells) - triangles} quadrilaterals"
        return f"<Mesh of {len(self.vertices)} vertices, {cells}: {', '.join(self.components)}>"


@dataclass(frozen=True, eq=False, repr=False)
class Block(ByContent):
    """The cells of one shape."""

    #: ``triangle`` or ``quad``, as in meshio.
    kind: str
    #: uint32, (b, 3) or (b, 4): vertices of each cell.
    cells: NDArray[np.uint32]
    #: (b,): the cells' places in the mesh.
    places: NDArray[np.intp]


def blocks(cells: ArrayLike) -> list[Block]:
    """Cells, uint32, (m, 4), as :attr:`Mesh.cells`, by shape, triangles first; shapes without cells are left out."""
    cells = np.asarray(cells, dtype=np.uint32)
    triangle = cells[:, 3] == NO_VERTEX
    both = (("triangle", 3, triangle), ("quad", 4, ~triangle))
    return [Block(kind, cells[which, :corners], np.flatnonzero(which)) for kind, corners, which in both if which.any()]


def write_vtu(
    path: str | os.PathLike[str],
    mesh: Mesh,
    vertices: ArrayLike | Deformation | None = None,
    point_data: Mapping[str, ArrayLike] | None = None,
    cell_data: Mapping[str, ArrayLike] | None = None,
) -> None:
    """Writes `mesh` as a VTK unstructured grid (.vtu, appended raw binary), with owner and seam.

    `vertices`: float64, (n, 3), metres, in place of the mesh's own, such as `Deformation.vertices`.
    `point_data`, `cell_data`: arrays by name, of first extent n or m.
    """
    points = mesh.vertices if vertices is None else mesh.moved(vertices).vertices
    seam = {"seam": mesh.seam.astype("u1"), **(point_data or {})}
    owner = {"owner": mesh.cell_owner, **(cell_data or {})}
    write_cells(path, points, mesh.cells, seam, owner)


def write_cells(
    path: str | os.PathLike[str],
    vertices: ArrayLike,
    cells: ArrayLike,
    point_data: Mapping[str, ArrayLike] | None = None,
    cell_data: Mapping[str, ArrayLike] | None = None,
) -> None:
    """Writes a mesh of vertices, float64, (n, 3), metres, and cells, uint32, (m, 4), as :attr:`Mesh.cells`."""
    points = np.asarray(vertices, dtype="<f8")
    cells = np.asarray(cells, dtype=np.uint32)
    triangles = cells[:, 3] == NO_VERTEX
    corners = np.where(triangles, 3, 4)
    connectivity = cells[cells != NO_VERTEX]

    blocks = _Blocks()
    at_points = {name: _of_length(name, data, len(points)) for name, data in (point_data or {}).items()}
    of_cells = {name: _of_length(name, data, len(corners)) for name, data in (cell_data or {}).items()}
    body = [
        _element("Points", [blocks.add("points", points)]),
        _element(
            "Cells",
            [
                blocks.add("connectivity", connectivity.astype("<i8")),
                blocks.add("offsets", np.cumsum(corners).astype("<i8")),
                blocks.add("types", np.where(triangles, 5, 9).astype("u1")),
            ],
        ),
        _element("PointData", [blocks.add(name, data) for name, data in at_points.items()]),
        _element("CellData", [blocks.add(name, data) for name, data in of_cells.items()]),
    ]
    head = (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
        f'<UnstructuredGrid>\n<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(corners)}">\n'
        f"{''.join(body)}</Piece>\n</UnstructuredGrid>\n"
        '<AppendedData encoding="raw">_'
    )
    tail = "\n</AppendedData>\n</VTKFile>\n"
    Path(path).write_bytes(b"".join([head.encode(), *blocks.data, tail.encode()]))


_VTK_TYPES = {
    "float64": "Float64",
    "float32": "Float32",
    "int64": "Int64",
    "int32": "Int32",
    "uint64": "UInt64",
    "uint32": "UInt32",
    "uint8": "UInt8",
    "int8": "Int8",
}


class _Blocks:
    """Appended data: each block is its length in bytes and its bytes."""

    def __init__(self) -> None:
        self.data: list[bytes] = []
        self._offset = 0

    def add(self, name: str, values: NDArray[Any]) -> str:
        if values.dtype == np.bool_:
            values = values.astype("u1")
        kind = _VTK_TYPES.get(values.dtype.name)
        if kind is None or values.ndim not in (1, 2):
            raise ValueError(f"{name}: arrays of {values.dtype}, {values.ndim} dimensions, cannot be written")
        columns = values.shape[1] if values.ndim == 2 else 1
        content = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes()
        description = f'<DataArray type="{kind}" Name={quoteattr(name)} NumberOfComponents="{columns}"'
        description += f' format="appended" offset="{self._offset}"/>\n'
        self.data += [struct.pack("<Q", len(content)), content]
        self._offset += 8 + len(content)
        return description


def _element(tag: str, children: list[str]) -> str:
    return f"<{tag}>\n{''.join(children)}</{tag}>\n"


def _of_length(name: str, data: ArrayLike, length: int) -> NDArray[Any]:
    array = np.asarray(data)
    if array.shape[:1] != (length,):
        raise ValueError(f"{name} has shape {array.shape}, its first extent must be {length}")
    return array
