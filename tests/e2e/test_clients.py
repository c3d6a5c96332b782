"""The same scenarios through every client, on real servers; their answers must be the same to the last bit."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sphere_and_boom
from clients import LANGUAGES, Client, Refused, bits
from server import Server
from wing import wing

#: Off the baseline, where nothing is symmetric; in the order of the variables.
NAMED = {"boom.translation": 0.2, "boom.lift": 0.1, "boom.far": -0.1}
VECTOR = np.array(list(NAMED.values()))

Same = Callable[[str, Any], None]


@pytest.fixture(scope="module", params=LANGUAGES)
def client(request: pytest.FixtureRequest, server: Server) -> Iterator[Client]:
    client = Client(request.param)
    client("connect", address=server.address)
    yield client
    client.close()


@pytest.fixture(scope="module")
def answers() -> dict[str, Any]:
    return {}


@pytest.fixture
def same(answers: dict[str, Any]) -> Same:
    """Compares an answer bit for bit with that of the previous clients."""

    def check(name: str, answer: Any) -> None:
        assert bits(answer) == answers.setdefault(name, bits(answer))

    return check


@pytest.fixture
def setup(client: Client, setup_folder: Path) -> Any:
    return client("create_setup", path=str(setup_folder))


@pytest.fixture
def session(client: Client, setup: Any) -> Iterator[str]:
    session = client("open", setup=setup["setup"])["session"]
    yield session
    client("close", session=session)


def own(client: Client) -> int:
    """A number for each language, for content of its own."""
    return LANGUAGES.index(client.language)


def test_a_setup_is_created_once(client: Client, tmp_path: Path) -> None:
    folder = sphere_and_boom.write(tmp_path / "folder", length=2.5 + 0.01 * (1 + own(client)))
    first = client("create_setup", path=str(folder))
    assert first["built"]
    assert first["stages"][:2] == ["receive", "read"]
    assert "factorisation" in first["stages"]
    again = client("create_setup", path=str(folder))
    assert again["setup"] == first["setup"] and not again["built"]
    assert client("get_setup", setup=first["setup"])["setup"] == first["setup"]
    listed = {each["setup"]: each for each in client("list_setups")["setups"]}
    assert listed[first["setup"]]["vertex_count"] == first["vertex_count"]
    assert abs(listed[first["setup"]]["created"] - time.time()) < 600
    assert client("delete_setup", setup=first["setup"]) == {}
    assert first["setup"] not in [each["setup"] for each in client("list_setups")["setups"]]


def test_a_request_id_names_one_content(client: Client, setup_folder: Path, tmp_path: Path) -> None:
    name = f"request of {client.language}"
    first = client("create_setup", path=str(setup_folder), request_id=name)
    assert client("create_setup", path=str(setup_folder), request_id=name)["setup"] == first["setup"]
    other = sphere_and_boom.write(tmp_path / "other", length=2.7)
    with pytest.raises(Refused) as refused:
        client("create_setup", path=str(other), request_id=name)
    assert refused.value.code == "ALREADY_EXISTS"
    assert refused.value.fields == ["request_id"]


def test_all_see_the_same_setup(client: Client, setup: Any, same: Same) -> None:
    same("set-up", {name: setup[name] for name in setup if name not in ("built", "stages")})
    assert setup["variables"] == list(NAMED)
    assert setup["upper"].tolist() == [0.5, 0.2, 5.0]
    mesh = client("mesh", setup=setup["setup"])
    assert mesh["vertices"].shape == (setup["vertex_count"], 3)
    assert mesh["cells"].dtype == np.uint32 and mesh["cells"].shape == (setup["cell_count"], 4)
    assert mesh["seam"].sum() == sphere_and_boom.SECTORS
    same("mesh", mesh)
    points = client("control_points", setup=setup["setup"])
    assert [len(points[component]) for component in setup["components"]] == setup["control_point_counts"]
    same("control points", points)


def test_who_may_use_a_setup_is_said(client: Client, tmp_path: Path) -> None:
    folder = sphere_and_boom.write(tmp_path / "shared", length=2.6 + 0.01 * own(client))
    setup = client("create_setup", path=str(folder), visibility="tenants", shared_with=["aero"])
    assert setup["access"] == {"owned": True, "visibility": "tenants", "shared_with": ["aero"]}
    public = {"owned": True, "visibility": "public", "shared_with": []}
    assert client("share", setup=setup["setup"], visibility="public")["access"] == public
    assert client("get_setup", setup=setup["setup"])["access"] == public


def test_names_and_vector_are_the_same_design(client: Client, setup: Any, session: str, same: Same) -> None:
    by_name = client("deform", session=session, design=NAMED, cell_quality=True)
    by_vector = client("deform", session=session, design=VECTOR, cell_quality=True)
    assert by_name.pop("engine_seconds") > 0 and by_vector.pop("engine_seconds") > 0
    assert bits(by_name) == bits(by_vector)
    assert by_name["vertices"].shape == (setup["vertex_count"], 3)
    assert by_name["quality"][0] == setup["cell_count"]
    same("deformation", by_name)
    baseline = client("deform", session=session)
    np.testing.assert_allclose(baseline["vertices"], client("mesh", setup=setup["setup"])["vertices"], atol=1e-12)
    np.testing.assert_allclose(baseline["functions"], setup["function_values"], rtol=1e-9)


def test_given_control_points_take_the_designs_place(client: Client, setup: Any, session: str, same: Same) -> None:
    given = {"boom": client("control_points", setup=setup["setup"])["boom"] + [0.1, 0.0, 0.05]}
    moved = client("deform", session=session, control_points=given)
    named = client("deform", session=session, design={"boom.translation": 0.1, "boom.lift": 0.05})
    np.testing.assert_allclose(moved["vertices"], named["vertices"], atol=1e-9)
    same("given control points", moved["vertices"])
    gradient = client(
        "vjp",
        session=session,
        functions=np.eye(len(setup["functions"]))[:1],
        by_control_points=["boom"],
        at={"deformation": moved["id"]},
    )
    assert not gradient["design"].any()
    assert gradient["control_points"]["boom"].any()
    same("gradient by control points", gradient)


def test_forward_and_reverse_agree(client: Client, setup: Any, session: str, same: Same) -> None:
    """w . (J v) = (J^T w) . v, by design and control points, for three directions and seeds."""
    random = np.random.default_rng(1)
    counts = dict(zip(setup["components"], map(int, setup["control_point_counts"]), strict=True))
    directions = random.normal(size=(3, 3))
    points = {component: random.normal(size=(3, count, 3)) for component, count in counts.items()}
    of_vertices = random.normal(size=(3, int(setup["vertex_count"]), 3))
    of_functions = random.normal(size=(3, len(setup["functions"])))
    at = {"deformation": client("deform", session=session, design=NAMED)["id"]}
    forward = client("jvp", session=session, directions=directions, control_points=points, at=at)
    reverse = client(
        "vjp", session=session, vertices=of_vertices, functions=of_functions, by_control_points=list(counts), at=at
    )
    one = np.einsum("inx,jnx->ij", of_vertices, forward["vertices"]) + of_functions @ forward["functions"].T
    other = reverse["design"] @ directions.T
    for component, vectors in points.items():
        other = other + np.einsum("inx,jnx->ij", reverse["control_points"][component], vectors)
    scale = np.linalg.norm(of_vertices, axis=(1, 2))[:, None] * np.linalg.norm(forward["vertices"], axis=(1, 2))
    assert np.max(np.abs(one - other) / scale) <= 1e-12
    same("forward", forward)
    same("reverse", reverse)


def test_the_jacobian_has_the_products_columns(client: Client, setup: Any, session: str, same: Same) -> None:
    jacobian = client("jacobian", session=session, at={"design": VECTOR})
    assert jacobian.pop("fraction") == 1.0
    together = client("jvp", session=session, directions=np.eye(3), at={"design": NAMED})
    assert bits(jacobian) == bits(together)
    same("jacobian", jacobian)


def test_a_large_block_goes_in_several_requests(client: Client, session: str, same: Same) -> None:
    directions = np.random.default_rng(4).normal(size=(150, 3))
    block = client("jvp", session=session, directions=directions, at={"design": VECTOR})
    last = client("jvp", session=session, directions=directions[128:], at={"design": VECTOR})
    assert block["vertices"].shape[0] == block["functions"].shape[0] == 150
    assert block["vertices"][128:].tobytes() == last["vertices"].tobytes()
    same("large block", block)


BAD = {
    "NaN": ({"design": np.array([0.0, math.nan, 0.0])}, "INVALID_ARGUMENT", "design[1]"),
    "above its bound": ({"design": np.array([0.75, 0.0, 0.0])}, "INVALID_ARGUMENT", "design[0]"),
    "too short": ({"design": np.zeros(2)}, "INVALID_ARGUMENT", "design"),
    "unknown name": ({"design": {"boom.translaton": 0.1}}, "INVALID_ARGUMENT", 'design["boom.translaton"]'),
    "unknown component": ({"control_points": {"wing": np.zeros((4, 3))}}, "INVALID_ARGUMENT", 'control_points["wing"]'),
    "seam lost": ({"design": {"boom.far": 4.0}}, "FAILED_PRECONDITION", "design"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused_by_field(client: Client, session: str, same: Same, name: str) -> None:
    arguments, code, field = BAD[name]
    with pytest.raises(Refused) as refused:
        client("deform", session=session, **arguments)
    assert refused.value.code == code
    assert refused.value.fields == [field]
    assert refused.value.descriptions[0] in refused.value.message
    same(name, [refused.value.message, refused.value.descriptions])


def test_a_bad_setup_is_refused_by_field(client: Client, tmp_path: Path, same: Same) -> None:
    def spoil(document: dict[str, Any], vertices: np.ndarray, cells: list[list[int]]) -> None:
        cells[3] = [0, 1, 99120]
        document["mesh"] = {"vertices": vertices.tolist(), "cells": cells}

    with pytest.raises(Refused) as refused:
        client("create_setup", path=str(sphere_and_boom.write(tmp_path, change=spoil)))
    assert refused.value.code == "INVALID_ARGUMENT"
    assert refused.value.fields == ["mesh.cells[3][2]"]
    same("bad set-up", refused.value.message)
    with pytest.raises(Refused) as refused:
        client("create_setup", path=str(tmp_path / "nowhere.rar"))
    assert refused.value.code == "CLIENT" and "nowhere.rar" in refused.value.message


def test_what_does_not_exist_is_not_found(client: Client, same: Same) -> None:
    for what, field in [("get_setup", "setup_id"), ("resume", "session_id")]:
        with pytest.raises(Refused) as refused:
            client(what, setup="no such", session="no such")
        assert refused.value.code == "NOT_FOUND"
        assert refused.value.fields == [field]
        same(what, refused.value.message)


def test_a_session_is_stored_resumed_and_closed(client: Client, server: Server, setup: Any, same: Same) -> None:
    label = f"of {client.language}"
    opened = client("open", setup=setup["setup"], label=label, request_id=label)
    session = opened["session"]
    assert client("open", setup=setup["setup"], label=label, request_id=label)["session"] == session
    stored = client("update", session=session, design=NAMED)
    assert stored["generation"] == opened["generation"] + 1
    assert stored["label"] == label
    assert stored["design"].tolist() == VECTOR.tolist()
    points = {"boom": client("control_points", setup=setup["setup"])["boom"] + [0.1, 0.0, 0.0]}
    stored = client("update", session=session, design=VECTOR, control_points=points, label="further")
    same("stored design", [stored["design"], stored["control_points"]])
    # Another connection continues the session.
    with_other = Client(client.language)
    with_other("connect", address=server.address)
    resumed = with_other("resume", session=session)
    assert bits(resumed) == bits(stored)
    assert session in [each["session"] for each in with_other("list_sessions")["sessions"]]
    advanced = with_other("update", session=session, design=np.zeros(3))
    assert advanced["generation"] == opened["generation"] + 3
    # The state of this connection is out of date now.
    with pytest.raises(Refused) as refused:
        client("update", session=session, design=VECTOR)
    assert refused.value.code == "ABORTED"
    assert bits(client("refresh", session=session)) == bits(advanced)
    assert client("update", session=session, label="at last")["generation"] == advanced["generation"] + 1
    with_other("close", session=session)
    with_other.close()
    with pytest.raises(Refused) as refused:
        client("deform", session=session)
    assert refused.value.code == "NOT_FOUND" and refused.value.fields == ["session_id"]
    assert client("close", session=session) == {}


def test_a_dropped_linearisation_is_made_again(client: Client, binary: Path, setup_folder: Path, same: Same) -> None:
    with Server(binary, "--linearisation-memory", "0") as small:
        other = Client(client.language)
        other("connect", address=small.address)
        session = other("open", setup=other("create_setup", path=str(setup_folder))["setup"])["session"]
        first = other("deform", session=session, design=NAMED)["id"]
        held = other("jvp", session=session, directions=np.eye(3), at={"id": first})
        other("deform", session=session)
        with pytest.raises(Refused) as refused:
            other("jvp", session=session, directions=np.eye(3), at={"id": first})
        assert refused.value.code == "NOT_FOUND" and refused.value.fields == ["at.linearisation_id"]
        again = other("jvp", session=session, directions=np.eye(3), at={"deformation": first})
        assert bits(again) == bits(held)
        same("made again", again)
        other.close()


def test_a_deadline_ends_a_call(client: Client, session: str) -> None:
    start = time.monotonic()
    with pytest.raises(Refused) as refused:
        client("deform", session=session, design=NAMED, timeout=1e-4)
    assert refused.value.code == "DEADLINE_EXCEEDED", refused.value.message
    assert time.monotonic() - start < 10, "it was tried again"
    assert client("deform", session=session, design=NAMED)["quality"][0] > 0


def test_a_build_that_is_cancelled_ends_on_the_server(client: Client, tmp_path: Path) -> None:
    folder = sphere_and_boom.write(tmp_path, rings=61 + own(client))
    with pytest.raises(Refused) as refused:
        client("create_setup", path=str(folder), cancel_at="ownership")
    assert refused.value.code == "CANCELLED"
    end = time.monotonic() + 20
    while client("status")["work"]:
        assert time.monotonic() < end, "the build goes on"
        time.sleep(0.05)
    assert client("create_setup", path=str(folder))["built"]


def test_the_servers_status_is_told(client: Client, session: str) -> None:
    status = client("status")
    assert status["uptime_seconds"] > 0 and status["version"]
    assert status["sessions"] >= 1 and status["setups_stored"] >= 1


CHECK = {"designs": 2, "seed": 5, "variables": ["boom.translation", "boom.lift"]}


@pytest.fixture(scope="module")
def near_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small set-up within bounds where random designs have a mesh."""

    def near(document: dict[str, Any], _vertices: np.ndarray, _cells: list[list[int]]) -> None:
        far = document["parameterisation"]["variables"][2]
        far["lower"], far["upper"] = -0.2, 0.2

    return sphere_and_boom.write(tmp_path_factory.mktemp("near"), change=near)


