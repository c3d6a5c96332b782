"""Client, set-ups and sessions of the mesh service, blocking. :mod:`moldline.aio` has the same for asyncio."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import cached_property
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline import operations
from moldline.caller import Caller
from moldline.check import Check
from moldline.designs import Design
from moldline.errors import MoldlineError
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
from moldline.own_sessions import OwnSessions
from moldline.progress import Tell, told
from moldline.v1 import mesh_service_pb2 as wire
from moldline.v1 import mesh_service_pb2_grpc


class Client(Caller):
    """A connection to a mesh service. Thread-safe; close it, or use it in a `with` statement.

    `target`: address such as ``127.0.0.1:50051``, or a `grpc.Channel` of your own (with credentials, interceptors), which
    the client does not close.
    `token`: bearer token, sent with every call; use it with `tls` unless the network is trusted. `token_file`: file with it.
    Without both the variable MOLDLINE_TOKEN is taken, if it is set.
    `tls`: `True` for TLS with gRPC's list of authorities, a :class:`TLS` for other settings, `False` for plain text.
    `timeout`: seconds that a call may take over all its attempts, except set-ups and checks; `math.inf` for no limit. Every
    method takes its own.
    `retry`: retry policy.

    The connection is made by the first call. Clients, and the set-ups and sessions that they return, go to other processes
    by fork and by pickle (joblib, Dask, Ray, ...), but for clients of a channel or of a `token` in plain text.
    """

    _STUB = mesh_service_pb2_grpc.MeshServiceStub

    def __init__(self, target: Any = "127.0.0.1:50051", **options: Any) -> None:
        super().__init__(target, **options)
        self._sessions = OwnSessions()

    def close(self) -> None:
        """Closes the connection, and before it the session of calls without one; running calls are cancelled."""
        for session in self._sessions.taken():
            with suppress(MoldlineError):
                session.close(timeout=1.0)
        super().close()

    def _session_of(self, setup: Setup) -> Session:
        session: Session = self._sessions.find(setup.id, lambda: setup.session(label="client"))
        return session

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
        """Uploads and builds a set-up; identical content returns the existing set-up.

        `path`: its folder, or an archive of it (.tar, .tar.gz, .tgz, .zip).
        `setup_file`: the file that describes the set-up; the server's usual names if empty.
        `visibility`, `shared_with`: as in :meth:`Setup.share`; if `None`, private if it is new, else unchanged.
        `progress`: `True` for a progress bar, or a function that is called with each :class:`Progress`. An exception of
        the function cancels the call.
        `request_id`: name of this request, by which a retry is recognised; random if `None`.

        Raises :class:`InvalidArgument` naming every wrong field.
        """
        with told(progress) as tell:
            operation = operations.create_setup(path, setup_file, request_id, visibility, shared_with, tell)
            created = self._run(operation, timeout)
        return Setup(self, created.setup, built=created.built)

    def get_setup(self, setup_id: str, *, timeout: float | None = None) -> Setup:
        """The set-up with this id. Raises :class:`NotFound`."""
        return Setup(self, self._run(operations.get_setup(setup_id), timeout), built=False)

    def list_setups(self, *, timeout: float | None = None) -> list[SetupSummary]:
        """The set-ups that you may use (your own, shared and public ones), ordered by id."""
        return self._run(operations.list_setups(), timeout)

    def resume(self, session_id: str, *, timeout: float | None = None) -> Session:
        """The open session with this id of your tenant, on whichever server it was opened. Raises :class:`NotFound`."""
        state, description = self._run(operations.resume(session_id), timeout)
        return Session(Setup(self, description, built=False), state)

    def list_sessions(self, *, timeout: float | None = None) -> list[SessionState]:
        """Your open sessions without their designs, ordered by id."""
        return self._run(operations.list_sessions(), timeout)

    def status(self, *, timeout: float | None = None) -> Status:
        """Load, caches and store of the server: your tenant's share, or all of it for administrators."""
        return self._run(operations.status(), timeout)

    def check(self, setup: Setup | str | os.PathLike[str], designs: int = 1, **options: Any) -> Check:
        """Checks the derivatives of a set-up, or of one in a folder or an archive; see :meth:`Setup.check`."""
        if not isinstance(setup, Setup):
            setup = self.create_setup(setup, progress=options.get("progress", False))
        return setup.check(designs, **options)


