"""Files of another run, and damage that only a checksum sees: never a number of a table."""

import random
import shutil

import numpy as np
import pytest
from stored import assert_same_bits
from studied import short_runs

import multicell as mc
from multicell.errors import OutputError
from multicell.results.documents import read_document, write_table
from multicell.studies.engine import RunOutcome
from multicell.studies.readings import read_final
from multicell.studies.status import read_finished


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    scene = short_runs(1)[0].scene
    place = tmp_path_factory.mktemp("whole") / "study"
    made = mc.study(scene, {"growth.cycle_time": "5,8,20 h"}, output=place)
    made.run(cores=1)
    cells = made.to_xarray()["cells"].isel(time=-1, seed=0).values
    assert len(set(cells.tolist())) == 3
    return made


@pytest.fixture
def study(whole, tmp_path):
    shutil.copytree(whole.folder, tmp_path / "study")
    return mc.load_study(tmp_path / "study")


def ends(table):
    return table["cells"].isel(time=-1, seed=0).values


@pytest.mark.slow
@pytest.mark.parametrize("files", [["frames.h5"], ["summary.json"], ["frames.h5", "summary.json"],
                                   ["frames.h5", "summary.json", "scene.toml"]])  # fmt: skip
def test_files_of_another_run_are_never_read_as_this_ones(files, study, whole):
    first, second, third = (study.folder / "runs" / name for name in study.plan.names)
    assert [state.state for state in study.status()] == ["done"] * 3
    for file in files:
        shutil.copy(second / file, first / file)
    states = study.status()
    assert [(s.state, s.kind) for s in states] == [("failed", "damage"), ("done", ""), ("done", "")]
    right = ends(whole.to_xarray())
    found = study.to_xarray()
    np.testing.assert_array_equal(ends(found), [np.nan, *right[1:]])
    assert found["state"].values.ravel().tolist() == ["failed", "done", "done"]
    if files != ["frames.h5", "summary.json", "scene.toml"]:  # that is another, whole run
        with pytest.raises(OutputError):
            mc.load_result(first)
        with pytest.raises(OutputError):
            read_finished(first.name, study.folder)
        outcomes = [RunOutcome(name, "done") for name in study.plan.names]
        values, failures = read_final(outcomes, study.folder, ["cells", "divisions"])
        assert list(failures) == [first.name]
        np.testing.assert_array_equal(values["cells"], [np.nan, *right[1:]])
        assert np.isnan(values["divisions"][0])
    study.run(cores=1, retry=True)
    assert ends(study.to_xarray()).tolist() == right.tolist()
    assert_same_bits(first, whole.folder / "runs" / first.name)
    assert third.is_dir()


def test_a_summary_of_an_older_version_is_held_against_the_last_frame(study):
    place, other = (study.folder / "runs" / name for name in study.plan.names[:2])
    for folder in (place, other):
        summary = read_document(folder / "summary.json")
        del summary["scene_digest"]
        write_table(folder / "summary.json", summary)
    assert mc.load_result(place).summary()["cells"] > 0
    summary["time"] = 1.0
    write_table(place / "summary.json", summary)
    with pytest.raises(OutputError, match="of another run than the frames beside it"):
        mc.load_result(place)


@pytest.mark.harness
@pytest.mark.slow
def test_one_flipped_bit_never_ends_a_table_and_is_mended_by_a_retry(study, whole, pytestconfig):
    right, name = ends(whole.to_xarray()), study.plan.names[0]
    path = study.folder / "runs" / name / "frames.h5"
    before, seen = path.read_bytes(), 0
    for case in range(max(6, pytestconfig.getoption("damages"))):
        rng = random.Random(case)
        data = bytearray(before)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        found = mc.load_study(study.folder)
        assert found.report().is_file()
        table = found.to_xarray()
        assert ends(table)[1:].tolist() == right[1:].tolist()
        assert str(ends(table)[0]) in (str(right[0]), "nan")
        (outcome, *_) = found.run(cores=1, retry=True)
        assert outcome.state == "done"
        seen += not outcome.reused
        assert_same_bits(path.parent, whole.folder / "runs" / name)
        shutil.copytree(whole.folder / "runs" / name, path.parent, dirs_exist_ok=True)
    assert seen
