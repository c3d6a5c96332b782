"""The panel service: the Python client, both transports, OpenMDAO, and the chain with the mesh service."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import meshio
import moldline
import numpy as np
import pytest
import requests
from moldline.panel import AnalysisPoint, Configuration, Edges, Groups, Reference

from server import Server
from wing import wing

ROOT = Path(__file__).parents[2]
REFERENCE = Reference(area=8.0, chord=1.0, span=8.0, point=(0.25, 0.0, 0.0))
PANELS = ("panel", "serve")


@pytest.fixture(scope="module")
def panel_server(binary: Path) -> Iterator[Server]:
    with Server(binary, "--threads", "2", "--analysis-memory", "512", command=PANELS) as server:
        yield server
        assert server.stop() == 0


@pytest.fixture
def panels(panel_server: Server) -> Iterator[moldline.panel.Client]:
    with moldline.panel.Client(panel_server.address) as panels:
        yield panels


@pytest.fixture
def configuration(panels: moldline.panel.Client) -> Configuration:
    vertices, cells, trailing = wing()
    return panels.create_configuration(
        vertices,
        cells,
        vertex_groups={"trailing": trailing},
        trailing_edges=Groups("trailing"),
        cell_groups={"wing": range(len(cells))},
    )


def test_a_wing_lifts_as_a_wing_does(panels: moldline.panel.Client, configuration: Configuration) -> None:
    assert configuration.symmetric and configuration.components == ("wing",)
    assert len(configuration.trailing_edges) == 6
    assert panels.get_configuration(configuration.id).unknowns == configuration.unknowns
    # A vertex of a trailing edge has two potentials, but for that at the tip.
    assert configuration.unknowns == configuration.vertex_count + len(configuration.trailing_edges)
    steps: list[moldline.Progress] = []
    level, raised = configuration.sweep([0.0, 0.05], reference=REFERENCE, mach=0.2, progress=steps.append)
    assert list(dict.fromkeys(step.stage for step in steps)) == ["influence", "factorisation", "solution"]
    # The cells of the flat tip are cut along one of their diagonals.
    assert abs(level.coefficients.lift) < 1e-9
    # The method is linear: the lift follows the slope to second order in the angle, and is close to thin-wing theory.
    lift = raised.coefficients.lift
    assert np.isclose(lift, level.coefficients.lift_slope * np.sin(0.05), rtol=2e-3)
    assert 4.0 < lift / 0.05 < 5.2
    assert abs(raised.disagreement) < 0.05
    demanded = lift - raised.coefficients.induced_drag * np.sin(0.05)
    assert np.isclose(
        raised.coefficients.pressure_lift + raised.wake_lift, demanded * (1 + raised.disagreement), rtol=1e-12
    )
    elliptic = lift**2 / (np.pi * 8)
    assert 0.9 * elliptic < raised.coefficients.induced_drag < 1.15 * elliptic
    # The lift is the load over the half span, twice.
    sections = raised.sections
    assert np.isclose(2 * np.sum(sections.loads * np.abs(sections.spans[:, 0])) / 8.0, lift, rtol=1e-6)
    assert np.isclose(raised.components["wing"].lift, raised.coefficients.pressure_lift)
    assert raised.cp.shape == (configuration.cell_count,) and raised.vertex_cp.shape == (configuration.vertex_count,)
    assert raised.residuals[-1] == raised.residual <= 1e-12
    again = configuration.analyze(reference=REFERENCE, mach=0.2, alpha=0.05, pressures=False)
    assert again.reused and again.cp.size == 0 and again.coefficients == raised.coefficients


def test_derivatives_are_those_of_differences_and_each_others_transpose(configuration: Configuration) -> None:
    vertices = wing()[0]
    flow = {"reference": REFERENCE, "mach": 0.3, "alpha": 0.04}
    at = configuration.analyze(vertices, **flow)
    random = np.random.default_rng(3)
    shift = 1e-2 * random.normal(size=vertices.shape) * [1.0, 0.0, 1.0]
    seeds = {"lift": [1.0, 0.0], "moment": [0.5, 0.0], "induced_drag": [0.0, 1.0]}
    gradient = configuration.vjp(seeds, at=at)
    tangent = configuration.jvp(shift, at=at)
    # Central differences of the fourth order: at this step neither truncation nor rounding counts.
    step = 2e-3
    weights = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
    around = {
        k: configuration.analyze(vertices + k * step * shift, **flow, pressures=False).coefficients for k in weights
    }
    for name in ("lift", "moment", "induced_drag", "neutral_point"):
        difference = sum(weight * getattr(around[k], name) for k, weight in weights.items()) / step
        assert np.isclose(tangent.coefficients[name], difference, rtol=1e-6, atol=1e-9), name
    along = np.tensordot(gradient.vertices, shift, axes=2)
    expected = [
        tangent.coefficients["lift"] + 0.5 * tangent.coefficients["moment"],
        tangent.coefficients["induced_drag"],
    ]
    assert np.allclose(along, expected, rtol=1e-9)
    # A point that was never analysed gives the same bytes as the analysis.
    by_point = configuration.vjp({"lift": 1.0}, at=AnalysisPoint(vertices, 0.3, 0.04, 0.0, REFERENCE))
    assert by_point.vertices.tobytes() == configuration.vjp({"lift": 1.0}, at=at).vertices.tobytes()
    slope = configuration.jvp(alpha=1.0, at=at).coefficients["lift"]
    assert np.isclose(slope, at.coefficients.lift_slope, rtol=1e-12)


def test_openmdao_agrees_with_differences(
    configuration: Configuration, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    import openmdao.api as om
    from moldline.openmdao import PanelComponent

    monkeypatch.chdir(tmp_path)
    # One number moves the vertices: as many differences, not three for each vertex.
    mode = np.random.default_rng(5).normal(size=(configuration.vertex_count, 3)) * [1e-3, 0.0, 1e-3]
    problem = om.Problem(reports=False)
    morph = om.ExecComp(
        "vertices = base + s * mode", vertices={"shape": mode.shape, "units": "m"}, base=wing()[0], mode=mode, s=0.5
    )
    problem.model.add_subsystem("morph", morph)
    component = PanelComponent(
        configuration=configuration,
        reference=REFERENCE,
        vertices=wing()[0],
        coefficients=("lift", "induced_drag"),
        section_loads=True,
    )
    problem.model.add_subsystem("panel", component)
    problem.model.connect("morph.vertices", "panel.vertices")
    problem.setup(mode="rev")
    problem.set_val("panel.alpha", 0.03)
    problem.set_val("panel.mach", 0.2)
    problem.run_model()
    of, wrt = ["panel.lift", "panel.induced_drag", "panel.section_loads"], ["morph.s", "panel.alpha", "panel.mach"]
    exact = problem.compute_totals(of, wrt)
    for name, step in (("morph.s", 1e-2), ("panel.alpha", 1e-4), ("panel.mach", 1e-4)):
        centre = problem.get_val(name).copy()
        sides = []
        for sign in (1, -1):
            problem.set_val(name, centre + sign * step)
            problem.run_model()
            sides.append([problem.get_val(output).copy() for output in of])
        problem.set_val(name, centre)
        for output, up, down in zip(of, *sides, strict=True):
            assert np.allclose(exact[output, name].ravel(), (up - down) / (2 * step), rtol=1e-5, atol=1e-8), (
                output,
                name,
            )


def test_faults_are_exceptions_that_name_them(panels: moldline.panel.Client, configuration: Configuration) -> None:
    vertices, cells, trailing = wing()
    with pytest.raises(moldline.InvalidArgument, match=r"cells\[\d+\]"):
        panels.create_configuration(
            vertices, cells[:-1], trailing_edges=Edges(np.column_stack([trailing[:-1], trailing[1:]]))
        )
    with pytest.raises(moldline.InvalidArgument, match="wing"):
        panels.create_configuration(vertices, cells, trailing_edges=Groups("wing"))
    with pytest.raises(moldline.InvalidArgument) as caught:
        configuration.analyze(vertices * [1, 1, np.nan], reference=REFERENCE)
    assert caught.value.violations[0].field == "vertices[0][2]"
    with pytest.raises(moldline.InvalidArgument, match="mach"):
        configuration.analyze(reference=REFERENCE, mach=1.2)
    with pytest.raises(ValueError, match="there is no coefficient"):
        configuration.vjp({"drag": 1.0}, at=configuration.analyze(reference=REFERENCE))
    with pytest.raises(moldline.NotFound):
        panels.get_configuration("none")


def test_what_the_server_has_lost_is_sent_again(binary: Path) -> None:
    """A restarted server has lost everything; the client recovers by itself."""
    with Server(binary, "--threads", "2", command=PANELS) as first:
        address = first.address
        panels = moldline.panel.Client(address)
        vertices, cells, _ = wing(12, 4)
        configuration = panels.create_configuration(vertices, cells)
        before = configuration.analyze(reference=REFERENCE, alpha=0.05)
        gradient = configuration.vjp({"lift": 1.0}, at=before)
        assert first.stop() == 0
    with Server(binary, "--threads", "2", "--listen", address, command=PANELS) as second:
        after = configuration.vjp({"lift": 1.0}, at=before)
        assert after.vertices.tobytes() == gradient.vertices.tobytes()
        assert configuration.analyze(reference=REFERENCE, alpha=0.05).id == before.id
        panels.close()
        assert second.stop() == 0


def test_too_large_for_the_server_is_refused_with_both_numbers(binary: Path) -> None:
    with Server(binary, "--analysis-memory", "1", command=PANELS) as server:
        with moldline.panel.Client(server.address) as panels:
            vertices, cells, _ = wing(40, 20)
            with pytest.raises(moldline.ResourceExhausted, match=r"\d+ bytes.*1048576") as caught:
                panels.create_configuration(vertices, cells)
            assert caught.value.retry_after is None
        assert server.stop() == 0


def test_a_call_that_is_given_up_stops(panel_server: Server, panels: moldline.panel.Client) -> None:
    vertices, cells, _ = wing(60, 30)
    configuration = panels.create_configuration(vertices, cells)
    begun = threading.Event()

    class GiveUp(Exception):
        pass

    def stop(step: moldline.Progress) -> None:
        begun.set()
        raise GiveUp

    with pytest.raises(GiveUp):
        configuration.analyze(reference=REFERENCE, alpha=0.05, progress=stop)
    assert begun.is_set()
    # Its place in the pool is free again.
    small = panels.create_configuration(*wing(12, 4)[:2])
    assert small.analyze(reference=REFERENCE, timeout=60).residual <= 1e-12


def test_http_has_the_same_numbers(panel_server: Server, configuration: Configuration) -> None:
    analysis = configuration.analyze(reference=REFERENCE, mach=0.2, alpha=0.05)
    url = f"http://{panel_server.address}/v1/configurations/{configuration.id}/analyze"
    reference = {"area": 8.0, "chord": 1.0, "span": 8.0, "point": [0.25, 0.0, 0.0]}
    answer = requests.post(url, json={"mach": 0.2, "flows": [{"alpha": 0.05}], "reference": reference}, timeout=60)
    answer.raise_for_status()
    assert answer.json()["analysis_id"] == analysis.id
    assert answer.json()["flows"][0]["coefficients"]["lift"] == analysis.coefficients.lift
    assert answer.json()["flows"][0]["cp"] == analysis.cp.tolist()
    metrics = requests.get(f"http://{panel_server.address}/metrics", timeout=10).text
    assert 'rpc="Analyze"' in metrics and 'moldline_cache_hits_total{cache="analyses"}' in metrics


def test_the_command_line_gives_the_same_numbers(binary: Path, configuration: Configuration, tmp_path: Path) -> None:
    vertices, cells, _ = wing()
    moldline.write_cells(tmp_path / "wing.vtu", vertices, cells)
    options = ["--mach", "0.2", "--alpha", "2", "--area", "8", "--chord", "1", "--span", "8", "--point", "0.25,0,0"]
    files = ["--output", str(tmp_path / "flow.vtu"), "--report", str(tmp_path / "report.json")]
    command = [str(binary), "panel", "analyze", str(tmp_path / "wing.vtu"), *options, *files]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    analysis = configuration.analyze(reference=REFERENCE, mach=0.2, alpha=np.deg2rad(2.0))
    assert f"{analysis.coefficients.lift:.6f}" in done.stdout
    written = meshio.read(tmp_path / "flow.vtu")
    assert np.array_equal(written.point_data["cp"][:, 0], analysis.vertex_cp)
    configuration.write_vtu(tmp_path / "again.vtu", analysis)
    again = meshio.read(tmp_path / "again.vtu")
    assert all(np.array_equal(a, b) for a, b in zip(again.cell_data["cp"], written.cell_data["cp"], strict=True))


def test_the_chain_of_both_services_is_that_of_differences(
    panels: moldline.panel.Client, client: moldline.Client, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The E175 example, on the coarse mesh."""
    e175 = ROOT / "examples/e175"
    monkeypatch.syspath_prepend(str(e175))
    from panel_gradient import E175, Chain, scaled_direction

    shutil.copytree(e175 / "geometry", tmp_path / "geometry")
    shutil.copy(e175 / "setup.toml", tmp_path)
    shutil.copy(e175 / "study/mesh-coarse.msh", tmp_path / "mesh.msh")
    with client.create_setup(tmp_path).session() as session:
        mesh = session.setup.mesh
        configuration = panels.create_configuration(mesh.vertices, mesh.cells, cell_groups=moldline.panel.parts(mesh))
        assert configuration.symmetric and len(configuration.roots) == 2
        chain = Chain(session, configuration, ("lift", "induced_drag"), E175, mach=0.7, alpha=0.02)
        design = session.setup.baseline
        direction = 0.1 * scaled_direction(session, np.random.default_rng(2))
        exact = chain.gradients(design) @ direction
        assert np.allclose(chain.differences(design, direction, 1e-4), exact, rtol=1e-5)
    sys.modules.pop("panel_gradient", None)


