"""Methods on recorded coupling steps: each failure is reproduced, and has its name."""

import csv
import json
import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from picture_texts import check_texts
from recorded_steps import chain_state, motile_end, motile_state, pulled_state

import multicell as mc
from multicell.comparison.ladders import Method, find_method
from multicell.comparison.stability_limits.failure_charts import END_LETTERS
from multicell.comparison.stability_limits.failure_map import FAILURE_FILES
from multicell.comparison.stability_limits.failures import (
    COARSE,
    DAMPED,
    MISSED,
    POCKET,
    SNAP,
    STEP_ENDS,
    trial_row,
    try_step,
)
from multicell.comparison.stability_limits.moving import moving_stability
from multicell.comparison.stability_limits.recorded import RecordedState, state_at
from multicell.comparison.stability_limits.trial import BLOW_UP, STABLE, STALL, WRONG
from multicell.comparison.stability_limits.truth import SHIFTS, TrueStep
from multicell.integrators.cvode import Cvode
from multicell.integrators.shift import shifted_positions

pytestmark = pytest.mark.kernels

STATES = {"motile": motile_state, "chain": chain_state, "pulled": pulled_state}


@pytest.fixture(scope="module")
def truths():
    known = {}

    def find(name, *given):
        if (name, *given) not in known:
            known[name, *given] = TrueStep.of(STATES[name](*given))
        return known[name, *given]

    return find


@dataclass(frozen=True)
class Blind:
    """A method that does not look for contacts which form within its steps."""

    inner: object

    def integrate(self, system, position):
        system.missed_contact = lambda *_: 1.0
        return self.inner.integrate(system, position)


def tried(truth, method, setting):
    state = truth.state
    chosen = find_method(method, state.scene, state.radius) if isinstance(method, str) else method
    return trial_row(truth, try_step(state, chosen, setting, math.inf))


def blind_cvode(radius):
    return Method("blind", "tolerance", lambda s: Blind(Cvode(1e-6, s * radius)))


# the failures, each by a method that a run can name, but for the one whose detector is put out


@pytest.mark.slow
@pytest.mark.parametrize("method", ["rosenbrock", "cvode"])
def test_methods_that_look_for_contacts_end_the_motile_step_right(truths, method):
    row = tried(truths("motile"), method, 0.01)
    assert row["kind"] == STABLE
    assert row["ratio"] < 0.2
    assert row["null_ratio"] > 1000.0


def test_a_contact_that_a_method_steps_over_is_named_with_its_cells_and_time(truths):
    truth = truths("motile")
    row = tried(truth, blind_cvode(truth.state.radius), 0.003)
    assert row["kind"] == MISSED
    assert row["ratio"] > 20.0
    assert row["error_um"] == pytest.approx(0.90, abs=0.01)
    # the distance of these two falls from 9.66 to 8.91 um between 730 and 740 s
    assert truth.state.motion.radius[[9, 26]].sum() == pytest.approx(9.655, abs=1e-3)
    assert row["words"].startswith("cells 9 and 26 touch from 7")


def test_a_wrong_pocket_is_named_where_no_stop_cures_it(truths):
    row = tried(truths("motile"), "euler-adaptive", 0.01)
    assert row["kind"] == WRONG
    assert "1 contacts are missing" in row["words"]
    assert row["ratio"] > 20.0


def test_a_pocket_that_shifts_by_the_tolerance_also_miss_is_no_failure(truths):
    row = tried(truths("motile"), "rkc2", 0.3)
    assert row["kind"] == POCKET
    assert row["error_um"] > 0.8
    assert row["ratio"] < 1.0


@pytest.mark.slow
def test_a_wrong_pocket_says_what_shifts_within_the_step_do(truths):
    """Two cells part at 101 s. The step forgets shifts of its start by then, but not later ones."""
    truth = truths("motile", "packed")
    row = tried(truth, "rkc2", 0.01)
    assert row["error_um"] == pytest.approx(2.29, abs=0.01)
    assert row["conditioning_um"] < 0.03
    assert row["kind"] == WRONG
    assert row["words"].endswith("shifts by 0.01 um at 32 times of the step do up to 2.3 um")
    assert truth.conditioning_within(1e-5) < 0.01
    assert tried(truth, "rkc2", 0.003)["kind"] == STABLE


def test_cells_that_stay_where_the_true_ones_left_are_damped_and_not_excused(truths):
    truth = truths("chain", 40.0, 1.0)
    row = tried(truth, "cvode", 1.5)
    assert row["kind"] == DAMPED
    assert row["ratio"] < 1.0  # a shift may turn the zigzag over; none leaves the chain straight
    assert truth.growth(truth.end) < 1e-4
    assert tried(truth, "cvode", 0.1)["kind"] == STABLE


