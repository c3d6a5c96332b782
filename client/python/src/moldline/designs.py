"""Designs as people write them: by variable, by group of variables, or as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from moldline.facts import SetupFacts

#: A design: values by the name of a variable (``wing.twist[3]``) or of a group of them (``wing.twist``: an array of the
#: group's shape, or one number for all), all others at their baseline; or float64, (number of variables,); every entry in
#: its variable's unit. `None` is the baseline.
Design = Mapping[str, ArrayLike] | ArrayLike | None


def normalised(setup: SetupFacts, design: Design) -> dict[str, float] | NDArray[np.float64] | None:
    """A copy of `design`, with values by the names of variables or in their order.

    Raises `ValueError` for texts in place of numbers, for a group's values of another shape than its own, and for a variable
    that is given twice. Unknown names stay: the server refuses them and names what there is.
    """
    if design is None:
        return None
    if not isinstance(design, Mapping):
        return _numbers("the design", design)
    values: dict[str, float] = {}
    for name, given in design.items():
        for variable, value in _entries(setup, name, _numbers(repr(name), given)):
            if variable in values:
                raise ValueError(f"{variable!r} is given twice: by itself and with its group")
            values[variable] = value
    return values


def _entries(setup: SetupFacts, name: str, given: NDArray[np.float64]) -> list[tuple[str, float]]:
    group = setup.groups.get(name)
    if group is None or group.shape == ():
        if given.shape != ():
            raise ValueError(f"{name!r} takes a number, not values of shape {given.shape}")
        return [(name, float(given))]
    if given.shape not in ((), group.shape):
        raise ValueError(
            f"{name!r} takes values of shape {group.shape}, or one number for all; these have {given.shape}"
        )
    variables = setup.variables[group.entries]
    flat = np.broadcast_to(given, group.shape).ravel()
    return [(variable.name, float(value)) for variable, value in zip(variables, flat, strict=True)]


def _numbers(what: str, given: Any) -> NDArray[np.float64]:
    """A copy as float64; numpy would turn texts such as '1.5' into numbers."""
    array = np.array(given)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{what} takes numbers, not {given!r:.60}")
    return array.astype(np.float64)
