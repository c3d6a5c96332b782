"""Client of the panel service: subsonic flow over surface meshes by a panel method, with exact derivatives.

    panels = moldline.panel.Client("127.0.0.1:50052")
    configuration = panels.create_configuration(
        mesh.vertices, mesh.cells, trailing_edges=moldline.panel.Angle(120), cell_groups=moldline.panel.parts(mesh)
    )
    reference = moldline.panel.Reference(area=68.2, chord=3.42, span=23.8, point=(14, 0, 0.9))
    analysis = configuration.analyze(vertices, mach=0.7, alpha=0.02, reference=reference)
    gradient = configuration.vjp({"lift": 1.0}, at=analysis).vertices

Axes: x aft, y starboard, z up; metres and radians. The service stores nothing durably: a configuration that it has dropped
is sent again. :mod:`moldline.panel.aio` is the same for asyncio.
"""

from moldline.panel.client import Client, Configuration, serve
from moldline.panel.facts import parts
from moldline.panel.model import (
    COEFFICIENTS,
    Analysis,
    AnalysisPoint,
    Angle,
    At,
    Coefficients,
    Edges,
    FlowGradients,
    FlowTangents,
    Groups,
    LineLeftOut,
    Loads,
    OnDoubt,
    Reference,
    Sections,
    Solver,
    Symmetry,
    TrailingEdges,
    Warning,
)

__all__ = [
    "COEFFICIENTS",
    "Analysis",
    "AnalysisPoint",
    "Angle",
    "At",
    "Client",
    "Coefficients",
    "Configuration",
    "Edges",
    "FlowGradients",
    "FlowTangents",
    "Groups",
    "LineLeftOut",
    "Loads",
    "OnDoubt",
    "Reference",
    "Sections",
    "Solver",
    "Symmetry",
    "TrailingEdges",
    "Warning",
    "parts",
    "serve",
]
