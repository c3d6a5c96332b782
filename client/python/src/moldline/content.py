"""Equality, hashes and short descriptions of results that hold arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from datetime import datetime
from typing import Any

import numpy as np


class ByContent:
    """Base of frozen dataclasses, declared with ``eq=False, repr=False``, that compares and hashes what they hold, arrays
    too, and prints arrays by type and shape.

    Fields with ``compare=False`` do not count.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(_same(getattr(self, name), getattr(other, name)) for name in _compared(self))

    def __hash__(self) -> int:
        return hash((type(self), *(_key(getattr(self, name)) for name in _compared(self))))

    def __repr__(self) -> str:
        parts = [f"{each.name}={short(getattr(self, each.name))}" for each in fields(self) if each.repr]  # type: ignore[arg-type]
        return f"{type(self).__name__}({', '.join(parts)})"


def short(value: Any) -> str:
    """A description of one line: arrays by type and shape, mappings by the number of their entries if they have many."""
    if isinstance(value, np.ndarray):
        return f"<{value.dtype} {value.shape}>"
    if isinstance(value, Mapping):
        if len(value) > 4:
            return f"<{len(value)} entries>"
        return "{" + ", ".join(f"{key!r}: {short(each)}" for key, each in value.items()) + "}"
    if isinstance(value, (list, tuple)) and len(value) > 8:
        return f"<{len(value)} entries>"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%d %H:%M:%S %Z}"
    text = repr(value)
    return text if len(text) <= 120 else text[:117] + "..."


def _compared(value: Any) -> list[str]:
    return [each.name for each in fields(value) if each.compare]


def _same(one: Any, two: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(two, np.ndarray):
        return np.shape(one) == np.shape(two) and np.array_equal(one, two)
    if isinstance(one, Mapping) and isinstance(two, Mapping):
        return one.keys() == two.keys() and all(_same(one[key], two[key]) for key in one)
    if isinstance(one, (list, tuple)) and isinstance(two, (list, tuple)):
        return len(one) == len(two) and all(map(_same, one, two))
    return bool(one == two)


def _key(value: Any) -> Any:
    """Something that can be hashed and is the same for equal values: of numbers and arrays, which may be equal whatever
    their types, the shape."""
    if isinstance(value, Mapping):
        return frozenset((key, _key(each)) for key, each in value.items())
    if isinstance(value, slice):
        return value.start, value.stop, value.step
    if isinstance(value, (str, bytes)) or value is None or not _numeric(value):
        return tuple(map(_key, value)) if isinstance(value, (list, tuple)) else value
    return np.shape(value)


def _numeric(value: Any) -> bool:
    """Whether a value is a number, an array, or a sequence of them."""
    if isinstance(value, (list, tuple)):
        return all(map(_numeric, value))
    return isinstance(value, (int, float, np.number, np.ndarray))