def serve(
    *arguments: str,
    store: str | os.PathLike[str] = "memory",
    binary: str | os.PathLike[str] | None = None,
    **options: Any,
) -> Client:
    """Starts a private server on a free port of this machine; returns a client of it, which ends it when it is closed.

        with moldline.serve() as client:
            setup = client.create_setup("examples/e175")

    The server ends with this process too, however that one ends. `client.address` tells other programs where it is.

    `arguments`: further ones of `moldline serve`, such as ``"--threads", "4"``. Variables of the environment for servers
    (``MOLDLINE_...``) do not count.
    `store`: what outlives the server, as for `moldline serve`: by default nothing.
    `binary`: the program; else the one that the variable MOLDLINE_BINARY names, the one beside the interpreter, or the one
    on the PATH.
    `options`: of the client, such as `timeout`.

    Raises `FileNotFoundError` if the program is not found, :class:`Unavailable` with its last words if it does not start.
    """
    return Client._with_server(("serve", "--store", os.fspath(store), *arguments), binary, options)


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
        design: Design = None,
        variables: Iterable[str] = (),
        seed: int = 1,
        progress: bool | Tell = False,
        timeout: float = math.inf,
    ) -> Check:
        """Checks the derivatives: products against their transposes, dual numbers and central differences.

        `designs`: number of designs: the baseline, then random ones far from it.
        `design`: the only design to check at, in their place, as :meth:`Session.deform` takes it.
        `variables`: names of variables or of groups of them whose derivatives are compared with dual numbers and central
        differences; all if empty.
        `seed`: seed of the random designs and vectors.
        `progress`: `True` for a progress bar, or a function that is called with each :class:`Progress`.
        `timeout`: seconds; a check of a large set-up takes minutes.

        Raises :class:`InvalidArgument` naming the wrong field, :class:`ResourceExhausted` while other checks are running.
        """
        with told(progress) as tell:
            operation = operations.check(self, designs, design, variables, seed, tell)
            return self._client._run(operation, timeout)

    def share(self, visibility: Visibility, *, shared_with: Iterable[str] = (), timeout: float | None = None) -> None:
        """Changes who else may use a set-up that you own.

        `visibility`: ``private``, ``tenants`` or ``public``.
        `shared_with`: names of tenants, with ``tenants``.
        """
        self.access = self._client._run(operations.share_setup(self.id, visibility, shared_with), timeout)

    def delete(self, *, timeout: float | None = None) -> None:
        """Gives up your ownership. Open sessions continue, and other owners of the same content keep the set-up."""
        self._client._run(operations.delete_setup(self.id), timeout)

    @property
    def _session(self) -> Session:
        """The session of calls without one, opened by the first of them and closed with the client."""
        return self._client._session_of(self)

    def deform(
        self,
        design: Design = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        cell_quality: bool = False,
        timeout: float | None = None,
    ) -> Deformation:
        """As :meth:`Session.deform`, in a session of the client's own, which ends with the client."""
        return self._session.deform(design, control_points=control_points, cell_quality=cell_quality, timeout=timeout)

    def jvp(
        self,
        directions: ArrayLike | None = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        at: At = None,
        timeout: float | None = None,
    ) -> Tangents:
        """As :meth:`Session.jvp`, in the session of :meth:`deform`."""
        return self._session.jvp(directions, control_points=control_points, at=at, timeout=timeout)

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
        """As :meth:`Session.vjp`, in the session of :meth:`deform`."""
        return self._session.vjp(
            vertices=vertices, functions=functions, at=at, design=design, control_points=control_points, timeout=timeout
        )

    def jacobian(self, *, at: At = None, progress: bool | Tell = False, timeout: float | None = None) -> Jacobian:
        """As :meth:`Session.jacobian`, in the session of :meth:`deform`."""
        return self._session.jacobian(at=at, progress=progress, timeout=timeout)

    def session(self, *, label: str = "", request_id: str | None = None, timeout: float | None = None) -> Session:
        """Opens a session, which lasts until it is closed: use it in a `with` statement, or close it.

        `label`: descriptive.
        `request_id`: as in :meth:`Client.create_setup`.
        """
        return Session(self, self._client._run(operations.open_session(self.id, label, request_id), timeout))


