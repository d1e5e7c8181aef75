"""Observables of the user's own in runs, studies and fits, and what is refused."""

from __future__ import annotations

import csv
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.calibration.fitting.simulator import SceneSimulator
from multicell.calibration.sensitivity.analysis import chosen_observables as asked_of
from multicell.cli.main import main
from multicell.errors import SceneError
from multicell.measured.data import read_data
from multicell.measured.observables import in_history
from multicell.results.measures import scene_observables
from multicell.results.observable import OWN_OBSERVABLES
from multicell.results.quantities import known_unit
from multicell.scene.own_units import own_units
from multicell.studies.axes import parse_range

TEXT = """
import multicell as mc

@mc.observable(name="surface of cells", unit="um^2")
def surface(state):
    return 4.0 * 3.0 * (state.cells.radius**2).sum()
"""
GROWING = mc.Scene.from_dict(
    {"duration": "1 h", "coupling_step": "20 min", "initial": {"count": 4}, "growth": {},
     "output": {"every": "20 min"}}
)  # fmt: skip


def observable(function, **options):
    return mc.observable(**{"name": "of a test", **options})(function)


@mc.observable(name="surface", unit="um^2")
def surface(state):
    return 4.0 * np.pi * (state.cells.radius**2).sum()


@mc.observable(name="oxygen in all", unit="mM", needs=["nutrients.oxygen"])
def oxygen(state):
    return state.concentrations["oxygen"].sum()


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_it_is_in_history_summary_tables_and_report(tmp_path, monkeypatch):
    monkeypatch.setattr("multicell.report.page.PICTURES", {})
    scene = GROWING.with_observables(surface)
    result = mc.run(scene, output=tmp_path / "run")
    for frame, row in zip(result.frames, result.history["surface"], strict=True):
        expected = 4.0 * np.pi * np.sum(frame.cells.radius**2)
        assert row == surface(frame, scene) == pytest.approx(expected, rel=1e-14)
    summary = result.summary()
    assert summary["surface"] == result.history["surface"][-1]
    assert summary["units"]["surface"] == "um^2"
    assert result.to_xarray()["surface"].attrs["units"] == "um^2"
    (path,) = mc.export(result, tmp_path, tables=["history"])
    with path.open(encoding="utf-8", newline="") as file:
        assert "surface_um2" in next(csv.reader(file))
    assert f"{summary['surface']:.4g} µm²" in (tmp_path / "run/report.html").read_text("utf-8")


def test_a_run_with_it_has_the_same_bits():
    plain, observed = (mc.run(s) for s in (GROWING, GROWING.with_observables(surface)))
    for name, values in plain.history.items():
        np.testing.assert_array_equal(values, observed.history[name])


