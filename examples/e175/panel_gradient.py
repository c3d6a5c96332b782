"""Chains the two services: lift and induced drag of the E175, and their gradients with respect to all design variables from
two adjoint calls.

    moldline serve --listen 127.0.0.1:50051 &
    moldline panel serve --listen 127.0.0.1:50052 &
    python panel_gradient.py                 # a minute; --checks 0 leaves the comparison out

    design --Deform--> vertices --Analyze--> coefficients
    design <--adjoint of the mesh-- gradient at the vertices <--adjoint of the panel method-- weights of coefficients

The gradients are compared with central differences through both services, along random directions of the design variables.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import moldline
import numpy as np
from moldline.panel import Configuration, Reference
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
#: Reference values of the baseline: wing area, mean aerodynamic chord, span; moment centre near the centre of gravity.
E175 = Reference(area=68.2, chord=3.42, span=23.82, point=(14.0, 0.0, 0.95))

Array = NDArray[np.float64]


class Chain:
    """Coefficients of a design, and their gradients."""

    def __init__(
        self,
        session: moldline.Session,
        configuration: Configuration,
        coefficients: Sequence[str],
        reference: Reference,
        mach: float,
        alpha: float,
    ) -> None:
        self.session, self.configuration, self.coefficients = session, configuration, tuple(coefficients)
        self.flow = {"reference": reference, "mach": mach, "alpha": alpha}

    def values(self, design: Array) -> Array:
        """The coefficients, in the order of `coefficients`."""
        return self._at(design)[2]

    def gradients(self, design: Array) -> Array:
        """Derivatives with respect to the design variables, a row for each coefficient: two calls, whatever the numbers."""
        deformation, analysis, _ = self._at(design)
        seeds = {name: np.eye(len(self.coefficients))[row] for row, name in enumerate(self.coefficients)}
        by_vertices = self.configuration.vjp(seeds, at=analysis).vertices
        by_design = self.session.vjp(vertices=by_vertices, at=deformation).design
        assert by_design is not None
        return by_design

    def differences(self, design: Array, direction: Array, step: float) -> Array:
        """Central differences of the coefficients along a direction."""
        return (self.values(design + step * direction) - self.values(design - step * direction)) / (2 * step)

    def _at(self, design: Array) -> tuple[moldline.Deformation, moldline.panel.Analysis, Array]:
        deformation = self.session.deform(design)
        analysis = self.configuration.analyze(deformation.vertices, **self.flow)
        return deformation, analysis, np.array([getattr(analysis.coefficients, name) for name in self.coefficients])


def scaled_direction(session: moldline.Session, random: np.random.Generator) -> Array:
    """A direction in which every variable crosses a random share of its range."""
    lower, upper = session.setup.bounds
    reach = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    return reach * random.uniform(-1, 1, len(reach))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mesh-server", default="127.0.0.1:50051", metavar="ADDRESS")
    parser.add_argument("--panel-server", default="127.0.0.1:50052", metavar="ADDRESS")
    parser.add_argument("--setup", type=Path, default=HERE, help="folder of the set-up")
    parser.add_argument("--mach", type=float, default=0.7)
    parser.add_argument("--alpha", type=float, default=0.0, help="angle of attack, degrees")
    parser.add_argument("--checks", type=int, default=2, help="random directions to compare with differences")
    parser.add_argument(
        "--step", type=float, default=1e-4, help="of the differences, as a share of the variables' ranges"
    )
    parser.add_argument("--output", type=Path, help="VTU file to write, with the pressure coefficients")
    arguments = parser.parse_args()

    with (
        moldline.Client(arguments.mesh_server) as meshes,
        moldline.panel.Client(arguments.panel_server) as panels,
        meshes.create_setup(arguments.setup, progress=True).session() as session,
    ):
        mesh = session.setup.mesh
        configuration = panels.create_configuration(mesh.vertices, mesh.cells, cell_groups=moldline.panel.parts(mesh))
        print(f"{configuration.unknowns} unknowns, {len(configuration.trailing_edges)} trailing edges")
        names = ("lift", "induced_drag", "moment")
        chain = Chain(session, configuration, names, E175, arguments.mach, np.deg2rad(arguments.alpha))
        design = session.setup.baseline
        for name, value in zip(names, chain.values(design), strict=True):
            print(f"{name:14} {value:12.6f}")
        gradients = chain.gradients(design)
        print(f"\n{'variable':28}" + "".join(f"{'d ' + name:>16}" for name in names))
        for index, variable in enumerate(session.setup.variables):
            row = "".join(f"{gradient:16.8f}" for gradient in gradients[:, index])
            print(f"{variable.name:28}{row}  per {variable.unit}")

        worst = 0.0
        random = np.random.default_rng(1)
        for check in range(arguments.checks):
            direction = scaled_direction(session, random)
            exact = gradients @ direction
            error = np.abs(chain.differences(design, direction, arguments.step) - exact) / np.abs(exact)
            worst = max(worst, *error)
            found = ", ".join(f"{name} {e:.1e}" for name, e in zip(names, error, strict=True))
            print(f"direction {check + 1}: relative difference from central differences: {found}")
        if arguments.output:
            deformation = session.deform(design)
            configuration.write_vtu(arguments.output, configuration.analyze(deformation.vertices, **chain.flow))
            print(f"wrote {arguments.output}")
    return 0 if worst <= 1e-5 else 1


if __name__ == "__main__":
    sys.exit(main())