def test_a_snap_at_the_steps_end_that_comes_too_early_is_named(truths):
    truth = truths("pulled")
    row = tried(truth, "backward-euler", 150.0)
    assert row["kind"] == SNAP
    assert row["ratio"] > 50.0
    assert tried(truth, "rkc2", 0.1)["kind"] == STABLE


def test_a_step_beyond_the_limit_is_a_blow_up_also_where_it_stays_finite(truths):
    truth = truths("chain", 3.0, 200.0)
    limit = 2.0 / truth.decay()
    row = tried(truth, "euler", 2.0 * limit)
    assert row["kind"] == BLOW_UP
    assert row["words"].startswith("the step is 2 times")
    assert tried(truth, "euler", 0.9 * limit)["kind"] == COARSE
    assert tried(truth, "euler", 0.5 * limit)["kind"] == STABLE


def test_a_refused_step_is_a_blow_up_and_a_lack_of_steps_a_stall(truths):
    truth = truths("chain", 3.0, 200.0)
    assert tried(truth, "euler", truth.state.length)["kind"] == BLOW_UP
    few = Method("few", "tolerance", lambda _: Cvode(1e-6, 1e-4, 3))
    row = tried(truth, few, 0.001)
    assert row["kind"] == STALL
    assert row["error_um"] == math.inf
    state = truth.state
    trial = try_step(state, find_method("cvode", state.scene, state.radius), 0.001, 1e-9)
    assert "wall time" in trial.words
    assert trial_row(truth, trial)["kind"] == STALL


# the truth


def test_the_truth_is_that_of_another_solver(truths):
    """By LSODA at 1e-9, on a right-hand side that shares nothing with the package."""
    truth = truths("motile")
    assert np.abs(truth.end - motile_end()).max() < 1e-6
    assert truth.uncertainty < 1e-8


def test_conditioning_is_the_largest_of_twelve_shifts(truths):
    """Free cells carry a shift along: its effect is the shift."""
    state = truths("pulled").state
    away = np.array([[0.0, -40.0, 0.0], [0.0, 40.0, 0.0]])
    walls = replace(state.template, walls=None)
    truth = TrueStep.of(replace(state, template=walls, start=away))
    shifts = [
        shifted_positions(away, 0.01, draw + 1, 0, np.arange(2), 3) - away for draw in range(SHIFTS)
    ]
    largest = np.sqrt(np.square(shifts).sum(axis=2)).max()
    assert truth.conditioning(0.01) == pytest.approx(largest, rel=1e-6)
    assert truth.conditioning(0.02) == pytest.approx(2.0 * largest, rel=1e-6)
    assert truth.contact_time(np.array([0, 1])) is None
    drift = state.motion.drift(state.template.drag)
    assert truth.null_error() == pytest.approx(np.linalg.norm(drift, axis=1).max(), rel=1e-6)


def test_a_step_in_parts_is_the_step(truths):
    motion = truths("chain", 3.0, 200.0).state.motion
    rates = np.arange(3.0)[:, None] * np.array([[1.0, 2.0, 3.0, 0.1, 0.2, 0.3]])
    whole = replace(motion, push=rates, radius_rate=np.full(3, 1e-3), bonds=rates[:, :4])
    half = 0.5 * whole.end
    later = whole.between(half, 2.0 * whole.end, None)
    np.testing.assert_allclose(later.radius, motion.radius + 1e-3 * half)
    np.testing.assert_allclose(later.push[:, :3], rates[:, :3] + half * rates[:, 3:])
    np.testing.assert_allclose(later.bonds[:, :2], rates[:, :2] + half * rates[:, 2:4])
    assert np.array_equal(whole.push, rates)
    assert later.end == 2.0 * whole.end


# states of runs


SMALL = mc.load_scene("growth").with_changes(
    {"initial.count": 8, "initial.stage": "uniform", "duration": "1 h", "output.every": "30 min"}
)


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("states") / "run"
    mc.run(SMALL, output=folder, report=False, threads=1)
    return folder


@pytest.mark.parametrize("minutes", [0, 20, 30, 50])
def test_a_state_is_bitwise_what_the_run_has_passed(run_folder, minutes):
    state = state_at(f"{run_folder}:{minutes} min", 1)
    simulation = mc.Simulation(SMALL, threads=1)
    while simulation.time < 60.0 * minutes - 1.0:
        simulation.step()
    expected = RecordedState.of(simulation, "other")
    assert state.mark == expected.mark
    assert np.array_equal(state.ids, simulation.cells.id)
    simulation.step()
    assert state.motion.end == simulation.time
    assert state.name == f"run at {minutes} min"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{}", "must be the folder of a run and a time"),
        ("{}:2 h", "but that run ends at"),
        ("{}:60 min", "but that run ends at"),
        ("{}:-1 h", "no frame up to that time"),
        ("{}:nan h", "state"),
        ("{}:1 um", "state"),
    ],
)
def test_a_state_that_is_not_there_is_refused_in_words(run_folder, text, words):
    with pytest.raises(mc.SceneError, match=words):
        state_at(text.format(run_folder if ":" in text else "results"), 1)


