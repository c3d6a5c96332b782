"""Bad input gives a typed error that names field, index and value; other clients are served meanwhile."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import moldline
import numpy as np
import pytest

import sphere_and_boom
from server import Server

Change = Callable[[dict[str, Any], np.ndarray, list[list[int]]], None]


@pytest.fixture(autouse=True)
def others_are_served(server: Server, setup_folder: Path) -> Iterator[None]:
    """Another client's session works before, and still works after."""
    with server.client() as client, client.create_setup(setup_folder).session() as session:
        before = session.deform({"boom.translation": 0.1}).vertices.tobytes()
        yield
        assert session.deform({"boom.translation": 0.1}).vertices.tobytes() == before


def patch(**changes: Any) -> Change:
    """Replaces the boom by a single faulty bilinear patch."""

    def change(document: dict[str, Any], vertices: np.ndarray, cells: list[list[int]]) -> None:
        flat = {
            "degree_u": 1,
            "degree_v": 1,
            "knots_u": [0, 0, 1, 1],
            "knots_v": [0, 0, 1, 1],
            "control_points": [[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]],
        }
        document["components"][1] = {"name": "boom", "patches": [{**flat, **changes}]}

    return change


def spoil_vertex(vertex: int, axis: int, value: float) -> Change:
    def change(document: dict[str, Any], vertices: np.ndarray, cells: list[list[int]]) -> None:
        vertices[vertex, axis] = value

    return change


def inline(vertices: Any = None, cells: Any = None) -> Change:
    """The mesh written into the set-up file, with other vertices or cells."""

    def change(document: dict[str, Any], own_vertices: np.ndarray, own_cells: list[list[int]]) -> None:
        document["mesh"] = {
            "vertices": own_vertices.tolist() if vertices is None else vertices,
            "cells": own_cells if cells is None else cells,
        }

    return change


def replace_cell(index: int, cell: list[int]) -> Change:
    def change(document: dict[str, Any], vertices: np.ndarray, cells: list[list[int]]) -> None:
        cells[index] = cell
        inline()(document, vertices, cells)

    return change


def remove_cell(document: dict[str, Any], vertices: np.ndarray, cells: list[list[int]]) -> None:
    del cells[5]


def write_field(path: list[Any], value: Any) -> Change:
    """Sets one field of the set-up file."""

    def change(document: dict[str, Any], vertices: np.ndarray, cells: list[list[int]]) -> None:
        at: Any = document
        for key in path[:-1]:
            at = at[key]
        at[path[-1]] = value

    return change


SETUPS: dict[str, tuple[Change, str, list[str]]] = {
    "control point NaN": (
        patch(control_points=[[[0, 0, 0], [0, math.nan, 0]], [[1, 0, 0], [1, 1, 0]]]),
        "components[1].patches[0].control_points[0][1][1]",
        ["NaN"],
    ),
    "control point infinite": (
        patch(control_points=[[[0, 0, 0], [0, 1, 0]], [[1, 0, math.inf], [1, 1, 0]]]),
        "components[1].patches[0].control_points[1][0][2]",
        ["inf"],
    ),
    "knots decreasing": (patch(knots_u=[0, 1, 0.5, 1]), "components[1].patches[0].knots_u[2]", ["0.5", "1"]),
    "knots NaN": (patch(knots_v=[0, 0, math.nan, 1]), "components[1].patches[0].knots_v[2]", ["NaN"]),
    "too few knots": (patch(knots_u=[0, 1]), "components[1].patches[0].knots_u", ["2"]),
    "rows do not match the knots": (
        patch(control_points=[[[0, 0, 0], [0, 1, 0]]]),
        "components[1].patches[0].control_points",
        ["1 rows", "2"],
    ),
    "columns do not match the knots": (
        patch(control_points=[[[0, 0, 0], [0, 1, 0]], [[1, 0, 0]]]),
        "components[1].patches[0].control_points[1]",
        ["1", "2"],
    ),
    "degree too high": (patch(degree_u=40), "components[1].patches[0].degree_u", ["40", "9"]),
    "weight not positive": (
        patch(weights=[[1, 1], [0, 1]]),
        "components[1].patches[0].weights[1][0]",
        ["0", "positive"],
    ),
    "shell open": (patch(), "components[1]", ["boom"]),
    "no component": (write_field(["components"], []), "components", ["0"]),
    "two components of one name": (write_field(["components", 1, "name"], "sphere"), "components[1].name", ["sphere"]),
    "no vertices": (inline(vertices=[], cells=[]), "mesh.vertices", []),
    "no cells": (inline(cells=[]), "mesh.cells", []),
    "vertex out of range": (
        replace_cell(3, [0, 1, 99120]),
        "mesh.cells[3][2]",
        ["99120"],
    ),
    "vertex repeated": (replace_cell(3, [7, 8, 7]), "mesh.cells[3]", ["7"]),
    "cell of five": (replace_cell(3, [0, 1, 2, 3, 4]), "mesh.cells[3]", ["5", "3 or 4"]),
    "hole": (remove_cell, "mesh", ["edges", "open_mesh"]),
    "off its component": (spoil_vertex(100, 1, 3.0), "mesh.vertices[100]", ["vertices[100]", " m"]),
    "mesh file missing": (write_field(["mesh", "file"], "nowhere.msh"), "mesh.file", ["nowhere.msh"]),
    "mesh file outside": (write_field(["mesh", "file"], "../mesh.msh"), "mesh.file", ["../mesh.msh"]),
    "unknown field": (write_field(["mesh", "colour"], "red"), "mesh.colour", ["colour"]),
    "unknown format": (write_field(["format"], 99), "format", ["99", "1"]),
    "option out of range": (write_field(["options"], {"blend_radius": 7.0}), "options.blend_radius", ["7"]),
    "option of unknown group": (
        write_field(["options"], {"protected_groups": ["tips"]}),
        "options.protected_groups",
        ["tips"],
    ),
    "operation on unknown component": (
        write_field(["parameterisation", "operations", 0, "components"], ["wing"]),
        "parameterisation.operations[0].components[0]",
        ["wing"],
    ),
    "baseline outside bounds": (
        write_field(["parameterisation", "variables", 0, "lower"], 0.25),
        "parameterisation.variables[0]",
        ["0.25", "0.5"],
    ),
}


