"""Connections of clients, over which operations run with deadlines and retries: by blocking, and by awaiting."""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import Any, ClassVar, TypeVar

import grpc
import grpc.aio

from moldline import connection, forks
from moldline.calls import Call, Operation
from moldline.connection import TLS, Credential
from moldline.errors import MoldlineError, translated
from moldline.private_server import PrivateServer
from moldline.retry import Attempts, Deadline, Retry

_LOG = logging.getLogger("moldline")

T = TypeVar("T")
C = TypeVar("C", bound="Caller")
A = TypeVar("A", bound="AsyncCaller")


class _Connection:
    """A channel to a service and the settings of its calls.

    The channel is made by the first call, once in each process: clients go to other processes by fork and by pickle, with
    the address and the place of the token. The copies of one client in a process are one client.
    """

    #: Makes the service's stub from a channel.
    _STUB: ClassVar[Any]
    #: Module that makes channels.
    _TRANSPORT: ClassVar[Any]

    def __init__(
        self,
        target: Any = "127.0.0.1:50051",
        *,
        token: str | None = None,
        token_file: str | os.PathLike[str] | None = None,
        tls: TLS | bool = False,
        timeout: float = 600.0,
        retry: Retry = Retry(),
    ) -> None:
        if not isinstance(target, str) and tls:
            raise ValueError("the given channel has its own credentials: leave out tls")
        self._target = target
        self._credential = Credential(token, token_file)
        self._tls = tls
        self._timeout = timeout
        self._retry = retry
        self._lock = forks.Lock()
        self._open: _Open | None = None
        #: Process that made the channel, and whether the client is closed there.
        self._process = os.getpid()
        self._closed = False
        #: A server that ends with the client.
        self._server: PrivateServer | None = None

    @property
    def address(self) -> str:
        """Address of the server, or that it is a given channel's."""
        return self._target if isinstance(self._target, str) else "the given channel"

    def __repr__(self) -> str:
        security = "TLS" if self._tls else "plain text" if isinstance(self._target, str) else "given channel"
        return f"<{type(self).__module__}.{type(self).__qualname__} of {self.address}: {security}>"

    def __reduce__(self) -> tuple[Any, ...]:
        if not isinstance(self._target, str):
            raise pickle.PicklingError("a client of a given channel does not go to other processes: give an address")
        return _copy, (type(self), self._target, self._credential, self._tls, self._timeout, self._retry)

    def _connection(self) -> _Open:
        """The channel of this process; a channel of the parent process is left alone."""
        with self._lock:
            if self._process != os.getpid():
                self._process, self._open, self._closed = os.getpid(), None, False
            if self._closed:
                raise ValueError("the client is closed")
            if self._open is None:
                channel = self._target
                if isinstance(channel, str):
                    channel = connection.channel(channel, self._tls, self._TRANSPORT)
                self._open = _Open(channel, self._STUB(channel), self._credential.metadata())
            return self._open

    @property
    def _stub(self) -> Any:
        """The stub of this process."""
        return self._connection().stub

    def _leave(self) -> Any:
        """Marks the client as closed; returns the channel that is to be closed, if any."""
        with self._lock:
            opened, self._open, self._closed = self._open, None, True
            own = opened is not None and self._process == os.getpid() and isinstance(self._target, str)
        _COPIES.forget(self)
        return opened.channel if opened is not None and own else None

    def _deadline(self, timeout: float | None) -> Deadline:
        return Deadline(self._timeout if timeout is None else timeout)

    def _begin(self, call: Call, deadline: Deadline) -> Any:
        opened = self._connection()
        method = getattr(opened.stub, call.method)
        return method(call.messages(), timeout=deadline.remaining, metadata=opened.metadata)


@dataclass(frozen=True)
class _Open:
    """A channel, its stub, and the metadata of its calls."""

    channel: Any
    stub: Any
    metadata: tuple[tuple[str, str], ...]


class _Copies:
    """The clients that came to this process by pickle: equal ones are one, with one channel."""

    def __init__(self) -> None:
        self._lock = forks.Lock()
        self._clients: dict[Any, _Connection] = {}

    def find(self, key: Any, make: Callable[[], _Connection]) -> _Connection:
        """The client of `key`, made if there is none."""
        with self._lock:
            return self._clients.setdefault(key, make())

    def forget(self, client: _Connection) -> None:
        """Copies that come later are new."""
        with self._lock:
            self._clients = {key: each for key, each in self._clients.items() if each is not client}


