"""Quality of a mesh."""

from __future__ import annotations

from dataclasses import dataclass

from moldline import display
from moldline.v1 import quality_pb2


@dataclass(frozen=True)
class Distribution:
    """Percentiles over cells."""

    p50: float
    p95: float
    p99: float
    max: float
    #: Share of the cells above 5, in percent.
    above_5_percent: float


@dataclass(frozen=True)
class QualitySummary:
    """Quality measures of a set of cells."""

    #: Number of cells.
    cells: int
    #: Verdict's aspect ratio.
    aspect_ratio: Distribution
    #: Longest over shortest edge.
    edge_ratio: Distribution
    #: With respect to the owner surface's current normal; 1 at best, negative where a corner is inverted.
    min_scaled_jacobian: float
    #: Interior angles, degrees.
    min_angle: float
    max_angle: float
    #: Equiangle skew, 0 at best.
    skew_p95: float
    skew_max: float
    #: Cells whose area vector points against their owner's normal.
    folded: int
    #: Cells with a corner whose normal points against their owner's normal.
    inverted: int


@dataclass(frozen=True, repr=False)
class QualityReport:
    """Quality measures of all cells, and of the cells of each component. `str` gives a table."""

    total: QualitySummary
    components: dict[str, QualitySummary]

    def __hash__(self) -> int:
        return hash((self.total, *self.components.items()))

    def __str__(self) -> str:
        title = f"{'':<16} {'cells':>8} {'AR p95':>8} {'AR max':>8} {'>5 [%]':>8} {'edges p95':>10}"
        title += f" {'min SJ':>8} {'angles [deg]':>14} {'folded':>7}"
        rows = [*self.components.items(), ("total", self.total)]
        return "\n".join([title, *(_row(name, summary) for name, summary in rows)])

    def __repr__(self) -> str:
        t = self.total
        return f"<QualityReport of {t.cells} cells: aspect ratio p95 {t.aspect_ratio.p95:.3f}, {t.folded} folded>"

    def _repr_html_(self) -> str:
        header = (
            "component",
            "cells",
            "aspect ratio p95",
            "largest",
            "> 5, %",
            "least scaled Jacobian",
            "folded",
            "inverted",
        )
        rows = [
            (name, s.cells, s.aspect_ratio.p95, s.aspect_ratio.max, s.aspect_ratio.above_5_percent)
            + (s.min_scaled_jacobian, s.folded, s.inverted)
            for name, s in [*self.components.items(), ("total", self.total)]
        ]
        return display.table("Quality of cells", header, rows)


def _row(name: str, s: QualitySummary) -> str:
    ratios = f"{s.aspect_ratio.p95:>8.3f} {s.aspect_ratio.max:>8.3f} {s.aspect_ratio.above_5_percent:>8.3f}"
    angles = f"{s.min_angle:.1f}..{s.max_angle:.1f}"
    edges = f"{s.edge_ratio.p95:>10.3f} {s.min_scaled_jacobian:>8.3f}"
    return f"{name:<16} {s.cells:>8} {ratios} {edges} {angles:>14} {s.folded:>7}"


def report_from_wire(report: quality_pb2.QualityReport) -> QualityReport:
    """The report of a message."""
    components = {entry.component: _summary(entry.summary) for entry in report.components}
    return QualityReport(_summary(report.total), components)


def _summary(s: quality_pb2.QualitySummary) -> QualitySummary:
    return QualitySummary(
        cells=s.cells,
        aspect_ratio=_distribution(s.aspect_ratio),
        edge_ratio=_distribution(s.edge_ratio),
        min_scaled_jacobian=s.min_scaled_jacobian,
        min_angle=s.min_angle,
        max_angle=s.max_angle,
        skew_p95=s.skew_p95,
        skew_max=s.skew_max,
        folded=s.folded,
        inverted=s.inverted,
    )


def _distribution(d: quality_pb2.Distribution) -> Distribution:
    return Distribution(d.p50, d.p95, d.p99, d.max, d.above_5_percent)
