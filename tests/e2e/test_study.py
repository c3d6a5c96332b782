"""The fuel-burn study on both services, on the coarse mesh: derivatives, a few iterations, resumption."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "examples/e175/study"))

import aircraft  # noqa: E402
import plain  # noqa: E402
import study  # noqa: E402
from formulation import PROBLEMS  # noqa: E402
from problem import Study  # noqa: E402
from services import services  # noqa: E402


@pytest.fixture(autouse=True)
def elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """OpenMDAO writes a folder where it runs."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def asked(binary: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Any, Any]]:
    """Session and flow solver."""
    with services(binary, tmp_path_factory.mktemp("study"), coarse=True) as both:
        yield both


def test_the_model_knows_the_geometry(asked: tuple[Any, Any]) -> None:
    """The model's constants agree with the set-up."""
    values = {function.name: function.value for function in asked[0].setup.functions}
    assert set(aircraft.GEOMETRY) <= set(values)
    assert values["fuselage.volume"] == pytest.approx(aircraft.BASELINE_VOLUME, rel=1e-9)
    assert values["wing.planform_area"] == pytest.approx(aircraft.REFERENCE_AREA, rel=1e-3)
    assert values["wing.mean_aerodynamic_chord"] == pytest.approx(aircraft.REFERENCE_CHORD, rel=1e-3)
    for name, x in (("cabin", 15.8), ("hold", 15.0), ("nose_gear", 3.9), ("main_gear", 16.25)):
        assert values[f"fuselage.{name}.x"] == pytest.approx(x, abs=1e-9)


def test_both_programs_have_the_same_derivatives_and_those_of_differences(asked: tuple[Any, Any]) -> None:
    """With OpenMDAO and without, in a random direction away from the baseline, against differences through both services."""
    limits = PROBLEMS["with"]
    with_openmdao, by_hand = Study(*asked, limits), plain.Problem(*asked, limits)
    random = np.random.default_rng(6)
    x, direction = random.uniform(-0.2, 0.2, 45), random.uniform(-1, 1, 45)
    gradient, jacobian, _ = with_openmdao.derivatives(x)
    exact = np.vstack([gradient, jacobian])
    weights = np.array([plain.OBJECTIVE_WEIGHT, *np.ones(len(limits))])
    np.testing.assert_allclose(
        by_hand.gradients(x), weights[:, None] * exact, rtol=1e-9, atol=1e-9 * np.abs(exact).max()
    )

    step = 2e-3
    ends = [by_hand.values(x + shift * step * direction) / weights for shift in (-2, -1, 1, 2)]
    differences = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * step)
    assert np.abs(exact @ direction - differences).max() <= 1e-6 * np.abs(exact).max()


def test_a_run_improves_and_a_resumed_one_has_the_same_iterates(asked: tuple[Any, Any], tmp_path: Path) -> None:
    _, whole = study.solve("without", *asked, tmp_path / "whole", iterations=3, resume=False)
    start, end = whole.iterates[0], whole.iterates[-1]
    # Trimmed, improving, and with a mesh as good as at the start.
    assert start.infeasibility <= 1e-8
    assert 0.2 < start.notes["values"]["results"]["fuel_fraction"] < 0.26
    assert end.objective < start.objective
    for iterate in whole.iterates:
        quality = iterate.notes["values"]["quality"]
        assert quality["folded"] == quality["inverted"] == 0
        assert quality["aspect_ratio_p95"] < 2.2

    _, begun = study.solve("without", *asked, tmp_path / "killed", iterations=1, resume=False)
    _, resumed = study.solve("without", *asked, tmp_path / "killed", iterations=3, resume=True)
    assert [i.x.tobytes() for i in resumed.iterates] == [i.x.tobytes() for i in whole.iterates]
    assert resumed.iterates[len(begun.iterates) - 1].replayed and not resumed.iterates[-1].replayed
