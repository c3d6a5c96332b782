"""Deformation: the same bits for every client, server and number of threads."""

from __future__ import annotations

import subprocess
import threading
from pathlib import Path

import meshio
import moldline
import numpy as np
import pytest

from server import Server

MOVED = {"boom.translation": 0.3}


def test_the_baseline_is_the_reference_mesh(setup: moldline.Setup) -> None:
    with setup.session() as session:
        result = session.deform()
    assert result.vertices.shape == (setup.vertex_count, 3)
    assert result.vertices.dtype == np.float64
    np.testing.assert_allclose(result.vertices, setup.mesh.vertices, atol=1e-12)


def test_vertices_follow_the_design(setup: moldline.Setup) -> None:
    """Here the boom moves along its own axis: the seam stays, and the cap moves with the boom."""
    with setup.session() as session:
        result = session.deform(MOVED)
    reference, moved = setup.mesh.vertices, result.vertices
    cap = reference[:, 0] == reference[:, 0].max()
    np.testing.assert_allclose(moved[cap] - reference[cap], [[0.3, 0, 0]] * cap.sum(), atol=1e-10)
    np.testing.assert_allclose(moved[setup.mesh.seam], reference[setup.mesh.seam], atol=1e-10)
    assert result.quality.total.folded == 0
    assert result.quality.total.cells == setup.cell_count
    assert result.engine_seconds > 0
    assert result.seam_residual < 1e-10


def test_vertices_are_not_copied_out_of_the_message(setup: moldline.Setup) -> None:
    with setup.session() as session:
        vertices = session.deform().vertices
    assert not vertices.flags.owndata
    assert not vertices.flags.writeable


def test_names_and_vector_are_the_same_design(setup: moldline.Setup) -> None:
    vector = setup.baseline
    vector[[v.name for v in setup.variables].index("boom.translation")] = 0.3
    with setup.session() as session:
        by_name, by_vector = session.deform(MOVED), session.deform(vector)
    assert by_name.vertices.tobytes() == by_vector.vertices.tobytes()
    assert by_name.linearisation_id == by_vector.linearisation_id
    assert by_name.quality == by_vector.quality


def test_the_same_request_twice_gives_the_same_bytes(setup: moldline.Setup) -> None:
    with setup.session() as session:
        first = session.deform(MOVED)
        session.deform({"boom.translation": -0.2})
        second = session.deform(MOVED)
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.linearisation_id == second.linearisation_id


def test_one_thread_gives_the_bytes_of_two(binary: Path, setup: moldline.Setup, setup_folder: Path) -> None:
    with setup.session() as session:
        two = session.deform(MOVED)
    with Server(binary, "--threads", "1") as server, server.client() as client:
        with client.create_setup(setup_folder).session() as session:
            one = session.deform(MOVED)
    assert one.vertices.tobytes() == two.vertices.tobytes()
    assert one.linearisation_id == two.linearisation_id


def test_the_command_line_gives_the_servers_bytes(
    binary: Path, setup: moldline.Setup, setup_folder: Path, tmp_path: Path
) -> None:
    output, report = tmp_path / "moved.vtu", tmp_path / "report.json"
    command = [str(binary), "deform", str(setup_folder), "--output", str(output), "--report", str(report)]
    run = subprocess.run([*command, "--design", "boom.translation=0.3"], capture_output=True, text=True, check=True)
    assert "total" in run.stdout
    with setup.session() as session:
        served = session.deform(MOVED, cell_quality=True)
    local = meshio.read(output)
    assert local.points.tobytes() == served.vertices.tobytes()
    owner = np.concatenate(local.cell_data["owner"])
    assert len(owner) == setup.cell_count
    assert local.point_data["seam"].ravel().astype(bool).tolist() == setup.mesh.seam.tolist()
    aspect_ratio = np.concatenate(local.cell_data["aspect_ratio"])
    assert sorted(aspect_ratio) == sorted(served.cell_quality["aspect_ratio"])


def test_concurrent_sessions_do_not_see_each_other(server: Server, setup: moldline.Setup) -> None:
    values = [-0.2, -0.1, 0.1, 0.2]
    with setup.session() as session:
        expected = {value: session.deform({"boom.translation": value}).vertices.tobytes() for value in values}
    wrong: list[float] = []

    def work(value: float) -> None:
        with server.client() as client, client.get_setup(setup.id).session() as session:
            for _ in range(10):
                if session.deform({"boom.translation": value}).vertices.tobytes() != expected[value]:
                    wrong.append(value)

    workers = [threading.Thread(target=work, args=(value,)) for value in values]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert wrong == []
    assert len(set(expected.values())) == len(values)


def test_a_closed_session_is_gone_and_its_setup_is_not(setup: moldline.Setup) -> None:
    with setup.session() as other:
        session = setup.session()
        session.close()
        with pytest.raises(moldline.NotFound) as refused:
            session.deform()
        assert refused.value.violations[0].field == "session_id"
        session.close()
        assert other.deform().vertices.shape == (setup.vertex_count, 3)


def test_more_than_the_server_takes_on_is_turned_away(binary: Path, setup_folder: Path) -> None:
    once = moldline.Retry(attempts=1)
    with Server(binary, "--running", "1", "--queued", "0") as server, server.client(retry=once) as client:
        session = client.create_setup(setup_folder).session()
        refused: list[moldline.ResourceExhausted] = []

        def work() -> None:
            for _ in range(20):
                try:
                    session.deform(MOVED)
                except moldline.ResourceExhausted as error:
                    refused.append(error)

        workers = [threading.Thread(target=work) for _ in range(4)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        assert refused and all(error.retry_after > 0 for error in refused)
        assert session.deform(MOVED).quality.total.folded == 0
        assert server.stop() == 0


def test_a_mesh_is_written_for_paraview(setup: moldline.Setup, tmp_path: Path) -> None:
    with setup.session() as session:
        result = session.deform(MOVED, cell_quality=True)
    path = tmp_path / "moved.vtu"
    shift = result.vertices - setup.mesh.vertices
    moldline.write_vtu(path, setup.mesh, result.vertices, {"shift": shift}, result.cell_quality)
    read = meshio.read(path)
    assert read.points.tobytes() == result.vertices.tobytes()
    assert sum(len(block.data) for block in read.cells) == setup.cell_count
    assert {block.type for block in read.cells} == {"triangle", "quad"}
    assert read.point_data["shift"].tobytes() == shift.tobytes()
    assert np.concatenate(read.cell_data["skew"]).tobytes() == result.cell_quality["skew"].tobytes()
