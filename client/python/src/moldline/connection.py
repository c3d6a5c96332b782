"""What a connection to a server is made from."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc

_OPTIONS = [
    ("grpc.max_receive_message_length", 512 << 20),
    ("grpc.max_send_message_length", 512 << 20),
    # Two clients in one process are two connections.
    ("grpc.use_local_subchannel_pool", 1),
    # A server that comes back is found at once, not minutes later.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 2000),
    # A server that has gone without a word is noticed while a long call waits for it.
    ("grpc.keepalive_time_ms", 60_000),
]


@dataclass(frozen=True)
class TLS:
    """How a connection is encrypted; all files are PEM."""

    #: Certificates of the authorities that are trusted; gRPC's own list if `None`.
    authorities: str | os.PathLike[str] | None = None
    #: The client's own certificate and private key, where the server asks for one (mTLS).
    certificate: str | os.PathLike[str] | None = None
    key: str | os.PathLike[str] | None = None
    #: The name that the server's certificate has to have; that of the address if `None`.
    server_name: str | None = None

    def credentials(self) -> grpc.ChannelCredentials:
        """With the content of the files."""
        if (self.certificate is None) != (self.key is None):
            raise ValueError("a certificate needs its key, and a key its certificate")
        files = (self.authorities, self.key, self.certificate)
        return grpc.ssl_channel_credentials(*(None if file is None else Path(file).read_bytes() for file in files))


def channel(target: Any, tls: TLS | bool, transport: Any) -> Any:
    """To the address `target`, by `grpc` or `grpc.aio`; or `target` itself if it is a channel."""
    if not isinstance(target, str):
        if tls:
            raise ValueError("a channel of your own has credentials of its own: leave out tls")
        return target
    if not tls:
        return transport.insecure_channel(target, options=_OPTIONS)
    tls = TLS() if tls is True else tls
    name = [] if tls.server_name is None else [("grpc.ssl_target_name_override", tls.server_name)]
    return transport.secure_channel(target, tls.credentials(), options=[*_OPTIONS, *name])


def metadata(token: str | None) -> tuple[tuple[str, str], ...]:
    """What goes with every call."""
    return () if token is None else (("authorization", f"Bearer {token}"),)
