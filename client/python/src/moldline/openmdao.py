"""OpenMDAO components with exact derivatives: from design variables to vertices, and from vertices to the flow.

    pip install moldline[openmdao]

    problem = om.Problem()
    mesh = DeformedMesh(session=setup.session())
    problem.model.add_subsystem("mesh", mesh)

    panel = PanelComponent(configuration=configuration, reference=reference, mach=0.7)
    problem.model.add_subsystem("panel", panel)
    problem.model.connect("mesh.vertices", "panel.vertices")

OpenMDAO's names have no dots: ``wing.twist`` is ``wing:twist`` there (:func:`om_name`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import openmdao.api as om
from numpy.typing import NDArray

from moldline.client import Session, Setup
from moldline.errors import FailedPrecondition
from moldline.model import Deformation, DesignPoint
from moldline.panel import COEFFICIENTS, Analysis, Configuration, Reference

#: OpenMDAO's words for units.
_UNITS = {"1": None, "percent": "percent", "m^2": "m**2", "m^3": "m**3", "ft^2": "ft**2"}


def om_name(name: str) -> str:
    """OpenMDAO's form of a name: dots become colons, and characters that OpenMDAO rejects underscores."""
    return re.sub(r"[^A-Za-z0-9_:]", "_", name.replace(".", ":"))


def add_design_variables(model: Any, setup: Setup, *, prefix: str = "") -> None:
    """Declares each group of the set-up's variables as design variables of `model`, with its bounds and unit.

    `prefix`: path of the component, such as ``mesh.``; empty if its inputs are promoted. Infinite bounds are left out.
    Entries with two finite bounds are scaled to run from 0 to 1; in groups with others none is.
    """
    for group in setup.groups.values():
        variables = setup.variables[group.entries]
        if not variables:
            continue
        lower = np.array([variable.lower for variable in variables])
        upper = np.array([variable.upper for variable in variables])
        options: dict[str, Any] = {}
        if np.isfinite(lower).any():
            options["lower"] = lower
        if np.isfinite(upper).any():
            options["upper"] = upper
        if np.isfinite(lower).all() and np.isfinite(upper).all() and (upper > lower).all():
            options |= {"ref0": lower, "ref": upper}
        model.add_design_var(prefix + om_name(group.name), units=_units(variables[0].unit), **options)


@contextmanager
def _evaluation(component: Any) -> Iterator[None]:
    """Refuses the complex step; the failure of a method on a valid input becomes an `AnalysisError`."""
    if component.under_complex_step:
        raise RuntimeError(
            f"{component.msginfo}: the complex step does not go through the server;"
            " use the component's exact derivatives, or method='fd'"
        )
    try:
        yield
    except FailedPrecondition as error:
        raise om.AnalysisError(f"{component.msginfo}: {error}") from error


class _Mesh(om.ExplicitComponent):  # type: ignore[misc]  # OpenMDAO has no types.
    """Inputs, outputs and options of both mesh components."""

    def initialize(self) -> None:
        self.options.declare("session", types=Session, recordable=False, desc="an open session")
        self.options.declare("control_points", default=(), desc="components whose control points are inputs")
        self.options.declare("functions", default=None, desc="names of the scalar outputs; all if None")

    def setup(self) -> None:
        session: Session = self.options["session"]
        setup = session.setup
        baseline = setup.baseline
        #: Input to the entries of a design.
        self._entries: dict[str, slice] = {}
        for group in setup.groups.values():
            unit = setup.variables[group.entries.start].unit if group.entries.stop > group.entries.start else "1"
            name = om_name(group.name)
            self._entries[name] = group.entries
            value = baseline[group.entries].reshape(group.shape or (1,))
            self.add_input(name, val=value, units=_units(unit), desc=group.name)
        #: Input to component.
        self._components: dict[str, str] = {}
        for component in self.options["control_points"]:
            if component not in setup.components:
                raise ValueError(f"there is no component {component!r}; there are: {', '.join(setup.components)}")
            name = f"{om_name(component)}:control_points"
            self._components[name] = component
            self.add_input(name, val=setup.control_points[component], units="m", desc=f"control points of {component}")
        self.add_output("vertices", val=setup.mesh.vertices, units="m", desc="vertices of the deformed mesh")
        known = {function.name: function for function in setup.functions}
        wanted = self.options["functions"]
        #: Output to function.
        self._functions: dict[str, str] = {}
        for function in known if wanted is None else wanted:
            if function not in known:
                raise ValueError(f"there is no function {function!r}; there are: {', '.join(known)}")
            name = om_name(function)
            self._functions[name] = function
            self.add_output(name, val=known[function].value, units=_units(known[function].unit), desc=function)
        self._last: Deformation | None = None

    def compute(self, inputs: Any, outputs: Any) -> None:
        session: Session = self.options["session"]
        with _evaluation(self):
            point = self._point(inputs)
            result = session.deform(point.design, control_points=point.control_points)
        outputs["vertices"] = result.vertices
        for name, function in self._functions.items():
            outputs[name] = result.functions[function]
        self._last = result

    def _point(self, inputs: Any) -> DesignPoint:
        session: Session = self.options["session"]
        design = np.empty(len(session.setup.variables))
        for name, entries in self._entries.items():
            design[entries] = inputs[name].ravel()
        points = {component: np.array(inputs[name]) for name, component in self._components.items()}
        return DesignPoint(design, points or None)

    def _at(self, inputs: Any) -> Deformation | DesignPoint:
        """The last deformation if it is that of `inputs`, which saves the server another one."""
        point = self._point(inputs)
        if self._last is not None and _same(self._last.linearisation.point, point):
            return self._last
        return point


