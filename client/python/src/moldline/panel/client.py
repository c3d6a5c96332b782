"""Client and configurations of the panel service, blocking. :mod:`moldline.panel.aio` has the same for asyncio."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from numpy.typing import ArrayLike

from moldline.caller import Caller
from moldline.panel import operations
from moldline.panel.facts import ConfigurationFacts
from moldline.panel.model import (
    Analysis,
    At,
    FlowGradients,
    FlowTangents,
    OnDoubt,
    Reference,
    Solver,
    Symmetry,
    TrailingEdges,
)
from moldline.progress import Tell, told
from moldline.v1 import panel_service_pb2 as wire
from moldline.v1 import panel_service_pb2_grpc


class Client(Caller):
    """A connection to a panel service (`moldline panel serve`). Thread-safe; close it, or use it in a `with` statement.

    The arguments are those of :class:`moldline.Client`.
    """

    _STUB = panel_service_pb2_grpc.PanelServiceStub

    def create_configuration(
        self,
        vertices: ArrayLike,
        cells: ArrayLike,
        *,
        cell_groups: Mapping[str, ArrayLike] | None = None,
        vertex_groups: Mapping[str, ArrayLike] | None = None,
        symmetry: Symmetry | None = None,
        trailing_edges: TrailingEdges | None = None,
        components: Iterable[str] | None = None,
        solver: Solver | None = None,
        tolerance: float | None = None,
        merge_tolerance: float | None = None,
        on_doubt: OnDoubt | None = None,
        timeout: float | None = None,
    ) -> Configuration:
        """Checks a mesh and finds everything that does not depend on the positions of its vertices.

        Identical content returns the same configuration.

        `vertices`: float64, (n, 3), metres: reference positions, where symmetry, trailing edges and wakes are found.
        `cells`: uint32, (m, 4), as :attr:`moldline.Mesh.cells`.
        `cell_groups`: parts of the surface by name, for forces; :func:`parts` makes them from a mesh.
        `vertex_groups`: vertices by name, for trailing edges.
        `symmetry`: found from the reference positions if `None`.
        `trailing_edges`: found by an angle of 120 degrees if `None`.
        `components`: cell groups whose forces are returned; all if `None`.
        `solver`: chosen by the number of unknowns if `None`.
        `tolerance`: residual relative to the right-hand side; 1e-12 if `None`.
        `merge_tolerance`: metres within which vertices become one, at their mean; none if `None`. All arrays, and
        derivatives, keep the vertices given.
        `on_doubt`: answers that contradict themselves are refused if `None`.

        Raises :class:`moldline.InvalidArgument` naming the wrong cell or edge, :class:`moldline.ResourceExhausted` if an
        analysis would need more memory than the server allows.
        """
        request = operations.configuration_request(
            vertices,
            cells,
            cell_groups,
            vertex_groups,
            symmetry,
            trailing_edges,
            components,
            solver,
            tolerance,
            merge_tolerance,
            on_doubt,
        )
        return Configuration(self, self._run(operations.create(request), timeout), request)

    def get_configuration(self, configuration_id: str, *, timeout: float | None = None) -> Configuration:
        """The configuration with this id. Raises :class:`moldline.NotFound` if the server does not hold it, or no longer."""
        return Configuration(self, self._run(operations.get(configuration_id), timeout), None)


def serve(*arguments: str, binary: str | os.PathLike[str] | None = None, **options: Any) -> Client:
    """As :func:`moldline.serve`, for the panel service: `arguments` are those of `moldline panel serve`."""
    return Client._with_server(("panel", "serve", *arguments), binary, options)


class Configuration(ConfigurationFacts):
    """A mesh prepared for analyses on the server. Immutable; valid for all positions of its vertices."""

    def __init__(
        self, client: Client, description: wire.Configuration, request: wire.CreateConfigurationRequest | None
    ) -> None:
        super().__init__(description, request)
        self._client = client

    def analyze(
        self,
        vertices: ArrayLike | None = None,
        *,
        reference: Reference,
        mach: float = 0.0,
        alpha: float = 0.0,
        sideslip: float = 0.0,
        pressures: bool = True,
        progress: bool | Tell = False,
        timeout: float | None = None,
    ) -> Analysis:
        """The flow at one angle of attack. A pure function: the same input gives the same bytes.

        `vertices`: float64, (n, 3), metres; the reference positions if `None`.
        `alpha`, `sideslip`: rad.
        `pressures`: whether to return the pressures of cells and vertices.
        `progress`: as in :meth:`moldline.Client.create_setup`.

        Raises :class:`moldline.InvalidArgument` naming the wrong field, :class:`moldline.FailedPrecondition` if the method
        fails on these vertices, such as a wake that cuts the body.
        """
        with told(progress) as tell:
            operation = operations.sweep(self, [alpha], vertices, reference, mach, sideslip, pressures, tell)
            return self._client._run(operation, timeout)[0]

    def sweep(
        self,
        alphas: Sequence[float],
        vertices: ArrayLike | None = None,
        *,
        reference: Reference,
        mach: float = 0.0,
        sideslip: float | Sequence[float] = 0.0,
        pressures: bool = True,
        progress: bool | Tell = False,
        timeout: float | None = None,
    ) -> list[Analysis]:
        """Analyses in several winds at little more than the cost of one; see :meth:`analyze`.

        `sideslip`: rad; one for each angle of attack, or the same for all.
        """
        with told(progress) as tell:
            operation = operations.sweep(self, alphas, vertices, reference, mach, sideslip, pressures, tell)
            return self._client._run(operation, timeout)

    def jvp(
        self,
        vertices: ArrayLike | None = None,
        *,
        alpha: ArrayLike | None = None,
        sideslip: ArrayLike | None = None,
        mach: ArrayLike | None = None,
        area: ArrayLike | None = None,
        chord: ArrayLike | None = None,
        point: ArrayLike | None = None,
        at: At,
        timeout: float | None = None,
    ) -> FlowTangents:
        """Jacobian-vector products `J v`, exactly: changes of the outputs along directions of the inputs. `None` is zero.

        `vertices`: float64, (k, n, 3) or (n, 3), m. `point`: (k, 3) or (3,). The others: (k,) or a number.
        `at`: point of linearisation.
        """
        directions = {
            "vertices": vertices,
            "alpha": alpha,
            "sideslip": sideslip,
            "mach": mach,
            "area": area,
            "chord": chord,
            "point": point,
        }
        return self._client._run(operations.jvp(self, directions, at), timeout)

    def vjp(
        self,
        coefficients: Mapping[str, ArrayLike] | ArrayLike | None = None,
        *,
        section_loads: ArrayLike | None = None,
        cp: ArrayLike | None = None,
        at: At,
        timeout: float | None = None,
    ) -> FlowGradients:
        """Vector-Jacobian products `J^T w`, exactly: gradients of weighted sums of the outputs. `None` is zero.

        Several sums share one pass.

        `coefficients`: weights by name (:data:`COEFFICIENTS`), each a number or (k,), all others zero; or all in order,
        (k, 9) or (9,). `section_loads`: (k, sections) or (sections,). `cp`: (k, m) or (m,).
        `at`: point of linearisation.
        """
        return self._client._run(operations.vjp(self, coefficients, section_loads, cp, at), timeout)
