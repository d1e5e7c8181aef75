"""A run that is resumed becomes what it would have been, bit for bit; the lineage of its cells."""

import json
import shutil

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from stored import assert_same_bits, contents

import multicell as mc
from multicell.cli.main import main
from multicell.errors import OutputError, SceneError
from multicell.results.hdf5 import File
from multicell.results.journal import Reader

SPHEROID = {
    "duration": "30 h",
    "initial.count": 60,
    "initial.stage": "uniform",
    "nutrients.oxygen.boundary": "0.03 mM",
    "death.lysis_time": "4 h",
    "output.every": "7 h",
}
GROWING = {
    "duration": "20 h",
    "initial.count": 8,
    "initial.stage": "uniform",
    "output.every": "5 h",
    "growth.cycle_time": "8 h",
}


def _late(t, y, u, p):
    return y[0] - p[0]


def _reset(t, y, u, p, y_then, p_then):
    y[0] = 0.0
    y[1] = y_then[1] + 1.0


@mc.network(
    states={"phase": 0.0, "rounds": 0.0}, inputs={"pace": 0.0}, parameters={"limit": 4000.0},
    events=[mc.Event("reset", _late, _reset)], amounts=("phase",),
)  # fmt: skip
def clock(t, y, u, p, out):
    out[0] = 1.0 + 0.1 * u[0]
    out[1] = 0.0


@mc.network(states={"M": 20.0}, parameters={"made": 0.002}, amounts=("M",))
def store(t, y, u, p, out):
    out[0] = p[0]


CASES = {
    "growth, nutrient and death": ("spheroid", SPHEROID),
    "shells": ("spheroid", {**SPHEROID, "nutrients.oxygen.geometry": "radial"}),
    "exact JKR": (
        "doublet",
        {"contact.law": "exact-jkr", "duration": "40 min", "output.every": "12 min"},
    ),
    "walkers that do not touch": ("growth", {
        **GROWING, "contact": {"law": "none"}, "motility": {"force": "1 nN"},
    }),
    "Brownian motion": ("growth", {
        **GROWING, "duration": "2 h", "output.every": "35 min", "coupling_step": "7 min",
        "motility": {"diffusion": "0.005 um^2/s", "diffusion_step": "2 min"},
        "types": {"a": {}, "b": {"diffusion_scale": 3}},
    }),
    "space that repeats": ("growth", {
        **GROWING, "domain": {"x": [-20, 20], "y": [-20, 20], "z": [-30, 30],
                              "periodic": ["x", "y"]},
        "types": {"a": {}, "b": {}}, "motility": {"force": "3 nN"},
        "nutrients": {"oxygen": {"boundary": 0.2, "regime": "transient", "spacing": 10.0,
                                 "uptake": 2.0}},
    }),
    "a finite medium and a reaction": ("growth", {
        **GROWING, "duration": "2 h", "output.every": "30 min", "nutrients": {
            "a": {"boundary": 0.05, "uptake": 2.0, "finite_medium": {"volume": 1e7},
                  "media": [["1 h", 0.04]], "growth_half_saturation": 0.02, "spacing": 20.0},
            "b": {"boundary": 0.02, "uptake": 0.0, "spacing": 20.0},
        },
        "reactions": {"bind": {"rate": 0.01, "consumes": {"a": 1, "b": 1}}},
    }),
    "responses and lives": ("growth", {
        **GROWING, "death": {"apoptosis_rate": "0.01 1/h"}, "types": {"a": {}, "b": {}},
        "responses": [
            {"behaviour": "change to b", "signal": "contacts with a", "law": "hill", "half": 2,
             "largest": "0.1 1/h", "cells": "a"},
            {"behaviour": "apoptosis rate", "signal": "neighbours", "law": "monod", "half": 4,
             "largest": "0.03 1/h"},
            {"behaviour": "growth rate", "signal": "time", "law": "linear", "falls": True,
             "begin": 0, "end": "60 h"},
        ],
    }),
    "the doomed and the damaged": ("growth", {
        **GROWING, "death": {"damage_time": "10 h", "damage_variation": 0.5,
                             "lysis_time": "4 h"},
        "nutrients": {"oxygen": {"boundary": 0.2, "uptake": 0.0, "necrosis": 0.02, "spacing": 20.0,
                                 "media": [["8 h", 0.01]]}},
        "radiation": {"course": {"dose": "2 Gy", "start": "6 h", "every": "6 h", "fractions": 2,
                                 "alpha": "0.3 1/Gy", "beta": "0.03 1/Gy^2",
                                 "mitotic_divisions": 2}},
    }),
    "driven cells that divide": ("growth", {
        **GROWING,
        "growth.phases": {name: {"duration": "2 h"} for name in ("G1", "S", "G2", "M")},
        "motions": {"held": {"cells": [0, 2]}, "x": {"cells": [1], "velocity": [0, 1e-5, 0]}},
    }),
    "networks inside cells": ("growth", {
        **GROWING, "duration": "10 h", "output.every": "2 h", "networks": {
            "cycle": {"network": clock, "inputs": {"pace": "neighbours.store.M"},
                      "parameters": {"limit": {"mean": 4000.0, "variation": 0.3}}},
            "store": {"network": store, "divide": {"M": "binomial"},
                      "parameters": {"made": {"mean": 0.002, "variation": 0.5}}},
        },
        "responses": [{"behaviour": "growth rate", "signal": "cycle.rounds", "law": "monod",
                       "half": 1.0}],
    }),
    "a gradient in a box": ("growth", {
        **GROWING, "domain": {axis: [-20.0, 20.0] for axis in "xyz"}, "chemotaxis": {"oxygen": {}},
        "nutrients": {"oxygen": {"boundary": 0.2, "regime": "transient", "spacing": 10.0,
                                 "growth_half_saturation": 0.1}},
    }),
}  # fmt: skip
"""Further physics is resumed from frames in memory in ``test_determinism``."""
ALONE = ("exact JKR", "space that repeats")
"""Cases whose kernels no other short test needs."""


