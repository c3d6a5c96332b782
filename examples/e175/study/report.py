"""The study's results as text, and as one HTML page with its pictures in it."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import aircraft
import figures
from figures import TITLES, Shape
from formulation import POUNDS_PER_SQUARE_FOOT
from raymer import FOOT

__all__ = ["FOOT", "POUNDS_PER_SQUARE_FOOT", "Shape", "text", "write"]

#: Table 3 of the paper: gross and fuel weight, N; A_W; S_W, ft^2; A_T; S_T, ft^2; travel, ft; loading, lbf/ft^2; C_VT;
#: static margin, %.
TABLE_3 = {
    "baseline": (288_800, 70_400, 8.3, 740, 4.3, 250, 0.0, 90, 1.16, -0.3),
    "without": (293_000, 57_600, 10.5, 658, 3.7, 188, -1.0, 100, 1.18, -23.0),
    "with": (294_500, 58_850, 10.5, 661, 4.0, 188, 3.7, 100, 1.20, 5.0),
}
COLUMNS = (
    "W_0, N",
    "W_f, N",
    "A_W",
    "S_W, ft^2",
    "A_T",
    "S_T, ft^2",
    "travel, ft",
    "W_0/S_W, lbf/ft^2",
    "C_VT",
    "margin, %",
)
#: From Table 3, beside what it leaves out.
DERIVED = {"baseline": (0.2438, 11.55, 0.326), "without": (0.1966, 14.75, 0.372), "with": (0.1998, 14.48, 0.372)}


def _designs(result: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """First iterate, and the last of each problem."""
    problems = result["problems"]
    first = next(iter(problems.values()))["iterates"][0]
    return {"baseline": first} | {name: problem["iterates"][-1] for name, problem in problems.items()}


def _row(iterate: Mapping[str, Any]) -> tuple[float, ...]:
    r = iterate["results"]
    return (
        r["gross_weight"],
        r["fuel_weight"],
        r["wing_aspect_ratio"],
        r["wing_area"] / FOOT**2,
        r["tail_aspect_ratio"],
        r["tail_area"] / FOOT**2,
        iterate["design"]["wing.translation"],
        r["wing_loading"] / POUNDS_PER_SQUARE_FOOT,
        r["tail_volume"],
        100 * r["static_margin"],
    )


def table_3(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Rows of text: ours and the paper's in turn."""
    rows: list[tuple[str, ...]] = [("", *COLUMNS, "W_f/W_0", "L/D", "C_L")]
    for name, iterate in _designs(result).items():
        r = iterate["results"]
        ours = (*_row(iterate), r["fuel_fraction"], r["lift_to_drag"], r["lift_coefficient"])
        for title, values in ((TITLES[name], ours), ("  paper", (*TABLE_3[name], *DERIVED[name]))):
            weights = [f"{value:,.0f}" for value in values[:2]]
            rest = [
                f"{value:.{digits}f}"
                for value, digits in zip(values[2:], (2, 0, 2, 0, 1, 1, 2, 1, 4, 2, 3), strict=True)
            ]
            rows.append((title, *weights, *rest))
    return rows


def text(result: Mapping[str, Any]) -> str:
    """The results as text for a terminal."""
    rows = table_3(result)
    widths = [max(len(row[k]) for row in rows) + 2 for k in range(len(rows[0]))]
    lines = [
        "".join(cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths)))
        for row in rows
    ]
    missed = [goal for goal in result["goals"] if not goal["reached"]]
    lines.append(f"\n{len(result['goals']) - len(missed)} of {len(result['goals'])} goals reached")
    lines += [
        f"  missed: {g['name']} = {g['value']:.4g} {g['unit']}, goal {g['least']:g} to {g['most']:g}" for g in missed
    ]
    return "\n".join(lines)