def test_a_check_finds_the_same_errors(client: Client, near_folder: Path, same: Same) -> None:
    setup = client("create_setup", path=str(near_folder))
    check = client("check", setup=setup["setup"], **CHECK)
    assert "check" in check["stages"]
    assert [(row["design"], row["variable"]) for row in check["rows"]] == [
        (design, variable) for design in range(2) for variable in CHECK["variables"]
    ]
    dot_product, dual, central_difference = check["maxima"]
    assert dot_product <= 1e-12 and dual <= 1e-10 and central_difference <= 1e-6
    assert check["seed"] == 5 and check["designs"][0]["design"].tolist() == setup["baseline"].tolist()
    assert all(row["best"][1] == np.nanmin(row["differences"][:, 1]) for row in check["rows"])
    same("check", {name: check[name] for name in check if name != "stages"})
    alone = client("check", setup=setup["setup"], design=NAMED, variables=["boom.lift"])
    assert len(alone["designs"]) == len(alone["rows"]) == 1
    assert alone["designs"][0]["design"].tolist() == VECTOR.tolist()
    same("check of a design", {name: alone[name] for name in alone if name != "stages"})


def test_a_bad_check_is_refused_by_field(client: Client, near_folder: Path, same: Same) -> None:
    setup = client("create_setup", path=str(near_folder))["setup"]
    for arguments, field in [
        ({"designs": 17}, "designs"),
        ({"variables": ["boom.lift", "boom.left"]}, "variables[1]"),
        ({"design": np.array([0.0, math.nan, 0.0])}, "design[1]"),
    ]:
        with pytest.raises(Refused) as refused:
            client("check", setup=setup, **arguments)
        assert refused.value.code == "INVALID_ARGUMENT" and refused.value.fields == [field]
        same(f"check of a bad {field}", refused.value.message)


