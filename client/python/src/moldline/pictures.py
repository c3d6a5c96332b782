"""Meshes for other libraries, and pictures of them."""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from moldline.mesh import Block, Mesh
    from moldline.model import Deformation

#: Where a picture is taken from: starboard, front and above; above; port; front.
View = Literal["iso", "top", "side", "front"]

# Direction to the eye, and the direction that is up in the picture; x aft, y starboard, z up.
_VIEWS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "iso": ((-1.0, 0.9, 0.7), (0.0, 0.0, 1.0)),
    "top": ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)),
    "side": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
    "front": ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
}


def to_pyvista(
    mesh: Mesh, point_data: Mapping[str, ArrayLike] | None, cell_data: Mapping[str, ArrayLike] | None
) -> Any:
    """A `pyvista.PolyData`, its cells in the mesh's order."""
    at_points = {"seam": mesh.seam.astype(np.uint8), **(point_data or {})}
    surface = polygons(mesh.vertices, mesh.blocks(), at_points, {"owner": mesh.cell_owner, **(cell_data or {})})
    surface.field_data["components"] = list(mesh.components)
    return surface


def polygons(
    vertices: ArrayLike,
    blocks: Sequence[Block],
    point_data: Mapping[str, ArrayLike],
    cell_data: Mapping[str, ArrayLike],
) -> Any:
    """A `pyvista.PolyData` of vertices, (n, 3), metres, and the blocks of a mesh's cells, in the mesh's order."""
    pyvista = _library("pyvista", "plot")
    corners = np.empty(sum(len(block.places) for block in blocks), dtype=np.int64)
    for block in blocks:
        corners[block.places] = block.cells.shape[1]
    ends = np.cumsum(corners + 1)
    faces = np.empty(int(ends[-1]) if len(ends) else 0, dtype=np.int64)
    heads = ends - corners - 1
    faces[heads] = corners
    for block in blocks:
        for corner in range(block.cells.shape[1]):
            faces[heads[block.places] + 1 + corner] = block.cells[:, corner]
    surface = pyvista.PolyData(np.array(vertices, dtype=np.float64), faces=faces)
    for name, data in point_data.items():
        surface.point_data[name] = np.asarray(data)
    for name, data in cell_data.items():
        surface.cell_data[name] = np.asarray(data)
    return surface


def to_meshio(mesh: Mesh, point_data: Mapping[str, ArrayLike] | None, cell_data: Mapping[str, ArrayLike] | None) -> Any:
    """A `meshio.Mesh`; data of the cells follow its blocks."""
    meshio = _library("meshio", "plot")
    blocks = mesh.blocks()
    of_cells = {"owner": mesh.cell_owner, **(cell_data or {})}
    return meshio.Mesh(
        np.array(mesh.vertices),
        [(block.kind, block.cells.astype(np.int64)) for block in blocks],
        point_data={"seam": mesh.seam.astype(np.uint8), **{k: np.asarray(v) for k, v in (point_data or {}).items()}},
        cell_data={name: [np.asarray(data)[block.places] for block in blocks] for name, data in of_cells.items()},
    )


def plot(
    mesh: Mesh,
    field: str | ArrayLike,
    vertices: ArrayLike | Deformation | None,
    path: str | os.PathLike[str] | None,
    title: str,
    edges: bool,
    view: View,
    size: tuple[int, int],
    limits: tuple[float, float] | None,
) -> Any:
    """As :meth:`moldline.Mesh.plot`."""
    pyvista = _library("pyvista", "plot")
    if view not in _VIEWS:
        raise ValueError(f"view is {view!r}, expected one of {', '.join(_VIEWS)}")
    if path is not None and os.path.splitext(os.fspath(path))[1].lower() != ".png":
        raise ValueError(f"pictures are written as .png, not as {os.fspath(path)!r}")
    surface = to_pyvista(mesh if vertices is None else mesh.moved(vertices), None, None)
    name, values, colours = _colours(mesh, surface, field)
    plotter = pyvista.Plotter(off_screen=path is not None, window_size=list(size))
    options: dict[str, Any] = {"show_edges": edges, "edge_color": "#404040", "line_width": 1, "copy_mesh": True}
    if isinstance(field, str) and field == "components":
        for index, component in enumerate(mesh.components):
            part = surface.extract_cells(np.flatnonzero(mesh.cell_owner == index))
            if part.n_cells:
                plotter.add_mesh(part, color=_PALETTE[index % len(_PALETTE)], label=component, **options)
        plotter.add_legend(bcolor=None, face="rectangle")
    else:
        bar = {"title": title or name, "vertical": False, "fmt": "%.4g"}
        plotter.add_mesh(surface, scalars=values, cmap=colours, clim=limits, scalar_bar_args=bar, **options)
    away, up = _VIEWS[view]
    centre = np.array(surface.center)
    plotter.camera_position = [tuple(centre + surface.length * np.array(away)), tuple(centre), up]
    plotter.reset_camera()
    # It leaves room for every direction of sight; this one needs less.
    plotter.camera.zoom(1.4)
    plotter.add_axes()
    if path is None:
        plotter.show()
        return plotter
    plotter.screenshot(os.fspath(path))
    plotter.close()
    return None


#: Colours of components, told apart by people who see colours differently (Okabe and Ito).
_PALETTE = ("#56B4E9", "#E69F00", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7", "#999999")


def _colours(mesh: Mesh, surface: Any, field: str | ArrayLike) -> tuple[str, NDArray[Any], str]:
    """Name and values of a field, and the colours that suit it."""
    if not isinstance(field, str):
        values = np.asarray(field, dtype=np.float64)
        if values.shape == mesh.vertices.shape:
            normals = surface.compute_normals(split_vertices=False, consistent_normals=False)
            return "along the normal", np.einsum("ij,ij->i", values, normals.point_data["Normals"]), "coolwarm"
        if values.shape not in ((len(mesh.cells),), (len(mesh.vertices),)):
            shapes = (
                f"({len(mesh.cells)},) of the cells, ({len(mesh.vertices)},) or {mesh.vertices.shape} of the vertices"
            )
            raise ValueError(f"the field has shape {values.shape}, expected {shapes}")
        return "", values, "coolwarm"
    if field in ("components", "seam"):
        return field, mesh.seam.astype(np.uint8), "viridis"
    if field == "displacement":
        return "displacement, m", np.linalg.norm(surface.points - mesh.vertices, axis=1), "viridis"
    if field == "quality":
        return "aspect ratio", aspect_ratios(np.asarray(surface.points), mesh), "viridis"
    raise ValueError(f"field is {field!r}, expected components, seam, quality, displacement or an array")


def aspect_ratios(points: NDArray[np.float64], mesh: Mesh) -> NDArray[np.float64]:
    """Verdict's aspect ratio of every cell, (m,): longest edge times perimeter over the area, scaled to 1 for an equilateral
    triangle and a square."""
    ratios = np.empty(len(mesh.cells))
    for block in mesh.blocks():
        corners = points[block.cells]
        lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        if block.kind == "triangle":
            area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
            scale = 4.0 * np.sqrt(3.0)
        else:
            area = 0.5 * np.linalg.norm(np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=1)
            scale = 4.0
        ratios[block.places] = lengths.max(axis=1) * lengths.sum(axis=1) / (scale * area)
    return ratios


def _library(name: str, extra: str) -> Any:
    """An optional library."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(f"{name} is needed for this: pip install 'moldline[{extra}]'") from error
