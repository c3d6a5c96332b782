"""Client and configurations of the panel service for asyncio: the classes of :mod:`moldline.panel.client` with methods to
be awaited.

    async with moldline.panel.aio.Client("127.0.0.1:50052") as panels:
        configuration = await panels.create_configuration(mesh.vertices, mesh.cells)
        analysis = await configuration.analyze(vertices, mach=0.7, alpha=0.02, reference=reference)
        gradient = (await configuration.vjp({"lift": 1.0}, at=analysis)).vertices

Arguments, results and exceptions are those of the methods of the same name there. Cancelling a task cancels its call on
the server.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from numpy.typing import ArrayLike

from moldline.caller import AsyncCaller
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


class Client(AsyncCaller):
    """As :class:`moldline.panel.Client`. Create it in the event loop; `target` may be a `grpc.aio.Channel`."""

    _STUB = panel_service_pb2_grpc.PanelServiceStub

    async def create_configuration(
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
        """As :meth:`moldline.panel.Client.create_configuration`."""
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
        return Configuration(self, await self._run(operations.create(request), timeout), request)

    async def get_configuration(self, configuration_id: str, *, timeout: float | None = None) -> Configuration:
        """As :meth:`moldline.panel.Client.get_configuration`."""
        return Configuration(self, await self._run(operations.get(configuration_id), timeout), None)


class Configuration(ConfigurationFacts):
    """As :class:`moldline.panel.Configuration`."""

    def __init__(
        self, client: Client, description: wire.Configuration, request: wire.CreateConfigurationRequest | None
    ) -> None:
        super().__init__(description, request)
        self._client = client

    async def analyze(
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
        """As :meth:`moldline.panel.Configuration.analyze`."""
        with told(progress) as tell:
            operation = operations.sweep(self, [alpha], vertices, reference, mach, sideslip, pressures, tell)
            return (await self._client._run(operation, timeout))[0]

    async def sweep(
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
        """As :meth:`moldline.panel.Configuration.sweep`."""
        with told(progress) as tell:
            operation = operations.sweep(self, alphas, vertices, reference, mach, sideslip, pressures, tell)
            return await self._client._run(operation, timeout)

    async def jvp(
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
        """As :meth:`moldline.panel.Configuration.jvp`."""
        directions = {
            "vertices": vertices,
            "alpha": alpha,
            "sideslip": sideslip,
            "mach": mach,
            "area": area,
            "chord": chord,
            "point": point,
        }
        return await self._client._run(operations.jvp(self, directions, at), timeout)

    async def vjp(
        self,
        coefficients: Mapping[str, ArrayLike] | ArrayLike | None = None,
        *,
        section_loads: ArrayLike | None = None,
        cp: ArrayLike | None = None,
        at: At,
        timeout: float | None = None,
    ) -> FlowGradients:
        """As :meth:`moldline.panel.Configuration.vjp`."""
        return await self._client._run(operations.vjp(self, coefficients, section_loads, cp, at), timeout)
