"""Uploading, building, and finding set-ups again."""

from __future__ import annotations

import shutil
import tarfile
import threading
from pathlib import Path

import moldline
import pytest

import sphere_and_boom
from server import Server

ENGINE_STAGES = ["mesh", "ownership", "seams", "training", "factorisation", "report"]


def test_progress_comes_in_order(binary: Path, setup_folder: Path) -> None:
    steps: list[moldline.Progress] = []
    with Server(binary) as server, server.client() as client:
        assert client.create_setup(setup_folder, progress=steps.append).built
    stages = list(dict.fromkeys(step.stage for step in steps))
    assert stages[:2] == ["receive", "read"]
    engine = stages[2:]
    assert len(engine) >= 4
    assert engine == [stage for stage in ENGINE_STAGES if stage in engine], "in the engine's order, none twice"
    for stage in stages:
        fractions = [step.fraction for step in steps if step.stage == stage]
        assert fractions == sorted(fractions)
        assert all(0 <= fraction <= 1 for fraction in fractions)
    assert all(step.message for step in steps)


def test_the_setup_is_described(setup: moldline.Setup) -> None:
    assert set(setup.components) == {"sphere", "boom"}
    translation = next(v for v in setup.variables if v.name == "boom.translation")
    assert (translation.unit, translation.baseline, translation.lower, translation.upper) == ("m", 0.0, -0.5, 0.5)
    assert setup.baseline.shape == (len(setup.variables),)
    assert setup.mesh.cells.shape == (setup.cell_count, 4)
    assert setup.mesh.cell_owner.shape == (setup.cell_count,)
    assert setup.mesh.seam.sum() == sphere_and_boom.SECTORS
    assert "watertight" in setup.report_text
    assert setup.report


def test_the_same_upload_again_is_the_same_setup(
    client: moldline.Client, setup: moldline.Setup, setup_folder: Path
) -> None:
    again = client.create_setup(setup_folder)
    assert again.id == setup.id
    assert not again.built
    assert client.get_setup(setup.id).variables == setup.variables


def test_what_the_setup_does_not_refer_to_does_not_count(
    client: moldline.Client, setup: moldline.Setup, setup_folder: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(setup_folder, tmp_path / "copy")
    (folder / "notes.txt").write_text("not part of the set-up")
    assert client.create_setup(folder).id == setup.id


def test_other_content_is_another_setup(client: moldline.Client, setup: moldline.Setup, tmp_path: Path) -> None:
    other = client.create_setup(sphere_and_boom.write(tmp_path / "longer", length=2.6))
    assert other.built
    assert other.id != setup.id


@pytest.mark.parametrize("suffix", [".tar", ".tar.gz", ".tgz", ".zip"])
def test_an_archive_is_the_folder(
    client: moldline.Client, setup: moldline.Setup, setup_folder: Path, tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"setup{suffix}"
    if suffix == ".zip":
        shutil.make_archive(str(tmp_path / "setup"), "zip", setup_folder)
    else:
        with tarfile.open(path, "w" if suffix == ".tar" else "w:gz") as archive:
            for file in setup_folder.iterdir():
                archive.add(file, arcname=file.name)
    assert client.create_setup(path).id == setup.id


def test_a_request_id_names_one_content(client: moldline.Client, setup_folder: Path, tmp_path: Path) -> None:
    first = client.create_setup(setup_folder, request_id="one")
    assert client.create_setup(setup_folder, request_id="one").id == first.id
    other = sphere_and_boom.write(tmp_path / "other", length=2.7)
    with pytest.raises(moldline.AlreadyExists) as refused:
        client.create_setup(other, request_id="one")
    assert refused.value.violations[0].field == "request_id"


def test_a_session_is_opened_once_for_each_request_id(setup: moldline.Setup) -> None:
    first, again, other = setup.session(request_id="a"), setup.session(request_id="a"), setup.session(request_id="b")
    assert first.id == again.id != other.id
    first.close()
    other.close()


def test_who_asks_for_the_same_at_the_same_time_shares_one_build(binary: Path, tmp_path: Path) -> None:
    folder = sphere_and_boom.write(tmp_path / "finer", rings=60)
    with Server(binary) as server, server.client() as client:
        setups: list[moldline.Setup] = []
        workers = [threading.Thread(target=lambda: setups.append(client.create_setup(folder))) for _ in range(4)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        assert len({setup.id for setup in setups}) == 1
        assert [setup.built for setup in setups].count(True) == 1


def test_a_client_that_goes_away_does_not_stop_the_server(server: Server, tmp_path: Path) -> None:
    folder = sphere_and_boom.write(tmp_path / "abandoned", rings=61)
    with server.client() as client:
        with pytest.raises(moldline.DeadlineExceeded):
            client.create_setup(folder, timeout=0.01)
        assert client.create_setup(folder).cell_count > 0


def test_an_unknown_setup_is_not_found(client: moldline.Client) -> None:
    with pytest.raises(moldline.NotFound) as refused:
        client.get_setup("no such set-up")
    assert refused.value.violations[0].field == "setup_id"
