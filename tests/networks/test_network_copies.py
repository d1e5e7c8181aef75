"""Files of networks in the folders of runs and studies: copied, and read there from then on."""

import shutil

import h5py
import numpy as np
import pytest
from forged import stretch
from network_models import WITH_NETWORK, WRITTEN
from stored import assert_same_bits

import multicell as mc
from multicell.errors import OutputError, SceneError
from multicell.results.folder import is_begun
from multicell.results.writer import Store
from multicell.scene import networks
from multicell.studies.runs import run_digest

pytest.importorskip("sbmlode")
pytest.importorskip("antimony")

COPY = "hif.network.ant"


@pytest.fixture
def scene(tmp_path):
    """Return a scene that names a file beside it."""
    place = tmp_path / "mine"
    place.mkdir()
    (place / "own.ant").write_text(WRITTEN, encoding="utf-8")
    (place / "scene.toml").write_text(WITH_NETWORK, encoding="utf-8")
    return mc.load_scene(place / "scene.toml")


def forget(tmp_path):
    """Remove the original, and what this process knows of it."""
    shutil.rmtree(tmp_path / "mine")
    networks._read.cache_clear()


def run(scene, folder, **options):
    return mc.run(scene, output=folder, report=False, threads=1, **options)


@pytest.mark.slow
def test_a_run_does_not_need_the_file_that_its_network_was_read_from(scene, tmp_path, forks):
    whole = run(scene, tmp_path / "whole")
    assert len(whole.frames) == 3
    shutil.copytree(tmp_path / "whole", tmp_path / "again")
    shutil.copytree(tmp_path / "whole", tmp_path / "moved")
    shutil.rmtree(tmp_path / "whole")
    forget(tmp_path)
    again = mc.load_result(tmp_path / "again")
    assert again.scene.networks["hif"].file == str(tmp_path / "again" / COPY)
    assert (tmp_path / "again" / COPY).read_text(encoding="utf-8") == WRITTEN
    mc.resume(tmp_path / "again", 1, threads=1, report=False)
    assert_same_bits(tmp_path / "again", tmp_path / "moved")
    mc.resume(tmp_path / "again", 1, output=tmp_path / "other", threads=1, report=False)
    assert_same_bits(tmp_path / "other", tmp_path / "moved")
    run(mc.load_scene(tmp_path / "again" / "scene.toml"), tmp_path / "new")
    assert_same_bits(tmp_path / "new", tmp_path / "moved")
    done = forks.multicell("view", tmp_path / "moved", "--no-browser")
    assert done["code"] == 0, done["text"]
    assert (tmp_path / "moved" / "report.html").is_file()


def test_a_copy_with_another_content_is_refused(scene, tmp_path):
    run(scene, tmp_path / "out")
    (tmp_path / "out" / COPY).write_text(WRITTEN.replace("0.3", "0.4"), encoding="utf-8")
    for reads in (mc.load_result, mc.resume):
        with pytest.raises(OutputError, match=r"hif.file: .* is not the file that") as found:
            reads(tmp_path / "out")
        assert found.value.damaged
    (tmp_path / "out" / COPY).unlink()
    with pytest.raises(OutputError, match=f"there is no file .*{COPY}"):
        mc.load_result(tmp_path / "out")


def test_a_file_that_changes_before_the_run_is_refused(scene, tmp_path):
    (tmp_path / "mine" / "own.ant").write_text(WRITTEN.replace("0.3", "0.4"), encoding="utf-8")
    with pytest.raises(SceneError, match=r"networks.hif.file: .* is not the file"):
        run(scene, tmp_path / "out")
    assert not (tmp_path / "out" / "scene.toml").exists()
    file = str(tmp_path / "mine" / "own.ant")
    changed = scene.with_changes({"networks.hif.file": file})  # as it is now
    model = changed.networks["hif"].model
    assert model.values[model.parameters.index("k_lost")] == 0.4


def test_overwriting_removes_copies_that_are_not_needed(scene, tmp_path):
    out = tmp_path / "out"
    run(scene, out)
    run(mc.load_scene(out / "scene.toml"), out, overwrite=True)  # its own copy
    assert (out / COPY).is_file()
    (out / "mine.ant").write_text(WRITTEN, encoding="utf-8")
    run(scene.with_changes({"networks": {}}), out, overwrite=True)
    assert {entry.suffix for entry in out.iterdir() if "ant" in entry.name} == {".ant"}
    assert [entry.name for entry in out.glob("*.ant")] == ["mine.ant"]


def test_what_is_written_before_the_first_frame_is_begun_anew(scene, tmp_path):
    with pytest.raises(OutputError, match="is not empty"):
        Store.create(tmp_path / "mine", scene)
    Store.create(tmp_path / "out", scene).close()
    assert (tmp_path / "out" / COPY).is_file()
    assert not is_begun(tmp_path / "out", {"scene.toml": ""})
    assert len(run(scene, tmp_path / "out").frames) == 3


def test_a_study_goes_on_without_the_file(scene, tmp_path):
    study = mc.study(scene, {"growth.cycle_time": ["6 h", "9 h"]}, output=tmp_path / "study")
    forget(tmp_path)
    study = mc.load_study(tmp_path / "study")
    placed = study.plan.scene
    assert placed.networks["hif"].file == str(tmp_path / "study" / COPY)
    assert run_digest(placed) == run_digest(scene)


def test_damage_to_what_networks_hold_is_refused(scene, tmp_path):
    run(scene, tmp_path / "out")
    for damage in ("value", "unknown", "rows", "columns", "absent"):
        folder = tmp_path / damage
        shutil.copytree(tmp_path / "out", folder)
        with h5py.File(folder / "frames.h5", "r+") as file:
            inside = file["cells/inside"]
            assert inside.shape[1] == 5
            if damage == "absent":
                del file["cells/inside"]
            elif damage == "rows":
                stretch(file, "cells/inside", 1 << 25)
            elif damage == "columns":
                values = inside[:, :4]
                del file["cells/inside"]
                file["cells"].create_dataset("inside", data=values)
            else:
                inside[-1, 0] = np.nan if damage == "unknown" else inside[-1, 0] + 1e-9
        with pytest.raises(OutputError) as found:
            _ = mc.load_result(folder).frames[-1].cells
        assert found.value.damaged, damage


def test_what_a_killed_run_leaves_is_resumed_to_the_same_bits(scene, tmp_path):
    def leave(simulation):
        if simulation.step_index in (3, 17):  # as the system has it at that moment
            shutil.copytree(tmp_path / "out", tmp_path / f"left{simulation.step_index}")

    run(scene, tmp_path / "out", progress=leave)
    forget(tmp_path)
    for folder in (tmp_path / "left3", tmp_path / "left17"):
        assert (folder / "frames.journal").is_file()
        mc.resume(folder, threads=1, report=False)
        assert_same_bits(folder, tmp_path / "out")