def write(out: Path, result: Mapping[str, Any], shapes: Mapping[str, Shape]) -> None:
    """`report.html`, and its pictures as files too."""
    pictures = [("Fig. 8: convergence", "convergence.png")]
    figures.convergence(
        out / "convergence.png", {name: problem["iterates"] for name, problem in result["problems"].items()}
    )
    if shapes:
        for title, draw in (
            ("Fig. 9: planforms", figures.planforms),
            ("Fig. 10: sections", figures.sections),
            ("Fig. 11: pressure", figures.pressures),
        ):
            name = title.split(": ")[1] + ".png"
            draw(out / name, shapes)
            pictures.append((title, name))
    parts = [
        "<!doctype html><meta charset=utf-8><title>Fuel-burn study of the E175</title><style>"
        "body{font:14px/1.45 system-ui,sans-serif;max-width:1180px;margin:2em auto;padding:0 1em;color:#1c222c}"
        "table{border-collapse:collapse;margin:1em 0}td,th{padding:2px 9px;text-align:right;border-bottom:1px solid #dde2e8}"
        "td:first-child,th:first-child{text-align:left}tr.paper td{color:#68707c}.no{color:#b3261e}img{max-width:100%}"
        "td.text{text-align:left;max-width:620px}</style><h1>Fuel-burn study of the E175</h1>",
        f"<p>Both problems of Sec. V, {result['cells']:,} cells, {result['cores']} cores, {result['seconds']:.0f} s.</p>",
        "<h2>Beside Table 3</h2>",
        _html_table(table_3(result), classes={row: "paper" for row in range(2, 99, 2)}),
        "<h2>Goals</h2>",
        _html_table(
            [("", "value", "goal", "unit", "")]
            + [
                (
                    g["name"],
                    f"{g['value']:.4g}",
                    f"{g['least']:g} to {g['most']:g}",
                    g["unit"],
                    "yes" if g["reached"] else "no",
                )
                for g in result["goals"]
            ],
            classes={row: "no" for row, g in enumerate(result["goals"], 1) if not g["reached"]},
        ),
    ]
    for title, name in pictures:
        data = base64.b64encode((out / name).read_bytes()).decode()
        parts.append(f'<h2>{title}</h2><img alt="{title}" src="data:image/png;base64,{data}">')
    parts += ["<h2>Choices of the model</h2>", _choices(result)]
    if result["variants"]:
        parts += ["<h2>Optima with other choices, coarse mesh</h2>", _html_table(_variants(result["variants"]))]
    (out / "report.html").write_text("\n".join(parts) + "\n")


def _choices(result: Mapping[str, Any]) -> str:
    """Numbers that the paper does not give, with the sensitivity of the fuel to them."""
    by = {name: {row["name"]: row for row in problem["sensitivities"]} for name, problem in result["problems"].items()}
    last = next(reversed(by.values()))
    order = sorted(aircraft.CHOICES, key=lambda name: -abs(last[name]["optimum"]))
    rows = [("number", "value", "unit", "reason", "baseline", *(TITLES[name] for name in by))]
    for name in order:
        choice = aircraft.CHOICES[name]
        changes = [next(iter(by.values()))[name]["baseline"], *(of[name]["optimum"] for of in by.values())]
        rows.append(
            (name.replace("_", " "), f"{choice.value:.4g}", choice.unit, choice.why, *(f"{c:+.3f}" for c in changes))
        )
    note = (
        "<p>The last columns: relative change of the fuel for a relative change of the number (for a change by one where "
        "it is zero), of the baseline kept in trim and of the optima.</p>"
    )
    return note + _html_table(rows, text_columns={3})


def _variants(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Baselines and optima with other numbers of the model."""
    heads = (
        "",
        "problem",
        "W_0, N",
        "W_f baseline, N",
        "W_f, N",
        "saved, %",
        "L/D",
        "S_W, ft^2",
        "A_W",
        "travel, ft",
        "margin, %",
        "converged",
    )
    table = [heads]
    for row in rows:
        start, end = row["baseline"], row["optimum"]
        table.append((
            row["variant"], TITLES[row["problem"]], f"{end['gross_weight']:,.0f}",
            f"{start['fuel_weight']:,.0f}", f"{end['fuel_weight']:,.0f}",
            f"{100 * (1 - end['fuel_weight'] / start['fuel_weight']):.1f}", f"{end['lift_to_drag']:.2f}",
            f"{end['wing_area'] / FOOT**2:.0f}", f"{end['wing_aspect_ratio']:.2f}", f"{row['travel_ft']:+.1f}",
            f"{100 * end['static_margin']:.1f}", "yes" if row["converged"] else "no",
        ))  # fmt: skip
    return table


def _html_table(
    rows: Sequence[Sequence[str]], classes: Mapping[int, str] | None = None, text_columns: set[int] | None = None
) -> str:
    lines = ["<table>"]
    for k, row in enumerate(rows):
        tag = "th" if k == 0 else "td"
        cells = "".join(
            f"<{tag}{' class=text' if column in (text_columns or ()) else ''}>{html.escape(cell)}</{tag}>"
            for column, cell in enumerate(row)
        )
        lines.append(f"<tr class='{(classes or {}).get(k, '')}'>{cells}</tr>")
    return "\n".join([*lines, "</table>"])
