"""Derivatives through a real connection: against each other, against differences, and refusals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import moldline
import numpy as np
import pytest
from moldline.errors import translated
from moldline.v1 import array_pb2
from moldline.v1 import mesh_service_pb2 as wire

from server import Server

ROOT = Path(__file__).parents[2]
#: Of the set-up of sphere and boom; off the baseline, where nothing is symmetric.
DESIGN = {"boom.translation": 0.2, "boom.lift": 0.1, "boom.far": -0.1}


@pytest.fixture(params=["sphere-and-boom", "half"])
def session(request: pytest.FixtureRequest, client: moldline.Client, setup_folder: Path) -> Iterator[moldline.Session]:
    folder = setup_folder if request.param == "sphere-and-boom" else ROOT / "tests/configurations/half"
    with client.create_setup(folder).session() as session:
        yield session


@pytest.fixture
def boom(setup: moldline.Setup) -> Iterator[moldline.Session]:
    with setup.session() as session:
        yield session


def somewhere(setup: moldline.Setup) -> np.ndarray:
    """A design away from the baseline, and within the bounds."""
    lower, upper = setup.bounds
    return setup.baseline + np.linspace(0.02, 0.04, len(lower)) * (upper - lower)


def seeds(session: moldline.Session, count: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    setup = session.setup
    return random.normal(size=(count, setup.vertex_count, 3)), random.normal(size=(count, len(setup.functions)))


def matrix(tangents: moldline.Tangents | moldline.Jacobian) -> np.ndarray:
    """All functions, in the order of the set-up's; the last axis."""
    return np.stack(list(tangents.functions.values()), axis=-1)


def test_the_functions_come_with_setup_and_deformation(session: moldline.Session) -> None:
    setup = session.setup
    names = [function.name for function in setup.functions]
    assert names[0] == "enclosed_volume"
    assert [function.unit for function in setup.functions][:2] == ["m^3", "m^2"]
    baseline, moved = session.deform(), session.deform(somewhere(setup))
    assert list(baseline.functions) == names
    for function in setup.functions:
        assert math.isclose(baseline.functions[function.name], function.value, rel_tol=1e-9)
    assert moved.functions != baseline.functions


@pytest.mark.parametrize("count", [1, None])
def test_forward_and_reverse_agree(session: moldline.Session, count: int | None) -> None:
    """w . (J v) = (J^T w) . v, for one direction and for as many as there are variables."""
    variables = len(session.setup.variables)
    count = variables if count is None else count
    at = session.deform(somewhere(session.setup))
    directions = np.random.default_rng(1).normal(size=(count, variables))
    points = {
        c: np.random.default_rng(2).normal(size=(count, n, 3)) for c, n in session.setup.control_point_counts.items()
    }
    of_vertices, of_functions = seeds(session, count)
    tangents = session.jvp(directions, control_points=points, at=at)
    gradients = session.vjp(vertices=of_vertices, functions=of_functions, at=at, control_points=points)
    forward = np.einsum("inx,jnx->ij", of_vertices, tangents.vertices) + of_functions @ matrix(tangents).T
    reverse = gradients.design @ directions.T
    for component, vectors in points.items():
        reverse = reverse + np.einsum("inx,jnx->ij", gradients.control_points[component], vectors)
    scale = np.linalg.norm(of_vertices, axis=(1, 2))[:, None] * np.linalg.norm(tangents.vertices, axis=(1, 2))
    assert np.max(np.abs(forward - reverse) / scale) <= 1e-12


def test_the_jacobian_has_the_products_columns(session: moldline.Session) -> None:
    at = session.deform(somewhere(session.setup))
    jacobian = session.jacobian(at=at)
    variables = len(session.setup.variables)
    assert jacobian.vertices.shape == (variables, session.setup.vertex_count, 3)
    together = session.jvp(np.eye(variables), at=at)
    assert jacobian.vertices.tobytes() == together.vertices.tobytes()
    assert matrix(jacobian).tobytes() == matrix(together).tobytes()
    # A single direction sums the field in another order.
    for column, direction in enumerate(np.eye(variables)):
        tangent = session.jvp(direction, at=at)
        assert tangent.vertices.shape == (session.setup.vertex_count, 3)
        scale = np.abs(tangent.vertices).max()
        np.testing.assert_allclose(jacobian.vertices[column], tangent.vertices, rtol=0, atol=1e-14 * scale)
        np.testing.assert_allclose(matrix(jacobian)[column], matrix(tangent), rtol=1e-13, atol=1e-13 * scale)


