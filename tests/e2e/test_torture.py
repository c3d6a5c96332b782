"""Small versions of the trials of `cargo xtask torture`: each must reach its goals, except those of time."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "torture"))

import torture
import trial


@pytest.mark.parametrize("name", torture.TRIALS)
def test_goals_are_reached(name: str, binary: Path, tmp_path: Path) -> None:
    rows = torture.run(name, binary, tmp_path / "trial", trial.small(tmp_path))
    if any(row.value is None for row in rows):
        pytest.skip(next(row.note for row in rows if row.value is None))
    judged = [row for row in rows if row.reached is not None and not row.timed]
    assert judged and all(row.reached for row in judged), [row for row in judged if not row.reached]
