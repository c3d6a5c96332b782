"""How the objects of the Python client look, compare and are written, and which designs they take."""

from __future__ import annotations

import asyncio
import logging
import pickle
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import moldline
import moldline.aio
import moldline.panel.aio
import numpy as np
import pytest
from moldline.panel import Groups, Reference

from server import Server
from sphere_and_boom import write
from wing import wing

REFERENCE = Reference(area=8.0, chord=1.0, span=8.0, point=(0.25, 0.0, 0.0))


@pytest.fixture(scope="module")
def panel_server(binary: Path) -> Iterator[Server]:
    with Server(binary, "--threads", "2", command=("panel", "serve")) as server:
        yield server


def with_group(document: dict[str, Any], vertices: np.ndarray, cells: list[list[int]]) -> None:
    """Declares three more variables as a group: they bend the boom upwards."""
    document["parameterisation"]["variables"].append(
        {"name": "boom.bend", "unit": "m", "shape": [3], "lower": -0.1, "upper": 0.1}
    )
    sections = [{"type": "dihedral", "variable": "boom.bend", "degree": 2}]
    lattice = {"type": "free_form", "components": ["boom"], "shape": [3, 5, 2], "degree": [2, 2, 1]}
    document["parameterisation"]["operations"].append({**lattice, "sections": sections})


@pytest.fixture
def grouped(client: moldline.Client, tmp_path: Path) -> moldline.Setup:
    return client.create_setup(write(tmp_path / "grouped", change=with_group))


