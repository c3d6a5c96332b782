"""Exceptions, one class for each class of failure."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import grpc
from google.rpc import error_details_pb2
from grpc_status import rpc_status


@dataclass(frozen=True)
class FieldViolation:
    """One fault of a request."""

    #: Path of the field, such as ``design[3]``.
    field: str
    #: What is wrong with it: index, value, limit and the way out.
    description: str


class MoldlineError(Exception):
    """A request failed."""

    def __init__(
        self, message: str, violations: tuple[FieldViolation, ...] = (), retry_after: float | None = None
    ) -> None:
        super().__init__(message)
        #: What is wrong, in one sentence.
        self.message = message
        #: The faults of the request, if it is the request's fault.
        self.violations = violations
        #: Seconds after which trying again may help, if it may.
        self.retry_after = retry_after


class InvalidArgument(MoldlineError, ValueError):
    """The request is wrong whatever the state of the server."""


class NotFound(MoldlineError, LookupError):
    """There is no set-up or session of that id that you may see, or no linearisation any more for a bare id."""


class AlreadyExists(MoldlineError):
    """The request id named a request with other content before."""


class Aborted(MoldlineError):
    """Somebody else was faster: the session has another generation than was expected. Read it again."""


class Unauthenticated(MoldlineError, PermissionError):
    """The server does not know who this is: the token is missing, unknown or has expired."""


class PermissionDenied(MoldlineError, PermissionError):
    """The server knows who this is, and that this is not theirs to do."""


class FailedPrecondition(MoldlineError):
    """The design is valid, but the mesh cannot follow it: a seam is lost, or a projection does not converge."""


class ResourceExhausted(MoldlineError):
    """The server is full, or a quota is; where trying again may help, :attr:`retry_after` says when."""


class OutOfRange(MoldlineError):
    """A message is larger than the server or the client accepts."""


class Cancelled(MoldlineError):
    """The call was cancelled."""


class DeadlineExceeded(MoldlineError, TimeoutError):
    """The call took longer than its timeout."""


class Unavailable(MoldlineError, ConnectionError):
    """The server cannot be reached, or is about to stop."""


class InternalError(MoldlineError):
    """A fault of the server, or an answer that cannot be understood."""


_CLASSES: dict[grpc.StatusCode, type[MoldlineError]] = {
    grpc.StatusCode.INVALID_ARGUMENT: InvalidArgument,
    grpc.StatusCode.NOT_FOUND: NotFound,
    grpc.StatusCode.ALREADY_EXISTS: AlreadyExists,
    grpc.StatusCode.ABORTED: Aborted,
    grpc.StatusCode.UNAUTHENTICATED: Unauthenticated,
    grpc.StatusCode.PERMISSION_DENIED: PermissionDenied,
    grpc.StatusCode.FAILED_PRECONDITION: FailedPrecondition,
    grpc.StatusCode.RESOURCE_EXHAUSTED: ResourceExhausted,
    grpc.StatusCode.OUT_OF_RANGE: OutOfRange,
    grpc.StatusCode.CANCELLED: Cancelled,
    grpc.StatusCode.DEADLINE_EXCEEDED: DeadlineExceeded,
    grpc.StatusCode.UNAVAILABLE: Unavailable,
}


def from_rpc(error: grpc.RpcError) -> MoldlineError:
    """The exception for a failed call, with the details that the server sent."""
    violations: list[FieldViolation] = []
    retry_after = None
    status = rpc_status.from_call(error)
    for detail in status.details if status is not None else ():
        bad_request, retry = error_details_pb2.BadRequest(), error_details_pb2.RetryInfo()
        if detail.Unpack(bad_request):
            violations += [FieldViolation(fault.field, fault.description) for fault in bad_request.field_violations]
        elif detail.Unpack(retry):
            retry_after = retry.retry_delay.ToTimedelta().total_seconds()
    kind = _CLASSES.get(error.code(), InternalError)
    return kind(error.details() or error.code().name, tuple(violations), retry_after)


@contextmanager
def translated() -> Iterator[None]:
    """Turns a failed call inside of it into an exception of this module."""
    try:
        yield
    except grpc.RpcError as error:
        raise from_rpc(error) from None
