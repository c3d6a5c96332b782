"""The services as functions of arrays with both products of their Jacobians, as libraries of automatic differentiation want
them. :mod:`moldline.jax` and :mod:`moldline.torch` build on these."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from moldline.client import Session, Setup
from moldline.panel import COEFFICIENTS, AnalysisPoint, Configuration, Reference

Array = NDArray[np.float64]
Shape = tuple[int, ...]


class Differentiable(Protocol):
    """A function of float64 arrays whose Jacobian is multiplied with blocks of k vectors at once."""

    #: Shapes of its arguments and results.
    inputs: tuple[Shape, ...]
    outputs: tuple[Shape, ...]

    def eval(self, inputs: Sequence[Array]) -> list[Array]:
        """The results."""
        ...

    def jvp(self, inputs: Sequence[Array], directions: Sequence[Array]) -> list[Array]:
        """`J v` at `inputs`: changes of each result, (k, ...), along `directions`, (k, ...), of each argument."""
        ...

    def vjp(self, inputs: Sequence[Array], weights: Sequence[Array]) -> list[Array]:
        """`J^T w` at `inputs`: gradients by each argument, (k, ...), of sums with `weights`, (k, ...), of each result."""
        ...


class Deform:
    """From a design, (number of variables,), to vertices, (n, 3), metres, and functions, (number of functions,)."""

    def __init__(self, session: Session | Setup) -> None:
        self._session = session
        self._setup = session if isinstance(session, Setup) else session.setup
        #: Names of the functions, in their order.
        self.functions = tuple(function.name for function in self._setup.functions)
        self.inputs: tuple[Shape, ...] = ((len(self._setup.variables),),)
        self.outputs: tuple[Shape, ...] = ((self._setup.vertex_count, 3), (len(self.functions),))

    def eval(self, inputs: Sequence[Array]) -> list[Array]:
        """As :meth:`Differentiable.eval`."""
        result = self._session.deform(inputs[0])
        return [result.vertices, np.array([result.functions[name] for name in self.functions], dtype=np.float64)]

    def jvp(self, inputs: Sequence[Array], directions: Sequence[Array]) -> list[Array]:
        """As :meth:`Differentiable.jvp`."""
        tangents = self._session.jvp(directions[0], at=inputs[0])
        functions = [tangents.functions[name] for name in self.functions]
        return [tangents.vertices, np.stack(functions, axis=-1) if functions else np.empty((len(directions[0]), 0))]

    def vjp(self, inputs: Sequence[Array], weights: Sequence[Array]) -> list[Array]:
        """As :meth:`Differentiable.vjp`."""
        vertices, functions = weights
        gradients = self._session.vjp(vertices=vertices, functions=functions if self.functions else None, at=inputs[0])
        assert gradients.design is not None  # It was asked for.
        return [gradients.design]


class Analyze:
    """From vertices, (n, 3), metres, angle of attack and sideslip, rad, and Mach number to the coefficients, (9,) in the
    order of :data:`moldline.panel.COEFFICIENTS`, section loads, (sections,), metres, and pressure coefficients, (m,)."""

    def __init__(self, configuration: Configuration, reference: Reference) -> None:
        self._configuration = configuration
        self._reference = reference
        self.inputs: tuple[Shape, ...] = ((configuration.vertex_count, 3), (), (), ())
        sections = len(configuration.trailing_edges)
        self.outputs: tuple[Shape, ...] = ((len(COEFFICIENTS),), (sections,), (configuration.cell_count,))

    def eval(self, inputs: Sequence[Array]) -> list[Array]:
        """As :meth:`Differentiable.eval`."""
        point = self._point(inputs)
        analysis = self._configuration.analyze(
            point.vertices, reference=self._reference, mach=point.mach, alpha=point.alpha, sideslip=point.sideslip
        )
        coefficients = np.array([getattr(analysis.coefficients, name) for name in COEFFICIENTS])
        return [coefficients, analysis.sections.loads, analysis.cp]

    def jvp(self, inputs: Sequence[Array], directions: Sequence[Array]) -> list[Array]:
        """As :meth:`Differentiable.jvp`."""
        vertices, alpha, sideslip, mach = directions
        tangents = self._configuration.jvp(vertices, alpha=alpha, sideslip=sideslip, mach=mach, at=self._point(inputs))
        coefficients = np.stack([tangents.coefficients[name] for name in COEFFICIENTS], axis=-1)
        return [coefficients, tangents.section_loads, tangents.cp]

    def vjp(self, inputs: Sequence[Array], weights: Sequence[Array]) -> list[Array]:
        """As :meth:`Differentiable.vjp`."""
        coefficients, section_loads, cp = weights
        # Sections there are none of have no weights.
        loads = section_loads if section_loads.shape[-1] else None
        gradients = self._configuration.vjp(coefficients, section_loads=loads, cp=cp, at=self._point(inputs))
        return [gradients.vertices, gradients.alpha, gradients.sideslip, gradients.mach]

    def _point(self, inputs: Sequence[Array]) -> AnalysisPoint:
        vertices, alpha, sideslip, mach = inputs
        return AnalysisPoint(vertices, float(mach), float(alpha), float(sideslip), self._reference)
