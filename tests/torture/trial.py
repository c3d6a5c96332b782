"""Common parts of the trials: a set-up, a folder, figures with goals, and an optimization that can be interrupted."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import moldline
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import sphere_and_boom

E175 = Path(__file__).resolve().parents[2] / "examples" / "e175"

#: Retries for more than a minute, since servers come and go.
PATIENT = moldline.Retry(longest_pause=0.5, losses=1000)
#: No retries: every refusal is counted.
IMPATIENT = moldline.Retry(attempts=1)


@dataclass(frozen=True)
class Row:
    """A figure and its goal."""

    name: str
    #: `None` if it cannot be measured here; `note` says why.
    value: float | None
    unit: str
    #: `== 0`, `<= 300`, `>= 1`, or empty for a figure without a goal.
    goal: str = ""
    note: str = ""
    #: Whether the figure depends on the machine's speed and load.
    timed: bool = False

    @property
    def reached(self) -> bool | None:
        """`None` without a goal or a measurement."""
        if not self.goal or self.value is None:
            return None
        relation, limit = self.goal.split()
        bound = float(limit)
        return {"==": self.value == bound, "<=": self.value <= bound, ">=": self.value >= bound}[relation]

    def document(self) -> dict[str, Any]:
        """For the JSON file."""
        return {**asdict(self), "reached": self.reached}


@dataclass(frozen=True)
class Scale:
    """Sizes of the trials."""

    #: The set-up of load, restart and optimizations.
    setup: Path
    #: Servers killed, and the longest time between two of them.
    kills: int
    between: float
    #: Sessions at once, and for how long.
    sessions: int
    seconds: float
    #: Budgets of the server's memory for set-ups and linearisations under load, MiB.
    memory: tuple[int, int]
    #: Restarts that are timed.
    restarts: int
    #: Steps of the optimization that moves from server to server.
    steps: int


def whole(folder: Path) -> Scale:
    """The sizes that the goals are for."""
    return Scale(E175, 20, 6.0, 64, 120.0, (256, 512), 7, 12)


def short(folder: Path) -> Scale:
    """For a short run: three minutes at most."""
    return Scale(E175, 6, 3.0, 64, 25.0, (256, 512), 3, 6)


def small(folder: Path) -> Scale:
    """For the tests: seconds, on a program that is not optimised throughout."""
    return Scale(sphere_and_boom.write(folder / "small"), 4, 1.5, 16, 5.0, (64, 64), 2, 6)


@dataclass(frozen=True)
class Trial:
    """A trial's surroundings."""

    binary: Path
    #: A folder of its own, empty.
    folder: Path
    scale: Scale

    def writer_setup(self, name: str, rings: int = 6) -> Path:
        """A set-up that builds quickly, with its own name and thus its own id."""

        def rename(document: dict[str, Any], *_: object) -> None:
            document["name"] = name

        return sphere_and_boom.write(self.folder / "setups" / name, rings, change=rename)

    def verify(
        self,
        store: Path | str,
        environment: Mapping[str, str] = MappingProxyType({}),
        within: tuple[str, ...] = (),
    ) -> list[str]:
        """Objects that `moldline store verify` reports as damaged."""
        command = [*within, str(self.binary), "store", "verify", "--store", str(store)]
        found = subprocess.run(command, capture_output=True, text=True, timeout=120, env={**os.environ, **environment})
        lines = found.stdout.splitlines()
        return lines[:-1] if lines and lines[-1].startswith("read ") else [f"verify failed: {found.stderr}"]


def bar(title: str, total: float, unit: str) -> tqdm:
    """A progress bar, if there is a terminal."""
    form = "{desc}: {percentage:3.0f}%|{bar}| {n:.0f}/{total:.0f} {unit} {postfix}"
    return tqdm(total=total, desc=title, unit=unit, bar_format=form, leave=False, disable=None)


@dataclass(frozen=True)
class Problem:
    """Fits the mesh to that of a design in the neighbourhood, by steepest descent.

    A step depends only on the design that it starts from, which is read from the session. Whatever happens to servers and
    sessions in between, the same steps must follow, bit by bit.
    """

    #: float64, (n, 3), metres.
    target: NDArray[np.float64]
    #: Of the bounds of each variable; the baseline where there is none.
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    #: Of the way along the gradient, by variable.
    step: NDArray[np.float64]

    @classmethod
    def at(cls, setup: moldline.Setup) -> Problem:
        """With a step that descends: one over the largest eigenvalue of the Gauss-Newton approximation at the baseline."""
        baseline = setup.baseline
        lower, upper = setup.bounds
        free = np.isfinite(lower) & np.isfinite(upper)
        width = np.where(free, upper - lower, 0.0)
        signs = np.random.default_rng(175).choice([-1.0, 1.0], len(baseline))
        with setup.session(label="the target") as session:
            target = session.deform(baseline + 0.04 * signs * width).vertices
            columns = session.jacobian().vertices.reshape(len(baseline), -1) * width[:, None]
        largest = np.linalg.eigvalsh(columns @ columns.T)[-1]
        return cls(
            np.array(target), np.where(free, lower, baseline), np.where(free, upper, baseline), width**2 / largest
        )

    def advance(self, session: moldline.Session) -> NDArray[np.float64]:
        """Stores the next design, and returns it."""
        session.refresh()
        design = np.asarray(session.design.design)
        deformation = session.deform(design)
        gradient = session.vjp(vertices=deformation.vertices - self.target, at=deformation).design
        assert gradient is not None
        following: NDArray[np.float64] = np.clip(design - self.step * gradient, self.lower, self.upper)
        session.update(following)
        return following

    def undisturbed(self, client: moldline.Client, setup: Path, steps: int) -> list[bytes]:
        """Designs of an undisturbed run."""
        with client.create_setup(setup).session() as session:
            return [self.advance(session).tobytes() for _ in range(steps)]


def different(one: list[bytes], other: list[bytes]) -> int:
    """How many entries differ."""
    return sum(a != b for a, b in zip(one, other, strict=True))


def refused(call: Callable[[], object], kind: type[moldline.MoldlineError], words: str) -> str:
    """Empty if a call is refused correctly; otherwise a description of the answer."""
    try:
        call()
    except moldline.MoldlineError as error:
        return "" if type(error) is kind and words in str(error) else f"{type(error).__name__}: {error}"
    return "it was carried out"