def test_the_jacobian_is_that_of_central_differences(session: moldline.Session) -> None:
    design = somewhere(session.setup)
    jacobian = session.jacobian(at=design)
    for column, direction in enumerate(np.eye(len(design))):
        errors = []
        for step in (1e-3, 1e-4, 1e-5):
            ahead, behind = session.deform(design + step * direction), session.deform(design - step * direction)
            of_vertices = (ahead.vertices - behind.vertices) / (2 * step)
            of_functions = np.subtract(list(ahead.functions.values()), list(behind.functions.values())) / (2 * step)
            exact = np.concatenate([jacobian.vertices[column].ravel(), matrix(jacobian)[column]])
            difference = exact - np.concatenate([of_vertices.ravel(), of_functions])
            errors.append(np.linalg.norm(difference) / np.linalg.norm(exact))
        assert min(errors) <= 1e-6


def test_by_id_and_by_design_the_bytes_are_the_same(session: moldline.Session) -> None:
    design = somewhere(session.setup)
    result = session.deform(design)
    of_vertices, _ = seeds(session, 2)
    answers = []
    with session.setup.session() as fresh:
        for asked, at in [(session, result), (session, result.linearisation_id), (session, design), (fresh, design)]:
            tangent = asked.jvp(np.eye(len(design)), at=at)
            gradient = asked.vjp(vertices=of_vertices, at=at)
            jacobian = asked.jacobian(at=at)
            answers.append((tangent.vertices.tobytes(), gradient.design.tobytes(), jacobian.vertices.tobytes()))
    assert all(answer == answers[0] for answer in answers)


def test_one_thread_gives_the_derivatives_of_two(binary: Path, boom: moldline.Session, setup_folder: Path) -> None:
    of_vertices, of_functions = seeds(boom, 3)
    two = boom.vjp(vertices=of_vertices, functions=of_functions, at=DESIGN)
    with Server(binary, "--threads", "1") as server, server.client() as client:
        with client.create_setup(setup_folder).session() as session:
            one = session.vjp(vertices=of_vertices, functions=of_functions, at=DESIGN)
    assert one.design.tobytes() == two.design.tobytes()


def test_given_control_points_take_the_designs_place(boom: moldline.Session) -> None:
    """The design has no effect on a component whose control points are given."""
    given = {"boom": boom.setup.control_points["boom"] + [0.1, 0.0, 0.05]}
    at = boom.deform(control_points=given)
    gradient = boom.vjp(functions={"enclosed_volume": 1.0}, at=at, control_points=["boom"])
    assert not gradient.design.any()
    assert not boom.jvp(np.eye(3), at=at).vertices.any()
    lift = np.broadcast_to([0.0, 0.0, 1.0], given["boom"].shape)
    tangent = boom.jvp(control_points={"boom": lift}, at=at)
    # A shift of all control points is what the variable `boom.lift` does.
    moved = boom.jvp([0.0, 1.0, 0.0], at={"boom.translation": 0.1, "boom.lift": 0.05})
    np.testing.assert_allclose(tangent.vertices, moved.vertices, atol=1e-9)
    volume = np.sum(gradient.control_points["boom"] * lift)
    assert math.isclose(volume, tangent.functions["enclosed_volume"], rel_tol=1e-10, abs_tol=1e-12)
    point = moldline.DesignPoint(control_points=given)
    assert (
        boom.vjp(functions={"enclosed_volume": 1.0}, at=point, control_points=["boom"]).control_points["boom"].tobytes()
        == gradient.control_points["boom"].tobytes()
    )


def test_seeds_by_name_are_those_by_number(boom: moldline.Session) -> None:
    weights = np.zeros((2, len(boom.setup.functions)))
    weights[:, 0] = 1.0, 2.0
    by_name = boom.vjp(functions={"enclosed_volume": [1.0, 2.0]}, at=DESIGN)
    assert by_name.design.shape == (2, 3)
    assert by_name.design.tobytes() == boom.vjp(functions=weights, at=DESIGN).design.tobytes()
    assert boom.vjp(functions={"enclosed_volume": 1.0}, at=DESIGN).design.shape == (3,)
    with pytest.raises(ValueError, match="enclosed_volume"):
        boom.vjp(functions={"volume": 1.0})
    with pytest.raises(ValueError, match="nothing"):
        boom.jvp()


def test_a_large_block_goes_in_several_requests(boom: moldline.Session) -> None:
    directions = np.random.default_rng(4).normal(size=(150, 3))
    block = boom.jvp(directions, at=DESIGN)
    assert block.vertices.shape == (150, boom.setup.vertex_count, 3)
    last = boom.jvp(directions[-1], at=DESIGN)
    scale = np.abs(last.vertices).max()
    np.testing.assert_allclose(block.vertices[-1], last.vertices, rtol=0, atol=1e-14 * scale)