class Fragment(HTMLParser):
    """The rows of the tables of a fragment, which is checked to be well formed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows: list[list[str]] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag in {"table", "caption", "thead", "tbody", "tr", "th", "td"}, "no scripts, styles or links"
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data


def test_descriptions_are_one_short_line(client: moldline.Client, setup: moldline.Setup) -> None:
    with setup.session(label="mine") as session:
        result = session.deform({"boom.translation": 0.1}, cell_quality=True)
        shown = [client, setup, setup.mesh, session, session.state, result, result.linearisation, result.quality]
        shown += [session.jvp([1.0, 0, 0]), session.vjp(functions={"enclosed_volume": 1.0}), session.jacobian()]
        for each in [*shown, *setup.variables, *setup.groups.values(), *setup.functions, client.status()]:
            text = repr(each)
            assert "\n" not in text and len(text) < 400, text
            assert " at 0x" not in text, text
        assert repr(setup).startswith("<Setup 'sphere and boom' ") and "3 variables" in repr(setup)
        assert f"{len(setup.mesh.vertices)} vertices" in repr(setup.mesh) and "48 triangles" in repr(setup.mesh)
        assert "'mine'" in repr(session)
        assert client.address in repr(client)


def test_tables_for_notebooks_show_what_there_is(client: moldline.Client, setup: moldline.Setup) -> None:
    rows = Fragment(setup._repr_html_()).rows
    assert ["boom.translation", "0", "-0.5", "0.5", "m"] in rows
    assert ["enclosed_volume", f"{setup.functions[0].value:.6g}", "m^3"] in rows
    result = setup.deform({"boom.translation": 0.1})
    rows = Fragment(result._repr_html_()).rows
    assert ["enclosed_volume", f"{result.functions['enclosed_volume']:.6g}"] in rows
    assert [row[0] for row in rows if row[0] in ("sphere", "boom", "total")] == ["sphere", "boom", "total"]
    Fragment(client.status()._repr_html_())
    with setup.session(label="<b>&") as session:
        assert ["label", "<b>&"] in Fragment(session._repr_html_()).rows, "texts are escaped"


def test_results_compare_by_content_and_hash(setup: moldline.Setup) -> None:
    with setup.session() as session:
        one, two = (session.deform({"boom.translation": 0.1}, cell_quality=True) for _ in range(2))
        other = session.deform({"boom.translation": 0.2}, cell_quality=True)
        assert one == two and hash(one) == hash(two) and one is not two
        assert one != other and len({one, two, other}) == 2
        assert one != 1
        products = [
            lambda at: session.jvp([1.0, 0, 0], at=at),
            lambda at: session.vjp(functions={"enclosed_volume": 1.0}, at=at),
            lambda at: session.jacobian(at=at),
            lambda at: at.linearisation,
            lambda at: at.linearisation.point,
            lambda at: at.quality,
        ]
        for product in products:
            assert product(one) == product(two) != product(other)
            assert hash(product(one)) == hash(product(two))
        moved = setup.mesh.moved(one)
        assert moved == setup.mesh.moved(one.vertices) != setup.mesh
        assert hash(moved) == hash(setup.mesh.moved(one.vertices))
    numbers = moldline.DesignPoint(np.array([0.1, 0.0, 0.0]))
    assert numbers == moldline.DesignPoint([0.1, 0, 0]) and hash(numbers) == hash(moldline.DesignPoint([0.1, 0, 0]))


def test_designs_are_given_by_group(grouped: moldline.Setup) -> None:
    names = [variable.name for variable in grouped.variables]
    design = grouped.baseline
    design[names.index("boom.bend[0]") : names.index("boom.bend[2]") + 1] = 0.01, 0.02, 0.03
    expected = grouped.deform(design)
    for given in (
        {"boom.bend": [0.01, 0.02, 0.03]},
        {"boom.bend": np.array([0.01, 0.02, 0.03])},
        {"boom.bend[0]": 0.01, "boom.bend[1]": 0.02, "boom.bend[2]": 0.03},
    ):
        assert np.array_equal(grouped.deform(given).vertices, expected.vertices)
    all_alike = grouped.deform({"boom.bend": 0.02})
    assert np.array_equal(all_alike.vertices, grouped.deform({"boom.bend": [0.02] * 3}).vertices)
    # Wherever designs go.
    volume = {"enclosed_volume": 1.0}
    direct = grouped.vjp(functions=volume, at=all_alike)
    assert grouped.vjp(functions=volume, at={"boom.bend": 0.02}) == direct
    assert grouped.vjp(functions=volume, at=moldline.DesignPoint({"boom.bend": 0.02})) == direct
    with grouped.session() as session:
        session.update({"boom.bend": 0.02, "boom.lift": 0.1})
        assert dict(zip(names, session.design.design, strict=True))["boom.bend[1]"] == 0.02
    assert grouped.check(design={"boom.bend": 0.02}, variables=["boom.lift"]).dual_max < 1e-9


@pytest.mark.parametrize(
    ("design", "message"),
    [
        ({"boom.bend": [0.01, 0.02]}, r"'boom.bend' takes values of shape \(3,\), or one number for all; .*\(2,\)"),
        ({"boom.bend": "0.01"}, "'boom.bend' takes numbers, not '0.01'"),
        ({"boom.bend": ["0.01"] * 3}, "'boom.bend' takes numbers"),
        ({"boom.bend": [True] * 3}, "'boom.bend' takes numbers"),
        ({"boom.bend": [1j] * 3}, "'boom.bend' takes numbers"),
        ({"boom.lift": [0.1]}, r"'boom.lift' takes a number, not values of shape \(1,\)"),
        ({"boom.bend": 0.01, "boom.bend[1]": 0.02}, r"'boom.bend\[1\]' is given twice"),
        ("boom", "the design takes numbers, not 'boom'"),
        (["0"] * 6, "the design takes numbers"),
    ],
)
def test_wrong_designs_are_refused_before_they_are_sent(grouped: moldline.Setup, design: Any, message: str) -> None:
    with grouped.session() as session:
        calls = [grouped.deform, session.deform, session.update, lambda at: grouped.check(design=at)]
        if not isinstance(design, str):  # As a point of linearisation, a text is an id.
            calls += [lambda at: session.jacobian(at=at), lambda at: session.vjp(functions=[1.0] * 5, at=at)]
        for call in calls:
            with pytest.raises(ValueError, match=message):
                call(design)
        session.refresh()
        assert session.generation == 1, "nothing was stored"


def test_unknown_names_are_the_servers_to_refuse(setup: moldline.Setup) -> None:
    with pytest.raises(moldline.InvalidArgument, match=r"boom\.twist"):
        setup.deform({"boom.twist": 1.0})


def test_calls_without_a_session_are_those_of_a_session(server: Server, setup: moldline.Setup) -> None:
    with server.client() as client:
        mine = client.get_setup(setup.id)
        before = {state.id for state in client.list_sessions()}
        at = mine.deform({"boom.translation": 0.1})
        with setup.session() as session:
            assert at == session.deform({"boom.translation": 0.1})
            assert mine.jvp([1.0, 0, 0], at=at) == session.jvp([1.0, 0, 0], at=at)
            assert mine.vjp(vertices=at.vertices, at=at) == session.vjp(vertices=at.vertices, at=at)
            assert mine.jacobian(at=at) == session.jacobian(at=at)
        opened = {state.id for state in client.list_sessions()} - before
        assert len(opened) == 1, "one session for all calls"
    with server.client() as client:
        assert opened.isdisjoint(state.id for state in client.list_sessions()), "closed with its client"


def test_progress_in_a_pipe_leaves_no_trace(server: Server, setup_folder: Path) -> None:
    code = "import moldline, sys; c = moldline.Client(sys.argv[1]); c.create_setup(sys.argv[2], progress=True).deform()"
    command = [sys.executable, "-c", code, server.address, str(setup_folder)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert (run.stdout, run.stderr) == ("", "")


def test_calls_are_logged_where_one_listens(
    client: moldline.Client, setup: moldline.Setup, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.DEBUG, "moldline"):
        setup.deform()
    assert any(re.fullmatch(r"Deform: \d+\.\d ms", record.getMessage()) for record in caplog.records)
    caplog.clear()
    with caplog.at_level(logging.DEBUG, "moldline"), moldline.Client("127.0.0.1:1", timeout=1.0) as nobody:
        with pytest.raises(moldline.MoldlineError):
            nobody.status()
    assert any(r.levelno == logging.WARNING and "again in" in r.getMessage() for r in caplog.records)


def test_the_version_is_the_packages() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*", moldline.__version__)


def test_panel_objects_show_compare_and_travel(panel_server: Server) -> None:
    vertices, cells, trailing = wing()
    with moldline.panel.Client(panel_server.address) as panels:
        configuration = panels.create_configuration(
            vertices,
            cells,
            vertex_groups={"trailing": trailing},
            trailing_edges=Groups("trailing"),
            cell_groups={"wing": range(len(cells))},
        )
        one, two = (configuration.analyze(reference=REFERENCE, alpha=0.05) for _ in range(2))
        other = configuration.analyze(reference=REFERENCE, alpha=0.06)
        assert one == two and hash(one) == hash(two)
        assert one != other
        products = [
            lambda at: configuration.vjp({"lift": 1.0}, at=at),
            lambda at: configuration.jvp(alpha=1.0, at=at),
            lambda at: at.sections,
            lambda at: at.total,
            lambda at: at.point,
        ]
        for product in products:
            assert product(one) == product(two) != product(other)
            assert hash(product(one)) == hash(product(two))
        for each in (
            panels,
            configuration,
            one,
            one.point,
            one.sections,
            one.total,
            configuration.vjp([1.0] * 9, at=one),
        ):
            assert "\n" not in repr(each) and len(repr(each)) < 400, repr(each)
        assert f"{configuration.unknowns} unknowns" in repr(configuration)
        rows = Fragment(one._repr_html_()).rows
        assert ["lift", f"{one.coefficients.lift:.6g}", "1"] in rows
        assert ["wing", *(f"{x:.6g}" for x in (one.components["wing"].lift, one.components["wing"].drag))] == next(
            row[:3] for row in rows if row[0] == "wing"
        )
        assert ["unknowns", str(configuration.unknowns)] in Fragment(configuration._repr_html_()).rows
        copy = pickle.loads(pickle.dumps(configuration))
        assert copy.analyze(reference=REFERENCE, alpha=0.05) == one
        assert pickle.loads(pickle.dumps(one)) == one
        bare = configuration.analyze(reference=REFERENCE, pressures=False)
        with pytest.raises(ValueError, match="pressures=True"):
            configuration.to_pyvista(bare)


def test_asyncio_has_the_same(server: Server, panel_server: Server, setup: moldline.Setup) -> None:
    async def run() -> None:
        async with moldline.aio.Client(server.address) as client:
            copy = pickle.loads(pickle.dumps(await client.get_setup(setup.id)))
            assert repr(copy) == repr(setup) and copy._repr_html_() == setup._repr_html_()
            assert copy._client.address == server.address
            async with await copy.session() as session:
                moved = await session.deform({"boom.translation": 0.1})
                assert moved == setup.deform({"boom.translation": 0.1})
                with pytest.raises(ValueError, match="takes numbers"):
                    await session.deform({"boom.translation": "0.1"})
            await copy._client.close()
        async with moldline.panel.aio.Client(panel_server.address) as panels:
            vertices, cells, _ = wing()
            configuration = await panels.create_configuration(vertices, cells)
            assert repr(configuration).startswith("<Configuration ")
            Fragment(configuration._repr_html_())

    asyncio.run(run())
