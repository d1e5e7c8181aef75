"""One table of a study: against the runs themselves, over all designs, cached and complete."""

import csv
import json
import shutil
import tomllib

import numpy as np
import pytest
import xarray as xr
from studied import SHORT

import multicell as mc
from multicell.results.documents import read_document, write_table
from multicell.results.quantities import known_unit
from multicell.studies import table
from multicell.studies.runs import MODEL_VERSION
from multicell.studies.status import write_note

BASE = mc.load_scene("growth").with_changes(SHORT)
VARY = {"cells.young": "1,2 kPa", "duration": "12,20 h"}


def compute(study, names=None):
    """Do the runs of a study one after the other in this process."""
    for run in study.runs:
        place = study.folder / "runs" / run.name
        if not place.exists() and (names is None or run.name in names):
            mc.run(run.scene, output=place, report=False)
    return study


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("table") / "study"
    return compute(mc.study(BASE, VARY, seeds=2, output=folder))


@pytest.fixture(scope="module")
def found(study):
    return study.to_xarray()


def test_dimensions_are_axes_seed_and_time(found):
    assert dict(found.sizes) == {"young": 2, "duration": 2, "seed": 2, "time": 6}
    assert found["cells"].dims == ("young", "duration", "seed", "time")
    assert found["young"].values.tolist() == [1.0, 2.0]
    assert found["young"].attrs == {"units": "kPa", "key": "cells.young"}
    assert found["seed"].values.tolist() == [1, 2]
    assert (found["time"] / 3600.0).values.tolist() == [0, 4, 8, 12, 16, 20]


def test_histories_are_those_of_the_runs(study, found):
    for run in study.runs:
        history = mc.load_result(study.folder / "runs" / run.name).history
        here = found.sel(run.coordinates)
        ended = found["time"].values > run.scene.duration
        assert np.isnan(here["diameter"].values).tolist() == ended.tolist()
        for name in ("cells", "diameter", "step"):
            expected = np.interp(found["time"].values, history["time"], history[name])
            np.testing.assert_allclose(here[name].values[~ended], expected[~ended], rtol=1e-12)


def test_summaries_are_those_of_the_runs(study, found):
    for run in study.runs:
        summary = mc.load_result(study.folder / "runs" / run.name).summary()
        here = found.sel(run.coordinates)
        assert here["divisions"] == summary["divisions"]
        assert here["end_time"] == summary["time"] == run.scene.duration
        assert here["wall_total"] == summary["wall"]["total"]
        assert here["integrator_evaluations"] == summary["integrator"]["evaluations"]
        assert here["run"].item() == run.name
    assert found["divisions"].dims == ("young", "duration", "seed")


def test_every_number_has_a_unit(found):
    assert found["diameter"].attrs["units"] == "um"
    assert found["wall_total"].attrs["units"] == "s"
    assert found["time"].attrs["units"] == "s"
    for name, variable in found.data_vars.items():
        if variable.dtype.kind == "f":
            assert "units" in variable.attrs, name
    for name in ("largest_pressure", "volume_released", "end_time", "splitting_volume_error"):
        assert found[name].attrs["units"] == known_unit(name.replace("end_time", "time"))


def test_the_table_says_where_it_comes_from(study, found):
    attributes = found.attrs
    assert json.loads(attributes["versions"])["multicell"] == mc.__version__
    assert attributes["model_version"] == MODEL_VERSION
    assert attributes["plan"] == study.plan.to_toml()
    assert mc.Scene.from_dict(tomllib.loads(attributes["scene"])) == study.plan.scene
    assert attributes["command"]
    assert not any("machine" in key for key in attributes)


def test_the_file_holds_the_table(study, found):
    with xr.open_dataset(study.folder / "study.nc", engine="h5netcdf") as stored:
        table = stored.load()
    assert table.identical(found)


def test_the_frame_and_the_csv_hold_the_table(study, found, tmp_path):
    frame = study.to_pandas()
    assert len(frame) == 2 * 2 * 2 * 6
    row = frame[(frame.young == 2.0) & (frame.duration == 72000.0) & (frame.seed == 2)].iloc[3]
    point = {"young": 2.0, "duration": 72000.0, "seed": 2, "time": 43200.0}
    assert row["diameter"] == found["diameter"].sel(point)
    assert frame.attrs["diameter"] == "um"
    path = tmp_path / "study.csv"
    table.write_study_csv(found, path)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(frame)
    assert {"young_kPa", "time_s", "diameter_um", "cells", "seed", "state"} <= set(rows[0])
    assert float(rows[3]["diameter_um"]) == frame["diameter"][3]
    assert rows[5]["diameter_um"] == ""  # the run ended before
    assert rows[5]["state"] == "done"


