"""Channels and metadata of a connection."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc

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


def metadata(token: str | None) -> tuple[tuple[str, str], ...]:
    """Metadata of every call."""
    return () if token is None else (("authorization", f"Bearer {token}"),)