PANELS = ("panel", "serve")
REFERENCE = {"area": 8.0, "chord": 1.0, "span": 8.0, "point": [0.25, 0.0, 0.0]}
FLOW = {"mach": 0.3, "reference": REFERENCE}


@pytest.fixture(scope="module")
def panel_server(binary: Path) -> Iterator[Server]:
    with Server(binary, "--threads", "2", command=PANELS) as server:
        yield server
        assert server.stop() == 0


@pytest.fixture(scope="module", params=LANGUAGES)
def panels(request: pytest.FixtureRequest, panel_server: Server) -> Iterator[Client]:
    client = Client(request.param)
    client("connect", address=panel_server.address)
    yield client
    client.close()


def create_wing(panels: Client, **options: Any) -> Any:
    vertices, cells, trailing = wing()
    groups = {"wing": np.arange(len(cells), dtype=np.uint32)}
    edges = {"trailing": trailing.astype(np.uint32)}
    return panels(
        "create_configuration",
        vertices=vertices,
        cells=cells,
        cell_groups=groups,
        vertex_groups=edges,
        **{"trailing_edges": {"groups": ["trailing"]}, **options},
    )


@pytest.fixture
def configuration(panels: Client) -> Any:
    return create_wing(panels)


def flow_answer(analysis: Any) -> Any:
    """An analysis without what depends on earlier calls."""
    return {name: analysis[name] for name in analysis if name != "reused"}


