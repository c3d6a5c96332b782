"""The aircraft's model against the paper's numbers, closed forms and differences."""

from __future__ import annotations

import numpy as np
import pytest

import aircraft
from aircraft import MODEL, REFERENCE_AREA, REFERENCE_CHORD, REFERENCE_POINT, analyse, derivatives
from raymer import FOOT, POUND_FORCE

#: Table 3: gross and fuel weight, wing area (ft^2), wing loading (lbf/ft^2).
TABLE_3 = ((288_800, 70_400, 740, 90), (293_000, 57_600, 658, 100), (294_500, 58_850, 661, 100))


@pytest.fixture
def state() -> dict[str, float]:
    """Approximately the baseline in level flight."""
    stations = {
        "wing": {"root": (10.882, 16.326, 0.0), "kink": (13.508, 16.421, 4.8635), "tip": (17.314, 18.314, 11.9106)},
        "htail": {"root": (26.0, 29.534, 0.0), "tip": (29.7, 30.816, 5.0)},
    }
    values = {
        "fuselage.volume": aircraft.BASELINE_VOLUME, "fuselage.wetted_area": 265.0,
        "wing.wetted_area": 112.0, "htail.wetted_area": 38.0,
        "wing.planform_area": 68.2, "wing.span": 23.82, "wing.mean_aerodynamic_chord": 3.42,
        "htail.planform_area": 23.25, "htail.span": 10.0, "htail.mean_aerodynamic_chord": 2.55,
        "fuselage.cabin.x": 15.8, "fuselage.hold.x": 15.0, "fuselage.nose_gear.x": 3.9, "fuselage.main_gear.x": 16.25,
        "fuselage.barrel_side.y": 1.505, "fuselage.barrel_top.z": 2.625, "fuselage.barrel_bottom.z": -0.725,
        "fuselage.tail_side.y": 0.9,
        "flow.lift": 0.33, "flow.induced_drag": 0.0045, "flow.pressure_lift": 0.332, "flow.pressure_drag": 0.006,
        "flow.moment": -0.08, "flow.neutral_point": 15.0, "angle_of_attack": 0.03,
    }  # fmt: skip
    for surface, at in stations.items():
        for name, (leading, trailing, y) in at.items():
            for edge, x in (("leading_edge", leading), ("trailing_edge", trailing)):
                values |= {f"{surface}.{name}_{edge}.x": x, f"{surface}.{name}_{edge}.y": y}
    assert set(values) == set(aircraft.INPUTS)
    return values


def test_flight_condition() -> None:
    """The standard atmosphere at 25,000 ft, 309.67 m/s and 0.5489 kg/m^3, and at sea level."""
    air = aircraft.standard_air(7620.0)
    assert air.speed_of_sound == pytest.approx(309.67, abs=0.01)
    assert air.density == pytest.approx(0.54895, abs=1e-4)
    sea = aircraft.standard_air(0.0)
    assert (sea.density, sea.viscosity) == (pytest.approx(1.225, rel=1e-4), pytest.approx(1.7894e-5, rel=1e-4))


def test_table_3_is_in_newtons() -> None:
    """Its loadings, in pounds of force per square foot, agree with its areas only if its weights are in newtons."""
    for gross, _, area, loading in TABLE_3:
        assert gross / POUND_FORCE / area == pytest.approx(loading, rel=0.03)
    # And its payload, 22,050 lbf, is then a third of the aircraft.
    assert MODEL["baseline_payload"].value / TABLE_3[0][0] == pytest.approx(0.34, abs=0.005)
    assert MODEL["baseline_payload"].value == pytest.approx(10_000 * 9.80665, rel=2e-4)


def test_breguet_gives_the_papers_ratios() -> None:
    """W_f / W_0 of Table 3 for the lift-to-drag ratios that Eq. (19) turns into them."""
    speed = 0.7 * aircraft.standard_air(7620.0).speed_of_sound
    for (gross, fuel, *_), lift_to_drag in zip(TABLE_3, (11.55, 14.75, 14.48), strict=True):
        fraction = aircraft.fuel_fraction(
            lift_to_drag=lift_to_drag,
            distance=MODEL["range"].value,
            consumption=MODEL["thrust_specific_consumption"].value,
            speed=speed,
        )
        assert fraction == pytest.approx(fuel / gross, rel=1e-3)


