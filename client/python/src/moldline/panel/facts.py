"""Descriptions of configurations, known without another call."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moldline import arrays, display, pictures
from moldline.mesh import Mesh, blocks, write_cells
from moldline.panel import convert
from moldline.panel.model import Analysis, LineLeftOut, Warning
from moldline.v1 import panel_service_pb2 as wire


class ConfigurationFacts:
    """Description of a configuration."""

    def __init__(self, description: wire.Configuration, request: wire.CreateConfigurationRequest | None) -> None:
        #: Sent again if the server has dropped the configuration; `None` if another client created it.
        self._request = request
        #: Hash of its content.
        self.id: str = description.configuration_id
        self.vertex_count: int = description.vertex_count
        self.cell_count: int = description.cell_count
        #: Unknowns of the linear system.
        self.unknowns: int = description.unknowns
        #: Whether one half is solved for both.
        self.symmetric: bool = description.symmetric
        #: uint32, (k, 2): trailing edges of the solved half, in the order of section loads.
        self.trailing_edges: NDArray[np.uint32] = arrays.from_wire(description.trailing_edges)
        #: uint32: vertices where a trailing edge ends on a body, across which its circulation continues.
        self.roots: NDArray[np.uint32] = arrays.from_wire(description.roots)
        #: uint32: for each of them the vertex at the body's aft end where its circulation leaves the body.
        self.aft_ends: NDArray[np.uint32] = (
            arrays.from_wire(description.aft_ends) if description.HasField("aft_ends") else np.empty(0, np.uint32)
        )
        #: What looks like a trailing edge, but was not taken as one; the longest of each reason first.
        self.left_out: tuple[LineLeftOut, ...] = tuple(map(convert.left_out, description.left_out))
        #: Reasons to doubt the configuration.
        self.warnings: tuple[Warning, ...] = convert.warnings(description.warnings)
        #: Such as ``single``.
        self.solver: str = convert.solver(description.solver)
        #: Approximate peak memory of an analysis, bytes.
        self.memory: int = description.memory_bytes
        #: Names of the parts whose forces are returned.
        self.components: tuple[str, ...] = tuple(description.components)

    def write_vtu(self, path: str | os.PathLike[str], analysis: Analysis) -> None:
        """Writes the mesh of an analysis with its pressure coefficients as a VTK unstructured grid (.vtu)."""
        at_points, of_cells = _pressures(analysis)
        write_cells(path, *self._surface(analysis), at_points, of_cells)

    def to_pyvista(self, analysis: Analysis) -> Any:
        """The mesh of an analysis as a `pyvista.PolyData` with `cp`, its pressure coefficients; needs ``moldline[plot]``."""
        vertices, cells = self._surface(analysis)
        at_points, of_cells = _pressures(analysis)
        return pictures.polygons(vertices, blocks(cells), at_points, of_cells)

    def _surface(self, analysis: Analysis) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
        """Vertices and cells of an analysis."""
        if self._request is None:
            raise ValueError("another client created this configuration and has its cells: use moldline.write_cells")
        vertices = analysis.point.vertices
        if vertices is None:
            vertices = arrays.from_wire(self._request.vertices)
        return np.asarray(vertices, dtype=np.float64), arrays.from_wire(self._request.cells)

    def __repr__(self) -> str:
        sizes = f"{self.vertex_count} vertices, {self.cell_count} cells, {self.unknowns} unknowns"
        return f"<{type(self).__name__} {self.id[:12]}: {sizes}, solver {self.solver}>"

    def _repr_html_(self) -> str:
        rows = [
            ("vertices", self.vertex_count),
            ("cells", self.cell_count),
            ("unknowns", self.unknowns),
            ("plane of symmetry", "yes" if self.symmetric else "no"),
            ("trailing edges", len(self.trailing_edges)),
            ("solver", self.solver),
            ("memory of an analysis, MB", self.memory / 1e6),
            ("parts", ", ".join(self.components)),
        ]
        return display.table(f"Configuration {self.id[:12]}", ("", ""), rows)


def _pressures(analysis: Analysis) -> tuple[dict[str, NDArray[np.float64]], dict[str, NDArray[np.float64]]]:
    """Pressure coefficients at vertices and of cells, by name. Raises `ValueError` if they were not requested."""
    if not len(analysis.cp):
        raise ValueError("the analysis has no pressures: ask for them with pressures=True")
    return {"cp": analysis.vertex_cp}, {"cp": analysis.cp}


def parts(mesh: Mesh) -> dict[str, NDArray[np.uint32]]:
    """The cells of each component of a mesh, by name: cell groups of a configuration."""
    owned = {
        name: np.flatnonzero(mesh.cell_owner == index).astype(np.uint32) for index, name in enumerate(mesh.components)
    }
    return {name: cells for name, cells in owned.items() if len(cells)}
