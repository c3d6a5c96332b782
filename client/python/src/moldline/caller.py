"""What clients of all services have: a connection, deadlines, and calls that are tried again."""

from __future__ import annotations

import time
from contextlib import closing
from types import TracebackType
from typing import Any, ClassVar, TypeVar

import grpc

from moldline import connection
from moldline.connection import TLS
from moldline.errors import MoldlineError, translated
from moldline.operations import Call, Operation
from moldline.retry import Attempts, Deadline, Retry

T = TypeVar("T")
C = TypeVar("C", bound="Caller")


class Caller:
    """A connection to a service, over which operations run."""

    #: Makes the service's stub from a channel.
    _STUB: ClassVar[Any]

    def __init__(
        self,
        target: str | grpc.Channel = "127.0.0.1:50051",
        *,
        token: str | None = None,
        tls: TLS | bool = False,
        timeout: float = 600.0,
        retry: Retry = Retry(),
    ) -> None:
        self._own = isinstance(target, str)
        self._channel: grpc.Channel = connection.channel(target, tls, grpc)
        self._stub = self._STUB(self._channel)
        self._metadata = connection.metadata(token)
        self._timeout = timeout
        self._retry = retry

    def close(self) -> None:
        """Closes the connection; calls under way are cancelled."""
        if self._own:
            self._channel.close()

    def __enter__(self: C) -> C:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self, operation: Operation[T], timeout: float | None) -> T:
        deadline = Deadline(self._timeout if timeout is None else timeout)
        with closing(operation):
            step = operation.send
            result: Any = None
            while True:
                try:
                    call = step(result)
                except StopIteration as end:
                    return end.value  # type: ignore[no-any-return]  # What the operation returns is a T.
                try:
                    step, result = operation.send, self._perform(call, deadline)
                except MoldlineError as error:
                    step, result = operation.throw, error

    def _perform(self, call: Call, deadline: Deadline) -> Any:
        attempts = Attempts(self._retry, deadline)
        while True:
            try:
                with translated():
                    return self._attempt(call, deadline)
            except MoldlineError as error:
                time.sleep(attempts.pause(error))

    def _attempt(self, call: Call, deadline: Deadline) -> Any:
        method = getattr(self._stub, call.method)
        answer = method(call.messages(), timeout=deadline.remaining, metadata=self._metadata)
        if call.receiver is None:
            return answer
        receive = call.receiver()
        try:
            for message in answer:
                receive(message)
        finally:
            # Without effect if it has ended.
            answer.cancel()
        return None
