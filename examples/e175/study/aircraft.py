"""The study's model of the E175 beyond its surface: weights, balance, drag, fuel, stability.

:func:`analyse` is a plain function of numbers from the two services (wetted areas, planforms, tracked points; lift, drag and
moment with their slopes) to what the optimizer sees. It takes complex numbers and arrays, so that :func:`derivatives` has
exact derivatives by complex steps, all inputs in one call.

SI throughout: metres, newtons, seconds, radians. x aft, z up; moments positive nose up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import raymer
from raymer import FOOT, GRAVITY, KNOT, POUND_FORCE, Value

NAUTICAL_MILE = 1852.0  #: m, exact


class Choice(NamedTuple):
    """A number of the model, and the reason for it."""

    value: float
    unit: str
    why: str


#: Numbers that the paper gives.
GIVEN = {
    "mach": Choice(0.7, "1", "Sec. V.A"),
    "altitude": Choice(25_000 * FOOT, "m", "25,000 ft, Sec. V.A"),
    "range": Choice(2_000 * NAUTICAL_MILE, "m", "2,000 nm, Sec. V.A"),
    "thrust_specific_consumption": Choice(0.68 / 3600 / GRAVITY, "kg/(N s)", "0.68 lb/lbf/h, Sec. V.A"),
    "baseline_payload": Choice(22_050 * POUND_FORCE, "N", "Table 2; 22,050 lbf are the weight of 10,000 kg"),
}

#: Numbers that the paper does not give.
CHOICES = {
    # weights
    "load_factor": Choice(3.75, "1", "1.5 times the 2.5 that FAR 25.337 asks for"),
    "wing_control_fraction": Choice(
        0.10, "1", "control surfaces of the wing over its area, as SUAVE and OpenConcept have it"
    ),
    "wing_root_thickness": Choice(0.135, "1", "the geometry's section at y = 0"),
    "elevator_fraction": Choice(0.25, "1", "of the tail's area, usual"),
    "door_factor": Choice(1.0, "1", "no freight door on the main deck"),
    "landing_fraction": Choice(
        32_800 / 37_500, "1", "landing over take-off weight, type certificate of the ERJ 170-200 STD"
    ),
    "landing_load_factor": Choice(4.5, "1", "1.5 times a gear load factor of 3, Raymer's for transports"),
    "main_gear_length": Choice(2.2, "m", "estimated from views; enters to the power 0.4"),
    "nose_gear_length": Choice(1.6, "m", "estimated from views; enters to the power 0.5"),
    "main_wheels": Choice(4.0, "1", "E175"),
    "main_struts": Choice(2.0, "1", "E175"),
    "nose_wheels": Choice(2.0, "1", "E175"),
    "stall_speed": Choice(104 * KNOT, "m/s", "approach at 128 kt over 1.23; enters to the power 0.1"),
    "engines": Choice(2.0, "1", "E175"),
    "engine_weight": Choice(2_600 * POUND_FORCE, "N", "CF34-8E, dry, maker's data"),
    "nacelle_length": Choice(3.3, "m", "estimated from views"),
    "nacelle_width": Choice(1.6, "m", "estimated from views"),
    "engine_run": Choice(20.0, "m", "both engines to the cockpit"),
    "fuel_density": Choice(803.0, "kg/m^3", "Jet A-1, usual"),
    "fuel_tanks": Choice(2.0, "1", "E175: one in each half wing, integral"),
    "control_functions": Choice(7.0, "1", "Raymer: 4 to 7"),
    "electrical_rating": Choice(50.0, "kVA", "Raymer: 40 to 60 for transports"),
    "avionics_weight": Choice(1_100 * POUND_FORCE, "N", "uninstalled; Raymer: 800 to 1,400 lb"),
    "engines_weighed": Choice(
        0.0,
        "1",
        "share of the dry engines that is weighed. The paper leaves propulsion out in part (Sec. V.C) and has nacelles "
        "among its components: its Table 3 and payload leave 27,030 lbf for the empty weight, which is what all regressions "
        "give without engines; 1 weighs them",
    ),
    "systems_weighed": Choice(
        1.0, "1", "share of furnishings, seats, air conditioning, APU, anti-ice, instruments: all of them"
    ),
    "cockpit_crew": Choice(2.0, "1", "E175"),
    "passengers": Choice(76.0, "1", "E175, single class at 31 in"),
    "apu_weight": Choice(260 * POUND_FORCE, "N", "uninstalled, of this class"),
    "pressurised_fraction": Choice(0.85, "1", "of the fuselage's volume"),
    # balance
    "tail_arm_offset": Choice(
        2.3,
        "m",
        "subtracted from the distance of the quarter chords in Eq. (20) alone: that distance, 14.0 m, gives C_VT = 1.39 "
        "for the areas of Table 3's baseline, beyond the bound; its 1.16 takes 11.7 m",
    ),
    "surface_position": Choice(0.40, "1", "wing, fuel in it and tails, of their mean chord; Raymer, Table 15.2"),
    "cabin_share": Choice(
        0.72, "1", "of the payload in the cabin, the rest in the hold: 76 passengers with hand luggage, 95 kg each"
    ),
    "nacelle_ahead": Choice(2.9, "m", "front of the nacelle ahead of the leading edge at the kink"),
    "nacelle_end_ahead": Choice(3.1, "m", "its end ahead of the trailing edge there"),
    # drag
    "wing_thickness": Choice(0.12, "1", "mean of the geometry's sections, 0.135 to 0.105"),
    "tail_thickness": Choice(0.105, "1", "mean of the geometry's sections"),
    "thickest": Choice(0.30, "1", "of chord, NACA 4-digit sections"),
    "wing_interference": Choice(1.0, "1", "well-filleted low wing, Raymer, Sec. 12.5.5"),
    "tail_interference": Choice(1.05, "1", "conventional tail, 4 to 5 %, Raymer, Sec. 12.5.5"),
    "nacelle_interference": Choice(1.3, "1", "closer than a diameter to the wing, Raymer, Sec. 12.5.5"),
    "upsweep": Choice(
        np.arctan2(1.90 - 0.95, 31.68 - 21.6), "rad", "rise of the tail cone's centre line in the geometry"
    ),
    "leakage": Choice(0.035, "1", "leakage and protuberances; Raymer, Sec. 12.5.7: 2 to 5 % for jet transports"),
    # parts without a mesh
    "fuselage_length": Choice(31.68, "m", "no variable changes it"),
    "fin_area": Choice(16.2, "m^2", "vertical tail, from its chords below and its height"),
    "fin_height": Choice(4.76, "m", "from views"),
    "fin_root": Choice(26.1, "m", "x of the root's leading edge"),
    "fin_root_chord": Choice(5.1, "m", "to x = 31.2"),
    "fin_tip": Choice(29.3, "m", "x of the tip's leading edge"),
    "fin_tip_chord": Choice(1.7, "m", "to x = 31.0"),
    "fin_thickness": Choice(0.11, "1", "as the horizontal tail's root"),
}

MODEL: dict[str, Choice] = {**GIVEN, **CHOICES}

#: Reference values of the panel method: the baseline's area and mean chord, and the moment centre. They are fixed, so that
#: its coefficients stand for forces; `analyse` gives coefficients with respect to the current wing.
REFERENCE_AREA = 68.2  #: m^2
REFERENCE_CHORD = 3.42  #: m
REFERENCE_POINT = (14.0, 0.0, 0.95)  #: m

#: Points that the set-up tracks on leading and trailing edges.
_EDGES = ("leading_edge", "trailing_edge")
_STATIONS = {"wing": ("root", "kink", "tip"), "htail": ("root", "tip")}

#: Scalar outputs of the mesh service that :func:`analyse` needs.
GEOMETRY = (
    *("fuselage.volume", "fuselage.wetted_area", "wing.wetted_area", "htail.wetted_area"),
    *(f"{surface}.{name}" for surface in _STATIONS for name in ("planform_area", "span", "mean_aerodynamic_chord")),
    *(
        f"{s}.{at}_{edge}.{axis}"
        for s, stations in _STATIONS.items()
        for at in stations
        for edge in _EDGES
        for axis in "xy"
    ),
    *("fuselage.cabin.x", "fuselage.hold.x", "fuselage.nose_gear.x", "fuselage.main_gear.x"),
    *("fuselage.barrel_side.y", "fuselage.barrel_top.z", "fuselage.barrel_bottom.z", "fuselage.tail_side.y"),
)

#: Results of the panel service: coefficients for the reference above and the neutral point. The lift that balances the
#: weight is that of the circulation, consistent with the induced drag of the Trefftz plane; the moment is that of the
#: pressure, and so is the normal force that carries it to the centre of gravity.
_COEFFICIENTS = ("lift", "induced_drag", "pressure_lift", "pressure_drag", "moment", "neutral_point")
AERODYNAMICS = tuple(f"flow.{name}" for name in _COEFFICIENTS)

INPUTS = (*GEOMETRY, *AERODYNAMICS, "angle_of_attack")


class Air(NamedTuple):
    """The air that the aircraft flies in."""

    density: float  #: kg/m^3
    speed_of_sound: float  #: m/s
    viscosity: float  #: Pa s


def standard_air(altitude: float) -> Air:
    """The International Standard Atmosphere below 11 km (ISO 2533); viscosity by Sutherland's formula in it."""
    temperature = 288.15 - 0.0065 * altitude
    pressure = 101_325 * (temperature / 288.15) ** (GRAVITY / (0.0065 * 287.05287))
    viscosity = 1.458e-6 * temperature**1.5 / (temperature + 110.4)
    return Air(pressure / (287.05287 * temperature), (1.4 * 287.05287 * temperature) ** 0.5, viscosity)


