"""The OpenMDAO component on a real server, checked by OpenMDAO itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import moldline
import numpy as np
import openmdao.api as om
import pytest
from moldline.openmdao import DeformedMesh, DenseDeformedMesh, add_design_variables
from openmdao.utils.assert_utils import assert_check_partials, assert_check_totals

HALF = Path(__file__).parents[2] / "tests/configurations/half"


@pytest.fixture(autouse=True)
def elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """OpenMDAO writes a folder where it runs."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def session(client: moldline.Client) -> Iterator[moldline.Session]:
    with client.create_setup(HALF).session() as session:
        yield session


def problem(component: Any, **values: float) -> om.Problem:
    problem = om.Problem(reports=False)
    problem.model.add_subsystem("mesh", component)
    problem.setup(force_alloc_complex=False)
    for name, value in values.items():
        problem.set_val(f"mesh.{name.replace('__', ':')}", value)
    problem.run_model()
    return problem


def check(problem: om.Problem) -> Any:
    data = problem.check_partials(method="fd", form="central", step=1e-5, out_stream=None)
    assert_check_partials(data, atol=1e-5, rtol=1e-6)
    return data["mesh"]


def test_inputs_and_outputs_are_those_of_the_setup(session: moldline.Session) -> None:
    component = DeformedMesh(session=session)
    run = problem(component, wing__translation=0.3, wing__rotation=2.0)
    expected = session.deform({"wing.translation": 0.3, "wing.rotation": 2.0})
    assert run.get_val("mesh.vertices").tobytes() == expected.vertices.tobytes()
    for name, value in expected.functions.items():
        assert run.get_val(f"mesh.{name.replace('.', ':')}").item() == value
    # In other units too.
    assert np.isclose(run.get_val("mesh.wing:rotation", units="rad").item(), np.deg2rad(2.0))
    assert np.isclose(
        run.get_val("mesh.enclosed_volume", units="ft**3").item(), expected.functions["enclosed_volume"] / 0.3048**3
    )


def test_products_pass_openmdaos_check(session: moldline.Session) -> None:
    """Forward and reverse, in random directions: all variables and outputs take part."""
    component = DeformedMesh(session=session)
    run = om.Problem(reports=False)
    run.model.add_subsystem("mesh", component)
    run.setup()
    run.set_val("mesh.wing:translation", 0.3)
    run.set_val("mesh.wing:rotation", 2.0)
    run.run_model()
    data = run.check_partials(out_stream=None)["mesh"]
    assert_check_partials({"mesh": data}, atol=1e-5, rtol=1e-6)
    assert {"wing:translation", "wing:rotation"} == {wrt for _, wrt in data}
    assert {"vertices", "enclosed_volume"} <= {of for of, _ in data}
    assert all({"J_fwd", "J_rev", "J_fd"} <= set(entry) for entry in data.values())


@pytest.mark.parametrize("mode", ["fwd", "rev"])
def test_products_by_control_points_pass_openmdaos_check(session: moldline.Session, mode: str) -> None:
    """A user's own geometry engine: it shifts the wing and gives it dihedral. Patches stay joined."""
    points = session.setup.control_points["wing"]
    shift, dihedral = np.zeros_like(points), np.zeros_like(points)
    shift[:, 0] = 1.0
    dihedral[:, 2] = points[:, 1]
    run = om.Problem(reports=False)
    geometry = om.ExecComp(
        "points = base + a * shift + b * dihedral",
        points={"shape": points.shape, "units": "m"},
        **{name: {"val": value} for name, value in {"base": points, "shift": shift, "dihedral": dihedral}.items()},
        a={"val": 0.1},
        b={"val": 0.02},
    )
    run.model.add_subsystem("geometry", geometry)
    component = DeformedMesh(
        session=session, control_points=["wing"], functions=["enclosed_volume", "wing.wetted_area"]
    )
    run.model.add_subsystem("mesh", component)
    run.model.connect("geometry.points", "mesh.wing:control_points")
    run.setup(mode=mode)
    run.run_model()
    of = ["mesh.enclosed_volume", "mesh.wing:wetted_area", *(["mesh.vertices"] if mode == "fwd" else [])]
    inputs = ["geometry.a", "geometry.b", "mesh.wing:translation"]
    data = run.check_totals(of=of, wrt=inputs, method="fd", form="central", step=1e-5, out_stream=None)
    assert_check_totals(data, atol=1e-5, rtol=1e-6)
    totals = run.compute_totals(of=of, wrt=inputs)
    assert np.any(totals["mesh.enclosed_volume", "geometry.b"])
    # Its control points are given, so that the design does not move it.
    assert not np.any(totals["mesh.enclosed_volume", "mesh.wing:translation"])


