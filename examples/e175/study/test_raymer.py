"""Raymer's equations against published numbers of other implementations, and against arithmetic by hand."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import pytest

import raymer
from raymer import FOOT, GRAVITY, INCH, KNOT, POUND, POUND_FORCE

RAD = math.pi / 180


class TestSuavesBoeing737:
    """Weights of SUAVE's Boeing 737-800 by its method "Raymer", kg, as its regression test keeps them
    (github.com/suavecode/SUAVE, regression/scripts/weights/weights_Raymer.res; vehicle:
    regression/scripts/Vehicles/Boeing_737.py)."""

    gross: ClassVar = {"gross_weight": 79015.8 * GRAVITY, "load_factor": 3.75}

    def test_wing(self) -> None:
        wing = dict(
            area=124.862, aspect_ratio=10.18, root_thickness=0.1, taper=0.1, sweep=25 * RAD, control_area=12.4862
        )
        assert raymer.wing_weight(**self.gross, **wing) / GRAVITY == pytest.approx(6268.223851650347, rel=1e-12)

    def test_fuselage(self) -> None:
        length, diameter = 38.02, 3.74
        weight = raymer.fuselage_weight(
            **self.gross,
            length=length,
            depth=diameter,
            wetted_area=math.pi * (length / diameter - 1.7) * diameter**2,
            wing_span=34.32,
            wing_taper=0.1,
            wing_sweep=25 * RAD,
            door_factor=1.06,
        )
        assert weight / GRAVITY == pytest.approx(6655.851643473622, rel=1e-12)

    def test_tails(self) -> None:
        """SUAVE's tail arms run between the wings' origins there."""
        horizontal = raymer.horizontal_tail_weight(
            **self.gross, area=41.49, aspect_ratio=4.99, span=14.4, sweep=28.225 * RAD,
            arm=33.02 - 13.61, body_width=3.74, elevator_fraction=0.4,
        )  # fmt: skip
        vertical = raymer.vertical_tail_weight(
            **self.gross, area=34.89, aspect_ratio=1.98865, root_thickness=0.08, sweep=31.2 * RAD, arm=26.944 - 13.61
        )
        assert horizontal / GRAVITY == pytest.approx(771.7634897931891, rel=1e-12)
        assert vertical / GRAVITY == pytest.approx(825.7185825230849, rel=1e-12)

    def test_gear(self) -> None:
        """SUAVE lands with 1 - 0.00004 of the range in miles of its take-off weight, and takes its stall speed, 51 kt, for
        26.2 kt (metres per second where the equation has knots)."""
        landing = 79015.8 * GRAVITY * (1 - 0.00004 * 3582 * 1609.344 / 1852)
        main = raymer.main_gear_weight(
            landing_weight=landing, load_factor=4.5, length=1.8, wheels=4, struts=2, stall_speed=51 * KNOT * KNOT
        )
        nose = raymer.nose_gear_weight(landing_weight=landing, load_factor=4.5, length=1.3, wheels=2)
        assert main / GRAVITY == pytest.approx(2359.709779278413, rel=1e-9)
        assert nose / GRAVITY == pytest.approx(427.45355397385555, rel=1e-9)

    def test_systems(self) -> None:
        size = {"length": 38.02, "wing_span": 34.32}
        weights = {
            142.71787740338283: raymer.hydraulics_weight(functions=7, **size),
            114.1774504782736: raymer.instruments_weight(crew=3, engines=2, **size),
            588.0869043112685: raymer.electrical_weight(rating=60, run=2 * 38.02, generators=2),
            971.3051753350211: raymer.avionics_weight(uninstalled=1400 * POUND_FORCE),
        }
        for expected, weight in weights.items():
            assert weight / GRAVITY == pytest.approx(expected, rel=1e-12)

    def test_furnishings_and_air_conditioning(self) -> None:
        """SUAVE adds seats, lavatories and pilots' seats to the furnishings, and anti-ice to the air conditioning."""
        length, diameter, people = 38.02, 3.74, 170
        furnishings = raymer.furnishings_weight(
            crew=3, cargo=10000 * GRAVITY, wetted_area=math.pi * (length / diameter - 1.7) * diameter**2
        )
        seats = (46 * people + 75 * 3 + 2.5 * people**1.33) * POUND
        assert furnishings / GRAVITY + seats == pytest.approx(5447.768488802387, rel=1e-12)
        air = raymer.air_conditioning_weight(
            people=people, volume=math.pi / 4 * diameter**2 * length, avionics=1400 * POUND_FORCE
        )
        ice = raymer.anti_ice_weight(gross_weight=79015.8 * GRAVITY)
        assert (air + ice) / GRAVITY == pytest.approx(1228.9398601987073, rel=1e-12)


