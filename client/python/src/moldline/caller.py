"""Connections of clients, over which operations run with deadlines and retries: by blocking, and by awaiting."""

from __future__ import annotations

import asyncio
import time
from contextlib import closing
from types import TracebackType
from typing import Any, ClassVar, TypeVar

import grpc
import grpc.aio

from moldline import connection
from moldline.calls import Call, Operation
from moldline.connection import TLS
from moldline.errors import MoldlineError, translated
from moldline.retry import Attempts, Deadline, Retry

T = TypeVar("T")
C = TypeVar("C", bound="Caller")
A = TypeVar("A", bound="AsyncCaller")


class _Connection:
    """A channel to a service and the settings of its calls."""

    #: Makes the service's stub from a channel.
    _STUB: ClassVar[Any]
    #: Module that makes channels.
    _TRANSPORT: ClassVar[Any]

    def __init__(
        self,
        target: Any = "127.0.0.1:50051",
        *,
        token: str | None = None,
        tls: TLS | bool = False,
        timeout: float = 600.0,
        retry: Retry = Retry(),
    ) -> None:
        self._own = isinstance(target, str)
        self._server = target if isinstance(target, str) else "the given channel"
        self._channel: Any = connection.channel(target, tls, self._TRANSPORT)
        self._stub = self._STUB(self._channel)
        self._metadata = connection.metadata(token)
        self._timeout = timeout
        self._retry = retry

    def _deadline(self, timeout: float | None) -> Deadline:
        return Deadline(self._timeout if timeout is None else timeout)

    def _begin(self, call: Call, deadline: Deadline) -> Any:
        method = getattr(self._stub, call.method)
        return method(call.messages(), timeout=deadline.remaining, metadata=self._metadata)


class Caller(_Connection):
    """A connection whose operations block. `target` may be a `grpc.Channel`."""

    _TRANSPORT = grpc

    def close(self) -> None:
        """Closes the connection; running calls are cancelled."""
        if self._own:
            self._channel.close()

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
        attempts = Attempts(self._retry, deadline, self._server)
        while True:
            try:
                with translated():
                    return self._attempt(call, deadline)
            except MoldlineError as error:
                time.sleep(attempts.pause(error))

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
        if self._own:
            await self._channel.close()

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
        attempts = Attempts(self._retry, deadline, self._server)
        while True:
            try:
                with translated():
                    return await self._attempt(call, deadline)
            except MoldlineError as error:
                pause = attempts.pause(error)
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