def test_all_see_the_same_configuration(panels: Client, configuration: Any, same: Same) -> None:
    assert configuration["symmetric"] and configuration["components"] == ["wing"]
    assert configuration["trailing_edges"].shape == (6, 2)
    assert bits(panels("get_configuration", configuration=configuration["configuration"])) == bits(configuration)
    same("configuration", configuration)
    trailing = wing()[2].astype(np.uint32)
    for name, options in {
        "edges": {"trailing_edges": {"edges": np.column_stack([trailing[:-1], trailing[1:]])}},
        "angle": {"trailing_edges": {"angle": 120.0}},
        "none": {"trailing_edges": {"none": True}, "components": []},
        "options": {"symmetry": "half", "solver": "iterative", "tolerance": 1e-10},
    }.items():
        same(f"configuration by {name}", create_wing(panels, **options))


def test_all_see_the_same_flow(panels: Client, configuration: Any, same: Same) -> None:
    vertices = wing()[0] * [1.0, 1.0, 1.1]
    swept = panels(
        "analyze", configuration=configuration["configuration"], vertices=vertices, alphas=[0.0, 0.05, -0.02], **FLOW
    )
    # The solution may be that of the previous client.
    assert swept["stages"] in ([], ["influence", "factorisation", "solution"])
    assert len({analysis["id"] for analysis in swept["analyses"]}) == 1
    level, raised, _ = swept["analyses"]
    # The cells of the flat tip are cut along one of their diagonals.
    assert abs(level["coefficients"][0]) < 1e-9 and raised["coefficients"][0] > 0.2
    assert raised["cp"].shape == (configuration["cell_count"],)
    assert raised["vertex_cp"].shape == (configuration["vertex_count"],)
    same("sweep", [flow_answer(analysis) for analysis in swept["analyses"]])
    (bare,) = panels("analyze", configuration=configuration["configuration"], alphas=[0.05], pressures=False, **FLOW)[
        "analyses"
    ]
    assert bare["cp"].size == bare["vertex_cp"].size == 0
    same("flow without pressures", flow_answer(bare))


