"""Runs a server that ends with the process that asked for it, however that one ends.

    python supervise.py COMMAND...

A program of its own, of the standard library alone: a process that is killed cannot clean up after itself, and the signal
that Linux sends on a parent's death comes on the death of the *thread* that started the child. This one has a single thread
that starts it. It ends the server when its standard input does (the asking process closed it or is gone) or when it has
another parent (the asking process is gone, but children that it forked hold the input open). If it is killed itself, the
server ends by that signal, on Linux.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading

#: Seconds between two looks at the parent, and for the server to end by itself.
_LOOK = 0.5
_GRACE = 10.0

_PR_SET_PDEATHSIG = 1


def _die_with_parent() -> None:
    """In the child, before the server begins: asks for a signal when this program dies."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def main(command: list[str], parent: int) -> int:
    """Runs `command` until it ends, or until process `parent` is gone; returns its exit code."""
    preparation = _die_with_parent if os.name == "posix" else None
    server = subprocess.Popen(command, stdin=subprocess.DEVNULL, preexec_fn=preparation)
    closed = threading.Event()
    threading.Thread(target=_wait_for_end_of_input, args=(closed,), daemon=True).start()
    while server.poll() is None:
        if closed.wait(_LOOK) or os.getppid() != parent:
            server.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                return server.wait(_GRACE)
            server.kill()
            return server.wait()
    return server.returncode


def _wait_for_end_of_input(closed: threading.Event) -> None:
    # Of the descriptor: a reader of sys.stdin would hold its lock at the end of this program.
    while os.read(0, 4096):
        pass
    closed.set()


if __name__ == "__main__":
    # Standard output carries the server's announcement, and closes when the server ends.
    code = main(sys.argv[2:], int(sys.argv[1]))
    sys.stdout.close()
    os._exit(code if code >= 0 else 128 - code)