@pytest.fixture(scope="module")
def spheroid(tmp_path_factory):
    scene = mc.load_scene("spheroid").with_changes(SPHEROID)
    return mc.run(scene, output=tmp_path_factory.mktemp("whole") / "run", report=False, threads=1)


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=pytest.mark.slow) if case in ALONE else case for case in CASES],
)
def test_resumed_runs_have_the_bits_of_uninterrupted_ones(case, spheroid, tmp_path):
    name, changes = CASES[case]
    if changes is SPHEROID:
        whole = spheroid
    else:
        scene = mc.load_scene(name).with_changes(changes)
        whole = mc.run(scene, output=tmp_path / "whole", report=False, threads=1)
    assert len(whole.frames) >= 3
    if "medium" in case:
        assert whole.frames[1].cells.lag.any()
    if "doomed" in case:
        columns = [(frame.cells.doomed.any(), frame.cells.damage.any()) for frame in whole.frames]
        assert columns[1:4] == [(False, False), (True, True), (True, True)]
    for k, threads in ((1, 2), (len(whole.frames) - 2, 1)):
        again = tmp_path / f"again{k}"
        result = mc.resume(
            whole.folder, k, output=again, report=False, threads=threads, overwrite=True
        )
        assert_same_bits(whole.folder, again)
        one, other = whole.summary(), result.summary()
        for summary in (one, other):
            del summary["wall"], summary["threads"], summary["peak_memory"]
        assert one == other


def test_a_run_goes_on_in_its_own_folder_after_an_interruption(spheroid, tmp_path):
    def stop(simulation):
        if simulation.step_index == 61:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mc.run(spheroid.scene, output=tmp_path / "part", report=False, progress=stop)
    assert json.loads((tmp_path / "part" / "summary.json").read_text())["interrupted"]
    # the frame written at the interruption is not one of the whole run
    result = mc.resume(tmp_path / "part", -2, report=False)
    assert "interrupted" not in result.summary()
    assert_same_bits(spheroid.folder, tmp_path / "part")
    assert not list((tmp_path / "part").glob("*.part"))


def test_a_run_is_prolonged_with_another_medium(spheroid, tmp_path):
    shutil.copytree(spheroid.folder, tmp_path / "run")
    changes = {"duration": "36 h", "nutrients.oxygen.boundary": "0.2 mM"}
    longer = mc.resume(tmp_path / "run", changes=changes, report=False)
    assert longer.frames[-1].time == pytest.approx(36 * 3600)
    assert longer.history["time"][-1] == pytest.approx(36 * 3600)
    assert len(np.unique(longer.history["step"])) == len(longer.history["step"])
    assert longer.frames[-1].concentrations["oxygen"].max() > 0.15
    assert mc.load_result(tmp_path / "run").scene.nutrients["oxygen"].boundary == 0.2