def test_the_gradient_in_cpp_has_the_same_bits(
    server: Server, panel_server: Server, panels: moldline.panel.Client, client: moldline.Client
) -> None:
    optimizer = Path(os.environ.get("MOLDLINE_OPTIMIZER", ROOT / "target/cpp-examples/moldline-optimizer"))
    folder = ROOT / "tests/configurations/half"
    command = [optimizer.with_name("moldline-gradient"), server.address, panel_server.address, folder, "0.3", "0.02"]
    run = subprocess.run(list(map(str, command)), check=True, capture_output=True, text=True, timeout=120)
    told = {line.split()[0]: float(line.split()[1]) for line in run.stdout.splitlines()}
    with client.create_setup(folder).session() as session:
        mesh, moved = session.setup.mesh, session.deform()
        configuration = panels.create_configuration(mesh.vertices, mesh.cells, cell_groups=moldline.panel.parts(mesh))
        analysis = configuration.analyze(moved.vertices, reference=Reference(1.0, 1.0, 1.0), mach=0.3, alpha=0.02)
        gradient = session.vjp(vertices=configuration.vjp({"lift": 1.0}, at=analysis).vertices, at=moved).design
        names = [variable.name for variable in session.setup.variables]
    assert told == {"lift": analysis.coefficients.lift} | dict(zip(names, gradient.tolist(), strict=True))
