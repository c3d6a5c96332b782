"""The examples in Python do what they say."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sphere_and_boom import RADIUS, SECTORS

ROOT = Path(__file__).parents[2]


def test_scipy_finds_the_longer_boom(binary: Path, setup_folder: Path) -> None:
    script = ROOT / "examples/scipy/minimise.py"
    run = subprocess.run(
        [sys.executable, str(script), str(setup_folder)],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        env={**os.environ, "MOLDLINE_BINARY": str(binary)},
    )
    assert "terminated successfully" in run.stdout
    found = {name: float(value) for name, value in re.findall(r"^(boom\.\w+) +(\S+) m$", run.stdout, re.MULTILINE)}
    told = re.search(r"wetted area (\S+) m\^2, volume (\S+) m\^3", run.stdout)
    assert told is not None
    # Only the boom's length adds volume, by its section: a regular polygon. Lift would add none.
    section = 0.5 * SECTORS * RADIUS**2 * np.sin(2 * np.pi / SECTORS)
    length = found["boom.translation"] + found["boom.far"]
    assert length * section == pytest.approx(float(told[2]) * (1 - 1 / 1.02), abs=1e-5)
    assert found["boom.lift"] == pytest.approx(0.0, abs=1e-3)