def test_what_cannot_be_resumed_is_refused_with_words(tmp_path):
    scene = mc.load_scene("settle").with_changes({"duration": "3 min", "output.every": "1 min"})
    folder = tmp_path / "run"
    mc.run(scene, output=folder, report=False)
    before = contents(folder)
    with pytest.raises(OutputError, match="To prolong it, change duration"):
        mc.resume(folder)
    with pytest.raises(OutputError, match="has no frame 9: it has the frames 0 to 3"):
        mc.resume(folder, 9)
    for frame in ({"duration": "5 min"}, "9", 1.0, None):
        with pytest.raises(OutputError, match=r"is a whole number.*Changes are given by name"):
            mc.resume(folder, frame)
    with pytest.raises(OutputError, match="there are no results"):
        mc.resume(tmp_path / "nothing")
    with pytest.raises(SceneError, match="cannot change during a run"):
        mc.resume(folder, 0, changes={"cells.young": "2 kPa"})
    with h5py.File(folder / "frames.h5", "r+") as file:
        file.attrs["format"] = 3
    with pytest.raises(OutputError, match="result format 3"):
        mc.resume(folder, 0)
    with h5py.File(folder / "frames.h5", "r+") as file:
        file.attrs["format"] = 6
    assert contents(folder) == before


def test_the_command_resumes(tmp_path):
    folder = str(tmp_path / "run")
    args = ["--set", "duration=3 min", "--set", "output.every=1 min", "--no-report", "--quiet"]
    assert CliRunner().invoke(main, ["run", "settle", "-o", folder, *args]).exit_code == 0
    done = CliRunner().invoke(main, ["resume", folder, "--json", "--quiet"])
    assert done.exit_code == 2
    assert "To prolong it" in done.output
    done = CliRunner().invoke(
        main, ["resume", folder, "--set", "duration=5 min", "--json", "--quiet", "--no-report"]
    )
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["time"] == 300.0


@pytest.fixture(scope="module")
def family(tmp_path_factory):
    folder = tmp_path_factory.mktemp("family") / "run"
    changes = {
        "duration": "3 d",
        "initial.count": 150,
        "initial.stage": "uniform",
        "nutrients.oxygen.boundary": "0.02 mM",
        "nutrients.oxygen.necrosis": "0.0135 mM",
        "death.lysis_time": "3 h",
    }
    return mc.run(mc.load_scene("spheroid").with_changes(changes), output=folder, report=False)


def test_the_lineage_accounts_for_every_cell_at_all_times(family):
    table, summary = family.lineage, family.summary()
    assert summary["divisions"] > 20
    assert summary["removals"] > 0
    assert (table["end"] == "division").sum() == summary["divisions"]
    assert (table["end"] == "necrotic").sum() == summary["removals"]
    for time, cells in zip(family.history["time"], family.history["cells"], strict=True):
        alive = (table["birth_time"] <= time) & ~(table["end_time"] <= time)
        assert alive.sum() == cells
    last = family.frames[-1].cells
    assert set(table["id"][np.isnan(table["end_time"])]) == set(last.id)


def test_parents_divide_when_their_daughters_are_born(family):
    table = family.lineage
    daughters = table["parent"] >= 0
    parent = np.searchsorted(table["id"], table["parent"][daughters])
    np.testing.assert_array_equal(table["id"][parent], table["parent"][daughters])
    np.testing.assert_array_equal(table["end_time"][parent], table["birth_time"][daughters])
    assert (table["end"][parent] == "division").all()
    _, count = np.unique(table["parent"][daughters], return_counts=True)
    assert (count == 2).all()


def test_the_dead_die_before_they_are_removed(family):
    table = family.lineage
    removed = table["end"] == "necrotic"
    assert (table["death_time"][removed] < table["end_time"][removed]).all()
    assert np.isnan(table["death_time"][table["end"] == "division"]).all()