@pytest.mark.parametrize("name", SETUPS)
def test_a_bad_setup_is_refused_by_field(client: moldline.Client, tmp_path: Path, name: str) -> None:
    change, field, words = SETUPS[name]
    with pytest.raises(moldline.InvalidArgument) as refused:
        client.create_setup(sphere_and_boom.write(tmp_path, change=change))
    (violation,) = refused.value.violations
    assert violation.field == field
    for word in words:
        assert word in violation.description


def test_a_mesh_with_holes_is_accepted_where_an_option_says_so(client: moldline.Client, tmp_path: Path) -> None:
    def change(document: dict[str, Any], vertices: np.ndarray, cells: list[list[int]]) -> None:
        remove_cell(document, vertices, cells)
        document["options"] = {"open_mesh": True}

    setup = client.create_setup(sphere_and_boom.write(tmp_path, change=change))
    assert setup.report["watertight"] is False
    with setup.session() as session:
        assert session.deform({"boom.translation": 0.1}).quality.total.folded == 0


@pytest.mark.parametrize("content", [b"", b"{", b"[1, 2", b"\xff\xfe", b'{"format": 1}', b"[" * 100_000])
def test_a_setup_file_that_is_none_is_refused(client: moldline.Client, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "setup.json").write_bytes(content or b" ")
    with pytest.raises(moldline.InvalidArgument) as refused:
        client.create_setup(tmp_path)
    assert refused.value.violations


@pytest.mark.parametrize(
    "mesh",
    [
        b"not a mesh",
        b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n18446744073709551615\n",
        b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n-1\n",
        b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 nan 0 0\n$EndNodes\n",
    ],
)
def test_a_mesh_file_that_is_none_is_refused(
    client: moldline.Client, setup_folder: Path, tmp_path: Path, mesh: bytes
) -> None:
    folder = sphere_and_boom.write(tmp_path)
    (folder / "mesh.msh").write_bytes(mesh)
    with pytest.raises(moldline.InvalidArgument) as refused:
        client.create_setup(folder)
    assert refused.value.violations[0].field.startswith("mesh")