#: Extents of one vector of the inputs and outputs; `None` stands for the vertices, sections or cells.
INPUTS = {"vertices": (None, 3), "alpha": (), "mach": (), "area": (), "chord": (), "point": (3,)}
OUTPUTS = {"coefficients": (9,), "section_loads": (None,), "cp": (None,)}


def random_blocks(configuration: Any, kinds: dict[str, tuple[int | None, ...]], count: int, seed: int) -> Any:
    random = np.random.default_rng(seed)
    counts = {
        "vertices": int(configuration["vertex_count"]),
        "section_loads": len(configuration["trailing_edges"]),
        "cp": int(configuration["cell_count"]),
    }
    return {
        name: random.normal(size=(count, *(counts[name] if extent is None else extent for extent in shape)))
        for name, shape in kinds.items()
    }


def test_panel_products_are_each_others_transpose(panels: Client, configuration: Any, same: Same) -> None:
    """w . (J v) = (J^T w) . v, over all inputs and outputs, for three directions and seeds."""
    name = configuration["configuration"]
    vertices = wing()[0]
    analysis = panels("analyze", configuration=name, vertices=vertices, alphas=[0.04], **FLOW)["analyses"][0]
    directions, seeds = random_blocks(configuration, INPUTS, 3, 1), random_blocks(configuration, OUTPUTS, 3, 2)
    at = {"analysis": analysis["id"]}
    forward = panels("panel_jvp", configuration=name, at=at, **directions)
    reverse = panels("panel_vjp", configuration=name, at=at, **seeds)
    for block, shape in {**INPUTS, "sideslip": ()}.items():
        assert reverse[block].shape[0] == 3 and reverse[block].ndim == 1 + len(shape)
    flat = lambda blocks, names: np.concatenate([np.reshape(blocks[each], (3, -1)) for each in names], axis=1)
    one = flat(seeds, OUTPUTS) @ flat(forward, OUTPUTS).T
    other = flat(reverse, INPUTS) @ flat(directions, INPUTS).T
    np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-8 * np.abs(one).max())
    same("panel forward", forward)
    same("panel reverse", reverse)
    # A point without an analysis gives the same bits.
    point = {"vertices": vertices, "alpha": 0.04, "sideslip": 0.0, **FLOW}
    assert bits(panels("panel_vjp", configuration=name, at=point, **seeds)) == bits(reverse)