class Session(SessionFacts):
    """A session: work on one set-up, isolated from all other sessions.

    The server keeps it with the design stored last, across restarts and until it is closed: an optimizer stores its
    accepted designs (:meth:`update`), and continues from the last one after an interruption (:meth:`resume`).
    """

    def __init__(self, setup: Setup, state: SessionState) -> None:
        super().__init__(state)
        #: The set-up.
        self.setup = setup

    @classmethod
    def resume(cls, client: Client, session_id: str, *, timeout: float | None = None) -> Session:
        """Same as :meth:`Client.resume`."""
        return client.resume(session_id, timeout=timeout)

    def update(
        self,
        design: Design = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        label: str | None = None,
        timeout: float | None = None,
    ) -> None:
        """Stores the session's design, label or both, durably; `None` leaves them unchanged.

        Raises :class:`Aborted` if the session has been updated elsewhere since: :meth:`refresh` reads the current state.
        """
        operation = operations.update_session(self.setup, self.state, design, control_points, label)
        self.state = self.setup._client._run(operation, timeout)

    def refresh(self, *, timeout: float | None = None) -> None:
        """Reads :attr:`state` from the server again."""
        self.state = self.setup._client._run(operations.get_session(self.id), timeout)

    def deform(
        self,
        design: Design = None,
        *,
        control_points: Mapping[str, ArrayLike] | None = None,
        cell_quality: bool = False,
        timeout: float | None = None,
    ) -> Deformation:
        """The mesh at a design. A pure function: the same design gives the same bytes.

        `design`: values by name of a variable (``wing.twist[3]``) or of a group (``wing.twist``: an array of its shape, or
        one number for all), all others at their baseline; or float64, (number of variables,); every entry in its
        variable's unit; `None` for the baseline.
        `control_points`: by component name, float64, (number of its control points, 3), metres: external control points
        that replace the component's own.
        `cell_quality`: whether to return the quality measures of every cell.

        Raises :class:`InvalidArgument` naming the wrong entry, :class:`FailedPrecondition` if the mesh cannot follow.
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
        """Jacobian-vector products `J v`, exactly: changes of the outputs along directions of the inputs.

        `directions`: of the design variables, float64, (k, number of variables) or (number of variables,), every entry in
        its variable's unit; `None` for zero.
        `control_points`: of the control points of some components, by name, float64, (k, number of its control points, 3)
        or without the first axis, metres, in addition to the effect of `directions`. The design does not move a component
        whose control points `at` gives.
        `at`: see :data:`At`.

        Raises :class:`InvalidArgument` naming the wrong entry, :class:`NotFound` for a bare id of a linearisation that the
        server no longer holds.
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
        """Vector-Jacobian products `J^T w`, exactly: gradients of weighted sums of the outputs with respect to the inputs.

        Several sums share part of the work.

        `vertices`: weights of the vertices' coordinates, float64, (k, n, 3) or (n, 3), such as the gradient of an objective
        with respect to them, per metre; `None` for zero.
        `functions`: weights of the functions, by name, each a number or float64, (k,), all others zero; or float64,
        (k, number of functions) or (number of functions,), in the order of :attr:`Setup.functions`.
        `at`: see :data:`At`.
        `design`: whether to take gradients with respect to the design variables.
        `control_points`: components whose control points to take gradients with respect to.

        Raises as :meth:`jvp`.
        """
        operation = operations.vjp(self.setup, self.id, vertices, functions, at, design, control_points)
        return self.setup._client._run(operation, timeout)

    def jacobian(self, *, at: At = None, progress: bool | Tell = False, timeout: float | None = None) -> Jacobian:
        """The Jacobian, exactly: derivatives of all outputs with respect to all design variables.

        It is received in blocks into one array.

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