@pytest.mark.parametrize("suffix", [".tar", ".tar.gz", ".zip"])
def test_an_archive_that_is_none_is_refused(client: moldline.Client, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"setup{suffix}"
    path.write_bytes(b"not an archive" * 100)
    with pytest.raises(moldline.InvalidArgument) as refused:
        client.create_setup(path)
    assert refused.value.violations


def test_more_than_the_limit_is_refused_before_it_is_sent(binary: Path, tmp_path: Path) -> None:
    folder = sphere_and_boom.write(tmp_path)
    (folder / "big.bin").write_bytes(bytes(2 << 20))
    with Server(binary, "--max-upload", "1") as server, server.client() as client:
        with pytest.raises(moldline.InvalidArgument) as refused:
            client.create_setup(folder)
    assert refused.value.violations[0].field == "header"
    assert str(1 << 20) in refused.value.message


def of_length(count: int) -> Callable[[moldline.Setup], Any]:
    return lambda setup: np.zeros(count)


def with_entry(index: int, value: float) -> Callable[[moldline.Setup], Any]:
    def design(setup: moldline.Setup) -> np.ndarray:
        values = setup.baseline
        values[index] = value
        return values

    return design


DESIGNS: dict[str, tuple[Callable[[moldline.Setup], Any], str, list[str]]] = {
    "too short": (of_length(2), "design", ["2", "3"]),
    "too long": (of_length(4), "design", ["4", "3"]),
    "empty": (of_length(0), "design", ["0", "3"]),
    "two dimensions": (lambda setup: np.zeros((3, 1)), "design.shape", ["2"]),
    "NaN": (with_entry(1, math.nan), "design[1]", ["boom.lift", "NaN"]),
    "infinite": (with_entry(0, -math.inf), "design[0]", ["boom.translation", "inf"]),
    "above its bound": (with_entry(0, 0.75), "design[0]", ["boom.translation", "0.75", "0.5"]),
    "below its bound": (with_entry(1, -0.3), "design[1]", ["boom.lift", "-0.3", "-0.2"]),
    "unknown name": (lambda setup: {"boom.translaton": 0.1}, 'design["boom.translaton"]', ["boom.translation"]),
    "NaN by name": (lambda setup: {"boom.lift": math.nan}, "design[1]", ["boom.lift", "NaN"]),
}


@pytest.mark.parametrize("name", DESIGNS)
def test_a_bad_design_is_refused_by_entry(setup: moldline.Setup, name: str) -> None:
    design, field, words = DESIGNS[name]
    with setup.session() as session:
        with pytest.raises(moldline.InvalidArgument) as refused:
            session.deform(design(setup))
        (violation,) = refused.value.violations
        assert violation.field == field
        for word in words:
            assert word in violation.description
        assert session.deform().quality.total.folded == 0


def test_a_seam_that_leaves_every_bracket_names_its_vertices(setup: moldline.Setup) -> None:
    """The boom is moved out of the sphere: they no longer cross."""
    with setup.session() as session, pytest.raises(moldline.FailedPrecondition) as refused:
        session.deform({"boom.far": 4.0})
    (violation,) = refused.value.violations
    assert violation.field == "design"
    assert "vertices[" in violation.description
    assert "sphere" in violation.description and "boom" in violation.description


def test_bad_control_points_are_refused(setup: moldline.Setup) -> None:
    with setup.session() as session:
        for points, field, words in [
            ({"wing": np.zeros((4, 3))}, 'control_points["wing"]', ["sphere", "boom"]),
            ({"boom": np.zeros((4, 3))}, "control_points[1]", ["4"]),
            ({"boom": np.zeros((4, 2))}, 'control_points["boom"].shape[1]', ["2", "3"]),
        ]:
            with pytest.raises(moldline.InvalidArgument) as refused:
                session.deform(control_points=points)
            (violation,) = refused.value.violations
            assert violation.field == field
            for word in words:
                assert word in violation.description


def test_control_points_far_away_are_searched_or_refused_and_the_server_lives(setup: moldline.Setup) -> None:
    """At 100 m rounding keeps halves of the boom's pieces as large as they were; beyond 1000 lengths nothing is searched."""
    boom = setup.control_points["boom"]
    with setup.session() as session:
        for far in [100.0, 1000.0, 3000.0]:
            with pytest.raises(moldline.FailedPrecondition):
                session.deform(control_points={"boom": boom + [0, far, 0]})
        for far in [1e5, 1e9, 1e300]:
            with pytest.raises(moldline.InvalidArgument) as refused:
                session.deform(control_points={"boom": boom + [0, far, 0]})
            (violation,) = refused.value.violations
            assert violation.field == "control_points[1]"
            assert "1000 reference lengths" in violation.description
        assert session.deform().vertices.shape == (setup.vertex_count, 3)


def test_unknown_sessions_are_not_found(setup: moldline.Setup) -> None:
    with setup.session() as session:
        unknown = moldline.Session(setup, replace(session.state, id="x" * 10_000))
    with pytest.raises(moldline.NotFound) as refused:
        unknown.deform()
    assert refused.value.violations[0].field == "session_id"
    assert len(refused.value.message) < 500, "what a client sends is not repeated at length"
