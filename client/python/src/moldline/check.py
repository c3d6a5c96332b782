"""Reports of derivative checks."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moldline import arrays
from moldline.v1 import mesh_service_pb2 as wire


@dataclass(frozen=True)
class DotProduct:
    """`W^T (J V)` against `(J^T W)^T V`."""

    #: Vectors in the block.
    block: int
    #: Frobenius norm of the difference over that of the product.
    error: float


@dataclass(frozen=True)
class Difference:
    """A derivative against central differences of one step."""

    #: Step, relative to the range of the variable.
    step: float
    #: Relative error; `None` if one of the two designs has no mesh.
    error: float | None


@dataclass(frozen=True)
class Kink:
    """Vertices on a crease that they cross: they have two one-sided derivatives instead of one derivative."""

    #: How many vertices.
    vertices: int
    #: The vertex whose one-sided derivatives differ most.
    worst_vertex: int
    #: Their difference, metres per unit of the variable.
    jump: float
    #: Position of that vertex, metres, and its component.
    position: tuple[float, ...]
    component: str
    #: Relative error of the derivative: at these vertices against the nearer one-sided derivative, at all others against
    #: central differences.
    error: float


@dataclass(frozen=True)
class CheckedDesign:
    """The errors at one design."""

    #: Every variable by name, in its unit.
    design: dict[str, float]
    #: For blocks of one vector and of as many as there are variables.
    dot_products: tuple[DotProduct, ...]
    dot_product_max: float
    dual_max: float
    central_difference_max: float
    #: Largest distance between a vertex and that of the evaluation in dual numbers, relative to the reference length.
    values_max: float


@dataclass(frozen=True)
class CheckedVariable:
    """The errors of the derivative with respect to one variable at one design."""

    #: Index into :attr:`Check.designs`.
    design: int
    variable: str
    #: `|J v|` over all vertices, metres per unit of the variable.
    size: float
    #: Error against dual numbers.
    dual: float
    #: The vertex that contributes most to it.
    worst_vertex: int
    #: The same error after each stage of the chain, by its name, in order.
    stages: dict[str, float]
    #: The first stage whose error is too large; `None` if there is none.
    first_discrepancy: str | None
    #: Errors against central differences, over steps.
    differences: tuple[Difference, ...]
    #: Largest error of the scalar outputs against central differences at the best step.
    functions: float
    #: Searched for where central differences do not agree at any step; `None` if there is none.
    kink: Kink | None

    @property
    def best(self) -> Difference | None:
        """The central difference with the smallest error, if any has one."""
        known = [each for each in self.differences if each.error is not None and not math.isnan(each.error)]
        return min(known, key=lambda each: each.error or 0.0, default=None)

    @property
    def central_difference(self) -> float | None:
        """Its error."""
        return self.best.error if self.best else None


@dataclass(frozen=True)
class Check:
    """Errors of the derivatives of a set-up, all of them relative."""

    #: The largest errors over all designs and variables.
    dot_product_max: float
    dual_max: float
    central_difference_max: float
    #: Seed of the random designs and vectors.
    seed: int
    designs: tuple[CheckedDesign, ...]
    #: One row for each requested variable, design after design.
    rows: tuple[CheckedVariable, ...]
    #: Definition of the errors, in words.
    definition: str
    #: Seconds in the engine.
    engine_seconds: float
    #: Seconds in the queue.
    queue_seconds: float
    _text: str

    def table(self) -> str:
        """All errors as a table, as `moldline check` prints them."""
        return self._text

    def to_json(self) -> dict[str, Any]:
        """All errors as `moldline check --json` writes them; `None` for values that are not finite."""
        designs = [
            {
                "design": {name: _number(value) for name, value in design.design.items()},
                "dot_products": [{"block": dot.block, "error": _number(dot.error)} for dot in design.dot_products],
                "dot_product_max": _number(design.dot_product_max),
                "dual_max": _number(design.dual_max),
                "central_difference_max": _number(design.central_difference_max),
                "values_max": _number(design.values_max),
            }
            for design in self.designs
        ]
        rows = [
            {
                "design": row.design,
                "variable": row.variable,
                "size": _number(row.size),
                "dual": _number(row.dual),
                "worst_vertex": row.worst_vertex,
                "stages": {step: _number(error) for step, error in row.stages.items()},
                "first_discrepancy": row.first_discrepancy,
                "central_difference": _number(row.central_difference),
                "best_step": row.best.step if row.best else None,
                "functions": _number(row.functions),
                "differences": [{"step": each.step, "error": _number(each.error)} for each in row.differences],
                "kink": asdict(row.kink) | {"position": list(row.kink.position)} if row.kink else None,
            }
            for row in self.rows
        ]
        return {
            "definition": self.definition,
            "seed": self.seed,
            "dot_product_max": _number(self.dot_product_max),
            "dual_max": _number(self.dual_max),
            "central_difference_max": _number(self.central_difference_max),
            "designs": designs,
            "rows": rows,
        }

    def __repr__(self) -> str:
        maxima = f"dot products {self.dot_product_max:.1e}, dual numbers {self.dual_max:.1e}"
        return f"<Check: {maxima}, central differences {self.central_difference_max:.1e}>"


def check_from_wire(report: wire.CheckReport, variables: tuple[str, ...]) -> Check:
    """The report of a message, for a set-up with these variables."""
    return Check(
        dot_product_max=report.dot_product_max,
        dual_max=report.dual_max,
        central_difference_max=report.central_difference_max,
        seed=report.seed,
        designs=tuple(_design(design, variables) for design in report.designs),
        rows=tuple(_row(row) for row in report.rows),
        definition=report.definition,
        engine_seconds=report.timings.engine_seconds,
        queue_seconds=report.timings.queue_seconds,
        _text=report.text,
    )


def _design(checked: wire.CheckedDesign, variables: tuple[str, ...]) -> CheckedDesign:
    values: NDArray[np.float64] = arrays.from_wire(checked.design)
    return CheckedDesign(
        design=dict(zip(variables, values.tolist(), strict=True)),
        dot_products=tuple(DotProduct(dot.block, dot.error) for dot in checked.dot_products),
        dot_product_max=checked.dot_product_max,
        dual_max=checked.dual_max,
        central_difference_max=checked.central_difference_max,
        values_max=checked.values_max,
    )


def _row(row: wire.CheckedVariable) -> CheckedVariable:
    return CheckedVariable(
        design=row.design,
        variable=row.variable,
        size=row.size,
        dual=row.dual,
        worst_vertex=row.worst_vertex,
        stages={each.step: each.error for each in row.steps},
        first_discrepancy=row.first_discrepancy if row.HasField("first_discrepancy") else None,
        differences=tuple(
            Difference(each.step, each.error if each.HasField("error") else None) for each in row.differences
        ),
        functions=row.functions,
        kink=_kink(row.kink) if row.HasField("kink") else None,
    )


def _kink(kink: wire.Kink) -> Kink:
    return Kink(kink.vertices, kink.worst_vertex, kink.jump, tuple(kink.position), kink.component, kink.error)


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
