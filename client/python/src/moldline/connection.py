"""Channels and metadata of a connection."""

from __future__ import annotations

import os
import pickle
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import grpc

#: Variable of the environment with the token of connections that are given none.
TOKEN_VARIABLE = "MOLDLINE_TOKEN"

_OPTIONS = [
    ("grpc.max_receive_message_length", 512 << 20),
    ("grpc.max_send_message_length", 512 << 20),
    # Clients of one process do not share connections.
    ("grpc.use_local_subchannel_pool", 1),
    # Reconnects to a restarted server within seconds instead of minutes.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 2000),
    # Detects a server that has vanished while a long call waits for it.
    ("grpc.keepalive_time_ms", 60_000),
]


@dataclass(frozen=True)
class TLS:
    """TLS settings of a connection; all files are PEM."""

    #: Certificates of the trusted authorities; gRPC's own list if `None`.
    authorities: str | os.PathLike[str] | None = None
    #: The client's own certificate and private key, for servers that require one (mTLS).
    certificate: str | os.PathLike[str] | None = None
    key: str | os.PathLike[str] | None = None
    #: Server name that the certificate must carry; that of the address if `None`.
    server_name: str | None = None

    def credentials(self) -> grpc.ChannelCredentials:
        """gRPC credentials from the content of the files."""
        if (self.certificate is None) != (self.key is None):
            raise ValueError("a certificate needs its key, and a key its certificate")
        files = (self.authorities, self.key, self.certificate)
        return grpc.ssl_channel_credentials(*(None if file is None else Path(file).read_bytes() for file in files))


def channel(target: Any, tls: TLS | bool, transport: Any) -> Any:
    """A channel to the address `target`, made by `grpc` or `grpc.aio`; or `target` itself if it is a channel."""
    if not isinstance(target, str):
        if tls:
            raise ValueError("the given channel has its own credentials: leave out tls")
        return target
    if not tls:
        return transport.insecure_channel(target, options=_OPTIONS)
    tls = TLS() if tls is True else tls
    name = [] if tls.server_name is None else [("grpc.ssl_target_name_override", tls.server_name)]
    return transport.secure_channel(target, tls.credentials(), options=[*_OPTIONS, *name])


@dataclass(frozen=True)
class Credential:
    """Bearer token of a connection: the token itself, or the place where each process finds it."""

    token: str | None = field(default=None, repr=False)
    #: File whose content, without surrounding white space, is the token; read when the connection is made.
    file: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        if self.token is not None and self.file is not None:
            raise ValueError("give a token or the file with it, not both")

    def metadata(self) -> tuple[tuple[str, str], ...]:
        """Metadata of every call."""
        token = self.token
        if self.file is not None:
            token = Path(self.file).read_text().strip()
        elif token is None:
            token = os.environ.get(TOKEN_VARIABLE)
        return () if token is None else (("authorization", f"Bearer {token}"),)

    def __reduce__(self) -> tuple[Any, ...]:
        """Only the place travels to other processes."""
        if self.token is not None and self.token != os.environ.get(TOKEN_VARIABLE):
            raise pickle.PicklingError(
                "a client with a token does not go to other processes, for the token would lie in the pickle: give its file"
                f" (token_file=...) or set the variable {TOKEN_VARIABLE} there"
            )
        return Credential, (None, self.file)