def frames_read(folder, count, monkeypatch):
    """Return how many frames and rows of the lineage a resume of so many frames reads."""
    changes = {
        "duration": f"{count} min",
        "coupling_step": "1 min",
        "output.every": "1 min",
        "initial.count": 3,
    }
    mc.run(mc.load_scene("settle").with_changes(changes), output=folder, report=False, threads=1)
    read = []

    def counted(function):
        def call(*args):
            read.append(args)
            return function(*args)

        return call

    with monkeypatch.context() as patch:
        patch.setattr(File, "frame", counted(File.frame))
        patch.setattr(File, "log", counted(File.log))
        patch.setattr(Reader, "arrays", counted(Reader.arrays))
        longer = {"duration": f"{count + 3} min"}
        result = mc.resume(folder, changes=longer, report=False, threads=1)
    assert len(result.frames) == count + 4
    return len(read)


@pytest.mark.slow
def test_the_cost_of_a_resume_is_linear_in_the_frames(tmp_path, monkeypatch):
    few, many = (frames_read(tmp_path / str(n), n, monkeypatch) for n in (10, 40))
    assert few > 10
    # so many more frames, and for each the same number of reads
    assert many - few <= 8 * 30


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"duration": "10 min"}, "duration: is 600 s, which ends before the frame at 1800 s"),
        ({"stop_cells": 5}, "stop_cells: is 5, but the frame at 1800 s has 8 cells"),
    ],
)
def test_a_change_that_the_frame_is_beyond_is_refused(changes, problem, tmp_path):
    scene = mc.load_scene("settle").with_changes({"duration": "30 min", "initial.count": 8})
    mc.run(scene, output=tmp_path / "run", report=False)
    with pytest.raises(SceneError, match=problem):
        mc.resume(tmp_path / "run", changes=changes, report=False)
    assert mc.load_result(tmp_path / "run").summary()["time"] == 1800.0


def test_a_run_can_end_earlier_than_planned_after_the_frame(tmp_path):
    scene = mc.load_scene("settle").with_changes(
        {"duration": "3 min", "initial.count": 8, "output.every": "1 min"}
    )
    mc.run(scene, output=tmp_path / "run", report=False)
    shorter = mc.resume(tmp_path / "run", 1, changes={"duration": "2 min"}, report=False)
    assert shorter.summary()["time"] == shorter.frames[-1].time == 120.0


# a run that ends within a coupling step loses no time and counts none twice

STOPPED = mc.Scene.from_dict(
    {
        "duration": "25 min",
        "coupling_step": "10 min",
        "initial": {"count": 12, "stage": "uniform"},
        "growth": {"cycle_time": "3 d", "cycle_variation": 0},
        "drag": {"viscosity": "0.5 kPa s"},
        "output": {"every": "5 min"},
    }
)


@pytest.mark.parametrize(
    "ends", [["45 min"], ["26 min", "27 min", "52 min"], ["25.0001 min", "1 h"]]
)
def test_time_goes_on_where_it_stopped(ends, tmp_path):
    mc.run(STOPPED, output=tmp_path / "run", report=False)
    for end in ends:
        result = mc.resume(tmp_path / "run", changes={"duration": end}, report=False)
    time = result.history["time"]
    last = result.scene.duration
    assert time[-1] == last
    assert (np.diff(time) > 0.0).all()
    assert np.diff(time).max() <= 600.0 * (1.0 + 1e-12)
    cells, start = result.frames[-1].cells, result.frames[0].cells
    # nobody divides: each has grown older, and larger, by just the time that has passed
    older = cells.age[np.argsort(cells.id)] - start.age[np.argsort(start.id)]
    np.testing.assert_allclose(older, last, rtol=1e-12)
    grown = cells.volume[np.argsort(cells.id)] - start.volume[np.argsort(start.id)]
    birth = 0.5 * 4.0 / 3.0 * np.pi * 5.0**3
    np.testing.assert_allclose(grown, birth * last / (3 * 86400.0), rtol=1e-9)


def test_a_prolonged_run_is_resumed_bit_for_bit(tmp_path):
    mc.run(STOPPED, output=tmp_path / "run", report=False)
    whole = mc.resume(
        tmp_path / "run", changes={"duration": "55 min"}, output=tmp_path / "a", report=False
    )
    for frame in range(4, len(whole.frames) - 1):
        again = mc.resume(tmp_path / "a", frame, output=tmp_path / f"b{frame}", report=False)
        assert again.history["time"].tolist() == whole.history["time"].tolist()
        np.testing.assert_array_equal(
            again.frames[-1].cells.position, whole.frames[-1].cells.position
        )
