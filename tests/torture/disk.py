"""Disks that are full or read-only, and stored bytes that have changed."""

from __future__ import annotations

import resource
import subprocess
from collections.abc import Callable
from pathlib import Path

import moldline
import numpy as np
from numpy.typing import NDArray

from server import Server
from trial import IMPATIENT, Row, Trial, bar, refused

#: MiB of the small disk.
SIZE = 64


class SmallDisk:
    """A disk of the server's own, in namespaces of its own: nothing is mounted for others, and root is not needed."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder = folder
        mount = f'mount -t tmpfs -o size={SIZE}m none "$0" && exec "$@"'
        #: Runs a server with the disk.
        self.within = ("unshare", "--user", "--map-root-user", "--mount", "sh", "-c", mount, str(folder))
        self._server: Server | None = None

    @classmethod
    def possible(cls, folder: Path) -> bool:
        """Whether the system allows such a disk."""
        disk = cls(folder)
        try:
            return subprocess.run([*disk.within, "true"], capture_output=True, timeout=60).returncode == 0
        except OSError:
            return False

    def of(self, server: Server) -> None:
        """Starts a server; the disk lasts as long as it does."""
        self._server = server

    @property
    def beside(self) -> tuple[str, ...]:
        """Runs another program with the same disk."""
        assert self._server is not None
        return ("nsenter", "--target", str(self._server.process.pid), "--user", "--mount", "--preserve-credentials")

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Runs a program that sees the disk to its end."""
        return subprocess.run([*self.beside, *command], capture_output=True, text=True, timeout=60)

    def fill(self) -> None:
        """Fills the disk to the last byte."""
        self.run("sh", "-c", f"cat /dev/zero > '{self.folder}/filler'; sync")

    def empty(self) -> None:
        """Frees the space that :meth:`fill` took."""
        assert self.run("rm", f"{self.folder}/filler").returncode == 0

    def remount(self, mode: str) -> None:
        """`ro` or `rw`."""
        done = self.run("mount", "-o", f"remount,{mode}", str(self.folder))
        assert done.returncode == 0, done.stderr