def test_gross_weight_is_the_sum_of_the_parts(state: dict[str, float]) -> None:
    result = analyse(state)
    parts = [value for name, value in result.items() if name.startswith("weight: ")]
    assert sum(parts) == pytest.approx(result["gross_weight"], rel=1e-14)
    assert result["fuel_weight"] == pytest.approx(result["fuel_fraction"] * result["gross_weight"], rel=1e-14)
    assert result["payload_weight"] == pytest.approx(22_050 * POUND_FORCE, rel=1e-14)
    # Payload goes with the fuselage's volume.
    assert analyse(state | {"fuselage.volume": 1.1 * aircraft.BASELINE_VOLUME})["payload_weight"] == pytest.approx(
        1.1 * 22_050 * POUND_FORCE, rel=1e-14
    )


def test_trim_and_stability_are_about_the_centre_of_gravity(state: dict[str, float]) -> None:
    """A force that acts at a point has no moment about it."""
    centre = analyse(state)["centre_of_gravity"]
    normal = 0.332 * np.cos(0.03) + 0.006 * np.sin(0.03)
    moment = normal * (REFERENCE_POINT[0] - centre) / REFERENCE_CHORD
    result = analyse(state | {"flow.moment": moment, "flow.neutral_point": centre + 0.05 * 3.42})
    assert result["pitching_moment"] == pytest.approx(0.0, abs=1e-9 * result["lift"])
    assert result["static_margin"] == pytest.approx(0.05)
    # Nose up is positive: the same force further ahead.
    assert analyse(state | {"flow.moment": moment + 0.01})["pitching_moment"] > 0
    air = aircraft.standard_air(7620.0)
    pressure = 0.5 * air.density * (0.7 * air.speed_of_sound) ** 2
    assert pressure == pytest.approx(12_897, rel=1e-4)
    assert result["lift"] == pytest.approx(pressure * REFERENCE_AREA * 0.33, rel=1e-14)
    assert result["lift_excess"] == result["lift"] - result["gross_weight"]


def test_tail_volume_of_straight_tapered_surfaces(state: dict[str, float]) -> None:
    """A trapezoid's mean chord is at (1 + 2 t) / (1 + t) / 3 of the half span (t: taper), its quarter point on the line of
    quarter chords."""
    taper = 1.116 / 3.534
    tail = 26.0 + 0.25 * 3.534 + (1 + 2 * taper) / (1 + taper) / 3 * (29.7 + 0.25 * 1.116 - 26.0 - 0.25 * 3.534)
    # A wing without sweep of the quarter chord.
    for station, chord in (("root", 4.0), ("kink", 3.0), ("tip", 1.5)):
        state |= {
            f"wing.{station}_leading_edge.x": 14.0 - 0.25 * chord,
            f"wing.{station}_trailing_edge.x": 14.0 + 0.75 * chord,
        }
    result = analyse(state)
    assert result["tail_arm"] == pytest.approx(tail - 14.0, rel=1e-12)
    expected = 23.25 * (tail - 14.0) / (68.2 * 3.42)
    assert analyse(state, {"tail_arm_offset": 0.0})["tail_volume"] == pytest.approx(expected, rel=1e-12)


def test_table_3s_tail_volume(state: dict[str, float]) -> None:
    areas = {"wing.planform_area": 740 * FOOT**2, "htail.planform_area": 250 * FOOT**2}
    assert analyse(state | areas)["tail_volume"] == pytest.approx(1.16, abs=0.01)


def test_derivatives_are_those_of_differences(state: dict[str, float]) -> None:
    """Central ones of fourth order, all inputs in one array."""
    names = list(aircraft.INPUTS)
    at = analyse(state)
    results = [name for name, value in at.items() if np.ndim(value) == 0]
    exact = derivatives(state, results)
    sizes = np.array([max(1e-2, abs(state[name])) for name in names])
    ends = [
        analyse(
            {name: state[name] + shift * 1e-4 * sizes * (np.arange(len(names)) == k) for k, name in enumerate(names)}
        )
        for shift in (-2, -1, 1, 2)
    ]
    for result in results:
        a, b, c, d = (np.broadcast_to(end[result], len(names)) for end in ends)
        differences = (a - 8 * b + 8 * c - d) / 12e-4
        np.testing.assert_allclose(
            exact[result] * sizes, differences, rtol=1e-8, atol=1e-8 * abs(at[result]), err_msg=result
        )


def test_every_number_of_the_model_matters(state: dict[str, float]) -> None:
    results = [name for name, value in analyse(state).items() if np.ndim(value) == 0]
    rows = derivatives(state, results, MODEL, {"engines_weighed": 0.5})
    total = sum(np.abs(row) for row in rows.values())
    idle = [name for name, change in zip(MODEL, total, strict=True) if change == 0.0]
    assert not idle
    assert all(choice.why and choice.unit for choice in MODEL.values())
