"""Tables of results for notebooks: fragments of HTML without style sheets, scripts or links."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


def table(title: str, header: Sequence[str], rows: Iterable[Sequence[Any]], most: int = 60) -> str:
    """A table; numbers are set to the right, and rows beyond `most` are counted only."""
    rows = list(rows)
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows[:most])
    if len(rows) > most:
        body += f'<tr><td colspan="{len(header)}">and {len(rows) - most} more</td></tr>'
    return f"<table><caption>{escape(title)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def number(value: float) -> str:
    """A number with six digits; infinity as its sign."""
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    return f"{value:.6g}"


def _cell(value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return f'<td style="text-align:left">{escape(str(value))}</td>'
    text = f"{value}" if isinstance(value, int) else number(value)
    return f'<td style="text-align:right">{text}</td>'
