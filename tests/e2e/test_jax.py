"""Both services as functions of JAX, and their chain, against the clients' own products."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import moldline
import numpy as np
import pytest
from moldline.panel import Configuration, Reference

from server import Server

jax = pytest.importorskip("jax")
jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import moldline.jax  # noqa: E402
from jax.test_util import check_grads  # noqa: E402

REFERENCE = Reference(area=4.0, chord=1.0, span=2.0)
DESIGN = np.array([0.1, 0.05, 0.2])
WIND = {"alpha": 0.03, "mach": 0.3, "sideslip": 0.01}


@pytest.fixture
def session(setup: moldline.Setup) -> Iterator[moldline.Session]:
    with setup.session() as session:
        yield session


@pytest.fixture(scope="module")
def panels(binary: Path) -> Iterator[moldline.panel.Client]:
    with Server(binary, command=("panel", "serve")) as server, moldline.panel.Client(server.address) as panels:
        yield panels


@pytest.fixture
def configuration(panels: moldline.panel.Client, setup: moldline.Setup) -> Configuration:
    return panels.create_configuration(setup.mesh.vertices, setup.mesh.cells, trailing_edges="none", symmetry="none")


class Counted:
    """Counts the calls of a session's methods."""

    def __init__(self, session: moldline.Session, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[str] = []
        for name in ("deform", "jvp", "vjp"):
            method = getattr(session, name)

            def counted(*arguments, name=name, method=method, **options):
                self.calls.append(name)
                return method(*arguments, **options)

            monkeypatch.setattr(session, name, counted)


def close(one, two, scale: float = 1.0) -> bool:
    return np.max(np.abs(np.asarray(one) - np.asarray(two)), initial=0.0) <= 1e-14 * scale


@pytest.mark.parametrize("transform", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_values_and_products_are_the_sessions(session: moldline.Session, transform) -> None:
    deform = transform(moldline.jax.deform(session))
    direct = session.deform(DESIGN)
    result = deform(DESIGN)
    assert np.array_equal(result.vertices, direct.vertices)
    assert {name: float(value) for name, value in result.functions.items()} == direct.functions
    direction = np.array([1.0, -2.0, 0.5])
    _, tangent = jax.jvp(deform, (jnp.asarray(DESIGN),), (jnp.asarray(direction),))
    expected = session.jvp(direction, at=direct)
    assert np.array_equal(tangent.vertices, expected.vertices)
    assert {name: float(v) for name, v in tangent.functions.items()} == {
        k: float(v) for k, v in expected.functions.items()
    }
    weights = np.random.default_rng(1).normal(size=direct.vertices.shape)

    def objective(design):
        mesh = deform(design)
        return jnp.vdot(weights, mesh.vertices) + 3.0 * mesh.functions["enclosed_volume"]

    gradient = transform(jax.grad(objective))(DESIGN)
    assert np.array_equal(gradient, session.vjp(vertices=weights, functions={"enclosed_volume": 3.0}, at=direct).design)


def test_jacobians_are_one_call_each(session: moldline.Session, monkeypatch: pytest.MonkeyPatch) -> None:
    deform = moldline.jax.deform(session)
    jacobian = session.jacobian(at=DESIGN)
    counted = Counted(session, monkeypatch)
    forward = jax.jacfwd(deform)(DESIGN)
    assert counted.calls.count("jvp") == 1
    assert close(forward.vertices, np.moveaxis(jacobian.vertices, 0, -1), 10)
    counted.calls.clear()
    backward = jax.jacrev(lambda design: jnp.stack(list(deform(design).functions.values())))(DESIGN)
    assert counted.calls.count("vjp") == 1 and "jvp" not in counted.calls
    for row, name in zip(backward, jacobian.functions, strict=True):
        assert close(row, jacobian.functions[name], 100)


def test_batches_of_designs_are_their_designs(session: moldline.Session) -> None:
    deform = moldline.jax.deform(session)
    designs = DESIGN * np.array([[0.5], [1.0], [1.5]])
    for transform in (lambda f: f, jax.jit):
        batch = transform(jax.vmap(deform))(designs)
        for index, design in enumerate(designs):
            assert np.array_equal(batch.vertices[index], session.deform(design).vertices)
        volume = jax.grad(lambda design: deform(design).functions["enclosed_volume"])
        gradients = transform(jax.vmap(volume))(designs)
        assert np.array_equal(gradients, np.stack([volume(design) for design in designs]))


def test_jaxs_own_check_of_gradients(session: moldline.Session, configuration: Configuration) -> None:
    deform = moldline.jax.deform(session)
    check_grads(lambda x: deform(x).vertices, (jnp.asarray(DESIGN),), order=1, modes=("fwd", "rev"), eps=1e-5)
    check_grads(lambda x: list(deform(x).functions.values()), (jnp.asarray(DESIGN),), order=1, eps=1e-5)
    analyze = moldline.jax.analyze(configuration, REFERENCE)
    vertices = session.setup.mesh.vertices

    def wind(alpha, mach, sideslip):
        flow = analyze(vertices, alpha=alpha, mach=mach, sideslip=sideslip)
        return flow.coefficients["pressure_lift"], flow.coefficients["moment"], flow.cp

    check_grads(wind, (0.03, 0.3, 0.01), order=1, modes=("fwd", "rev"), eps=1e-5)


def test_the_chain_of_both_is_the_direct_chain(session: moldline.Session, configuration: Configuration) -> None:
    deform, analyze = moldline.jax.deform(session), moldline.jax.analyze(configuration, REFERENCE)

    def objective(design, alpha):
        mesh = deform(design)
        flow = analyze(mesh.vertices, **{**WIND, "alpha": alpha})
        return flow.coefficients["pressure_drag"] + 0.1 * jnp.sum(flow.cp**2) + 1e-3 * mesh.functions["enclosed_volume"]

    value, (by_design, by_alpha) = jax.jit(jax.value_and_grad(objective, argnums=(0, 1)))(DESIGN, WIND["alpha"])
    moved = session.deform(DESIGN)
    flow = configuration.analyze(moved.vertices, reference=REFERENCE, **WIND)
    direct = flow.coefficients.pressure_drag + 0.1 * np.sum(flow.cp**2) + 1e-3 * moved.functions["enclosed_volume"]
    adjoint = configuration.vjp({"pressure_drag": 1.0}, cp=0.2 * flow.cp, at=flow)
    gradient = session.vjp(vertices=adjoint.vertices, functions={"enclosed_volume": 1e-3}, at=moved).design
    assert close(value, direct, abs(direct))
    assert close(by_design, gradient, np.abs(gradient).max())
    assert close(by_alpha, adjoint.alpha, max(1.0, abs(float(adjoint.alpha))))
    # Forwards, along one direction.
    _, slope = jax.jvp(objective, (jnp.asarray(DESIGN), WIND["alpha"]), (jnp.asarray([0.3, -0.2, 0.1]), 0.0))
    assert slope == pytest.approx(gradient @ [0.3, -0.2, 0.1], rel=1e-9)


def test_what_cannot_be_is_refused(session: moldline.Session) -> None:
    deform = moldline.jax.deform(session)
    with pytest.raises(ValueError, match=r"design has shape \(2,\), expected \(3,\)"):
        deform(DESIGN[:2])
    with pytest.raises(NotImplementedError, match="first order only"):
        jax.hessian(lambda design: deform(design).functions["enclosed_volume"])(DESIGN)
    with pytest.raises(moldline.InvalidArgument, match=r"design\[1\]"):
        deform(np.array([0.0, np.nan, 0.0]))
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(RuntimeError, match="jax_enable_x64"):
            moldline.jax.deform(session)
    finally:
        jax.config.update("jax_enable_x64", True)
