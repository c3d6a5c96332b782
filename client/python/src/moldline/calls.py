"""Operations as generators of calls, without the waiting.

An operation yields calls, is sent their answers (or their errors are thrown into it), and returns its result. A
:class:`moldline.caller.Caller` runs operations by blocking, a :class:`moldline.caller.AsyncCaller` by awaiting.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moldline import arrays
from moldline.errors import InternalError
from moldline.model import Progress
from moldline.progress import Tell

#: Vectors and bytes of one request, within the server's usual limits; larger blocks go in several requests.
_VECTORS = 64
_REQUEST = 32 << 20


@dataclass(frozen=True)
class Call:
    """A call of an RPC, which may take several attempts."""

    method: str
    #: The request, or a function that makes the messages of an upload for each attempt.
    request: Any | Callable[[], Iterator[Any]]
    #: Makes the receiver of a streamed answer's messages for each attempt; `None` if the answer is one message.
    receiver: Callable[[], Callable[[Any], None]] | None = None

    def messages(self) -> Any:
        """What to send."""
        return self.request() if callable(self.request) else self.request


T = TypeVar("T")
Operation = Generator[Call, Any, T]


def streamed(method: str, request: Any, result: str, tell: Tell) -> Operation[Any]:
    """A call whose answer is a stream of progress that ends with a message in the field `result`."""
    results: list[Any] = []

    def receive(event: Any) -> None:
        if event.HasField(result):
            results[:] = [getattr(event, result)]
        else:
            tell(Progress(event.progress.stage, event.progress.fraction, event.progress.message))

    yield Call(method, request, lambda: receive)
    if not results:
        raise InternalError("the server ended without a result")
    return results[0]


def seconds(parts: Iterable[Any]) -> dict[str, Any]:
    """Total time of several answers in the engine and in its queue, by the names of the results' fields."""
    timings = [part.timings for part in parts]
    return {name: sum(getattr(each, name) for each in timings) for name in ("engine_seconds", "queue_seconds")}


class Blocks:
    """Blocks of vectors to multiply with, by name, cut into pieces that fit one request."""

    def __init__(self, points: int) -> None:
        """`points`: largest number of points that belong to one vector."""
        self._blocks: dict[str, NDArray[np.float64]] = {}
        #: Whether blocks without, and with, a first axis were added.
        self._single: set[bool] = set()
        self._step = max(1, min(_VECTORS, _REQUEST // (24 * max(1, points))))

    def add(self, name: str, vectors: ArrayLike | None, dimensions: int) -> None:
        """Adds vectors of `dimensions` axes each, or a single one; nothing if `None`."""
        if vectors is None:
            return
        block = np.asarray(vectors, dtype=np.float64)
        self._single.add(block.ndim == dimensions)
        self._blocks[name] = block[np.newaxis] if block.ndim <= dimensions else block

    def pieces(self) -> Iterator[dict[str, NDArray[np.float64]]]:
        """The blocks, some vectors at a time."""
        counts = {name: len(block) for name, block in self._blocks.items()}
        if not counts:
            raise ValueError("there is nothing to multiply with: give directions or seeds")
        if len(set(counts.values())) > 1:
            raise ValueError(f"all blocks must have the same number of vectors, these have {counts}")
        count = next(iter(counts.values()))
        # An empty block still makes one request, which the server rejects.
        for start in range(0, max(count, 1), self._step):
            yield {name: block[start : start + self._step] for name, block in self._blocks.items()}

    def joined(self, parts: Iterable[Any]) -> NDArray[np.float64]:
        """The answers to all pieces as one block; its only vector, if no block had a first axis."""
        blocks = [arrays.from_wire(part) for part in parts]
        block: NDArray[np.float64] = blocks[0] if len(blocks) == 1 else np.concatenate(blocks)
        return block[0] if self._single == {True} else block