class LimitedFiles:
    """A substitute for a small disk where none can be mounted: files that may not grow."""

    within = ("sh", "-c", "trap '' XFSZ; exec \"$@\"", "sh")
    beside = ()

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._server: Server | None = None

    def of(self, server: Server) -> None:
        """Those of this server."""
        self._server = server

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Runs a program to its end."""
        return subprocess.run(command, capture_output=True, text=True, timeout=60)

    def fill(self) -> None:
        """No file may grow."""
        self._limit(0)

    def empty(self) -> None:
        """Files may grow again."""
        self._limit(resource.RLIM_INFINITY)

    def _limit(self, size: int) -> None:
        assert self._server is not None
        resource.prlimit(self._server.process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


class User:
    """A set-up and a session in a store, and the requests that a server must serve or refuse."""

    def __init__(self, trial: Trial, client: moldline.Client) -> None:
        self._trial = trial
        self._setup = client.create_setup(trial.writer_setup("before"))
        session = self._setup.session(label="before")
        self._design = self._setup.baseline + 0.05
        session.update(self._design)
        self._session_id, self._generation = session.id, session.generation
        self._expected = session.deform(self._design).vertices.tobytes()

    def refusals(self, client: moldline.Client, kind: type[moldline.MoldlineError], words: str) -> list[str]:
        """Deviations from a clear refusal of requests that cannot be stored; empty if there are none."""
        setup, session = client.get_setup(self._setup.id), client.resume(self._session_id)
        calls: list[Callable[[], object]] = [
            lambda: client.create_setup(self._trial.writer_setup(words)),
            lambda: setup.session(),
            lambda: session.update(self._design + 0.01),
            lambda: session.close(),
            lambda: setup.share("public"),
            lambda: setup.delete(),
        ]
        return [refused(call, kind, words) for call in calls]

    def is_served(self, client: moldline.Client) -> bool:
        """Whether everything stored is served with the same bits as before."""
        try:
            session = client.resume(self._session_id)
            deformation = session.deform(self._design)
            session.vjp(vertices=deformation.vertices, at=deformation)
            names = {setup.name for setup in client.list_setups()}
        except moldline.MoldlineError:
            return False
        same_bits = deformation.vertices.tobytes() == self._expected
        return same_bits and session.generation == self._generation and "before" in names

    def can_write(self, client: moldline.Client, name: str) -> bool:
        """Whether set-ups, sessions and designs can be stored."""
        try:
            client.create_setup(self._trial.writer_setup(name)).session().close()
            session = client.resume(self._session_id)
            session.update(self._design)
        except moldline.MoldlineError:
            return False
        self._generation += 1
        return session.generation == self._generation


def full(trial: Trial) -> list[Row]:
    """Trial: a disk that fills, and one that is read-only."""
    mounted = SmallDisk.possible(trial.folder / "probe")
    disk: SmallDisk | LimitedFiles = SmallDisk(trial.folder / "disk") if mounted else LimitedFiles(trial.folder)
    store = disk.folder / "store"
    note = f"a tmpfs of {SIZE} MiB" if mounted else "by a limit on the size of files: nothing can be mounted here"
    rows = []

    def told(when: str, refusals: list[str], works: list[bool]) -> None:
        wrong = [text for text in refusals if text]
        name = f"{when}: requests not refused with a clear error"
        rows.append(Row(name, len(wrong), f"of {len(refusals)}", "== 0", "; ".join(wrong) or note))
        rows.append(Row(f"{when}: service does not go on", works.count(False), f"of {len(works)}", "== 0"))

    with Server(trial.binary, "--log", "warn", store=store, within=disk.within) as server:
        disk.of(server)
        with server.client(retry=IMPATIENT) as client:
            user = User(trial, client)
            disk.fill()
            refusals = user.refusals(client, moldline.ResourceExhausted, "no space left")
            works = [user.is_served(client)]
            disk.empty()
            told("disk full", refusals, [*works, user.is_served(client), user.can_write(client, "full, then not")])
            if isinstance(disk, SmallDisk):
                disk.remount("ro")
                refusals = user.refusals(client, moldline.Unavailable, "cannot be written to")
                works = [user.is_served(client)]
                with Server(trial.binary, "--log", "warn", store=store, within=disk.beside) as other:
                    with other.client(retry=IMPATIENT) as another:
                        works.append(user.is_served(another))
                disk.remount("rw")
                works += [user.is_served(client), user.can_write(client, "read-only, then not")]
                told("read-only disk", refusals, works)
            else:
                rows.append(Row("read-only disk: requests not refused with a clear error", None, "", "== 0", note))
            faults = trial.verify(store, within=disk.beside)
            left = disk.run("find", str(store), "-name", "*#*").stdout.split()
            rows.append(Row("after both: damaged objects", len(faults), "objects", "== 0", "; ".join(faults)))
            rows.append(Row("after both: files left half written", len(left), "files", "== 0"))
    return rows


Design = NDArray[np.float64]

#: Kinds of objects to damage, by the prefix of their names.
KINDS = ("blob", "setup", "derived", "access", "session")


def damaged(trial: Trial) -> list[Row]:
    """Trial: flipped bits and truncated files, one kind of object after the other, each with a fresh server."""
    store = trial.folder / "store"
    undetected: list[str] = []
    unserved: list[str] = []
    unmended: list[str] = []
    with Server(trial.binary, "--log", "warn", store=store) as server, server.client() as client:
        other = User(trial, client)
        names = {path.relative_to(store) for path in files(store)}
        # With a mesh of its own.
        folder = trial.writer_setup("to be damaged", rings=9)
        setup = client.create_setup(folder)
        session = setup.session()
        design = setup.baseline - 0.05
        session.update(design)
        expected = session.deform(design).vertices.tobytes()
        candidates = sorted({path.relative_to(store) for path in files(store)} - names)
        assert server.stop() == 0
    total = 2 * len(KINDS)
    mendable = ("blob", "setup", "derived", "access")
    with bar("damage", total, "cases") as progress:
        for kind in KINDS:
            # The largest or the last of its kind.
            of_kind = (store / path for path in candidates if path.parts[0] == kind)
            path = max(of_kind, key=lambda path: (path.stat().st_size, path))
            for damage in ("a flipped bit", "half of it missing"):
                # The last record of a row is the one that counts.
                path = max(path.parent.iterdir()) if kind in ("access", "session") else path
                name = path.relative_to(store)
                intact = path.read_bytes()
                half = len(intact) // 2
                flipped = bytes([*intact[:half], intact[half] ^ 4, *intact[half + 1 :]])
                content = flipped if damage == "a flipped bit" else intact[:half]
                case = f"{kind}, {damage}"
                path.write_bytes(content)
                found = trial.verify(store)
                if [name.as_posix() in line for line in found] != [True]:
                    undetected.append(f"{case}: verify says {found}")
                with (
                    Server(trial.binary, "--log", "warn", store=store) as server,
                    server.client(retry=IMPATIENT) as client,
                ):
                    answer = ask(client, session.id, design, expected)
                    # Derived data are recomputed.
                    named = name.as_posix() in answer and "damaged" in answer
                    if not (answer == "as before" if kind == "derived" else named):
                        undetected.append(f"{case}: {answer}")
                    if not (other.is_served(client) and other.can_write(client, case)):
                        unserved.append(case)
                    if kind in mendable:
                        # An upload of the same content repairs it.
                        answer = ask(client, session.id, design, expected, folder)
                        # A new record takes its place; the damaged one stays for garbage collection.
                        left = [] if kind == "access" else trial.verify(store)
                        if answer != "as before" or left:
                            unmended.append(f"{case}: {answer}, {left}")
                path.write_bytes(intact)
                progress.update()
    tried = 2 * len(mendable)
    return [
        failed("damaged objects not detected by service and `verify`", undetected, total),
        failed("damaged objects that keep others from being served and storing", unserved, total),
        failed("damaged set-ups not mended by another upload", unmended, tried),
    ]


def failed(name: str, cases: list[str], total: int) -> Row:
    """None may."""
    return Row(name, len(cases), f"of {total}", "== 0", "; ".join(cases))


def ask(client: moldline.Client, session_id: str, design: Design, expected: bytes, folder: Path | None = None) -> str:
    """`as before`, or an error's words; after the set-up of a folder was uploaded again, if one is given."""
    try:
        if folder is not None:
            client.create_setup(folder)
        vertices = client.resume(session_id).deform(design).vertices.tobytes()
    except moldline.InternalError as error:
        return str(error)
    return "as before" if vertices == expected else "other bits"


def files(folder: Path) -> set[Path]:
    """All files below a folder."""
    return {path for path in folder.rglob("*") if path.is_file()}