_COPIES = _Copies()


def _copy(
    kind: type[_Connection], target: str, credential: Credential, tls: TLS | bool, timeout: float, retry: Retry
) -> _Connection:
    """What a pickled client becomes."""
    key = (os.getpid(), kind, target, str(credential.file), tls, timeout, retry)
    return _COPIES.find(key, lambda: kind(target, token_file=credential.file, tls=tls, timeout=timeout, retry=retry))


@contextmanager
def _logged(call: Call) -> Iterator[None]:
    """Logs how long an attempt took."""
    began = time.monotonic()
    try:
        yield
    finally:
        _LOG.debug("%s: %.1f ms", call.method, 1e3 * (time.monotonic() - began))


def _told(call: Call, pause: float, error: MoldlineError) -> float:
    """Logs that an attempt failed and another follows after `pause` seconds."""
    _LOG.warning("%s failed (%s); again in %.1f s", call.method, error, pause)
    return pause


class Caller(_Connection):
    """A connection whose operations block. `target` may be a `grpc.Channel`."""

    _TRANSPORT = grpc

    def close(self) -> None:
        """Closes the connection; running calls are cancelled."""
        if (channel := self._leave()) is not None:
            channel.close()
        if self._server is not None:
            self._server.close()

    @classmethod
    def _with_server(
        cls: type[C], command: tuple[str, ...], binary: str | os.PathLike[str] | None, options: dict[str, Any]
    ) -> C:
        """A client of a server of its own."""
        server = PrivateServer((*command, "--listen", "127.0.0.1:0"), binary)
        client = cls(server.address, **options)
        client._server = server
        return client

    def __enter__(self: C) -> C:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self, operation: Operation[T], timeout: float | None) -> T:
        deadline = self._deadline(timeout)
        with closing(operation):
            step = operation.send
            result: Any = None
            while True:
                try:
                    call = step(result)
                except StopIteration as end:
                    return end.value  # type: ignore[no-any-return]  # The operation returns a T.
                try:
                    step, result = operation.send, self._perform(call, deadline)
                except MoldlineError as error:
                    step, result = operation.throw, error

    def _perform(self, call: Call, deadline: Deadline) -> Any:
        attempts = Attempts(self._retry, deadline, self.address)
        while True:
            try:
                with translated(), _logged(call):
                    return self._attempt(call, deadline)
            except MoldlineError as error:
                time.sleep(_told(call, attempts.pause(error), error))

    def _attempt(self, call: Call, deadline: Deadline) -> Any:
        answer = self._begin(call, deadline)
        if call.receiver is None:
            return answer
        receive = call.receiver()
        try:
            for message in answer:
                receive(message)
        finally:
            # No effect on a finished call.
            answer.cancel()
        return None


class AsyncCaller(_Connection):
    """A connection whose operations are awaited. `target` may be a `grpc.aio.Channel`. Create it in the event loop."""

    _TRANSPORT = grpc.aio

    async def close(self) -> None:
        """Closes the connection; running calls are cancelled."""
        if (channel := self._leave()) is not None:
            await channel.close()

    async def __aenter__(self: A) -> A:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def _run(self, operation: Operation[T], timeout: float | None) -> T:
        deadline = self._deadline(timeout)
        with closing(operation):
            step = operation.send
            result: Any = None
            while True:
                try:
                    call = step(result)
                except StopIteration as end:
                    return end.value  # type: ignore[no-any-return]  # The operation returns a T.
                try:
                    step, result = operation.send, await self._perform(call, deadline)
                except MoldlineError as error:
                    step, result = operation.throw, error

    async def _perform(self, call: Call, deadline: Deadline) -> Any:
        attempts = Attempts(self._retry, deadline, self.address)
        while True:
            try:
                with translated(), _logged(call):
                    return await self._attempt(call, deadline)
            except MoldlineError as error:
                pause = _told(call, attempts.pause(error), error)
            await asyncio.sleep(pause)

    async def _attempt(self, call: Call, deadline: Deadline) -> Any:
        answer = self._begin(call, deadline)
        if call.receiver is None:
            return await answer
        receive = call.receiver()
        try:
            async for message in answer:
                receive(message)
        finally:
            # No effect on a finished call.
            answer.cancel()
        return None