def test_cells_that_touch_nothing_are_no_state():
    apart = SMALL.with_changes({"initial.spacing": 3.0, "initial.jitter": 0.0})
    with pytest.raises(mc.SceneError, match="nothing to solve"):
        RecordedState.of(mc.Simulation(apart, threads=1), "apart")


# the map


def test_a_map_that_was_ended_early_continues_and_is_the_same(run_folder, tmp_path):
    states, methods = [f"{run_folder}:20 min", f"{run_folder}:40 min"], ["euler", "rkc2"]
    whole = moving_stability(states, methods, tmp_path / "whole", threads=1)

    def ends(line):
        if line == "run at 40 min rkc2":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        moving_stability(states, methods, tmp_path / "map", ends, threads=1)
    lines = []
    found = moving_stability(states, methods, tmp_path / "map", lines.append, threads=1)
    assert "run at 20 min euler: was measured before" in lines
    assert lines[-1] == "run at 40 min rkc2"
    assert not any("shifted" in line for line in lines)  # the truth is on disk, too
    for row, other in zip(found.table, whole.table, strict=True):
        assert {**row, "wall": 0.0} == {**other, "wall": 0.0}
    assert {path.name for path in (tmp_path / "map").iterdir()} == set(FAILURE_FILES)
    with (tmp_path / "map" / "failures.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["kind"] for row in rows] == [row["kind"] for row in found.table]
    with pytest.raises(mc.OutputError, match="not empty"):
        moving_stability(states, methods, tmp_path / "map", threads=1)


def test_the_worst_state_of_each_method_counts(run_folder):
    states = [f"{run_folder}:20 min", f"{run_folder}:40 min"]
    found = moving_stability(states, ["euler", "rkc2"], threads=1)
    coarse = [row for row in found.table if row["method"] == "euler"]
    assert {row["kind"] for row in coarse} >= {STABLE, BLOW_UP}
    worst = found.worst()
    assert [row["method"] for row in worst].count("rkc2") == 5
    euler = worst[0]
    assert euler["ratio"] == max(row["ratio"] for row in coarse)
    assert euler["wrong"] == euler["states"] == 2
    assert {row["kind"] for row in found.failures()} <= set(STEP_ENDS) - {STABLE, POCKET}
    check_texts(found.figure())
    letters = [text.get_text() for axes in found.figure().axes for text in axes.texts]
    assert letters.count("B") == sum(row["kind"] == BLOW_UP for row in found.table)
    assert set(END_LETTERS) == set(STEP_ENDS)
    assert len(set(END_LETTERS.values())) == len(END_LETTERS)


def test_one_name_for_two_states_and_no_state_are_refused(run_folder):
    with pytest.raises(mc.SceneError, match="two states"):
        moving_stability([f"{run_folder}:20 min"] * 2, ["rkc2"])
    with pytest.raises(mc.SceneError, match="no run"):
        moving_stability([])


# the command


def command(*words):
    from click.testing import CliRunner

    from multicell.cli.main import main

    found = CliRunner().invoke(main, ["stability", *map(str, words)])
    return found.exit_code, found.output


def test_the_command_writes_the_map_of_a_state(run_folder, tmp_path):
    out = tmp_path / "out"
    state = f"{run_folder}:20 min"
    code, said = command("--state", state, "-o", out, "--methods", "rkc2", "--quiet", "--json")
    assert code == 0, said
    rows = json.loads(said)
    assert {row["state"] for row in rows} == {"run at 20 min"}
    assert {path.name for path in out.iterdir()} == set(FAILURE_FILES)
    page = (out / "report.html").read_text()
    assert all(kind.replace("'", "&#39;") in page for kind in STEP_ENDS)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "Missing argument 'SCENE', or --state"),
        (["settle", "--state", "run:1 h"], "leave out SCENE"),
        (["--state", "run:1 h", "--networks"], "leave out SCENE and --networks"),
        (["--state", "run:1 h", "--set", "seed=3"], "belong to a SCENE"),
        (["--state", "run"], "must be the folder of a run and a time"),
    ],
)
def test_a_command_that_makes_no_sense_is_refused(words, said, tmp_path):
    code, output = command(*words, "-o", tmp_path / "out")
    assert code != 0
    assert said in " ".join(output.split()), output
