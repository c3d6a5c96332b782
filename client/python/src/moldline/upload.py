"""Upload of a set-up's files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from moldline.v1 import mesh_service_pb2 as wire

#: Bytes of one message, within the server's limit of 1 MiB.
CHUNK = 1 << 20

_ARCHIVES = {
    ".tar": wire.ARCHIVE_KIND_TAR,
    ".tar.gz": wire.ARCHIVE_KIND_TAR_GZ,
    ".tgz": wire.ARCHIVE_KIND_TAR_GZ,
    ".zip": wire.ARCHIVE_KIND_ZIP,
}


def files(path: str | os.PathLike[str], header: wire.SetupHeader) -> list[Path]:
    """Enters the files to send in the header: an archive, or a folder's files except hidden ones and Python's caches."""
    path = Path(path)
    if path.is_dir():
        found = [file for file in sorted(path.rglob("*")) if file.is_file() and not _hidden(file.relative_to(path))]
        for file in found:
            header.files.files.add(path=file.relative_to(path).as_posix(), size=file.stat().st_size)
        return found
    kind = next((kind for suffix, kind in _ARCHIVES.items() if path.name.endswith(suffix)), None)
    if kind is None:
        raise ValueError(f"{path} is neither a folder nor an archive ({', '.join(_ARCHIVES)})")
    header.archive.kind = kind
    header.archive.size = path.stat().st_size
    return [path]


def messages(header: wire.SetupHeader, files: list[Path]) -> Iterator[wire.CreateSetupRequest]:
    """The header, then the files' bytes."""
    yield wire.CreateSetupRequest(header=header)
    for index, file in enumerate(files):
        with file.open("rb") as stream:
            while data := stream.read(CHUNK):
                yield wire.CreateSetupRequest(chunk=wire.SetupChunk(file=index, data=data))


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") or part == "__pycache__" for part in path.parts)