def test_weights_by_hand() -> None:
    """Where SUAVE differs: powers of numbers whose roots are known."""
    controls = raymer.flight_controls_weight(
        gross_weight=1e4 * POUND_FORCE, functions=1, control_area=32 * FOOT**2, arm=100 / 3 * FOOT
    )
    assert controls == pytest.approx(145.9 * 2 * POUND_FORCE, rel=1e-12)
    starter = raymer.starter_weight(engines=2, engine_weight=500 * POUND_FORCE)
    assert starter == pytest.approx(49.19 * POUND_FORCE, rel=1e-12)
    run = raymer.engine_controls_weight(engines=2, run=10 * FOOT)
    assert run == pytest.approx(18 * POUND_FORCE, rel=1e-12)
    fuel = raymer.fuel_system_weight(volume=raymer.GALLON, tanks=4)
    assert fuel == pytest.approx(2.405 * POUND_FORCE, rel=1e-12)
    one = dict(engine_weight=POUND_FORCE, engines=1, load_factor=1, length=FOOT, width=FOOT, wetted_area=FOOT**2)
    plain = raymer.nacelle_weight(**one, pylon=False, thrust_reverser=False)
    assert plain == pytest.approx(0.6724 * 2.331**0.611 * POUND_FORCE, rel=1e-12)
    assert raymer.nacelle_weight(**one) == pytest.approx(1.017 * 1.18**0.611 * plain, rel=1e-12)
    assert raymer.auxiliary_power_weight(uninstalled=1.0) == 2.2
    assert raymer.handling_gear_weight(gross_weight=1e4) == pytest.approx(3.0)


def test_units_are_their_definitions() -> None:
    assert pytest.approx(4.4482216152605, rel=1e-15) == POUND_FORCE
    assert pytest.approx(0.514444444444, rel=1e-9) == KNOT
    assert pytest.approx(3.785411784e-3, rel=1e-15) == raymer.GALLON
    assert pytest.approx(12 * INCH, rel=1e-15) == FOOT


class TestNotebookOfDragBuildUp:
    """Numbers printed in the drag build-up of the Computational Design Lab's course
    (github.com/ComputationalDesignLab/aircraft-design, book/aerodynamics/drag_buildup.ipynb), six digits."""

    def test_friction(self) -> None:
        """It leaves the Mach number out of the friction."""
        for feet, expected in ((4.3, 0.003147), (2.4, 0.003467), (3.7, 0.003225)):
            reynolds = 0.962870 * 102.89 * feet * FOOT / 0.0000173188
            assert raymer.friction_coefficient(reynolds, 0.0) == pytest.approx(expected, abs=5e-7)
        slowed = raymer.friction_coefficient(1e7, 0.7) / raymer.friction_coefficient(1e7, 0.0)
        assert slowed == pytest.approx((1 + 0.144 * 0.49) ** -0.65, rel=1e-14)

    def test_surfaces(self) -> None:
        for thickness, sweep, expected in ((0.18, 0.0, 1.580582), (0.12, 10.0, 1.354407), (0.12, 30.0, 1.306530)):
            factor = raymer.surface_form_factor(thickness=thickness, thickest=0.3, mach=0.3, sweep=sweep * RAD)
            assert factor == pytest.approx(expected, abs=5e-7)

    def test_upsweep(self) -> None:
        """The notebook adds 0.07 D/q of 0.3 of the cross section for the windshield."""
        area = raymer.upsweep_drag_area(upsweep=10 * RAD, cross_section=24.0)
        assert (area + 0.07 * 0.3 * 24.0) / 134 == pytest.approx(0.012491, abs=5e-7)

    def test_bodies(self) -> None:
        assert raymer.body_form_factor(10.0) == pytest.approx(1 + 0.06 + 0.025, rel=1e-14)
        assert raymer.nacelle_form_factor(2.0) == pytest.approx(1.175, rel=1e-14)


def test_arrays_and_complex_steps() -> None:
    """One call for many values, and derivatives to the last digits."""
    lengths = np.array([20.0, 30.0])
    both = raymer.hydraulics_weight(functions=7, length=lengths, wing_span=24.0)
    assert both.tolist() == [raymer.hydraulics_weight(functions=7, length=x, wing_span=24.0) for x in lengths]
    slope = raymer.hydraulics_weight(functions=7, length=30.0 + 1e-30j, wing_span=24.0).imag / 1e-30
    assert slope == pytest.approx(0.937 / 54.0 * both[1], rel=1e-14)
