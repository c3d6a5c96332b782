"""The services as functions of JAX, with exact derivatives of the first order.

    pip install moldline[jax]

    jax.config.update("jax_enable_x64", True)
    deform = moldline.jax.deform(session)
    analyze = moldline.jax.analyze(configuration, reference)

    def drag(design):
        return analyze(deform(design).vertices, alpha=0.03, mach=0.7).coefficients["induced_drag"]

    value, gradient = jax.jit(jax.value_and_grad(drag))(setup.baseline)

`jit` calls the service by `pure_callback`. `vmap` over directions or weights (so `jacfwd` and `jacrev`) is one call with a
block of them; `vmap` over designs is one call after another. An exception of a call is itself outside of `jit`, within it a
text in JAX's own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from moldline.client import Session, Setup
from moldline.differentiable import Analyze, Deform, Differentiable, Shape
from moldline.panel import COEFFICIENTS, Configuration, Reference


class Deformed(NamedTuple):
    """A deformed mesh."""

    #: float64, (n, 3), metres.
    vertices: jax.Array
    #: By name, each in its unit.
    functions: dict[str, jax.Array]


class Flow(NamedTuple):
    """The flow in one wind."""

    #: By name (:data:`moldline.panel.COEFFICIENTS`).
    coefficients: dict[str, jax.Array]
    #: (sections,): section lift coefficient times chord, metres.
    section_loads: jax.Array
    #: (m,): pressure coefficient of every cell.
    cp: jax.Array


def deform(session: Session | Setup) -> Callable[[Any], Deformed]:
    """The function from a design, float64, (number of variables,), to the deformed mesh.

    `session`: an open session, or a set-up, whose client then has its own. Raises `RuntimeError` without 64 bits.
    """
    _need_64_bits()
    model = Deform(session)

    def deformed(design: Any) -> Deformed:
        vertices, functions = _call(model, ("design",), (design,))
        return Deformed(vertices, {name: functions[index] for index, name in enumerate(model.functions)})

    return deformed


def analyze(configuration: Configuration, reference: Reference) -> Callable[..., Flow]:
    """The function of vertices, float64, (n, 3), metres, `alpha` and `sideslip`, rad, and `mach` to the flow.

    `reference`: constant reference values. Raises `RuntimeError` without 64 bits.
    """
    _need_64_bits()
    model = Analyze(configuration, reference)

    def analyzed(vertices: Any, *, alpha: Any = 0.0, sideslip: Any = 0.0, mach: Any = 0.0) -> Flow:
        names = ("vertices", "alpha", "sideslip", "mach")
        coefficients, section_loads, cp = _call(model, names, (vertices, alpha, sideslip, mach))
        return Flow({name: coefficients[index] for index, name in enumerate(COEFFICIENTS)}, section_loads, cp)

    return analyzed


def _need_64_bits() -> None:
    if not jax.config.read("jax_enable_x64"):
        raise RuntimeError(
            "JAX computes in 32 bits, which loses the derivatives' digits: "
            'call jax.config.update("jax_enable_x64", True) first'
        )


def _call(model: Differentiable, names: Sequence[str], arguments: Sequence[Any]) -> list[Any]:
    arrays = [jnp.asarray(argument, dtype=jnp.float64) for argument in arguments]
    for name, array, shape in zip(names, arrays, model.inputs, strict=True):
        if array.shape != shape:
            raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
    results: list[Any] = _EVAL.bind(*arrays, model=model)
    return results


# Three primitives: the function; `J v` and `J^T w` on blocks of vectors. The arguments of the latter two are those of the
# function, followed by the blocks. Each of the two is the other's transpose.
_EVAL, _JVP, _VJP = (Primitive(f"moldline_{name}") for name in ("eval", "jvp", "vjp"))


def _on_host(primitive: Primitive, model: Differentiable, arguments: Sequence[Any]) -> list[np.ndarray[Any, Any]]:
    """Calls the service."""
    arrays = [np.asarray(argument) for argument in arguments]
    count = len(model.inputs)
    if primitive is _EVAL:
        return model.eval(arrays)
    product = model.jvp if primitive is _JVP else model.vjp
    return product(arrays[:count], arrays[count:])


def _shapes(primitive: Primitive, model: Differentiable, arguments: Sequence[Any]) -> list[Shape]:
    """Shapes of the results."""
    if primitive is _EVAL:
        return list(model.outputs)
    vectors = arguments[-1].shape[0]
    return [(vectors, *shape) for shape in (model.outputs if primitive is _JVP else model.inputs)]


def _batched(primitive: Primitive, arguments: Sequence[Any], axes: Sequence[Any], model: Differentiable) -> Any:
    """Blocks of blocks are one block; other batches are taken one after another."""
    count = len(model.inputs)
    extent = next(a.shape[axis] for a, axis in zip(arguments, axes, strict=True) if axis is not None)
    if primitive is not _EVAL and all(axis is None for axis in axes[:count]):
        blocks = [
            jnp.broadcast_to(block, (extent, *block.shape)) if axis is None else jnp.moveaxis(block, axis, 0)
            for block, axis in zip(arguments[count:], axes[count:], strict=True)
        ]
        vectors = blocks[0].shape[1]
        joined = [block.reshape(extent * vectors, *block.shape[2:]) for block in blocks]
        results = primitive.bind(*arguments[:count], *joined, model=model)
        results = [result.reshape(extent, vectors, *result.shape[1:]) for result in results]
    else:
        mapped = [axis is not None for axis in axes]
        moved = [jnp.moveaxis(a, axis, 0) for a, axis in zip(arguments, axes, strict=True) if axis is not None]

        def one(given: Sequence[Any]) -> list[Any]:
            rest = iter(given)
            each = [next(rest) if m else a for a, m in zip(arguments, mapped, strict=True)]
            answers: list[Any] = primitive.bind(*each, model=model)
            return answers

        results = jax.lax.map(one, moved)
    return results, [0] * len(results)


def _register(primitive: Primitive) -> None:
    """What all three have in common: values, shapes, `jit` and `vmap`."""
    primitive.multiple_results = True

    def implementation(*arguments: Any, model: Differentiable) -> list[Any]:
        return [jnp.asarray(result) for result in _on_host(primitive, model, arguments)]

    def shapes(*arguments: Any, model: Differentiable) -> list[Any]:
        return [jax.core.ShapedArray(shape, jnp.float64) for shape in _shapes(primitive, model, arguments)]

    def callback(*arguments: Any, model: Differentiable) -> Any:
        results = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in _shapes(primitive, model, arguments)]
        return jax.pure_callback(lambda *given: _on_host(primitive, model, given), results, *arguments)

    primitive.def_impl(implementation)
    primitive.def_abstract_eval(shapes)
    mlir.register_lowering(primitive, mlir.lower_fun(callback, multiple_results=True))
    batching.primitive_batchers[primitive] = lambda arguments, axes, model: _batched(primitive, arguments, axes, model)


def _eval_jvp(primals: Sequence[Any], tangents: Sequence[Any], *, model: Differentiable) -> Any:
    blocks = [ad.instantiate_zeros(tangent)[None] for tangent in tangents]
    changes = _JVP.bind(*primals, *blocks, model=model)
    return _EVAL.bind(*primals, model=model), [change[0] for change in changes]


def _register_linear(primitive: Primitive, transpose: Primitive) -> None:
    """Derivatives of a product, which is linear in its blocks."""

    def jvp(primals: Sequence[Any], tangents: Sequence[Any], *, model: Differentiable) -> Any:
        count = len(model.inputs)
        if any(not isinstance(tangent, ad.Zero) for tangent in tangents[:count]):
            raise NotImplementedError("moldline has derivatives of the first order only")
        blocks = [ad.instantiate_zeros(tangent) for tangent in tangents[count:]]
        return primitive.bind(*primals, model=model), primitive.bind(*primals[:count], *blocks, model=model)

    def transposed(cotangents: Sequence[Any], *arguments: Any, model: Differentiable) -> list[Any]:
        count = len(model.inputs)
        # Points of linearisation are no linear arguments: `jvp` above refuses them.
        weights = [ad.instantiate_zeros(cotangent) for cotangent in cotangents]
        gradients = transpose.bind(*arguments[:count], *weights, model=model)
        blocks = zip(arguments[count:], gradients, strict=True)
        return [None] * count + [gradient if ad.is_undefined_primal(block) else None for block, gradient in blocks]

    ad.primitive_jvps[primitive] = jvp
    ad.primitive_transposes[primitive] = transposed


for _primitive in (_EVAL, _JVP, _VJP):
    _register(_primitive)
ad.primitive_jvps[_EVAL] = _eval_jvp
_register_linear(_JVP, _VJP)
_register_linear(_VJP, _JVP)