def test_a_large_panel_block_goes_in_several_requests(panels: Client, configuration: Any, same: Same) -> None:
    point = {"alpha": 0.04, "sideslip": 0.0, **FLOW}
    directions = random_blocks(configuration, {"alpha": (), "point": (3,)}, 150, 4)
    name = configuration["configuration"]
    block = panels("panel_jvp", configuration=name, at=point, **directions)
    last = panels("panel_jvp", configuration=name, at=point, **{each: directions[each][128:] for each in directions})
    assert block["coefficients"].shape == (150, 9)
    assert all(block[each][128:].tobytes() == last[each].tobytes() for each in block)
    same("large panel block", block)


def test_panel_faults_are_refused_by_field(panels: Client, configuration: Any, same: Same) -> None:
    name = configuration["configuration"]
    spoilt = wing()[0]
    spoilt[0, 2] = math.nan
    for field, arguments in {
        "vertices[0][2]": {"vertices": spoilt, **FLOW},
        "mach": {**FLOW, "mach": 1.2},
    }.items():
        with pytest.raises(Refused) as refused:
            panels("analyze", configuration=name, alphas=[0.0], **arguments)
        assert refused.value.code == "INVALID_ARGUMENT" and refused.value.fields == [field]
        same(f"panel fault in {field}", [refused.value.message, refused.value.descriptions])
    with pytest.raises(Refused) as refused:
        create_wing(panels, trailing_edges={"groups": ["wing"]})
    assert refused.value.code == "INVALID_ARGUMENT"
    same("unknown vertex group", [refused.value.message, refused.value.fields])
    with pytest.raises(Refused) as refused:
        panels("get_configuration", configuration="none")
    assert refused.value.code == "NOT_FOUND"
    same("unknown configuration", [refused.value.message, refused.value.fields])
    with pytest.raises(Refused) as refused:
        panels("panel_jvp", configuration=name, at={"alpha": 0.0, "sideslip": 0.0, **FLOW}, alpha=np.zeros(0))
    assert refused.value.code in ("CLIENT", "INVALID_ARGUMENT")


