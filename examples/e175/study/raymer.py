"""Weights and parasite drag of jet transports, by the regressions of Raymer's textbook.

D. P. Raymer, *Aircraft Design: A Conceptual Approach* (AIAA): weights of cargo and transport aircraft, Eqs. 15.25 to 15.44;
parasite drag by components, Sec. 12.5. Equation numbers beside the functions are those of the book's second to sixth
edition. They are power laws of pounds, feet, inches and knots; here these units stay inside the functions. Arguments and
results are SI: metres, newtons, metres per second, radians.

All functions take real or complex numbers or arrays of them, so that complex steps give their derivatives.
"""

from __future__ import annotations

from typing import Any

import numpy as np

#: A number or an array of them, real or complex.
Value = Any

FOOT = 0.3048  #: m, exact (international foot)
INCH = 0.0254  #: m, exact
POUND = 0.45359237  #: kg, exact
GRAVITY = 9.80665  #: m/s^2, standard
POUND_FORCE = POUND * GRAVITY  #: N
KNOT = 1852 / 3600  #: m/s, exact
GALLON = 231 * INCH**3  #: m^3, U.S. liquid gallon, exact


# --- structure --------------------------------------------------------------------------------------------------------


def wing_weight(
    *,
    gross_weight: Value,
    load_factor: Value,
    area: Value,
    aspect_ratio: Value,
    root_thickness: Value,
    taper: Value,
    sweep: Value,
    control_area: Value,
) -> Value:
    """Wing, N (15.25). `load_factor` is the ultimate one, `sweep` of the quarter chord."""
    loaded = gross_weight / POUND_FORCE * load_factor
    pounds = 0.0051 * loaded**0.557 * (area / FOOT**2) ** 0.649 * aspect_ratio**0.5 * root_thickness**-0.4
    return pounds * (1 + taper) ** 0.1 / np.cos(sweep) * (control_area / FOOT**2) ** 0.1 * POUND_FORCE


def horizontal_tail_weight(
    *,
    gross_weight: Value,
    load_factor: Value,
    area: Value,
    aspect_ratio: Value,
    span: Value,
    sweep: Value,
    arm: Value,
    body_width: Value,
    elevator_fraction: Value,
    all_moving: bool = False,
) -> Value:
    """Horizontal tail, N (15.26). `arm` from the wing's to the tail's quarter chord; `body_width` where the tail meets the
    fuselage. The radius of gyration in pitch is 0.3 of the arm, as the book proposes."""
    pounds = 0.0379 * (1.143 if all_moving else 1.0) * (1 + body_width / span) ** -0.25
    pounds = pounds * (gross_weight / POUND_FORCE) ** 0.639 * load_factor**0.1 * (area / FOOT**2) ** 0.75 / (arm / FOOT)
    pounds = pounds * (0.3 * arm / FOOT) ** 0.704 / np.cos(sweep) * aspect_ratio**0.166 * (1 + elevator_fraction) ** 0.1
    return pounds * POUND_FORCE


def vertical_tail_weight(
    *,
    gross_weight: Value,
    load_factor: Value,
    area: Value,
    aspect_ratio: Value,
    root_thickness: Value,
    sweep: Value,
    arm: Value,
) -> Value:
    """Vertical tail without a tail on top of it, N (15.27). The radius of gyration in yaw is the arm."""
    pounds = 0.0026 * (gross_weight / POUND_FORCE) ** 0.556 * load_factor**0.536 * (arm / FOOT) ** (0.875 - 0.5)
    pounds = pounds * (area / FOOT**2) ** 0.5 / np.cos(sweep) * aspect_ratio**0.35 * root_thickness**-0.5
    return pounds * POUND_FORCE