class DeformedMesh(_Mesh):
    """The deformed mesh of a session, matrix-free: derivatives are products.

    The cost of an adjoint does not depend on the number of variables.

    Inputs: each declared group of design variables, by its name with colons, in its shape and unit; and, for components
    named in the option `control_points`, their control points as ``NAME:control_points``, (count, 3), metres, which replace
    those of the design.

    Outputs: `vertices`, (n, 3), metres; and the scalar outputs, each in its unit, by name with colons.

    Options:
    `session`: an open :class:`moldline.Session`, which the component does not close.
    `control_points`: names of components whose control points are inputs.
    `functions`: names of the scalar outputs; all if `None`.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        # Two evaluations for each input; those of the user replace them.
        self.set_check_partial_options(wrt="*", directional=True, method="fd", form="central", step=1e-5)

    def compute_jacvec_product(self, inputs: Any, d_inputs: Any, d_outputs: Any, mode: str) -> None:
        if mode == "fwd":
            self._forward(inputs, d_inputs, d_outputs)
        else:
            self._reverse(inputs, d_inputs, d_outputs)

    def _forward(self, inputs: Any, d_inputs: Any, d_outputs: Any) -> None:
        session: Session = self.options["session"]
        direction = np.zeros(len(session.setup.variables))
        for name, entries in self._entries.items():
            if name in d_inputs:
                direction[entries] = d_inputs[name].ravel()
        points = {component: d_inputs[name] for name, component in self._components.items() if name in d_inputs}
        tangent = session.jvp(direction, control_points=points, at=self._at(inputs))
        if "vertices" in d_outputs:
            d_outputs["vertices"] += tangent.vertices
        for name, function in self._functions.items():
            if name in d_outputs:
                d_outputs[name] += tangent.functions[function]

    def _reverse(self, inputs: Any, d_inputs: Any, d_outputs: Any) -> None:
        session: Session = self.options["session"]
        vertices = d_outputs["vertices"] if "vertices" in d_outputs else None  # noqa: SIM401  # no dict
        weights = {function: d_outputs[name].item() for name, function in self._functions.items() if name in d_outputs}
        components = {name: component for name, component in self._components.items() if name in d_inputs}
        by_design = any(name in d_inputs for name in self._entries)
        if (vertices is None and not weights) or not (by_design or components):
            return
        gradient = session.vjp(
            vertices=vertices,
            functions=weights or None,
            at=self._at(inputs),
            design=by_design,
            control_points=components.values(),
        )
        if gradient.design is not None:
            for name, entries in self._entries.items():
                if name in d_inputs:
                    d_inputs[name] += gradient.design[entries].reshape(d_inputs[name].shape)
        for name, component in components.items():
            d_inputs[name] += gradient.control_points[component]


class DenseDeformedMesh(_Mesh):
    """As :class:`DeformedMesh`, with dense partial derivatives.

    Suited to few variables and many products. Partials with respect to control points have three columns for each.
    """

    def setup_partials(self) -> None:
        self.declare_partials("*", "*")

    def compute_partials(self, inputs: Any, partials: Any) -> None:
        session: Session = self.options["session"]
        at = self._at(inputs)
        jacobian = session.jacobian(at=at)
        for name, entries in self._entries.items():
            columns = jacobian.vertices[entries]
            partials["vertices", name] = columns.reshape(len(columns), -1).T
            for output, function in self._functions.items():
                partials[output, name] = jacobian.functions[function][np.newaxis, entries]
        for name, component in self._components.items():
            count = session.setup.control_point_counts[component]
            directions = np.eye(3 * count).reshape(-1, count, 3)
            tangents = session.jvp(control_points={component: directions}, at=at)
            partials["vertices", name] = tangents.vertices.reshape(3 * count, -1).T
            for output, function in self._functions.items():
                partials[output, name] = tangents.functions[function][np.newaxis]


class PanelComponent(om.ExplicitComponent):  # type: ignore[misc]
    """The flow over a mesh by the panel method, matrix-free: derivatives are products.

    Inputs: `vertices`, (n, 3), metres; `alpha`, rad; `mach`.

    Outputs: those of the option `coefficients`, such as `lift` (:data:`moldline.panel.COEFFICIENTS`); `section_loads`, m,
    and `cp` of every cell, optionally.

    Options:
    `configuration`: a :class:`moldline.panel.Configuration`.
    `reference`: a :class:`moldline.panel.Reference`, which stays constant.
    `vertices`, `alpha`, `mach`: initial values; `vertices` are required.
    `coefficients`: names of the scalar outputs.
    `section_loads`, `cp`: whether they are outputs.
    """

    def initialize(self) -> None:
        self.options.declare("configuration", types=Configuration, recordable=False, desc="a prepared mesh")
        self.options.declare("reference", types=Reference, recordable=False, desc="reference values")
        self.options.declare("vertices", recordable=False, desc="initial positions")
        self.options.declare("alpha", default=0.0, desc="rad")
        self.options.declare("mach", default=0.0)
        self.options.declare("coefficients", default=COEFFICIENTS, desc="names of the scalar outputs")
        self.options.declare("section_loads", default=False, types=bool)
        self.options.declare("cp", default=False, types=bool)

    def setup(self) -> None:
        configuration: Configuration = self.options["configuration"]
        self.add_input("vertices", val=self.options["vertices"], shape=(configuration.vertex_count, 3), units="m")
        self.add_input("alpha", val=self.options["alpha"], units="rad")
        self.add_input("mach", val=self.options["mach"])
        for name in self.options["coefficients"]:
            if name not in COEFFICIENTS:
                raise ValueError(f"there is no coefficient {name!r}; there are: {', '.join(COEFFICIENTS)}")
            units = "m" if name == "neutral_point" else "1/rad" if name.endswith("slope") else None
            self.add_output(name, units=units)
        if self.options["section_loads"]:
            self.add_output("section_loads", shape=len(configuration.trailing_edges), units="m")
        if self.options["cp"]:
            self.add_output("cp", shape=configuration.cell_count)
        #: The last analysis.
        self.analysis: Analysis | None = None

    def compute(self, inputs: Any, outputs: Any) -> None:
        with _evaluation(self):
            self.analysis = analysis = self._analyze(inputs)
        for name in self.options["coefficients"]:
            outputs[name] = getattr(analysis.coefficients, name)
        if self.options["section_loads"]:
            outputs["section_loads"] = analysis.sections.loads
        if self.options["cp"]:
            outputs["cp"] = analysis.cp

    def _analyze(self, inputs: Any) -> Analysis:
        configuration: Configuration = self.options["configuration"]
        return configuration.analyze(
            inputs["vertices"],
            reference=self.options["reference"],
            mach=inputs["mach"].item(),
            alpha=inputs["alpha"].item(),
        )

    def _at(self, inputs: Any) -> Analysis:
        """The last analysis if it is that of `inputs`, or a new one."""
        if self.analysis is not None:
            point = self.analysis.point
            scalars = (point.mach, point.alpha) == (inputs["mach"].item(), inputs["alpha"].item())
            if scalars and np.array_equal(_array(point.vertices), inputs["vertices"]):
                return self.analysis
        return self._analyze(inputs)

    def compute_jacvec_product(self, inputs: Any, d_inputs: Any, d_outputs: Any, mode: str) -> None:
        configuration: Configuration = self.options["configuration"]
        named = [name for name in self.options["coefficients"] if name in d_outputs]
        blocks = [name for name in ("section_loads", "cp") if name in d_outputs]
        scalars = [name for name in ("alpha", "mach") if name in d_inputs]
        vertices = "vertices" in d_inputs
        if not (named or blocks) or not (vertices or scalars):
            return
        if mode == "fwd":
            directions: dict[str, Any] = {name: d_inputs[name].item() for name in scalars}
            tangent = configuration.jvp(d_inputs["vertices"] if vertices else None, **directions, at=self._at(inputs))
            for name in named:
                d_outputs[name] += tangent.coefficients[name]
            for name in blocks:
                d_outputs[name] += getattr(tangent, name)
            return
        weights = {name: d_outputs[name].item() for name in named}
        seeds = {name: d_outputs[name] for name in blocks}
        gradient = configuration.vjp(weights or None, **seeds, at=self._at(inputs))
        if vertices:
            d_inputs["vertices"] += gradient.vertices
        for name in scalars:
            d_inputs[name] += getattr(gradient, name)


def _same(one: DesignPoint, other: DesignPoint) -> bool:
    points, others = one.control_points or {}, other.control_points or {}
    return np.array_equal(_array(one.design), _array(other.design)) and all(
        np.array_equal(_array(points[component]), _array(others[component])) for component in others
    )


def _array(values: Any) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)


def _units(unit: str) -> str | None:
    return _UNITS.get(unit, unit)
