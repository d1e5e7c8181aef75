"""Coupling steps that the run chooses: long where nothing happens, short where much does."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from stored import assert_same_bits

import multicell as mc
from multicell.biology.pace import Pace, end_of_step, next_pace
from multicell.biology.splitting import StepError
from multicell.cli.main import main
from multicell.errors import SceneError
from multicell.report.explain.scene import explain
from multicell.scene import coupling
from multicell.scene.steps import step_plan

SWITCHED = mc.Scene.from_dict(
    {
        "duration": "3 d",
        "coupling_step": "auto",
        "initial": {"count": 40, "stage": "uniform"},
        "growth": {"cycle_time": "40 h"},
        "death": {},
        "nutrients": {
            "oxygen": {
                "boundary": "0.1 mM", "uptake": "1 amol/s", "quiescence": "0.03 mM",
                "growth_half_saturation": "0.02 mM", "spacing": "20 um", "regime": "steady",
                "media": [["30.3 h", "0.02 mM"], ["54 h", "0.1 mM"]],
            }
        },
        "output": {"every": "6 h"},
    }
)  # fmt: skip


@pytest.fixture(scope="module")
def switched(tmp_path_factory):
    folder = tmp_path_factory.mktemp("auto") / "run"
    return mc.run(SWITCHED, output=folder, report=False, threads=1)


def test_steps_are_long_at_rest_and_short_when_the_medium_has_changed(switched):
    time = switched.history["time"]
    begin, length = time[:-1] / 3600.0, np.diff(time)
    shortest, longest = coupling.shortest_step(SWITCHED), coupling.longest_step(SWITCHED)
    assert (shortest, longest) == (56.25, 3600.0)
    assert length.max() <= longest
    growing = length[(begin > 10.0) & (begin < 29.0)]
    changed = length[(begin >= 30.3) & (begin < 31.0)]
    resting = length[(begin > 40.0) & (begin < 53.0)]
    assert resting.min() == longest  # all cells rest: there is no growth to get wrong
    assert changed.max() < growing.min()  # free growth and divisions are exact
    # a fixed step as fine as the finest would be many times as many
    assert len(length) < time[-1] / shortest / 8


def test_steps_land_on_frames_changes_of_the_medium_and_the_end(switched):
    time = switched.history["time"]
    assert time[-1] == SWITCHED.duration == switched.summary()["time"]
    assert 30.3 * 3600.0 in time
    assert 54 * 3600.0 in time
    assert [frame.time for frame in switched.frames] == [k * 21600.0 for k in range(13)]
    assert (np.diff(switched.history["step"]) == 1).all()
    # but for the odd moment of the change all times are multiples of the shortest step
    odd = time[time % 56.25 != 0.0]
    assert odd.tolist() == [30.3 * 3600.0]


def test_each_step_gets_no_more_of_growth_wrong_than_the_tolerance(switched):
    found = mc.run(SWITCHED.with_changes({"coupling_tolerance": 0.04}), threads=1)
    fine, coarse = (np.abs(r.history["splitting_volume_error"]).sum() for r in (switched, found))
    assert found.summary()["steps"] < 0.6 * switched.summary()["steps"]
    assert fine < 0.5 * coarse
    mean = switched.summary()["splitting"]["mean_step"]
    assert mean == SWITCHED.duration / switched.summary()["steps"]


@pytest.mark.parametrize("frame", [1, 5, 6, 9])
def test_a_resumed_run_has_the_bits_of_one_that_was_not_stopped(switched, frame, tmp_path):
    again = mc.resume(switched.folder, frame, output=tmp_path / "again", report=False, threads=2)
    assert_same_bits(switched.folder, tmp_path / "again")
    one, other = switched.summary(), again.summary()
    for summary in (one, other):
        del summary["wall"], summary["threads"]
    assert one == other


def test_a_run_that_was_stopped_between_frames_goes_on_bit_for_bit(switched, tmp_path):
    def stop(simulation):
        if simulation.step_index == 77:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mc.run(SWITCHED, output=tmp_path / "part", report=False, progress=stop, threads=1)
    mc.resume(tmp_path / "part", output=tmp_path / "whole", report=False, threads=1)
    again = mc.load_result(tmp_path / "whole").frames[-1].cells
    for name, column in switched.frames[-1].cells.columns():
        np.testing.assert_array_equal(column, getattr(again, name.removeprefix("cells/")))


@pytest.mark.parametrize("ends", [["45 min"], ["26 min", "27 min", "52.001 min"]])
def test_a_prolonged_run_loses_no_time(ends, tmp_path):
    scene = SWITCHED.with_changes({"duration": "25.3 min", "output.every": "5 min"})
    mc.run(scene, output=tmp_path / "run", report=False)
    start = mc.load_result(tmp_path / "run").frames[0].cells
    for end in ends:
        result = mc.resume(tmp_path / "run", changes={"duration": end}, report=False)
    time = result.history["time"]
    assert time[-1] == result.scene.duration
    assert (np.diff(time) > 0.0).all()
    cells = result.frames[-1].cells
    same = np.isin(start.id, cells.id)
    older = cells.age[np.isin(cells.id, start.id)][
        np.argsort(cells.id[np.isin(cells.id, start.id)])
    ]
    before = start.age[same][np.argsort(start.id[same])]
    np.testing.assert_allclose(older - before, time[-1], rtol=1e-12)


def test_a_run_that_is_to_stop_at_a_number_of_cells_does():
    result = mc.run(SWITCHED.with_changes({"stop_cells": 44}), threads=1)
    assert result.summary()["cells"] >= 44
    assert result.history["cells"][-2] < 44


def pace_after(pace, error, uptake=0.0):
    return next_pace(step_plan(SWITCHED), pace, error, uptake, pace.step)


def test_the_pace_doubles_at_most_and_halves_as_often_as_it_must():
    calm, rough = StepError(), StepError(drift=1e-2)
    pace = Pace(56.25)
    for k in range(1, 9):
        pace = pace_after(pace, calm)
        assert pace.step == min(56.25 * 2.0**k, 3600.0)
    assert pace_after(pace, rough).step == 56.25
    assert pace_after(pace, calm, uptake=1e-2).step == 56.25
    # a steady part that is wrong is held at just below the tolerance
    for states in (2e-6, 4e-6, 1e-5):
        steady = Pace(3600.0, states=states)
        for _ in range(3):
            steady = pace_after(steady, StepError(states=states))
        assert 0.5 * coupling.TOLERANCE < states * steady.step <= coupling.TOLERANCE


def test_a_drift_to_and_fro_is_no_error_but_switching_to_and_fro_is():
    pace = other = Pace(900.0)
    for k in range(40):
        pace = pace_after(pace, StepError(drift=(-1) ** k * 1e-5))
        other = pace_after(other, StepError(states=1e-5))
    assert pace.step >= 1800.0
    assert other.step == 450.0


@pytest.mark.parametrize(
    ("time", "step", "end"),
    [(0.0, 900.0, 900.0), (450.0, 900.0, 900.0), (899.9999, 900.0, 1800.0),
     (30.25 * 3600, 900.0, 30.3 * 3600), (30.3 * 3600, 900.0, 30.5 * 3600),
     (3 * 86400 - 60.0, 900.0, 3 * 86400)],
)  # fmt: skip
def test_steps_end_at_multiples_of_their_length_or_where_something_else_does(time, step, end):
    assert end_of_step(step_plan(SWITCHED), Pace(step), time) == pytest.approx(end, rel=1e-15)


def test_the_longest_step_is_short_against_cycle_and_reaction():
    for changes, longest in (
        ({"growth.cycle_time": "10 h"}, 1800.0),
        ({"growth.cycle_time": "11 min"}, 28.125),
        ({"cells.reaction_time": "70 min"}, 1800.0),
    ):
        scene = SWITCHED.with_changes(changes)
        assert coupling.longest_step(scene) == longest
        assert coupling.shortest_step(scene) == min(56.25, longest)


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        ({"coupling_step": "often"}, "coupling_step", "'auto'"),
        ({"coupling_step": "Auto"}, "coupling_step", "'auto'"),
        ({"coupling_tolerance": 0}, "coupling_tolerance", "above 0"),
        ({"coupling_tolerance": -0.01}, "coupling_tolerance", "above 0"),
        ({"coupling_tolerance": "1 %"}, "coupling_tolerance", "a number"),
        ({"coupling_tolerance": 0.5}, "coupling_tolerance", "at most 0.1"),
        ({"coupling_step": "10 min", "coupling_tolerance": 0.01}, "coupling_tolerance", "auto"),
        ({"growth": None}, "coupling_step", "no growth"),
        ({"motility": {}}, "coupling_step", "motility"),
        ({"haptotaxis": {}}, "coupling_step", "haptotaxis"),
        ({"chemotaxis": {"oxygen": {}}}, "coupling_step", "chemotaxis"),
        ({"pull": {}}, "coupling_step", "pull"),
        ({"contact.law": "exact-jkr"}, "coupling_step", "which pairs touch"),
    ],
)
def test_what_cannot_be_is_refused_by_name(changes, path, words):
    with pytest.raises(SceneError) as caught:
        SWITCHED.with_changes(changes)
    assert caught.value.path == path
    assert words in str(caught.value)


def test_the_word_is_written_and_read_back(tmp_path):
    scene = SWITCHED.with_changes({"coupling_tolerance": 0.01})
    text = scene.to_toml()
    assert 'coupling_step = "auto"\n' in text
    path = tmp_path / "scene.toml"
    path.write_text(text)
    assert mc.load_scene(path) == scene


def test_explain_and_the_closing_lines_tell_of_it(tmp_path):
    told = json.dumps(explain(SWITCHED), default=str)
    assert "the run chooses steps from 56.25 to 3600 s" in told
    assert "0.5 % of growth wrong" in told
    told = json.dumps(explain(SWITCHED.with_changes({"coupling_step": "10 min"})), default=str)
    assert "late divisions" in told
    file = tmp_path / "scene.toml"
    file.write_text(SWITCHED.with_changes({"duration": "5 h"}).to_toml())
    done = CliRunner().invoke(main, ["run", str(file), "-o", str(tmp_path / "run"), "--no-report"])
    assert done.exit_code == 0
    assert "volume changed by coupling steps" in done.output
    assert "mean coupling step" in done.output


def test_methods_are_compared_on_the_steps_that_a_run_chose():
    from multicell.comparison.record import record
    from multicell.integrators import registry

    scene = SWITCHED.with_changes({"duration": "4 h"})
    problem, _ = record(scene, registry.from_options(scene.integrator), threads=1)
    assert problem.times[-1] == scene.duration
    assert len(set(np.diff(problem.times))) > 2