def fuselage_weight(
    *,
    gross_weight: Value,
    load_factor: Value,
    length: Value,
    depth: Value,
    wetted_area: Value,
    wing_span: Value,
    wing_taper: Value,
    wing_sweep: Value,
    door_factor: Value = 1.0,
    gear_factor: Value = 1.0,
) -> Value:
    """Fuselage, N (15.28). The book's L/D is structural length over depth, not lift over drag.

    `door_factor`: 1 without cargo door, 1.06 with one, 1.12 with two; `gear_factor`: 1.12 with the main gear on the body.
    """
    sweep = 0.75 * (1 + 2 * wing_taper) / (1 + wing_taper) * wing_span * np.tan(wing_sweep) / length
    pounds = 0.3280 * door_factor * gear_factor * (gross_weight / POUND_FORCE * load_factor) ** 0.5
    pounds = pounds * (length / FOOT) ** 0.25 * (wetted_area / FOOT**2) ** 0.302 * (1 + sweep) ** 0.04
    return pounds * (length / depth) ** 0.1 * POUND_FORCE


def main_gear_weight(
    *, landing_weight: Value, load_factor: Value, length: Value, wheels: Value, struts: Value, stall_speed: Value
) -> Value:
    """Main landing gear that does not kneel, N (15.29). `load_factor`: ultimate, of landing, 1.5 times the gear's."""
    pounds = 0.0106 * (landing_weight / POUND_FORCE) ** 0.888 * load_factor**0.25 * (length / INCH) ** 0.4
    return pounds * wheels**0.321 * struts**-0.5 * (stall_speed / KNOT) ** 0.1 * POUND_FORCE


def nose_gear_weight(*, landing_weight: Value, load_factor: Value, length: Value, wheels: Value) -> Value:
    """Nose landing gear that does not kneel, N (15.30)."""
    pounds = 0.032 * (landing_weight / POUND_FORCE) ** 0.646 * load_factor**0.2
    return pounds * (length / INCH) ** 0.5 * wheels**0.45 * POUND_FORCE


# --- propulsion and systems -------------------------------------------------------------------------------------------


def nacelle_weight(
    *,
    engine_weight: Value,
    engines: Value,
    load_factor: Value,
    length: Value,
    width: Value,
    wetted_area: Value,
    pylon: bool = True,
    thrust_reverser: bool = True,
) -> Value:
    """Nacelle group of all engines, N (15.31). Lengths and `wetted_area` of one nacelle, `engine_weight` of one engine."""
    contents = 2.331 * (engine_weight / POUND_FORCE) ** 0.901 * (1.18 if thrust_reverser else 1.0)
    pounds = 0.6724 * (1.017 if pylon else 1.0) * (length / FOOT) ** 0.1 * (width / FOOT) ** 0.294 * load_factor**0.119
    return pounds * contents**0.611 * engines**0.984 * (wetted_area / FOOT**2) ** 0.224 * POUND_FORCE


def engine_controls_weight(*, engines: Value, run: Value) -> Value:
    """Engine controls, N (15.32). `run`: from the engines to the cockpit, all together."""
    return (5.0 * engines + 0.8 * run / FOOT) * POUND_FORCE


def starter_weight(*, engines: Value, engine_weight: Value) -> Value:
    """Pneumatic starters, N (15.33)."""
    return 49.19 * (engines * engine_weight / POUND_FORCE / 1000) ** 0.541 * POUND_FORCE


def fuel_system_weight(*, volume: Value, tanks: Value) -> Value:
    """Fuel system with integral tanks, none of them self-sealing, N (15.34)."""
    return 2.405 * (volume / GALLON) ** 0.606 / 2 * tanks**0.5 * POUND_FORCE


def flight_controls_weight(*, gross_weight: Value, functions: Value, control_area: Value, arm: Value) -> Value:
    """Powered flight controls, N (15.35). `functions`: their number, 4 to 7; `control_area`: the sum over all
    controls. The moment of inertia in pitch follows from the radius of gyration in :func:`horizontal_tail_weight`."""
    inertia = gross_weight / POUND_FORCE * (0.3 * arm / FOOT) ** 2
    return 145.9 * functions**0.554 * (control_area / FOOT**2) ** 0.2 * (inertia * 1e-6) ** 0.07 * POUND_FORCE


