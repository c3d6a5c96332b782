"""The services as functions of PyTorch, with exact derivatives of the first order.

    pip install moldline[torch]

    deform = moldline.torch.deform(session)
    vertices, functions = deform(torch.tensor(setup.baseline, requires_grad=True))
    functions["enclosed_volume"].backward()

Tensors are float64, on the CPU. Derivatives are those of reverse mode (`backward`, `torch.autograd.grad`) and of forward
mode (`torch.autograd.forward_ad`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch

from moldline.client import Session, Setup
from moldline.differentiable import Analyze, Deform, Differentiable
from moldline.panel import COEFFICIENTS, Configuration, Reference


class Deformed(NamedTuple):
    """A deformed mesh."""

    #: float64, (n, 3), metres.
    vertices: Any
    #: By name, each in its unit.
    functions: dict[str, Any]


class Flow(NamedTuple):
    """The flow in one wind."""

    #: By name (:data:`moldline.panel.COEFFICIENTS`).
    coefficients: dict[str, Any]
    #: (sections,): section lift coefficient times chord, metres.
    section_loads: Any
    #: (m,): pressure coefficient of every cell.
    cp: Any


def deform(session: Session | Setup) -> Callable[[Any], Deformed]:
    """The function from a design, float64, (number of variables,), to the deformed mesh."""
    model = Deform(session)

    def deformed(design: Any) -> Deformed:
        vertices, functions = _call(model, ("design",), (design,))
        return Deformed(vertices, {name: functions[index] for index, name in enumerate(model.functions)})

    return deformed


def analyze(configuration: Configuration, reference: Reference) -> Callable[..., Flow]:
    """The function of vertices, float64, (n, 3), metres, `alpha` and `sideslip`, rad, and `mach` to the flow."""
    model = Analyze(configuration, reference)

    def analyzed(vertices: Any, *, alpha: Any = 0.0, sideslip: Any = 0.0, mach: Any = 0.0) -> Flow:
        names = ("vertices", "alpha", "sideslip", "mach")
        coefficients, section_loads, cp = _call(model, names, (vertices, alpha, sideslip, mach))
        return Flow({name: coefficients[index] for index, name in enumerate(COEFFICIENTS)}, section_loads, cp)

    return analyzed


def _call(model: Differentiable, names: Sequence[str], arguments: Sequence[Any]) -> Any:
    tensors = [torch.as_tensor(argument, dtype=torch.float64) for argument in arguments]
    for name, tensor, shape in zip(names, tensors, model.inputs, strict=True):
        if tuple(tensor.shape) != shape:
            raise ValueError(f"{name} has shape {tuple(tensor.shape)}, expected {shape}")
    return _Call.apply(model, *tensors)


def _arrays(tensors: Sequence[Any]) -> list[Any]:
    return [tensor.detach().cpu().numpy() for tensor in tensors]


def _tensors(arrays: Sequence[Any]) -> tuple[Any, ...]:
    # Copies: answers are views of read-only memory.
    return tuple(torch.from_numpy(np.array(array)) for array in arrays)


class _Call(torch.autograd.Function):  # type: ignore[misc]  # PyTorch may be absent.
    """A call of a service."""

    @staticmethod
    def forward(model: Differentiable, *inputs: Any) -> Any:
        return _tensors(model.eval(_arrays(inputs)))

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        ctx.model = inputs[0]
        ctx.save_for_backward(*inputs[1:])
        ctx.save_for_forward(*inputs[1:])

    @staticmethod
    @torch.autograd.function.once_differentiable  # type: ignore[misc]
    def backward(ctx: Any, *weights: Any) -> Any:
        blocks = [weight[None] for weight in _arrays(weights)]
        gradients = ctx.model.vjp(_arrays(ctx.saved_tensors), blocks)
        return (None, *(gradient[0] for gradient in _tensors(gradients)))

    @staticmethod
    def jvp(ctx: Any, _model: Any, *directions: Any) -> Any:
        inputs = _arrays(ctx.saved_tensors)
        given = [np.zeros_like(x) if d is None else d.detach().numpy() for x, d in zip(inputs, directions, strict=True)]
        changes = ctx.model.jvp(inputs, [direction[None] for direction in given])
        return tuple(change[0] for change in _tensors(changes))
