"""Client, set-ups and sessions, for code that waits. :mod:`moldline.aio` has the same for asyncio."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from functools import cached_property
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline import operations
from moldline.caller import Caller
from moldline.check import Check
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


class Client(Caller):
    """A connection to a server. Safe to use from several threads; close it, or use it in a `with` statement.

    `target`: address such as ``127.0.0.1:50051``, or a `grpc.Channel` of your own (with credentials, interceptors),
    which is then yours to close.
    `token`: says who you are; it goes with every call, so use it with `tls` unless the network is your own.
    `tls`: `True` to encrypt, trusting gRPC's list of authorities; a :class:`TLS` to say more; `False` for plain text.
    `timeout`: seconds that a call other than `create_setup` may take in all, with what is tried again; `math.inf` for no
    limit. Every method takes one of its own.
    `retry`: when a call that failed is tried again.
    """

    _STUB = mesh_service_pb2_grpc.MeshServiceStub

    def create_setup(
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
        """Uploads and builds a set-up; the same content again gives the set-up that exists.

        `path`: its folder, or an archive of it (.tar, .tar.gz, .tgz, .zip).
        `setup_file`: the file in it that describes the set-up; the server's usual names if empty.
        `visibility`, `shared_with`: as in :meth:`Setup.share`; if `None`, private if it is new, else as it was.
        `progress`: `True` for a progress bar, or a function that is called with each :class:`Progress`. An exception of
        the function cancels the call.
        `request_id`: name of this request, so that a retry is recognised; made up if `None`.

        Raises :class:`InvalidArgument` naming every field that is wrong.
        """
        with told(progress) as tell:
            operation = operations.create_setup(path, setup_file, request_id, visibility, shared_with, tell)
            created = self._run(operation, timeout)
        return Setup(self, created.setup, built=created.built)

    def get_setup(self, setup_id: str, *, timeout: float | None = None) -> Setup:
        """The set-up of that id. Raises :class:`NotFound`."""
        return Setup(self, self._run(operations.get_setup(setup_id), timeout), built=False)

    def list_setups(self, *, timeout: float | None = None) -> list[SetupSummary]:
        """The set-ups that you may use: your own, those shared with you, and public ones; in the order of their ids."""
        return self._run(operations.list_setups(), timeout)

    def resume(self, session_id: str, *, timeout: float | None = None) -> Session:
        """The open session of that id, whoever of your tenant opened it, on whichever server. Raises :class:`NotFound`."""
        state, description = self._run(operations.resume(session_id), timeout)
        return Session(Setup(self, description, built=False), state)

    def list_sessions(self, *, timeout: float | None = None) -> list[SessionState]:
        """Your open sessions, without their designs; in the order of their ids."""
        return self._run(operations.list_sessions(), timeout)

    def status(self, *, timeout: float | None = None) -> Status:
        """What the server does and holds: of your tenant, or of all if you are an administrator."""
        return self._run(operations.status(), timeout)

    def check(self, setup: Setup | str | os.PathLike[str], designs: int = 1, **options: Any) -> Check:
        """Checks the derivatives of a set-up, or of that in a folder or an archive; see :meth:`Setup.check`."""
        if not isinstance(setup, Setup):
            setup = self.create_setup(setup, progress=options.get("progress", False))
        return setup.check(designs, **options)


class Setup(SetupFacts):
    """A set-up on the server: geometry, mesh, design variables and options. Immutable, and shared by all its users."""

    def __init__(self, client: Client, description: wire.SetupDescription, *, built: bool) -> None:
        super().__init__(description, built=built)
        self._client = client

    @cached_property
    def mesh(self) -> Mesh:
        """The reference mesh, fetched once."""
        return self._client._run(operations.mesh(self), None)

    @cached_property
    def control_points(self) -> dict[str, NDArray[np.float64]]:
        """By component: float64, (number of its control points, 3), metres, at the baseline; fetched once.

        Patch after patch, the second parameter fastest.
        """
        return self._client._run(operations.control_points(self), None)

    def check(
        self,
        designs: int = 1,
        *,
        design: Mapping[str, float] | ArrayLike | None = None,
        variables: Iterable[str] = (),
        seed: int = 1,
        progress: bool | Tell = False,
        timeout: float = math.inf,
    ) -> Check:
        """Checks the derivatives: products against their transposes, dual numbers and central differences.

        `designs`: at how many designs: the baseline, then random ones far from it.
        `design`: the only design to check at, in their place, as :meth:`Session.deform` takes it.
        `variables`: names of variables or of groups of them, to be compared with dual numbers and central differences;
        all if empty.
        `seed`: of the random designs and vectors.
        `progress`: `True` for a progress bar, or a function that is called with each :class:`Progress`.
        `timeout`: seconds it may take. It is minutes of work for the E175.

        Raises :class:`InvalidArgument` naming what is wrong, :class:`ResourceExhausted` while other checks are under way.
        """
        with told(progress) as tell:
            operation = operations.check(self, designs, design, variables, seed, tell)
            return self._client._run(operation, timeout)

    def share(self, visibility: Visibility, *, shared_with: Iterable[str] = (), timeout: float | None = None) -> None:
        """Changes who else may use a set-up of your own.

        `visibility`: ``private``, ``tenants`` or ``public``.
        `shared_with`: with ``tenants``: their names.
        """
        self.access = self._client._run(operations.share_setup(self.id, visibility, shared_with), timeout)

    def delete(self, *, timeout: float | None = None) -> None:
        """Gives up a set-up of your own. Sessions open on it go on; whoever else uploaded the same content keeps it."""
        self._client._run(operations.delete_setup(self.id), timeout)

    def session(self, *, label: str = "", request_id: str | None = None, timeout: float | None = None) -> Session:
        """Opens a session, which lasts until it is closed: use it in a `with` statement, or close it.

        `label`: for people.
        `request_id`: as in :meth:`Client.create_setup`.
        """
        return Session(self, self._client._run(operations.open_session(self.id, label, request_id), timeout))


class Session(SessionFacts):
    """Work on one set-up, apart from all other sessions.

    The server keeps it, with the design that was stored last, over restarts and until it is closed: an optimizer stores
    where it has got to (:meth:`update`), and goes on from there (:meth:`resume`) when it was interrupted itself.
    """

    def __init__(self, setup: Setup, state: SessionState) -> None:
        super().__init__(state)
        #: The set-up.
        self.setup = setup

    @classmethod
    def resume(cls, client: Client, session_id: str, *, timeout: float | None = None) -> Session:
        """The same as :meth:`Client.resume`."""
        return client.resume(session_id, timeout=timeout)

    def update(
        self,
        design: Mapping[str, float] | ArrayLike | None = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        label: str | None = None,
        timeout: float | None = None,
    ) -> None:
        """Stores the session's design, label or both; what is `None` stays as it was. When it returns, it is durable.

        Raises :class:`Aborted` if the session has been updated elsewhere since: :meth:`refresh` reads what is there now.
        """
        operation = operations.update_session(self.state, design, control_points, label)
        self.state = self.setup._client._run(operation, timeout)

    def refresh(self, *, timeout: float | None = None) -> None:
        """Reads :attr:`state` from the server again."""
        self.state = self.setup._client._run(operations.get_session(self.id), timeout)

    def deform(
        self,
        design: Mapping[str, float] | ArrayLike | None = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        cell_quality: bool = False,
        timeout: float | None = None,
    ) -> Deformation:
        """The mesh at a design. A pure function: the same design gives the same bytes, and a retry is safe.

        `design`: values by name, the others staying at their baseline; or float64, (number of variables), every
        entry in its variable's unit; `None` for the baseline.
        `control_points`: by component name, float64, (number of its control points, 3), metres: geometry from
        elsewhere, in place of what the design makes of the component.
        `cell_quality`: whether the measures of every cell are wanted too.

        Raises :class:`InvalidArgument` naming the entry that is wrong, :class:`FailedPrecondition` if the mesh cannot
        follow.
        """
        operation = operations.deform(self.setup, self.id, design, control_points, cell_quality)
        return self.setup._client._run(operation, timeout)

    def jvp(
        self,
        directions: ArrayLike | None = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        at: At = None,
        timeout: float | None = None,
    ) -> Tangents:
        """How the outputs change along directions of the inputs: `J v`, exactly.

        `directions`: of the design variables, float64, (k, number of variables) or (number of variables,), every entry in
        its variable's unit; `None` for zero.
        `control_points`: of the control points of some components, by name, float64, (k, number of its control points, 3)
        or without the first axis, metres, on top of what `directions` does to them. Where `at` gives a component's
        control points, the design does not move that component.
        `at`: see :data:`At`.

        Raises :class:`InvalidArgument` naming the entry that is wrong, :class:`NotFound` for a bare id of a linearisation
        that the server does not hold any more.
        """
        return self.setup._client._run(operations.jvp(self.setup, self.id, directions, control_points, at), timeout)

    def vjp(
        self,
        *,
        vertices: ArrayLike | None = None,
        functions: Mapping[str, ArrayLike] | ArrayLike | None = None,
        at: At = None,
        design: bool = True,
        control_points: Iterable[str] = (),
        timeout: float | None = None,
    ) -> Gradients:
        """Gradients of weighted sums of the outputs by the inputs: `J^T w`, exactly. One seed costs as much as k in part.

        `vertices`: weights of the vertices' coordinates, float64, (k, n, 3) or (n, 3), such as the derivative of an
        objective by them, per metre; `None` for zero.
        `functions`: weights of the functions, by name, each a number or float64, (k,), those not named being zero; or
        float64, (k, number of functions) or (number of functions,), in the order of :attr:`Setup.functions`.
        `at`: see :data:`At`.
        `design`: whether gradients by the design variables are wanted.
        `control_points`: components by whose control points gradients are wanted too.

        Raises as :meth:`jvp`.
        """
        operation = operations.vjp(self.setup, self.id, vertices, functions, at, design, control_points)
        return self.setup._client._run(operation, timeout)

    def jacobian(self, *, at: At = None, progress: bool | Tell = False, timeout: float | None = None) -> Jacobian:
        """Derivatives of all outputs by all design variables, exactly; received in blocks into one array.

        `at`: see :data:`At`.
        `progress`: as in :meth:`Client.create_setup`.

        Raises as :meth:`jvp`.
        """
        with told(progress) as tell:
            return self.setup._client._run(operations.jacobian(self.setup, self.id, at, tell), timeout)

    def close(self, *, timeout: float | None = None) -> None:
        """Closes the session for good; closing it again does nothing."""
        self.setup._client._run(operations.close_session(self.id), timeout)

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