def fuel_fraction(*, lift_to_drag: Value, distance: Value, consumption: Value, speed: Value) -> Value:
    """Fuel over gross weight by Breguet's equation (19). `consumption` in kg of fuel per second and newton of thrust."""
    return 1 - np.exp(-distance * consumption * GRAVITY / (lift_to_drag * speed))


class _Surface(NamedTuple):
    """A wing or tail of straight parts."""

    area: Value  #: m^2
    span: Value  #: m
    chord: Value  #: mean aerodynamic, m
    quarter_chord: Value  #: x at the mean aerodynamic chord, m
    taper: Value  #: tip chord over root chord
    lines: dict[float, Value]

    @property
    def aspect_ratio(self) -> Value:
        return self.span**2 / self.area


def _surface(g: Mapping[str, Value], name: str, fractions: Iterable[float]) -> _Surface:
    """Planform from the tracked points; `fractions`: of the chord, for lines whose sweep is computed."""
    at = [[g[f"{name}.{station}_{edge}.x"] for edge in _EDGES] for station in _STATIONS[name]]
    y = [
        (g[f"{name}.{station}_leading_edge.y"] + g[f"{name}.{station}_trailing_edge.y"]) / 2
        for station in _STATIONS[name]
    ]
    # x of the quarter chord, weighted with the chord and integrated exactly over straight parts.
    moment, area = 0.0, 0.0
    for (a, b), y0, y1 in zip(pairwise(at), y, y[1:]):
        c, d = a[1] - a[0], b[1] - b[0]
        p, q = a[0] + c / 4, b[0] + d / 4
        moment = moment + (y1 - y0) * (p * (2 * c + d) + q * (c + 2 * d)) / 6
        area = area + (y1 - y0) * (c + d) / 2
    chords = [trailing - leading for leading, trailing in at]

    def sweep(fraction: float) -> Value:
        """Of the line from root to tip, rad."""
        return np.arctan((at[-1][0] + fraction * chords[-1] - at[0][0] - fraction * chords[0]) / (y[-1] - y[0]))

    return _Surface(
        area=g[f"{name}.planform_area"],
        span=g[f"{name}.span"],
        chord=g[f"{name}.mean_aerodynamic_chord"],
        quarter_chord=moment / area,
        taper=chords[-1] / chords[0],
        lines={fraction: sweep(fraction) for fraction in fractions},
    )


