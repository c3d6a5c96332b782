"""Conversions between numpy arrays and messages: little-endian bytes with element type and shape."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline.errors import InternalError
from moldline.v1 import array_pb2

_DTYPES: dict[int, np.dtype[Any]] = {
    array_pb2.DATA_TYPE_FLOAT64: np.dtype("<f8"),
    array_pb2.DATA_TYPE_UINT32: np.dtype("<u4"),
    array_pb2.DATA_TYPE_UINT8: np.dtype("u1"),
}


def from_wire(array: array_pb2.Array) -> NDArray[Any]:
    """The array, read-only and without a copy: a view of the message's memory."""
    try:
        flat: NDArray[Any] = np.frombuffer(array.data, dtype=_DTYPES[array.dtype])
        return flat.reshape(tuple(array.shape))
    except (KeyError, ValueError) as error:
        raise InternalError(f"the server sent an array that contradicts itself: {error}") from None


def write(values: ArrayLike, message: array_pb2.Array) -> None:
    """Writes `values` as float64 of the same shape."""
    values = np.ascontiguousarray(values, dtype="<f8")
    message.dtype = array_pb2.DATA_TYPE_FLOAT64
    message.shape.extend(values.shape)
    message.data = values.tobytes()