def test_dense_partials_pass_openmdaos_check(session: moldline.Session) -> None:
    run = problem(DenseDeformedMesh(session=session), wing__translation=0.3, wing__rotation=2.0)
    data = check(run)
    assert data["vertices", "wing:translation"]["J_fwd"].shape == (3 * session.setup.vertex_count, 1)


@pytest.mark.parametrize("mode", ["fwd", "rev"])
@pytest.mark.parametrize("component", [DeformedMesh, DenseDeformedMesh])
def test_total_derivatives_are_those_of_the_session(session: moldline.Session, component: Any, mode: str) -> None:
    run = om.Problem(reports=False)
    run.model.add_subsystem("mesh", component(session=session, functions=["enclosed_volume"]))
    run.setup(mode=mode)
    run.set_val("mesh.wing:rotation", 1.0)
    run.run_model()
    totals = run.compute_totals(of=["mesh.enclosed_volume"], wrt=["mesh.wing:translation", "mesh.wing:rotation"])
    expected = session.vjp(functions={"enclosed_volume": 1.0}, at={"wing.rotation": 1.0}).design
    for name, value in zip(["wing:translation", "wing:rotation"], expected, strict=True):
        np.testing.assert_allclose(totals["mesh.enclosed_volume", f"mesh.{name}"].item(), value, rtol=1e-12, atol=1e-14)


def test_names_that_are_not_there_are_refused(session: moldline.Session) -> None:
    for option in ({"functions": ["mass"]}, {"control_points": ["tail"]}):
        with pytest.raises(ValueError, match="there are: "):
            problem(DeformedMesh(session=session, **option))


@pytest.mark.parametrize("component", [DeformedMesh, DenseDeformedMesh])
def test_the_complex_step_is_refused(session: moldline.Session, component: Any) -> None:
    run = om.Problem(reports=False)
    run.model.add_subsystem("mesh", component(session=session, functions=["enclosed_volume"]), promotes=["*"])
    run.model.add_design_var("wing:translation")
    run.model.add_objective("enclosed_volume")
    run.model.approx_totals(method="cs")
    run.setup(force_alloc_complex=True)
    run.run_model()
    with pytest.raises(RuntimeError, match="complex step"):
        run.compute_totals()


def test_only_a_design_that_cannot_be_reached_is_an_analysis_error(
    session: moldline.Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = problem(DeformedMesh(session=session))
    for error, expected in (
        (moldline.errors.FailedPrecondition("seam lost"), om.AnalysisError),
        (moldline.errors.Unavailable("no server"), moldline.errors.Unavailable),
    ):

        def fail(*_: Any, error: Exception = error, **__: Any) -> None:
            raise error

        monkeypatch.setattr(moldline.Session, "deform", fail)
        with pytest.raises(expected, match=error.args[0]):
            run.run_model()


def test_design_variables_have_the_bounds_of_the_setup(session: moldline.Session) -> None:
    run = om.Problem(reports=False)
    run.model.add_subsystem("mesh", DeformedMesh(session=session))
    add_design_variables(run.model, session.setup, prefix="mesh.")
    run.setup()
    run.final_setup()
    declared = run.model.get_design_vars()
    rotation = declared["mesh.wing:rotation"]
    assert set(declared) == {"mesh.wing:translation", "mesh.wing:rotation"}
    assert rotation["units"] == "deg"
    assert (np.min(rotation["lower"]), np.max(rotation["upper"])) == (-5.0, 5.0)
    # The driver sees the middle of the bounds as 0.5.
    assert run.driver.get_design_var_values()["mesh.wing:rotation"].item() == 0.5