def test_a_dropped_configuration_is_sent_again(panels: Client, binary: Path, same: Same) -> None:
    """A restarted panel server knows nothing; its client need not care."""
    client = Client(panels.language)
    seeds = {"coefficients": np.eye(9)[:1]}
    with Server(binary, "--threads", "2", command=PANELS) as first:
        address = first.address
        client("connect", address=address)
        name = create_wing(client)["configuration"]
        analysis = client("analyze", configuration=name, alphas=[0.05], **FLOW)["analyses"][0]
        before = client("panel_vjp", configuration=name, at={"analysis": analysis["id"]}, **seeds)
        assert first.stop() == 0
    with Server(binary, "--threads", "2", "--listen", address, command=PANELS) as second:
        after = client("panel_vjp", configuration=name, at={"analysis": analysis["id"]}, **seeds)
        assert bits(after) == bits(before)
        assert second.stop() == 0
    with Server(binary, "--threads", "2", "--listen", address, command=PANELS) as third:
        again = client("analyze", configuration=name, alphas=[0.05], **FLOW)["analyses"][0]
        assert bits(flow_answer(again)) == bits(flow_answer(analysis))
        client.close()
        assert third.stop() == 0
    same("sent again", before)


def test_an_analysis_that_is_cancelled_or_late_ends(panels: Client) -> None:
    vertices, cells, _ = wing(60, 30 + own(panels))
    large = panels("create_configuration", vertices=vertices, cells=cells)["configuration"]
    with pytest.raises(Refused) as refused:
        panels("analyze", configuration=large, alphas=[0.05], cancel_at="influence", **FLOW)
    assert refused.value.code == "CANCELLED"
    # Its place is free for the next one.
    small = create_wing(panels)["configuration"]
    assert panels("analyze", configuration=small, alphas=[0.05], timeout=60.0, **FLOW)["analyses"]
    start = time.monotonic()
    with pytest.raises(Refused) as refused:
        panels("analyze", configuration=large, alphas=[0.05], timeout=0.05, **FLOW)
    assert refused.value.code == "DEADLINE_EXCEEDED", refused.value.message
    assert time.monotonic() - start < 10, "it was tried again"