def test_a_dropped_linearisation_is_said_or_made_again(binary: Path, setup_folder: Path) -> None:
    with Server(binary, "--linearisation-memory", "0") as server, server.client() as client:
        with client.create_setup(setup_folder).session() as session:
            first = session.deform(DESIGN)
            before = session.jvp([1.0, 0.0, 0.0], at=first.linearisation_id)
            for value in (0.1, 0.2):
                session.deform({"boom.translation": value})
            with pytest.raises(moldline.NotFound) as refused:
                session.jvp([1.0, 0.0, 0.0], at=first.linearisation_id)
            (violation,) = refused.value.violations
            assert violation.field == "at.linearisation_id"
            assert "Deform again" in violation.description
            # Given the result of `deform`, the client sends the design too.
            again = session.jvp([1.0, 0.0, 0.0], at=first)
            assert again.vertices.tobytes() == before.vertices.tobytes()
            column = session.jacobian(at=first).vertices[0]
            np.testing.assert_allclose(column, before.vertices, rtol=0, atol=1e-14 * np.abs(column).max())


def test_a_linearisation_is_known_to_all_sessions_on_its_set_up(boom: moldline.Session) -> None:
    made = boom.deform(DESIGN).linearisation_id
    with boom.setup.session() as other:
        assert other.jacobian(at=made).vertices.tobytes() == boom.jacobian(at=made).vertices.tobytes()
        with pytest.raises(moldline.NotFound) as refused:
            other.jacobian(at="0" * len(made))
    assert refused.value.violations[0].field == "at.linearisation_id"


def array(
    values: Any, dtype: int = array_pb2.DATA_TYPE_FLOAT64, shape: tuple[int, ...] | None = None
) -> array_pb2.Array:
    values = np.asarray(values, dtype="<f8")
    return array_pb2.Array(dtype=dtype, shape=values.shape if shape is None else shape, data=values.tobytes())


def vectors(component: str, values: Any) -> wire.ControlPointVectors:
    return wire.ControlPointVectors(component=component, vectors=array(values))


def spoilt(shape: tuple[int, ...], index: tuple[int, ...], value: float) -> np.ndarray:
    values = np.zeros(shape)
    values[index] = value
    return values


Fields = Callable[[moldline.Setup], dict[str, Any]]

DIRECTIONS: dict[str, tuple[Fields, str, list[str]]] = {
    "one dimension": (lambda s: {"design": array([1.0, 0, 0])}, "design.shape", ["1", "2"]),
    "too short": (lambda s: {"design": array(np.zeros((2, 2)))}, "design.shape[1]", ["2", "3"]),
    "none": (lambda s: {"design": array(np.zeros((0, 3)))}, "design.shape[0]", ["0"]),
    "too many": (lambda s: {"design": array(np.zeros((65, 3)))}, "design.shape[0]", ["65", "64"]),
    "NaN": (lambda s: {"design": array(spoilt((2, 3), (1, 2), math.nan))}, "design[1][2]", ["NaN"]),
    "infinite": (lambda s: {"design": array(spoilt((1, 3), (0, 0), math.inf))}, "design[0][0]", ["inf"]),
    "bytes missing": (lambda s: {"design": array(np.zeros(3), shape=(2, 3))}, "design.data", ["24", "[2, 3]"]),
    "wrong type": (
        lambda s: {"design": array(np.zeros((1, 3)), dtype=array_pb2.DATA_TYPE_UINT32)},
        "design.dtype",
        ["UINT32", "FLOAT64"],
    ),
    "nothing": (lambda s: {}, "design", ["no direction", "control_points"]),
    "unknown component": (
        lambda s: {"control_points": [vectors("wing", np.zeros((1, 4, 3)))]},
        'control_points["wing"]',
        ["sphere", "boom"],
    ),
    "wrong number of control points": (
        lambda s: {"control_points": [vectors("boom", np.zeros((1, 4, 3)))]},
        'control_points["boom"].shape[1]',
        ["4"],
    ),
    "control point NaN": (
        lambda s: {
            "control_points": [vectors("boom", spoilt((1, s.control_point_counts["boom"], 3), (0, 2, 1), math.nan))]
        },
        'control_points["boom"][0][2][1]',
        ["NaN"],
    ),
    "component twice": (
        lambda s: {"control_points": 2 * [vectors("boom", np.zeros((1, s.control_point_counts["boom"], 3)))]},
        'control_points["boom"]',
        ["twice"],
    ),
    "counts differ": (
        lambda s: {
            "design": array(np.zeros((2, 3))),
            "control_points": [vectors("boom", np.zeros((1, s.control_point_counts["boom"], 3)))],
        },
        'control_points["boom"].shape[0]',
        ["1", "2", "design"],
    ),
}