def auxiliary_power_weight(*, uninstalled: Value) -> Value:
    """Auxiliary power unit, installed, N (15.36)."""
    return 2.2 * uninstalled


def instruments_weight(*, crew: Value, engines: Value, length: Value, wing_span: Value) -> Value:
    """Instruments, N (15.37); `crew` in the cockpit, `length` of the fuselage."""
    return 4.509 * crew**0.541 * engines * ((length + wing_span) / FOOT) ** 0.5 * POUND_FORCE


def hydraulics_weight(*, functions: Value, length: Value, wing_span: Value) -> Value:
    """Hydraulics, N (15.38)."""
    return 0.2673 * functions * ((length + wing_span) / FOOT) ** 0.937 * POUND_FORCE


def electrical_weight(*, rating: Value, run: Value, generators: Value) -> Value:
    """Electrical system, N (15.39). `rating`: kVA, 40 to 60 for transports; `run`: generators to avionics to cockpit, m."""
    return 7.291 * rating**0.782 * (run / FOOT) ** 0.346 * generators**0.1 * POUND_FORCE


def avionics_weight(*, uninstalled: Value) -> Value:
    """Avionics, installed, N (15.40)."""
    return 1.73 * (uninstalled / POUND_FORCE) ** 0.983 * POUND_FORCE


def furnishings_weight(*, crew: Value, cargo: Value, wetted_area: Value) -> Value:
    """Furnishings without seats, N (15.41). `cargo`: largest weight of cargo; `wetted_area` of the fuselage."""
    return 0.0577 * crew**0.1 * (cargo / POUND_FORCE) ** 0.393 * (wetted_area / FOOT**2) ** 0.75 * POUND_FORCE


def air_conditioning_weight(*, people: Value, volume: Value, avionics: Value) -> Value:
    """Air conditioning, N (15.42). `volume`: pressurised; `avionics`: their uninstalled weight."""
    pounds = 62.36 * people**0.25 * (volume / FOOT**3 / 1000) ** 0.604 * (avionics / POUND_FORCE) ** 0.1
    return pounds * POUND_FORCE


def anti_ice_weight(*, gross_weight: Value) -> Value:
    """Anti-ice system, N (15.43)."""
    return 0.002 * gross_weight


def handling_gear_weight(*, gross_weight: Value) -> Value:
    """Handling gear of civil aircraft, N (15.44)."""
    return 3.0e-4 * gross_weight


# --- parasite drag ----------------------------------------------------------------------------------------------------


def friction_coefficient(reynolds: Value, mach: Value) -> Value:
    """Friction coefficient of a flat plate with turbulent boundary layer (12.27)."""
    return 0.455 / (np.log10(reynolds) ** 2.58 * (1 + 0.144 * mach**2) ** 0.65)


def surface_form_factor(*, thickness: Value, thickest: Value, mach: Value, sweep: Value) -> Value:
    """Form factor of wings and tails (12.30). `thickness`: relative to the chord; `thickest`: the fraction of the chord at
    which it is greatest and `sweep` is measured."""
    section = 1 + 0.6 / thickest * thickness + 100 * thickness**4
    return section * 1.34 * mach**0.18 * np.cos(sweep) ** 0.28


def body_form_factor(fineness: Value) -> Value:
    """Form factor of fuselages (12.31); the argument is length over diameter."""
    return 1 + 60 / fineness**3 + fineness / 400


def nacelle_form_factor(fineness: Value) -> Value:
    """Form factor of nacelles and smooth stores (12.32)."""
    return 1 + 0.35 / fineness


def upsweep_drag_area(*, upsweep: Value, cross_section: Value) -> Value:
    """D/q of a fuselage's upswept rear, m^2 (12.36). `upsweep`: of its centre line, rad."""
    return 3.83 * upsweep**2.5 * cross_section
