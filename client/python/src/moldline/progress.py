"""Progress of long calls."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm.auto import tqdm

from moldline.model import Progress

#: Callback for the progress of a long call.
Tell = Callable[[Progress], None]


@contextmanager
def told(progress: bool | Tell) -> Iterator[Tell]:
    """The callback for `progress`: a function as it is, a progress bar if `True`, or one without effect."""
    if callable(progress):
        yield progress
        return
    layout = "{desc:<50} {percentage:3.0f}%|{bar:30}| {elapsed}"
    with tqdm(total=1.0, disable=not (progress and _watched()), bar_format=layout, leave=False) as bar:

        def show(step: Progress) -> None:
            bar.set_description_str(step.message, refresh=False)
            bar.n = step.fraction
            bar.refresh()

        yield show


def _watched() -> bool:
    """Whether a bar would be seen: on a terminal or in a notebook, not in a file or a pipe."""
    return sys.stderr.isatty() or "ipykernel" in sys.modules
