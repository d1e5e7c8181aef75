"""Fits that are stored: opened again, their runs as tables and studies, and in other fits."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest

import multicell as mc
from multicell.calibration.fit import plan_of
from multicell.calibration.simulator import SceneSimulator
from multicell.results.folder import to_json

SCENE = mc.load_scene("growth").with_changes(
    {"duration": "30 h", "initial.count": 6, "coupling_step": "2 h"}
)
DATA = {
    "time / h": [12, 22, 22],
    "diameter / um": [26.0, 30.0, 29.0],
    "diameter sd / um": [1.0, 1.0, 1.0],
    "cells": [7, None, 9],
    "growth.cycle_variation": [0.2, 0.2, 0.3],
}
CYCLE, RADIUS = "growth.cycle_time", "cells.division_radius"
FREE = {CYCLE: "norm(16 h, 3 h) in 10:30 h", RADIUS: "4:10 um"}
FEW = {"seeds": 1, "cores": 1, "repeats": 4, "budget": 64, "start": "2 h"}
BOUND = [f"{RADIUS} < 9 um"]


def same(one, other):
    """Return whether two fits say the same, apart from how rows of the data are called."""
    texts = []
    for fit in (one, other):
        said = fit.summary()
        rows = [{**row, "row": ""} for row in said["residuals"]]
        notes = [re.sub(r"(row|line) \d+", "row", note) for note in said["notes"]]
        texts.append(to_json({**said, "residuals": rows, "notes": notes}))
    return texts[0] == texts[1]


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fit") / "first"
    found = mc.fit(SCENE, DATA, FREE, constraints=BOUND, output=folder, **FEW)
    return found, folder


def test_a_fit_is_opened_from_its_folder_without_a_run(stored, monkeypatch):
    found, folder = stored
    monkeypatch.setattr(SceneSimulator, "__call__", None)
    again = mc.load_fit(folder)
    assert same(again, found)
    assert again.readings == found.readings
    assert again.problem.prior == found.problem.prior
    assert again.best.scene == found.best.scene
    assert again.predictive_check().chi_squared == found.predictive_check().chi_squared
    assert mc.compare_fits({"a": found, "b": again}).behind.tolist() == [0.0, 0.0]


def test_folders_that_hold_no_fit_that_is_done_are_refused(stored, tmp_path):
    _, folder = stored
    with pytest.raises(mc.OutputError, match="holds no fit that is done"):
        mc.load_fit(tmp_path)

    def edited(name, edit):
        place = tmp_path / name.replace(".", "-")
        shutil.copytree(folder, place)
        (place / name).write_text(edit((place / name).read_text()))
        return place

    with pytest.raises(mc.OutputError, match="scene or data have been changed"):
        mc.load_fit(edited("scene.toml", lambda text: text.replace("count = 6", "count = 5")))
    with pytest.raises(mc.OutputError, match="scene or data have been changed"):
        mc.load_fit(edited("data.csv", lambda text: text.replace("26", "27")))
    with pytest.raises(mc.OutputError, match="lacks runs of its fit"):
        mc.load_fit(edited("search.log", lambda text: text[: len(text) // 2]))
    with pytest.raises(mc.OutputError, match="is damaged"):
        mc.load_fit(edited("fit.json", lambda text: text.replace('"seeds"', '"sees"')))


def test_every_run_is_a_row(stored):
    found, folder = stored
    frame = found.runs
    assert len(frame) == len(found.readings) == 64
    assert set(frame.stage) == {"search", "fresh"}
    conditions = found.problem.measured.conditions
    assert set(frame.condition) == {c.label for c in conditions}
    row = frame[(frame.stage == "fresh") & (frame.condition == conditions[1].label)].iloc[0]
    shares = [free.share(row[free.name]) for free in found.problem.ranges]
    again = found.problem.simulator(shares, 1, int(row.seed))
    assert row["diameter at 20 h"] == pytest.approx(again.values[0], rel=1e-9)
    titles, *lines = (folder / "runs.csv").read_text().splitlines()
    assert len(lines) == 64
    assert "cycle_time" in titles


def test_a_fit_of_other_data_takes_over_the_runs(stored, tmp_path, monkeypatch):
    found, folder = stored
    calls, usual = [], SceneSimulator.__call__
    monkeypatch.setattr(
        SceneSimulator, "__call__", lambda self, *more: (calls.append(more), usual(self, *more))[1]
    )
    fewer = {key: column[:2] for key, column in DATA.items()}
    fewer["diameter / um"] = [25.0, 29.0]
    free = {CYCLE: FREE[CYCLE], RADIUS: "5:9.5 um"}
    again = mc.fit(SCENE, fewer, free, output=tmp_path / "second", reuse=folder,
                   **{**FEW, "budget": 20})  # fmt: skip
    low, high = (1.0 / 6.0, 5.5 / 6.0)
    within = [e for e in found.evaluations if low <= e.shares[1] <= high]
    assert again.facts["reused"] == len(within) > 10
    assert 16 < len(calls) <= 20  # a point may be there already
    assert again.facts["sets_of_parameters"] == 10
    assert len(again.evaluations) == len(within) + 10
    reading = again.problem.simulator(again.evaluations[0].shares, 0, SCENE.seed)
    np.testing.assert_allclose(again.evaluations[0].misfit.means[0], reading.values[0], rtol=1e-9)
    calls.clear()
    once_more = mc.fit(SCENE, fewer, free, output=tmp_path / "second", **{**FEW, "budget": 20})
    assert calls == []
    assert once_more.best.values == again.best.values
    opened = mc.load_fit(tmp_path / "second")
    assert calls == []
    assert same(opened, once_more)


LONGER = {**DATA, "time / h": [12, 24, 24]}
REFUSED = [
    ({"free": {CYCLE: "8:30 h"}}, "whose free parameters are others"),
    ({"scene": SCENE.with_changes({"initial.count": 5})}, "whose scene is another one"),
    ({"seeds": 2}, "whose runs have other seeds"),
    ({"data": LONGER}, "whose runs did not keep 'diameter' of "),
    ({"data": {**DATA, "growth.cycle_variation": [0.2, 0.2, 0.4]}},
     "whose scene is another one under the condition"),
    ({"data": {**DATA, "diameter / um": [26.0, 90.0, 29.0]}},
     "whose runs may have ended before 'diameter' was as large"),
]  # fmt: skip


@pytest.mark.parametrize(("wrong", "words"), REFUSED)
def test_runs_that_cannot_serve_are_refused(wrong, words, stored, monkeypatch):
    monkeypatch.setattr(SceneSimulator, "__call__", None)
    options = {"scene": SCENE, "data": DATA, "free": FREE, **FEW, "reuse": stored[1], **wrong}
    options.pop("cores")
    with pytest.raises(mc.SceneError) as caught:
        plan_of(**options)
    assert words in str(caught.value)


def test_folders_without_runs_to_reuse_are_refused(tmp_path):
    few = {key: value for key, value in FEW.items() if key != "cores"}
    with pytest.raises(mc.OutputError, match="holds no fit"):
        plan_of(SCENE, DATA, FREE, reuse=tmp_path / "none", **few)
    (tmp_path / "fit.json").write_text(json.dumps({"problem": 3}))
    with pytest.raises(mc.OutputError):
        plan_of(SCENE, DATA, FREE, reuse=tmp_path, **few)
