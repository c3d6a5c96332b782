"""Client, set-ups and sessions for asyncio: the classes of :mod:`moldline.client` with methods to be awaited.

    async with moldline.aio.Client("127.0.0.1:50051") as client:
        setup = await client.create_setup("examples/e175")
        async with await setup.session() as session:
            result = await session.deform({"wing.translation": 5.0})
            gradient = (await session.vjp(functions={"enclosed_volume": 1.0}, at=result)).design

Arguments, results and exceptions are those of the methods of the same name there. Cancelling a task cancels its call on
the server. :mod:`moldline.panel.aio` is the client of the panel service for asyncio.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline import operations
from moldline.caller import AsyncCaller
from moldline.check import Check
from moldline.designs import Design
from moldline.facts import SessionFacts, SetupFacts
from moldline.mesh import Mesh
from moldline.model import (
    At,
    Deformation,
    Gradients,
    Jacobian,
    SessionState,
    SetupSummary,
    Status,
    Tangents,
    Visibility,
)
from moldline.progress import Tell, told
from moldline.v1 import mesh_service_pb2 as wire
from moldline.v1 import mesh_service_pb2_grpc


class Client(AsyncCaller):
    """As :class:`moldline.Client`. Create it in the event loop; `target` may be a `grpc.aio.Channel`."""

    _STUB = mesh_service_pb2_grpc.MeshServiceStub

    async def create_setup(
        self,
        path: str | os.PathLike[str],
        *,
        setup_file: str = "",
        visibility: Visibility | None = None,
        shared_with: Iterable[str] = (),
        progress: bool | Tell = False,
        request_id: str | None = None,
        timeout: float = math.inf,
    ) -> Setup:
        """As :meth:`moldline.Client.create_setup`."""
        with told(progress) as tell:
            operation = operations.create_setup(path, setup_file, request_id, visibility, shared_with, tell)
            created = await self._run(operation, timeout)
        return Setup(self, created.setup, built=created.built)

    async def get_setup(self, setup_id: str, *, timeout: float | None = None) -> Setup:
        """As :meth:`moldline.Client.get_setup`."""
        return Setup(self, await self._run(operations.get_setup(setup_id), timeout), built=False)

    async def list_setups(self, *, timeout: float | None = None) -> list[SetupSummary]:
        """As :meth:`moldline.Client.list_setups`."""
        return await self._run(operations.list_setups(), timeout)

    async def resume(self, session_id: str, *, timeout: float | None = None) -> Session:
        """As :meth:`moldline.Client.resume`."""
        state, description = await self._run(operations.resume(session_id), timeout)
        return Session(Setup(self, description, built=False), state)

    async def list_sessions(self, *, timeout: float | None = None) -> list[SessionState]:
        """As :meth:`moldline.Client.list_sessions`."""
        return await self._run(operations.list_sessions(), timeout)

    async def status(self, *, timeout: float | None = None) -> Status:
        """As :meth:`moldline.Client.status`."""
        return await self._run(operations.status(), timeout)

    async def check(self, setup: Setup | str | os.PathLike[str], designs: int = 1, **options: Any) -> Check:
        """As :meth:`moldline.Client.check`."""
        if not isinstance(setup, Setup):
            setup = await self.create_setup(setup, progress=options.get("progress", False))
        return await setup.check(designs, **options)


class Setup(SetupFacts):
    """As :class:`moldline.Setup`."""

    def __init__(self, client: Client, description: wire.SetupDescription, *, built: bool) -> None:
        super().__init__(description, built=built)
        self._client = client
        self._mesh: Mesh | None = None
        self._control_points: dict[str, NDArray[np.float64]] | None = None

    async def mesh(self) -> Mesh:
        """As :attr:`moldline.Setup.mesh`."""
        if self._mesh is None:
            self._mesh = await self._client._run(operations.mesh(self), None)
        return self._mesh

    async def control_points(self) -> dict[str, NDArray[np.float64]]:
        """As :attr:`moldline.Setup.control_points`."""
        if self._control_points is None:
            self._control_points = await self._client._run(operations.control_points(self), None)
        return self._control_points

    async def check(
        self,
        designs: int = 1,
        *,
        design: Design = None,
        variables: Iterable[str] = (),
        seed: int = 1,
        progress: bool | Tell = False,
        timeout: float = math.inf,
    ) -> Check:
        """As :meth:`moldline.Setup.check`."""
        with told(progress) as tell:
            operation = operations.check(self, designs, design, variables, seed, tell)
            return await self._client._run(operation, timeout)

    async def share(
        self, visibility: Visibility, *, shared_with: Iterable[str] = (), timeout: float | None = None
    ) -> None:
        """As :meth:`moldline.Setup.share`."""
        self.access = await self._client._run(operations.share_setup(self.id, visibility, shared_with), timeout)

    async def delete(self, *, timeout: float | None = None) -> None:
        """As :meth:`moldline.Setup.delete`."""
        await self._client._run(operations.delete_setup(self.id), timeout)

    async def session(self, *, label: str = "", request_id: str | None = None, timeout: float | None = None) -> Session:
        """As :meth:`moldline.Setup.session`: ``async with await setup.session() as session``."""
        return Session(self, await self._client._run(operations.open_session(self.id, label, request_id), timeout))


class Session(SessionFacts):
    """As :class:`moldline.Session`."""

    def __init__(self, setup: Setup, state: SessionState) -> None:
        super().__init__(state)
        #: The set-up.
        self.setup = setup

    @classmethod
    async def resume(cls, client: Client, session_id: str, *, timeout: float | None = None) -> Session:
        """Same as :meth:`Client.resume`."""
        return await client.resume(session_id, timeout=timeout)

    async def update(
        self,
        design: Design = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        label: str | None = None,
        timeout: float | None = None,
    ) -> None:
        """As :meth:`moldline.Session.update`."""
        operation = operations.update_session(self.setup, self.state, design, control_points, label)
        self.state = await self.setup._client._run(operation, timeout)

    async def refresh(self, *, timeout: float | None = None) -> None:
        """As :meth:`moldline.Session.refresh`."""
        self.state = await self.setup._client._run(operations.get_session(self.id), timeout)

    async def deform(
        self,
        design: Design = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        cell_quality: bool = False,
        timeout: float | None = None,
    ) -> Deformation:
        """As :meth:`moldline.Session.deform`."""
        operation = operations.deform(self.setup, self.id, design, control_points, cell_quality)
        return await self.setup._client._run(operation, timeout)

    async def jvp(
        self,
        directions: ArrayLike | None = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        at: At = None,
        timeout: float | None = None,
    ) -> Tangents:
        """As :meth:`moldline.Session.jvp`."""
        operation = operations.jvp(self.setup, self.id, directions, control_points, at)
        return await self.setup._client._run(operation, timeout)

    async def vjp(
        self,
        *,
        vertices: ArrayLike | None = None,
        functions: Mapping[str, ArrayLike] | ArrayLike | None = None,
        at: At = None,
        design: bool = True,
        control_points: Iterable[str] = (),
        timeout: float | None = None,
    ) -> Gradients:
        """As :meth:`moldline.Session.vjp`."""
        operation = operations.vjp(self.setup, self.id, vertices, functions, at, design, control_points)
        return await self.setup._client._run(operation, timeout)

    async def jacobian(self, *, at: At = None, progress: bool | Tell = False, timeout: float | None = None) -> Jacobian:
        """As :meth:`moldline.Session.jacobian`."""
        with told(progress) as tell:
            return await self.setup._client._run(operations.jacobian(self.setup, self.id, at, tell), timeout)

    async def close(self, *, timeout: float | None = None) -> None:
        """As :meth:`moldline.Session.close`."""
        await self.setup._client._run(operations.close_session(self.id), timeout)

    async def __aenter__(self) -> Session:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()
