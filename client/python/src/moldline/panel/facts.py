"""Descriptions of configurations, known without another call."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from moldline import arrays
from moldline.mesh import Mesh, write_cells
from moldline.panel import convert
from moldline.panel.model import Analysis
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
        #: Such as ``single``.
        self.solver: str = convert.solver(description.solver)
        #: Approximate peak memory of an analysis, bytes.
        self.memory: int = description.memory_bytes
        #: Names of the parts whose forces are returned.
        self.components: tuple[str, ...] = tuple(description.components)

    def write_vtu(self, path: str | os.PathLike[str], analysis: Analysis) -> None:
        """Writes the mesh of an analysis with its pressure coefficients as a VTK unstructured grid (.vtu)."""
        if self._request is None:
            raise ValueError("another client created this configuration and has its cells: use moldline.write_cells")
        vertices = analysis.point.vertices
        if vertices is None:
            vertices = arrays.from_wire(self._request.vertices)
        cells = arrays.from_wire(self._request.cells)
        write_cells(path, vertices, cells, {"cp": analysis.vertex_cp}, {"cp": analysis.cp})


def parts(mesh: Mesh) -> dict[str, NDArray[np.uint32]]:
    """The cells of each component of a mesh, by name: cell groups of a configuration."""
    owned = {
        name: np.flatnonzero(mesh.cell_owner == index).astype(np.uint32) for index, name in enumerate(mesh.components)
    }
    return {name: cells for name, cells in owned.items() if len(cells)}