@pytest.mark.slow
def test_it_is_read_and_resumed_by_a_process_that_knows_it_only_if_loaded(file, tmp_path):
    own = mc.load_observable(f"{file}:surface")
    mc.run(GROWING.with_observables(own), output=tmp_path / "run", report=False)
    code = f"""
import multicell as mc
from multicell.errors import SceneError
folder = {str(tmp_path / "run")!r}
result = mc.load_result(folder)
assert result.to_xarray()["surface_of_cells"].attrs["units"] == "um^2"
try:
    mc.resume(folder, changes={{"duration": "80 min"}}, report=False)
except SceneError as error:
    assert "mine.py:surface" in str(error), error
else:
    raise AssertionError("a file named in a scene was run")
mc.load_observable({f"{file}:surface"!r})
longer = mc.resume(folder, changes={{"duration": "80 min"}}, report=False)
assert len(longer.history["surface_of_cells"]) == 5
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)


def test_data_and_analyses_may_name_it():
    scene = GROWING.with_observables(surface)
    assert in_history(scene)["surface"] == "um^2"
    assert asked_of(scene, ["surface"]) == ["surface"]
    measured = read_data({"time / min": [40], "surface / mm^2": [2e-3]}, scene)
    assert measured.data[0].value == pytest.approx(2000.0)
    with pytest.raises(SceneError, match="no 'surface'"):
        asked_of(GROWING, ["surface"])


def test_runs_of_a_fit_load_and_measure_it(file):
    own = mc.load_observable(f"{file}:surface")
    scene = GROWING.with_observables(own)
    measured = read_data({"time / min": [40], "surface_of_cells / um^2": [900.0]}, scene)
    ranges = (parse_range("cells.division_radius", "5:6 um", scene),)
    simulator = pickle.loads(pickle.dumps(SceneSimulator.of(measured, ranges)))
    OWN_OBSERVABLES.pop(own.function)  # as in a worker
    small, large = (simulator([share], 0, 1) for share in (0.0, 1.0))
    assert small.reason == large.reason == ""
    assert large.values[0] == pytest.approx(1.44 * small.values[0], rel=0.02)


@pytest.mark.slow
def test_workers_of_studies_load_it(file, tmp_path):
    scene = GROWING.with_observables(mc.load_observable(f"{file}:surface"))
    made = mc.study(scene, vary={"cells.division_radius": ["5 um", "6 um"]}, output=tmp_path / "s")
    made.run(cores=2)
    table = made.to_xarray()
    assert table["surface_of_cells"].attrs["units"] == "um^2"
    assert np.isfinite(table["surface_of_cells"].isel(time=-1)).all()


def test_the_command_records_it(file, tmp_path):
    def call(spec, *more):
        given = ["--set", "duration=20 min", "--no-report", "-o", str(tmp_path / "run"), *more]
        return CliRunner().invoke(main, ["run", "growth", "--observable", spec, *given])

    done = call(f"{file}:surface")
    assert done.exit_code == 0, done.output
    assert "surface of cells" in done.output
    assert len(mc.load_result(tmp_path / "run").history["surface_of_cells"]) > 1
    refused = call(f"{file}:TEXT", "--overwrite")
    assert refused.exit_code == 2
    assert "has nothing called 'TEXT'" in refused.output


def test_a_scene_without_what_it_needs_refuses_it():
    with pytest.raises(SceneError, match=r"oxygen_in_all.*needs 'nutrients.oxygen'"):
        mc.run(GROWING.with_observables(oxygen))


def test_a_name_in_a_scene_runs_no_file(tmp_path):
    file = tmp_path / "bad.py"
    file.write_text("raise RuntimeError('run')", encoding="utf-8")
    stated = {"output.observables.bad": {"function": f"{file}:bad@0", "unit": "um"}}
    with pytest.raises(SceneError, match="No scene runs a file by itself"):
        mc.run(GROWING.with_changes(stated), output=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_scene_must_state_its_unit():
    own = observable(lambda state: 1.0, name="stated", unit="um^2")
    scene = GROWING.with_changes({"output.observables.stated": {"function": own.function}})
    with pytest.raises(SceneError, match=r"stated.unit: is '', must be 'um\^2'"):
        mc.run(scene)
    assert known_unit("stated") == "um^2"


def test_what_a_changed_function_gives_is_not_taken_for_the_old_one():
    first = observable(lambda state: 1.0)
    scene = GROWING.with_observables(first)
    OWN_OBSERVABLES.pop(first.function)
    second = observable(lambda state: 2.0)
    assert first.function != second.function
    with pytest.raises(SceneError, match="has changed since"):
        list(scene_observables(scene))


def test_a_name_with_two_units_is_labelled_with_none():
    for unit in ("um", "nN"):
        scene = GROWING.with_observables(observable(lambda s: 1.0, name="twice", unit=unit))
        assert in_history(scene)["twice"] == unit
    assert known_unit("twice") == ""


@pytest.mark.parametrize(
    ("options", "words"),
    [({"name": "Rim"}, "letters a-z"), ({"name": "cells"}, "already"),
     ({"name": "hypoxic radius drug"}, "already"), ({"name": "wall"}, "already"),
     ({"unit": "mm"}, "no product"), ({"unit": "um2"}, "no product")],
)  # fmt: skip
def test_names_and_units_that_it_cannot_have(options, words):
    with pytest.raises(ValueError, match=words):
        observable(lambda state: 1.0, **options)


def writes(state):
    state.cells.radius[:] = 1.0
    return 1.0


FAULTY = {
    "returns no single number": (lambda s: s.cells.radius, "must be a finite number"),
    "is infinite": (lambda s: float("inf"), "must be a finite number"),
    "raises": (lambda s: s.cells.radios, "did you mean 'radius'"),
    "writes": (writes, "read-only"),
    "is NaN": (lambda s: float("nan"), "does not state when it is absent"),
    "is negative": (lambda s: -1.0, "is not signed"),
    "has the order of cells": (lambda s: s.cells.radius[:1].sum(), "in another order"),
    "needs a field": (lambda s: s.concentrations["oxygen"].sum(), "in a bare scene it fails"),
}


@pytest.mark.parametrize("case", FAULTY)
def test_the_check_finds(case):
    function, words = FAULTY[case]
    with pytest.raises(AssertionError, match=words):
        mc.testing.check_observable(observable(function))


def late_fault(state):
    return state.cells.radios if state.time > 2500.0 else 1.0


def test_a_fault_in_a_run_has_file_and_line_and_the_run_can_be_resumed(tmp_path):
    scene = GROWING.with_observables(observable(late_fault))
    with pytest.raises(SceneError, match=rf"{Path(__file__).name}', line \d+.*'radios'"):
        mc.run(scene, output=tmp_path)
    mended = observable(lambda state: 2.0)
    result = mc.resume(
        tmp_path, changes={"output.observables.of_a_test": mended.stated()}, report=False
    )
    assert result.history["of_a_test"].tolist() == [1.0, 1.0, 1.0, 2.0]


def test_a_scene_that_is_refused_leaves_no_name_of_an_observable():
    own = {"function": "mine.py:late@0123456789ab", "unit": "um"}
    entries = {"duration": "1 h", "output": {"observables": {"of_a_refused_scene": own}}}
    with pytest.raises(SceneError):
        mc.Scene.from_dict({**entries, "friction": {"normal": -1.0}})
    with pytest.raises(SceneError):
        mc.Scene.from_dict({**entries, "motions": {"m": {"type": "none", "velocity": [0, 0, 0]}}})
    assert own_units("of_a_refused_scene") == set()
    mc.Scene.from_dict(entries)
    assert own_units("of_a_refused_scene") == {"um"}
