"""SeaweedFS as an S3 store with real conditional writes, in a process of its own.

    python seaweed.py COMMAND...

runs a command with the address of such a store in its environment, or without where SeaweedFS is not installed.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

#: Longest time to start, s.
STARTING = 120
BUCKET = "moldline"


def program() -> Path | None:
    """Path of `weed`: beside this Python, or on PATH."""
    found = shutil.which("weed", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]))
    return None if found is None else Path(found)


class SeaweedFS:
    """A running SeaweedFS on free ports of the loopback interface, which keeps its objects in a folder.

    `weed`: the program; by default the one that :func:`program` finds.
    """

    def __init__(self, folder: Path, weed: Path | None = None) -> None:
        weed = weed or program()
        assert weed is not None, "there is no SeaweedFS (`weed`)"
        data = folder / "data"
        data.mkdir(parents=True)
        key, secret = "moldline", "only for tests"
        identity = {"name": key, "credentials": [{"accessKey": key, "secretKey": secret}], "actions": ["Admin"]}
        (folder / "s3.json").write_text(json.dumps({"identities": [identity]}))
        ports = free_ports(8)
        self._port = ports[0]
        options = ["s3.port", "s3.port.grpc", "filer.port", "filer.port.grpc", "volume.port", "volume.port.grpc"]
        options += ["master.port", "master.port.grpc"]
        self._command = [
            str(weed), "-logtostderr", "server", f"-dir={data}", "-ip=127.0.0.1", "-filer", "-s3",
            *(f"-{option}={port}" for option, port in zip(options, ports, strict=True)),
            f"-s3.config={folder / 's3.json'}", "-s3.port.iceberg=0", "-s3.port.lance=0", "-master.volumeSizeLimitMB=64",
            f"-filer.localSocket={folder / 'filer.sock'}", f"-s3.localSocket={folder / 's3.sock'}",
        ]  # fmt: skip
        #: Says where a new object goes, once there is a place for it.
        self._assign = f"http://127.0.0.1:{ports[6]}/dir/assign"
        self._folder = folder
        #: For servers that use it.
        self.environment = {
            "AWS_ENDPOINT": f"http://127.0.0.1:{self._port}",
            "AWS_ALLOW_HTTP": "true",
            "AWS_REGION": "us-east-1",
            "AWS_ACCESS_KEY_ID": key,
            "AWS_SECRET_ACCESS_KEY": secret,
        }
        self.start()

    def start(self) -> None:
        """Restarts it with the objects that it had."""
        with (self._folder / "log").open("ab") as log:
            self.process = subprocess.Popen(self._command, cwd=self._folder, stdout=log, stderr=log)
        try:
            self._wait()
        except BaseException:
            self.stop()
            raise

    @property
    def store(self) -> str:
        """What `--store` takes. The bucket is made with the first object."""
        return f"s3://{BUCKET}/tests"

    def _wait(self) -> None:
        end = time.monotonic() + STARTING
        while time.monotonic() < end and self.process.poll() is None:
            try:
                with urllib.request.urlopen(self._assign, timeout=5) as answer:
                    ready = "fid" in json.load(answer)
                with socket.create_connection(("127.0.0.1", self._port), timeout=5):
                    if ready:
                        return
            except OSError:
                # It does not listen yet, or has no volume yet.
                pass
            time.sleep(0.05)
        raise AssertionError(f"SeaweedFS did not start; its log is {self._folder / 'log'}")

    def stop(self) -> None:
        """Kills it."""
        self.process.kill()
        self.process.wait()

    def __enter__(self) -> SeaweedFS:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


def free_ports(count: int) -> list[int]:
    """Ports that are free at the moment."""
    with ExitStack() as taken:
        sockets = [taken.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]


def main() -> int:
    """Runs the command."""
    command = sys.argv[1:]
    if program() is None:
        print("SeaweedFS is not installed: what needs an object store is left out", file=sys.stderr)
        return subprocess.call(command)
    # Whoever ends this ends SeaweedFS as well.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    with tempfile.TemporaryDirectory() as folder, SeaweedFS(Path(folder) / "objects") as objects:
        environment = {**os.environ, **objects.environment, "MOLDLINE_TEST_S3": objects.store}
        return subprocess.call(command, env=environment)


if __name__ == "__main__":
    sys.exit(main())
