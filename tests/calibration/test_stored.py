"""Fits that are stored: opened again, their runs as tables and studies, and in other fits."""

from __future__ import annotations

import re
import shutil

import pytest

import multicell as mc
from multicell.calibration.fitting.simulator import SceneSimulator
from multicell.results.documents import read_document, write_table
from multicell.results.folder import to_json

SCENE = mc.load_scene("growth").with_changes(
    {"duration": "30 h", "initial.count": 6, "coupling_step": "2 h"}
)
DATA = {
    "start / h": [2, 2, 2],
    "time / h": [12, 22, 22],
    "diameter / um": [26.0, 30.0, 29.0],
    "diameter sd / um": [1.0, 1.0, 1.0],
    "cells": [7, None, 9],
    "growth.cycle_variation": [0.2, 0.2, 0.3],
}
CYCLE, RADIUS = "growth.cycle_time", "cells.division_radius"
FREE = {CYCLE: "norm(16 h, 3 h) in 10:30 h", RADIUS: "4:10 um"}
FEW = {"seeds": 1, "cores": 1, "repeats": 4, "budget": 64}


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
    found = mc.fit(SCENE, DATA, FREE, output=folder, **FEW)
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


def as_asked(folder, **more):
    return mc.fit(SCENE, DATA, FREE, output=folder, **{**FEW, **more})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "way"),
    [("scene.toml", "edited"), ("scene.toml", "removed"), ("data.csv", "emptied"),
     ("result.json", "edited")],
)  # fmt: skip
def test_the_same_fit_mends_what_is_damaged_without_a_run(stored, file, way, tmp_path, monkeypatch):
    found, folder = stored
    place = tmp_path / "fit"
    shutil.copytree(folder, place)
    path = place / file
    if way == "removed":
        path.unlink()
    else:
        path.write_text(path.read_text().replace("6", "5") if way == "edited" else "")
    with pytest.raises(mc.OutputError):
        mc.load_fit(place)
    monkeypatch.setattr(SceneSimulator, "__call__", None)
    for again in (as_asked(place), mc.load_fit(place)):
        assert (again.best.values, again.readings) == (found.best.values, found.readings)


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe", b'{"a": 1}'])
def test_a_damaged_entry_of_a_fit_is_overwritten_where_asked_for(content, tmp_path):
    from multicell.calibration.fitting.fit import plan_fit

    plan = plan_fit(SCENE, DATA, FREE, seeds=1, repeats=4, budget=64)
    with plan.open_folder(tmp_path / "fit") as folder:
        (folder / "fit.json").write_bytes(content)
        (folder / "search.log").write_bytes(content)
    with pytest.raises(mc.OutputError, match="Allow overwriting"), plan.open_folder(folder):
        pass
    with plan.open_folder(folder, overwrite=True):
        assert not (folder / "search.log").exists()
    with plan.open_folder(folder):
        pass


def test_a_fit_of_another_model_version_is_said_to_be_one(stored, tmp_path):
    _, folder = stored
    place = tmp_path / "fit"
    shutil.copytree(folder, place)
    entry = read_document(place / "fit.json")
    entry["problem"]["model"] -= 1
    write_table(place / "fit.json", entry)
    with pytest.raises(mc.OutputError, match=r"a fit of model version .* whose runs have other"):
        mc.load_fit(place)
