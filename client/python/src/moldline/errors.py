"""Exceptions, one class for each class of failure."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import grpc
from google.protobuf.message import DecodeError
from google.rpc import error_details_pb2, status_pb2


@dataclass(frozen=True)
class FieldViolation:
    """One fault of a request."""

    #: Path of the field, such as ``design[3]``.
    field: str
    #: The fault: index, value, limit and the remedy.
    description: str


class MoldlineError(Exception):
    """Failure of a request."""

    def __init__(
        self, message: str, violations: tuple[FieldViolation, ...] = (), retry_after: float | None = None
    ) -> None:
        super().__init__(message)
        #: The failure in one sentence.
        self.message = message
        #: Faults of the request's fields, if any.
        self.violations = violations
        #: Seconds after which a retry may succeed, if any.
        self.retry_after = retry_after


class InvalidArgument(MoldlineError, ValueError):
    """The request is invalid, whatever the state of the server."""


class NotFound(MoldlineError, LookupError):
    """The caller can see nothing with this id, or the server no longer holds it."""


class AlreadyExists(MoldlineError):
    """An earlier request with other content had this request id."""


class Aborted(MoldlineError):
    """A concurrent update won: the session has a generation other than expected. Read it again."""


class Unauthenticated(MoldlineError, PermissionError):
    """The caller is not authenticated: the token is missing, unknown or expired."""


class PermissionDenied(MoldlineError, PermissionError):
    """The caller is authenticated, but lacks the permission."""


class FailedPrecondition(MoldlineError):
    """The input is valid, but the method fails on it, such as a mesh that loses a seam or a wake that cuts the body."""


class ResourceExhausted(MoldlineError):
    """The server or a quota is full; :attr:`retry_after` is set if a retry may succeed."""


class OutOfRange(MoldlineError):
    """A message exceeds the size limit of server or client."""


class Cancelled(MoldlineError):
    """The call was cancelled."""


class DeadlineExceeded(MoldlineError, TimeoutError):
    """The call exceeded its timeout."""


class Unavailable(MoldlineError, ConnectionError):
    """The server cannot be reached, or is stopping."""

    #: Whether the server said so itself, and so has not begun with the call.
    answered: bool = True
    #: Whether the connection broke after the call was sent: the server may have carried it out, or died of it.
    lost: bool = False
    #: Whether another attempt may succeed; not if one side does not trust the other.
    passes: bool = True


class InternalError(MoldlineError):
    """A fault of the server, or a malformed answer."""


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


#: Messages of gRPC about calls that were never sent; in case of doubt a call was.
_NEVER_SENT = re.compile(
    r"failed to connect to all addresses|connections to all backends failing|name resolution|DNS|empty address list"
    r"|connection refused|failed to connect to remote host|refused stream|stream refused|channel closed",
    re.IGNORECASE,
)
_NO_TRUST = re.compile("CERTIFICATE_VERIFY_FAILED")


def _sent(error: grpc.RpcError) -> status_pb2.Status | None:
    """What the server sent with an error.

    It counts whatever gRPC says beside it, which may be otherwise where a deadline passes at both ends at once.
    """
    for key, value in error.trailing_metadata() or ():
        if key == "grpc-status-details-bin":
            with suppress(DecodeError):
                return status_pb2.Status.FromString(value)
    return None


def from_rpc(error: grpc.RpcError) -> MoldlineError:
    """The exception for a failed call, with the details that the server sent."""
    violations: list[FieldViolation] = []
    retry_after = None
    status = _sent(error)
    for detail in status.details if status is not None else ():
        bad_request, retry = error_details_pb2.BadRequest(), error_details_pb2.RetryInfo()
        if detail.Unpack(bad_request):
            violations += [FieldViolation(fault.field, fault.description) for fault in bad_request.field_violations]
        elif detail.Unpack(retry):
            retry_after = retry.retry_delay.ToTimedelta().total_seconds()
    message = (status and status.message) or error.details() or error.code().name
    translation = _CLASSES.get(error.code(), InternalError)(message, tuple(violations), retry_after)
    # A server sends details with every error; without them it is the error of this side, or of a proxy.
    if isinstance(translation, Unavailable) and status is None:
        translation.answered = False
        translation.lost = _NEVER_SENT.search(message) is None
        translation.passes = _NO_TRUST.search(message) is None
    return translation


@contextmanager
def translated() -> Iterator[None]:
    """Turns the error of a failed call into an exception of this module."""
    try:
        yield
    except grpc.RpcError as error:
        raise from_rpc(error) from None
