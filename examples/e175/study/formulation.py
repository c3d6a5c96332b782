"""The optimization problem of the paper's Table 2: objective, limits and scales.

Both programs, with OpenMDAO and with SciPy alone, read it here. Physical values are SI, design variables in the units of
the set-up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aircraft import MODEL, REFERENCE_CHORD
from raymer import FOOT, POUND_FORCE

POUNDS_PER_SQUARE_FOOT = POUND_FORCE / FOOT**2  #: Pa


class Limit(NamedTuple):
    """lower <= result / scale <= upper."""

    result: str
    lower: float
    upper: float
    scale: float


#: Scale of forces: about the gross weight, N.
WEIGHT = 65_000 * POUND_FORCE
#: Scale of the objective: about the baseline's fuel, N.
FUEL = 15_000 * POUND_FORCE
OBJECTIVE = "fuel_weight"
#: See `slsqp.minimise`: an unscaled second derivative of the fuel is a few thousandths, with variables from bound to bound.
OBJECTIVE_WEIGHT = 300.0

_PAYLOAD = MODEL["baseline_payload"].value

#: Constraints of both problems.
LIMITS = (
    Limit("lift_excess", 0.0, 0.0, WEIGHT),
    Limit("pitching_moment", 0.0, 0.0, WEIGHT * REFERENCE_CHORD),
    Limit("payload_weight", 1.0, np.inf, _PAYLOAD),
    Limit("wing_loading", 0.6, 1.0, 100 * POUNDS_PER_SQUARE_FOOT),
    Limit("tail_volume", 0.7, 1.2, 1.0),
)
#: The additional constraint of the second problem.
STATIC_MARGIN = Limit("static_margin", 0.05, 0.05, 1.0)

PROBLEMS = {"without": LIMITS, "with": (*LIMITS, STATIC_MARGIN)}
