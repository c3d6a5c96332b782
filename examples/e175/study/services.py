"""The two services of the study, started for it."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import moldline
import moldline.panel
import numpy as np
from numpy.typing import NDArray

import aircraft

HERE = Path(__file__).resolve().parent
E175 = HERE.parent
sys.path.append(str(HERE.parents[2] / "xtask/scripts/demo"))

from demo import Server  # noqa: E402  # the demo's

Array = NDArray[np.float64]

#: Reference values for the panel service; the span is that of moments which the study does not use.
REFERENCE = moldline.panel.Reference(
    area=aircraft.REFERENCE_AREA, chord=aircraft.REFERENCE_CHORD, span=23.82, point=aircraft.REFERENCE_POINT
)
_NAMES = [name.removeprefix("flow.") for name in aircraft.AERODYNAMICS]


class PanelService:
    """The flow over one mesh, as :class:`problem.Aerodynamics`."""

    def __init__(self, client: moldline.panel.Client, mesh: moldline.Mesh) -> None:
        groups = moldline.panel.parts(mesh)
        self._configuration = client.create_configuration(mesh.vertices, mesh.cells, cell_groups=groups)
        self._last: moldline.panel.Analysis | None = None

    def coefficients(self, vertices: Array, alpha: float) -> Array:
        self._last = self._analyze(vertices, alpha)
        return np.array([getattr(self._last.coefficients, name) for name in _NAMES])

    def gradients(self, vertices: Array, alpha: float) -> tuple[Array, Array]:
        at = self._last
        if at is None or at.point.alpha != alpha or not np.array_equal(np.asarray(at.point.vertices), vertices):
            at = self._analyze(vertices, alpha)
        # Six seeds, which share one pass over the pairs of panels.
        seeds = dict(zip(_NAMES, np.eye(len(_NAMES)), strict=True))
        gradients = self._configuration.vjp(seeds, at=at)
        return gradients.vertices, gradients.alpha

    def pressures(self, vertices: Array, alpha: float) -> Array:
        return self._analyze(vertices, alpha, pressures=True).cp

    def _analyze(self, vertices: Array, alpha: float, *, pressures: bool = False) -> moldline.panel.Analysis:
        mach = aircraft.MODEL["mach"].value
        return self._configuration.analyze(vertices, reference=REFERENCE, mach=mach, alpha=alpha, pressures=pressures)


@contextmanager
def services(binary: Path, out: Path, *, coarse: bool) -> Iterator[tuple[moldline.Session, PanelService]]:
    """A session on the E175, on the committed mesh or on the coarse one, and the flow over its mesh."""
    out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        mesh_server = stack.enter_context(Server(binary, out / "mesh-service.log"))
        panel_server = stack.enter_context(Server(binary, out / "panel-service.log", command=("panel", "serve")))
        client = stack.enter_context(moldline.Client(mesh_server.address))
        panels = stack.enter_context(moldline.panel.Client(panel_server.address))
        setup = client.create_setup(_setup_folder(out, coarse))
        session = stack.enter_context(setup.session())
        yield session, PanelService(panels, setup.mesh)


def _setup_folder(out: Path, coarse: bool) -> Path:
    """The E175, or a copy of it with the coarse mesh."""
    if not coarse:
        return E175
    folder = out / "setup-coarse"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(E175 / "geometry", folder / "geometry")
    shutil.copy(E175 / "setup.toml", folder)
    shutil.copy(HERE / "mesh-coarse.msh", folder / "mesh.msh")
    return folder
