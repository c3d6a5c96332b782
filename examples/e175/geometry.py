"""The E175's fuselage, wing and horizontal tail as untrimmed bicubic B-spline components, from its published measures.

Metres; x aft from the nose, y starboard, z up; the symmetry plane is y = 0. Each component is exactly symmetric: control
points come in mirror pairs with equal bits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import brentq

from bspline import Component, Patch, clamped_knots, greville, interpolate

# --- measures ---------------------------------------------------------------------------------------------------------

FUSELAGE_LENGTH = 31.68
FUSELAGE_CENTRE = 0.950  # z of the barrel's axis
FUSELAGE_HALF_WIDTH = 1.505
FUSELAGE_HALF_HEIGHT = 1.675
AFT_END = (31.68, 0.0, 1.90)
TAIL_ROOT_TRAILING_EDGE = (29.689, 0.605)  # x, y where the tail's trailing edge leaves the body

# Control sections of the fuselage: x, centre z, half width and half height as fractions of the barrel's.
# The first and last are the poles; the ones beside them lie in the same plane, which makes the ends round.
NOSE_SECTIONS = (
    (0.00, 0.53, 0.000, 0.000),
    (0.00, 0.53, 0.280, 0.266),
    (0.45, 0.55, 0.573, 0.533),
    (1.45, 0.65, 0.813, 0.747),
    (2.90, 0.81, 0.953, 0.907),
    (4.60, 0.93, 1.000, 0.985),
)
BARREL_SECTIONS = tuple((x, FUSELAGE_CENTRE, 1.0, 1.0) for x in (6.4, 8.4, 11.0, 14.0, 17.0, 19.6, 21.6))
TAIL_SECTIONS = (
    (23.30, 1.000, 0.950, 0.950),
    (24.90, 1.120, 0.840, 0.860),
    (26.50, 1.285, 0.690, 0.740),
    (28.10, 1.440, 0.520, 0.635),
    (29.60, 1.565, 0.365, 0.560),
    (30.80, 1.690, 0.245, 0.455),
    (31.50, 1.830, 0.155, 0.270),
    (31.68, 1.900, 0.075, 0.095),
    (31.68, 1.900, 0.000, 0.000),
)
TAIL_SECTIONS_FITTED = slice(2, 6)  # their width is scaled to meet TAIL_ROOT_TRAILING_EDGE
FUSELAGE_SPANS_AROUND = 16


@dataclass(frozen=True)
class Station:
    """A section of a lifting surface: its leading and trailing edge (x, z), thickness and camber over chord."""

    y: float
    leading_edge: tuple[float, float]
    trailing_edge: tuple[float, float]
    thickness: float
    camber: float


WING_STATIONS = (
    Station(0.0, (10.882, 0.200), (16.326, -0.009), 0.135, 0.018),
    Station(4.8635, (13.508, 0.684), (16.421, 0.623), 0.120, 0.020),
    Station(11.9106, (17.314, 1.412), (18.314, 1.391), 0.105, 0.022),
)
TAIL_STATIONS = (
    Station(0.0, (26.000, 1.572), (29.534, 1.572), 0.110, 0.0),
    Station(5.0, (29.700, 1.572), (30.816, 1.572), 0.100, 0.0),
)

# Spanwise knots (y >= 0, mirrored). Equal steps on both sides of a station make it a Greville abscissa, and the surface
# interpolates the sections there, so the stations are met exactly while the kink is rounded within about one step.
WING_BREAKS = (
    0.0,
    0.3,
    0.6,
    1.0,
    1.7,
    2.6,
    3.5,
    4.0635,
    4.4635,
    4.8635,
    5.2635,
    5.6635,
    6.4,
    7.6,
    9.0,
    10.3,
    11.3,
    11.9106,
)
TAIL_BREAKS = (0.0, 0.2, 0.4, 0.7, 1.3, 2.2, 3.2, 4.2, 4.75, 5.0)
SECTION_SPANS = 16  # knot spans of a section, lower trailing edge to upper trailing edge


# --- fuselage ---------------------------------------------------------------------------------------------------------


def circle_profile(spans):
    """Clamped knots and control points (y, z) of a closed cubic curve through the unit circle at its knots.

    Runs bottom, port, top, starboard; curvature is continuous at the bottom too.
    """
    step = 2 * np.pi / spans
    angles = -np.pi / 2 - (np.arange(spans + 3) - 1) * step
    radius = 3 / (2 + np.cos(step))
    periodic = BSpline(np.arange(-3, spans + 4) / spans, radius * np.c_[np.cos(angles), np.sin(angles)], 3)
    knots = clamped_knots(np.arange(spans + 1) / spans)
    points = interpolate(knots, 3, periodic(greville(knots, 3)))
    points = 0.5 * (points + points[::-1] * [-1, 1])
    points[0, 0] = points[-1, 0] = 0.0
    return knots, points


def body(name, sections, spans_around):
    """A body of elliptical control sections (x, centre z, half width, half height), poles first and last."""
    sections = np.asarray(sections, float)
    knots_v, profile = circle_profile(spans_around)
    net = np.empty((len(sections), len(profile), 3))
    net[:, :, 0] = sections[:, 0, None]
    net[:, :, 1] = sections[:, 2, None] * profile[:, 0]
    net[:, :, 2] = sections[:, 1, None] + sections[:, 3, None] * profile[:, 1]
    arc = np.concatenate([[0], np.cumsum(np.hypot(np.diff(sections[:, 0]), np.diff(sections[:, 2])))])
    arc /= arc[-1]
    inner = [arc[j + 1 : j + 4].mean() for j in range(len(sections) - 4)]
    knots_u = np.concatenate([[0] * 4, inner, [1] * 4])
    return Patch(name, 3, 3, knots_u, knots_v, net)


def half_width_at(patch, x, z):
    """y of the starboard side of a body of sections at the given x and z, m."""
    v = np.linspace(0.95, 0.55, 4001)

    def y_at(u):
        side = patch.position(np.full(len(v), u), v)
        return np.interp(z, side[:, 2], side[:, 1])

    middle = lambda u: patch.position(u, 0.75)[0, 0] - x
    # x is constant around a section, because every control section is planar
    return y_at(brentq(middle, 0.01, 0.99, xtol=1e-15))


def fuselage():
    """One patch `body`: u from nose pole to tail pole, v around from the bottom over port, top and starboard."""

    def build(tail_width):
        tail = np.array(TAIL_SECTIONS)
        tail[TAIL_SECTIONS_FITTED, 2] *= tail_width
        sections = np.concatenate([NOSE_SECTIONS, BARREL_SECTIONS, tail])
        sections[:, 2] *= FUSELAGE_HALF_WIDTH
        sections[:, 3] *= FUSELAGE_HALF_HEIGHT
        return body("body", sections, FUSELAGE_SPANS_AROUND)

    x, y = TAIL_ROOT_TRAILING_EDGE
    z = TAIL_STATIONS[0].trailing_edge[1]
    width = brentq(lambda w: half_width_at(build(w), x, z) - y, 0.5, 2.0, xtol=1e-14)
    return Component("fuselage", [build(width)])


# --- lifting surfaces -------------------------------------------------------------------------------------------------


def section_profile(spans, samples=600):
    """Cubic splines of a NACA 4-digit section with a sharp trailing edge, in t from -1 (lower trailing edge) over 0
    (leading edge) to 1: knots and control values of x, half thickness for thickness 1, and camber line for camber 1.
    """
    t = np.linspace(-1, 1, 2 * samples + 1)
    x = t * t
    half_thickness = 5 * np.sign(t) * (0.2969 * np.abs(t) - 0.1260 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    camber = x * (1 - x) * (1.6 - x)
    curves = np.c_[x, half_thickness, camber / camber.max()]
    knots = clamped_knots(np.linspace(-1, 1, spans + 1))
    weights = np.ones(len(t))
    weights[[0, -1]], weights[samples] = 1e4, 1e6
    matrix = BSpline.design_matrix(t, knots, 3).toarray() * weights[:, None]
    control = np.linalg.lstsq(matrix, curves * weights[:, None], rcond=None)[0]
    control = 0.5 * (control + control[::-1] * [1, -1, 1])
    control[0] = control[-1] = [1, 0, 0]
    return knots, control


def lifting_surface(name, stations, breaks):
    """Four patches: `lower` and `upper` skins over both halves (u: lower trailing edge -> leading edge -> upper trailing
    edge; v: port -> starboard, y linear in v) and flat caps `tip_port` and `tip_starboard`.
    """
    knots_u, profile = section_profile(SECTION_SPANS)
    half = np.asarray(breaks)
    knots_y = clamped_knots(np.concatenate([-half[:0:-1], half]))
    knots_y = 0.5 * (knots_y - knots_y[::-1])
    y = greville(knots_y, 3)
    y = 0.5 * (y - y[::-1])

    at = np.abs(y)
    table = np.array([(s.y, *s.leading_edge, *s.trailing_edge, s.thickness, s.camber) for s in stations])
    x_le, z_le, x_te, z_te, thickness, camber = (np.interp(at, table[:, 0], column) for column in table[:, 1:].T)
    chord_x, chord_z = x_te - x_le, z_te - z_le
    height = profile[:, 1:2] * thickness + profile[:, 2:3] * camber
    sections = np.stack(
        [
            x_le + profile[:, :1] * chord_x - height * chord_z,
            np.broadcast_to(y, height.shape),
            z_le + profile[:, :1] * chord_z + height * chord_x,
        ],
        axis=-1,
    )

    net = np.moveaxis(interpolate(knots_y, 3, np.moveaxis(sections, 1, 0)), 0, 1).copy()
    net = 0.5 * (net + net[:, ::-1] * [1, -1, 1])
    net[:, :, 1] = y
    net[0] = net[-1] = 0.5 * (net[0] + net[-1])
    span = 2 * half[-1]
    skin = Patch(name, 3, 3, knots_u, (knots_y - knots_y[0]) / span, net)
    lower, upper = skin.split_u(0.0, ("lower", "upper"))
    lower.knots_u, upper.knots_u = lower.knots_u + 1, upper.knots_u
    for skin_half in (lower, upper):  # the leading edge, computed once
        skin_half.control_points[-1 if skin_half is lower else 0] = 0.5 * (
            lower.control_points[-1] + upper.control_points[0]
        )

    # S_u x S_v of the skins as built points out of the body; a cap joins the lower rim to the upper one at equal u
    caps = []
    for side, cap_name in ((0, "tip_port"), (-1, "tip_starboard")):
        low, high = lower.control_points[:, side], upper.control_points[::-1, side]
        rows = np.stack([low + (high - low) * fraction for fraction in (0, 1 / 3, 2 / 3, 1)], axis=1)
        rows[:, 3] = high
        cap = Patch(cap_name, 3, 3, lower.knots_u, clamped_knots([0, 1]), rows)
        caps.append(cap if side == -1 else cap.reversed_u())
    return Component(name, [lower, upper, *caps])


def wing():
    return lifting_surface("wing", WING_STATIONS, WING_BREAKS)


def htail():
    return lifting_surface("htail", TAIL_STATIONS, TAIL_BREAKS)


def build():
    """The three components, outward oriented."""
    return [fuselage(), wing(), htail()]