def analyse(state: Mapping[str, Value], model: Mapping[str, Value] | None = None) -> dict[str, Value]:
    """The aircraft of `state`, which has a value for each of :data:`INPUTS`.

    `model`: values of :data:`MODEL` to replace.

    The gross weight is the fixed point at which the weights of the components, which depend on it, add up to it. Lift equal
    to weight is a constraint of the optimizer.
    """
    m: dict[str, Value] = {name: choice.value for name, choice in MODEL.items()} | dict(model or {})
    air = standard_air(m["altitude"])
    speed = m["mach"] * air.speed_of_sound
    pressure = 0.5 * air.density * speed**2

    wing = _surface(state, "wing", (0.25, 0.30))
    tail = _surface(state, "htail", (0.25, 0.30))
    arm = tail.quarter_chord - wing.quarter_chord
    width = 2 * state["fuselage.barrel_side.y"]
    depth = state["fuselage.barrel_top.z"] - state["fuselage.barrel_bottom.z"]
    fin_sweep = np.arctan(
        (m["fin_tip"] - m["fin_root"] + 0.25 * (m["fin_tip_chord"] - m["fin_root_chord"])) / m["fin_height"]
    )
    fin_taper = m["fin_tip_chord"] / m["fin_root_chord"]
    fin_chord = 2 / 3 * m["fin_root_chord"] * (1 + fin_taper + fin_taper**2) / (1 + fin_taper)
    fin_rise = (1 + 2 * fin_taper) / (1 + fin_taper) / 3  # of the height, where that chord is
    fin_quarter = m["fin_root"] + fin_rise * (m["fin_tip"] - m["fin_root"]) + 0.25 * fin_chord
    nacelle_area = np.pi * m["nacelle_width"] * m["nacelle_length"]

    # --- drag and fuel
    lift = pressure * REFERENCE_AREA * state["flow.lift"]
    induced = REFERENCE_AREA * state["flow.induced_drag"]

    def friction(length: Value) -> Value:
        return raymer.friction_coefficient(air.density * speed * length / air.viscosity, m["mach"])

    def surface_factor(thickness: Value, sweep: Value) -> Value:
        return raymer.surface_form_factor(thickness=thickness, thickest=m["thickest"], mach=m["mach"], sweep=sweep)

    drag_areas = {
        "fuselage": friction(m["fuselage_length"])
        * raymer.body_form_factor(m["fuselage_length"] / (width * depth) ** 0.5)
        * state["fuselage.wetted_area"],
        "wing": friction(wing.chord)
        * surface_factor(m["wing_thickness"], wing.lines[0.30])
        * m["wing_interference"]
        * state["wing.wetted_area"],
        "horizontal tail": friction(tail.chord)
        * surface_factor(m["tail_thickness"], tail.lines[0.30])
        * m["tail_interference"]
        * state["htail.wetted_area"],
        "vertical tail": friction(fin_chord)
        * surface_factor(m["fin_thickness"], fin_sweep)
        * m["tail_interference"]
        * 2.05
        * m["fin_area"],
        "nacelles": friction(m["nacelle_length"])
        * raymer.nacelle_form_factor(m["nacelle_length"] / m["nacelle_width"])
        * m["nacelle_interference"]
        * m["engines"]
        * nacelle_area,
        "upsweep": raymer.upsweep_drag_area(upsweep=m["upsweep"], cross_section=np.pi / 4 * width * depth),
    }
    drag_areas["leakage"] = m["leakage"] * sum(drag_areas.values())
    parasite = sum(drag_areas.values())
    lift_to_drag = lift / (pressure * (parasite + induced))
    fuel = fuel_fraction(
        lift_to_drag=lift_to_drag,
        distance=m["range"],
        consumption=m["thrust_specific_consumption"],
        speed=speed,
    )

    # --- weights
    payload = m["baseline_payload"] * state["fuselage.volume"] / BASELINE_VOLUME
    control_area = m["wing_control_fraction"] * wing.area

    def components(gross: Value) -> dict[str, Value]:
        size = {"gross_weight": gross, "load_factor": m["load_factor"]}
        landing = {"landing_weight": m["landing_fraction"] * gross, "load_factor": m["landing_load_factor"]}
        return {
            "wing": raymer.wing_weight(
                **size,
                area=wing.area,
                aspect_ratio=wing.aspect_ratio,
                root_thickness=m["wing_root_thickness"],
                taper=wing.taper,
                sweep=wing.lines[0.25],
                control_area=control_area,
            ),
            "horizontal tail": raymer.horizontal_tail_weight(
                **size,
                area=tail.area,
                aspect_ratio=tail.aspect_ratio,
                span=tail.span,
                sweep=tail.lines[0.25],
                arm=arm,
                body_width=2 * state["fuselage.tail_side.y"],
                elevator_fraction=m["elevator_fraction"],
            ),
            "vertical tail": raymer.vertical_tail_weight(
                **size,
                area=m["fin_area"],
                aspect_ratio=m["fin_height"] ** 2 / m["fin_area"],
                root_thickness=m["fin_thickness"],
                sweep=fin_sweep,
                arm=fin_quarter - wing.quarter_chord,
            ),
            "fuselage": raymer.fuselage_weight(
                **size,
                length=m["fuselage_length"],
                depth=depth,
                wetted_area=state["fuselage.wetted_area"],
                wing_span=wing.span,
                wing_taper=wing.taper,
                wing_sweep=wing.lines[0.25],
                door_factor=m["door_factor"],
            ),
            "main gear": raymer.main_gear_weight(
                **landing,
                length=m["main_gear_length"],
                wheels=m["main_wheels"],
                struts=m["main_struts"],
                stall_speed=m["stall_speed"],
            ),
            "nose gear": raymer.nose_gear_weight(**landing, length=m["nose_gear_length"], wheels=m["nose_wheels"]),
            "propulsion": m["engines_weighed"] * m["engines"] * m["engine_weight"]
            + raymer.nacelle_weight(
                engine_weight=m["engine_weight"],
                engines=m["engines"],
                load_factor=m["load_factor"],
                length=m["nacelle_length"],
                width=m["nacelle_width"],
                wetted_area=nacelle_area,
            )
            + raymer.engine_controls_weight(engines=m["engines"], run=m["engine_run"])
            + raymer.starter_weight(engines=m["engines"], engine_weight=m["engine_weight"]),
            "fuel system": raymer.fuel_system_weight(
                volume=fuel * gross / (GRAVITY * m["fuel_density"]), tanks=m["fuel_tanks"]
            ),
            "systems": raymer.flight_controls_weight(
                gross_weight=gross,
                functions=m["control_functions"],
                control_area=control_area + m["elevator_fraction"] * (tail.area + m["fin_area"]),
                arm=arm,
            )
            + raymer.hydraulics_weight(
                functions=m["control_functions"], length=m["fuselage_length"], wing_span=wing.span
            )
            + raymer.electrical_weight(rating=m["electrical_rating"], run=m["fuselage_length"], generators=m["engines"])
            + raymer.avionics_weight(uninstalled=m["avionics_weight"]),
            "cabin systems": m["systems_weighed"]
            * (
                raymer.furnishings_weight(
                    crew=m["cockpit_crew"],
                    cargo=(1 - m["cabin_share"]) * m["baseline_payload"],
                    wetted_area=state["fuselage.wetted_area"],
                )
                # seats and lavatories, Raymer, Table 15.3, short ranges
                + (60 * m["cockpit_crew"] + 32 * m["passengers"] + 0.31 * m["passengers"] ** 1.33) * POUND_FORCE
                + raymer.air_conditioning_weight(
                    people=m["passengers"],
                    volume=m["pressurised_fraction"] * state["fuselage.volume"],
                    avionics=m["avionics_weight"],
                )
                + raymer.auxiliary_power_weight(uninstalled=m["apu_weight"])
                + raymer.anti_ice_weight(gross_weight=gross)
                + raymer.handling_gear_weight(gross_weight=gross)
                + raymer.instruments_weight(
                    crew=m["cockpit_crew"],
                    engines=m["engines"],
                    length=m["fuselage_length"],
                    wing_span=wing.span,
                )
            ),
        }

    gross = (payload + 120e3) / (1 - fuel)
    # The regressions grow with less than the first power of the gross weight: each step leaves a third of the error.
    for _ in range(60):
        gross = (payload + sum(components(gross).values())) / (1 - fuel)
    weights = components(gross) | {"payload": payload, "fuel": fuel * gross}

    # --- balance
    part = m["surface_position"] - 0.25
    # The middle of the cabin, half of the length: Raymer's Table 15.2 has 0.40 to 0.50 for fuselages with contents.
    body = state["fuselage.cabin.x"]
    on_wing = wing.quarter_chord + part * wing.chord
    kink = [state[f"wing.kink_{edge}.x"] for edge in _EDGES]
    positions = {
        "wing": on_wing,
        "horizontal tail": tail.quarter_chord + part * tail.chord,
        "vertical tail": fin_quarter + part * fin_chord,
        "fuselage": body,
        "main gear": state["fuselage.main_gear.x"],
        "nose gear": state["fuselage.nose_gear.x"],
        "propulsion": (kink[0] - m["nacelle_ahead"] + kink[1] - m["nacelle_end_ahead"]) / 2,
        "fuel system": on_wing,
        "systems": body,
        "cabin systems": body,
        "payload": m["cabin_share"] * body + (1 - m["cabin_share"]) * state["fuselage.hold.x"],
        "fuel": on_wing,
    }
    centre_of_gravity = sum(weights[name] * x for name, x in positions.items()) / sum(weights.values())

    # --- trim and stability
    alpha = state["angle_of_attack"]
    normal = state["flow.pressure_lift"] * np.cos(alpha) + state["flow.pressure_drag"] * np.sin(alpha)
    lever = centre_of_gravity - REFERENCE_POINT[0]
    moment = pressure * REFERENCE_AREA * (REFERENCE_CHORD * state["flow.moment"] + lever * normal)

    results = {
        "fuel_weight": weights["fuel"],
        "gross_weight": gross,
        "payload_weight": payload,
        "empty_weight": gross - weights["fuel"] - payload,
        "lift": lift,
        "lift_excess": lift - gross,
        "pitching_moment": moment,
        "wing_loading": gross / wing.area,
        "tail_volume": tail.area * (arm - m["tail_arm_offset"]) / (wing.area * wing.chord),
        "static_margin": (state["flow.neutral_point"] - centre_of_gravity) / wing.chord,
        "lift_to_drag": lift_to_drag,
        "fuel_fraction": fuel,
        "centre_of_gravity": centre_of_gravity,
        "neutral_point": state["flow.neutral_point"],
        "tail_arm": arm,
        "wing_area": wing.area,
        "wing_aspect_ratio": wing.aspect_ratio,
        "tail_area": tail.area,
        "tail_aspect_ratio": tail.aspect_ratio,
        "lift_coefficient": lift / (pressure * wing.area),
        "parasite_drag_coefficient": parasite / wing.area,
        "induced_drag_coefficient": induced / wing.area,
    }
    results |= {f"weight: {name}": weight for name, weight in weights.items()}
    results |= {f"position: {name}": x for name, x in positions.items()}
    results |= {f"drag area: {name}": area for name, area in drag_areas.items()}
    return results


#: m^3: volume of the fuselage of the set-up's geometry; the paper's payload is per volume of the baseline's.
BASELINE_VOLUME = 201.35057256999775


def derivatives(
    state: Mapping[str, float], of: Iterable[str], by: Iterable[str] = INPUTS, model: Mapping[str, float] | None = None
) -> dict[str, NDArray[np.float64]]:
    """Derivatives of the results `of` with respect to the inputs or numbers of :data:`MODEL` in `by`, an array each.

    By complex steps, which have no truncation and no cancellation; every input is perturbed in an entry of its own.
    """
    step = 1e-40
    names = list(by)

    def perturbed(name: str, value: float) -> NDArray[np.complex128]:
        entries = np.full(len(names), value, dtype=complex)
        entries[[at for at, other in enumerate(names) if other == name]] += 1j * step
        return entries

    numbers = {name: choice.value for name, choice in MODEL.items()} | dict(model or {})
    results = analyse(
        {name: perturbed(name, value) for name, value in state.items()},
        {name: perturbed(name, value) if name in names else value for name, value in numbers.items()},
    )
    return {name: np.broadcast_to(results[name], len(names)).imag / step for name in of}