def test_what_is_known_is_not_read_again(study, found, monkeypatch):
    def refused(*_):
        raise AssertionError("read again")

    before = (study.folder / "study.nc").stat().st_mtime_ns
    monkeypatch.setattr(table, "dataset", refused)
    assert study.to_xarray().identical(found)
    assert (study.folder / "study.nc").stat().st_mtime_ns == before


@pytest.mark.slow
def test_missing_and_failed_runs_are_nan_and_say_so(tmp_path):
    study = mc.study(BASE, {"cells.young": "1,2 kPa"}, seeds=2, output=tmp_path / "study")
    first, second = study.plan.names[:2]
    compute(study, {first})
    place = study.folder / "runs" / second
    place.mkdir()
    write_note(place, "a cell was lost", "run")
    found = study.to_xarray()
    assert found["state"].values.tolist() == [["done", "failed"], ["waiting", "waiting"]]
    assert found["reason"].values.tolist() == [["", "a cell was lost"], ["", ""]]
    missing = np.isnan(found["diameter"].values).all(axis=-1)
    assert missing.tolist() == [[False, True], [True, True]]
    assert np.isnan(found["divisions"].values).tolist() == missing.tolist()
    # what comes later takes its place
    shutil.rmtree(place)
    later = compute(study).to_xarray()
    assert (later["state"] == "done").all()
    assert not np.isnan(later["diameter"].values).any()
    again = later["diameter"].values[0, 0] == found["diameter"].values[0, 0]
    assert again.all()


def test_a_study_of_which_nothing_has_run_has_a_table(tmp_path):
    study = mc.study(BASE, {"cells.young": "1,2 kPa"}, output=tmp_path / "study")
    found = study.to_xarray()
    assert set(found.data_vars) == {"state", "reason", "run"}
    assert found.sizes["time"] == 6
    assert (found["state"] == "waiting").all()
    table.write_study_csv(found, tmp_path / "study.csv")
    assert (tmp_path / "study.csv").read_text().count("\n") == 1 + 2 * 6


@pytest.mark.slow
def test_lists_have_points_with_axes_as_coordinates(tmp_path):
    study = compute(
        mc.study(
            BASE.with_changes({"output.every": "10 h"}),
            points={"cells.young": "1,2 kPa", "contact.law": "jkr,hertz"}, seeds=2,
            output=tmp_path / "study",
        )
    )  # fmt: skip
    found = study.to_xarray()
    assert dict(found.sizes) == {"point": 2, "seed": 2, "time": 3}
    assert sorted(found["law"].values) == ["hertz", "jkr"]
    assert found["law"].dims == found["young"].dims == ("point",)
    for k, point in enumerate(study.plan.points):
        assert found["young"].values[k] == point.coordinates["young"]
    with xr.open_dataset(study.folder / "study.nc", engine="h5netcdf") as stored:
        assert stored.identical(found)


def test_results_that_have_gone_are_told(tmp_path):
    study = compute(mc.study(BASE, output=tmp_path / "study"))
    state = study.status()
    (study.folder / "runs" / study.plan.names[0] / "summary.json").unlink()
    found = table.dataset(study.plan, study.folder, state)
    (after, *_) = table.states_of(found, state)
    assert after.state == "failed"
    assert "holds no results" in after.reason


def test_the_table_states_all_versions_that_have_made_its_runs(tmp_path):
    study = compute(mc.study(BASE, seeds=2, output=tmp_path / "study"))
    path = study.folder / "runs" / study.plan.names[0] / "summary.json"
    summary = read_document(path)
    own = summary["versions"]["numpy"]
    summary["versions"]["numpy"] = "2.3.5"
    write_table(path, summary)
    versions = json.loads(study.to_xarray().attrs["versions"])
    assert versions["numpy"] == ["2.3.5", own]
    assert versions["multicell"] == mc.__version__


def test_values_between_rows_are_linear_and_gaps_stay_gaps():
    nan = np.nan
    known, values = np.array([0.0, 1.0, 2.0, 4.0]), np.array([nan, 2.0, nan, 6.0])
    times = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 4.0 * (1 + 1e-15), 5.0])
    found = table.at_times(times, known, values)
    expected = [nan, nan, 2.0, nan, nan, nan, 6.0, 6.0, nan]
    np.testing.assert_array_equal(found, expected)
    values = np.array([1.0, 2.0, 8.0, 4.0])
    found = table.at_times(times[:-2], known, values)
    np.testing.assert_allclose(found, [1.0, 1.5, 2.0, 5.0, 8.0, 6.0, 4.0])


@pytest.mark.parametrize(
    ("every", "hours"), [("5 h", [0, 5, 10, 15, 20]), ("8 h", [0, 8, 16, 20]), ("30 h", [0, 20])]
)
def test_times_end_with_the_longest_run(tmp_path, every, hours):
    scene = BASE.with_changes({"output.every": every})
    study = mc.study(scene, {"duration": "3,20 h"}, output=tmp_path / "study")
    assert (table.common_times(study.plan) / 3600.0).tolist() == hours