SEEDS: dict[str, tuple[Fields, str, list[str]]] = {
    "nothing": (lambda s: {}, "vertices", ["no seed", "functions"]),
    "flat vertices": (lambda s: {"vertices": array(np.zeros((1, 3 * s.vertex_count)))}, "vertices.shape", ["2", "3"]),
    "two columns": (lambda s: {"vertices": array(np.zeros((1, s.vertex_count, 2)))}, "vertices.shape[2]", ["2"]),
    "too few vertices": (lambda s: {"vertices": array(np.zeros((1, 5, 3)))}, "vertices.shape[1]", ["5"]),
    "vertex NaN": (
        lambda s: {"vertices": array(spoilt((1, s.vertex_count, 3), (0, 7, 2), math.nan))},
        "vertices[0][7][2]",
        ["NaN"],
    ),
    "too many functions": (
        lambda s: {"functions": array(np.zeros((1, len(s.functions) + 1)))},
        "functions.shape[1]",
        ["functions"],
    ),
    "function infinite": (
        lambda s: {"functions": array(spoilt((1, len(s.functions)), (0, 1), -math.inf))},
        "functions[0][1]",
        ["-inf"],
    ),
    "counts differ": (
        lambda s: {
            "vertices": array(np.zeros((2, s.vertex_count, 3))),
            "functions": array(np.zeros((1, len(s.functions)))),
        },
        "functions.shape[0]",
        ["1", "2", "vertices"],
    ),
    "unknown component": (
        lambda s: {"functions": array(np.zeros((1, len(s.functions)))), "control_points_of": ["wing"]},
        'control_points_of["wing"]',
        ["sphere", "boom"],
    ),
    "no gradient": (
        lambda s: {"functions": array(np.zeros((1, len(s.functions)))), "include_design": False},
        "include_design",
        ["control_points_of"],
    ),
}


def refused(session: moldline.Session, method: str, request: Any, field: str, words: list[str]) -> None:
    """The request is refused by field, and the session goes on."""
    with pytest.raises(moldline.InvalidArgument) as error, translated():
        getattr(session.setup._client._stub, method)(request)
    assert [violation.field for violation in error.value.violations] == [field]
    for word in words:
        assert word in error.value.message
    assert session.deform().quality.total.folded == 0


@pytest.mark.parametrize("name", DIRECTIONS)
def test_bad_directions_are_refused_by_entry(boom: moldline.Session, name: str) -> None:
    fields, field, words = DIRECTIONS[name]
    request = wire.ApplyJacobianVectorRequest(session_id=boom.id, **fields(boom.setup))
    request.at.design_point.SetInParent()
    refused(boom, "ApplyJacobianVector", request, field, words)


@pytest.mark.parametrize("name", SEEDS)
def test_bad_seeds_are_refused_by_entry(boom: moldline.Session, name: str) -> None:
    fields, field, words = SEEDS[name]
    request = wire.ApplyAdjointRequest(session_id=boom.id, **{"include_design": True, **fields(boom.setup)})
    request.at.design_point.SetInParent()
    refused(boom, "ApplyAdjoint", request, field, words)


def test_a_bad_point_is_refused_by_entry(boom: moldline.Session) -> None:
    direction = array(np.ones((1, 3)))
    request = wire.ApplyJacobianVectorRequest(session_id=boom.id, design=direction)
    refused(boom, "ApplyJacobianVector", request, "at", ["missing"])
    for design, field in [([math.nan, 0, 0], "design[0]"), ([0, 9, 0], "design[1]"), ([0, 0], "design")]:
        with pytest.raises(moldline.InvalidArgument) as error:
            boom.jvp([1.0, 0, 0], at=design)
        assert error.value.violations[0].field == f"at.design_point.{field}"
        with pytest.raises(moldline.InvalidArgument) as error:
            boom.jacobian(at=design)
        assert error.value.violations[0].field == f"at.design_point.{field}"
    with pytest.raises(moldline.FailedPrecondition) as lost:
        boom.vjp(functions={"enclosed_volume": 1.0}, at={"boom.far": 4.0})
    assert lost.value.violations[0].field == "at.design_point.design"
    with pytest.raises(moldline.NotFound) as unknown:
        boom.jvp([1.0, 0, 0], at="x" * 10_000)
    assert unknown.value.violations[0].field == "at.linearisation_id"
    assert len(unknown.value.message) < 500, "what a client sends is not repeated at length"
    assert boom.jvp([1.0, 0, 0]).vertices.any()


def test_derivatives_of_a_closed_session_are_not_found(setup: moldline.Setup) -> None:
    session = setup.session()
    result = session.deform()
    session.close()
    for call in (lambda: session.jvp([1.0, 0, 0], at=result), lambda: session.jacobian(at=result)):
        with pytest.raises(moldline.NotFound) as gone:
            call()
        assert gone.value.violations[0].field == "session_id"
