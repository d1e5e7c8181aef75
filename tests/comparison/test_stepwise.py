"""Step-wise comparison: every coupling step from its own recorded state, judged at its end."""

import csv
import io
import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from two_cells import GROWING, PAIR, RADIUS, PlantedInSteps, parted, step_method
from two_cells import IN_STEPS as EXACT
from two_cells import compared_in_steps as compared

import multicell.comparison.measure as measure
from multicell.cli.main import main
from multicell.comparison.norms import NORMS
from multicell.comparison.record import SAMPLES, sample_size
from multicell.comparison.reference import method_pair, reference
from multicell.comparison.replay import Trajectory, replay
from multicell.comparison.result import WorkPrecision
from multicell.comparison.work_precision import compare

# errors


def test_every_step_starts_from_its_recorded_state_and_meets_the_closed_form():
    found = reference(PAIR, stepwise=24)
    problem = found.problem
    assert problem.total == len(problem.steps) == len(problem.starts) == 5
    for start, end in zip(problem.starts, found.trajectory.positions, strict=True):
        np.testing.assert_allclose(end, parted(start, 60.0), rtol=0, atol=1e-9 * RADIUS)
    # the states were led to by a loose tolerance: they are near the solution, and not on it
    chained = parted(problem.starts[0], 60.0)
    assert 1e-9 < np.abs(problem.starts[1] - chained).max() / RADIUS < 0.05
    assert 0.0 < found.uncertainty["position"] < 1e-8


def test_an_error_of_each_step_is_found_and_not_carried_on():
    drift = step_method(lambda s: PlantedInSteps(shift=s * RADIUS))
    apart = compared([drift], [1e-3]).table[0]
    whole = compared([drift], [1e-3], stepwise=False).table[0]
    for norm in ("position", "position_median", "position_final"):
        assert apart[f"error_{norm}"] == pytest.approx(1e-3, rel=1e-6)
    assert whole["error_position"] == pytest.approx(5e-3, rel=1e-6)
    assert whole["error_position_median"] == pytest.approx(3e-3, rel=1e-6)
    for norm in ("energy", "gyration"):
        assert apart[f"error_{norm}"] == pytest.approx(0.0, abs=1e-9)


def test_one_step_from_the_start_is_the_ordinary_comparison():
    scene = PAIR.with_changes({"duration": "60 s"})
    one, all_ = (compared(["euler", "rk4"], [8.0, 2.0], scene, stepwise=s) for s in (True, False))
    for a, b in zip(one.table, all_.table, strict=True):
        times = ("wall", "cpu", "spent", "mode", "worst_cell_over_shift")
        same = [name for name in a if not name.startswith(times)]
        assert [a[name] for name in same] == [b[name] for name in same]
    assert one.uncertainty == all_.uncertainty


def test_the_cost_is_the_sum_over_the_steps():
    row = compared(["euler"], [10.0], stepwise=3).table[0]
    assert (row["evaluations"], row["cost"]) == (18, 18.0)


# failures


@pytest.fixture(scope="module")
def failing():
    """Return a comparison in which a method fails in the fourth step at one setting."""
    make = {2.0: PlantedInSteps(fail_in=200.0), 1.0: PlantedInSteps(shift=0.01)}
    off = step_method(lambda s: PlantedInSteps(shift=1e-4 * RADIUS), "off")
    fragile = step_method(make.__getitem__, "fragile")
    return compared([EXACT, fragile], [2.0, 1.0], references=[(EXACT, 1.0), (off, 1.0)])


def test_a_failure_in_one_step_is_nan_with_words(failing):
    (row,) = failing.failures()
    assert (row["method"], row["setting"]) == ("fragile", 2.0)
    assert row["words"] == "the planted end (t = 180 s)"
    assert all(math.isnan(row[f"error_{norm}"]) for norm in NORMS)


# chart, page and files say what was compared


def test_chart_page_and_csv_state_the_mode(failing, tmp_path):
    mode = "step-wise, 5 of 5 coupling steps"
    assert failing.facts["mode"] == mode
    assert any(mode in text.get_text() for text in failing.figure().texts)
    page = failing.save(tmp_path).read_text(encoding="utf-8")
    assert mode in page
    assert "positions, largest over the steps / mean radius" in page
    rows = list(csv.DictReader(io.StringIO((tmp_path / "workprecision.csv").read_text())))
    assert {row["mode"] for row in rows} == {mode}
    table = json.loads((tmp_path / "workprecision.json").read_text())
    assert "over the steps" in table["norms"]["energy"]
    whole = compared([EXACT], [1.0], stepwise=False)
    assert whole.table[0]["mode"] == "whole run"
    assert not any("step-wise" in text.get_text() for text in whole.figure().texts)


def test_a_result_comes_back_from_its_json(failing, tmp_path):
    failing.save(tmp_path)
    again = WorkPrecision.read(tmp_path / "workprecision.json")
    assert again.to_csv() == failing.to_csv()
    assert again.uncertainty == failing.uncertainty
    assert again.scene == failing.scene
    assert (again.clock, again.stepwise) == ("cpu", True)
    assert again.within(0.01).keys() == failing.within(0.01).keys()


# sampling


IN_A_PLANE = [
    "duration", "initial.count", "growth.cycle_time", "contact.law", "types.a", "types.b"
]  # fmt: skip
RICH = {
    "duration": "2 h",
    "initial.count": 10,
    "growth.cycle_time": "5 h",
    "contact.law": "exact-jkr",
    "friction": {"normal": "0.1 nN s/um^3", "tangential": "0.1 nN s/um^3"},
    "types.a": {"fraction": 0.5},
    "types.b": {"fraction": 0.5, "young": "3 kPa"},
    "nutrients.oxygen": {
        "diffusion": "2000 um^2/s",
        "boundary": "0.05 mM",
        "uptake": "40 amol/s",
        "half_saturation": "0.005 mM",
        "growth_half_saturation": "0.01 mM",
        "quiescence": "0.015 mM",
        "necrosis": "0.008 mM",
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("dimensions", [2, 3])
def test_nutrient_division_types_friction_and_remembered_contacts_are_held(dimensions):
    rich = RICH if dimensions == 3 else {k: v for k, v in RICH.items() if k in IN_A_PLANE}
    scene = GROWING.with_changes(rich | {"dimensions": dimensions})
    tight = [("cvode", 1e-9), ("cvode", 1e-8)]
    options = {"stepwise": 3, "repeats": 1, "references": tight}
    first = compare(scene, ["cvode"], {"tolerance": [1e-2, 1e-4]}, **options)
    assert first.failures() == []
    assert first.uncertainty["position"] < 1e-6
    assert first.table[1]["error_position"] < 1e-2
    pair = method_pair(tight, scene, first.facts["mean_radius"])
    problem = reference(scene, pair=pair, stepwise=3).problem
    assert len(problem.starts) == 3
    assert any(len(step.motion.touching) for step in problem.steps)
    assert all(step.motion.kind is not None for step in problem.steps)
    assert problem.counts[-1] > problem.counts[0]
    for start, step in zip(problem.starts, problem.steps, strict=True):
        assert start.shape == (len(step.motion.radius), 3)


# time that judges


def test_the_chosen_clock_judges(monkeypatch):
    # of each method: loading, the solve of the errors, a warm-up, and the one that counts
    times = iter([(9.0, 9.0), *[(1.0, 5.0)] * 3, (9.0, 9.0), *[(4.0, 2.0)] * 3])

    def timed(problem, integrator, limit=math.inf):
        found = replay(problem, integrator)
        return Trajectory(found.positions, found.work, *next(times), found.problem)

    monkeypatch.setattr(measure, "replay", timed)
    methods = [EXACT, step_method(lambda s: PlantedInSteps(), "other")]
    result = compared(methods, [1.0], clock="cpu")
    assert list(result.within(0.1)) == ["other", "exact"]
    assert [(row["wall"], row["cpu"]) for row in result.table] == [(1.0, 5.0), (4.0, 2.0)]
    assert result.figure().axes[0].get_xlabel() == "CPU time (s)"
    by_wall = WorkPrecision(result.scene, result.table, result.facts, result.uncertainty)
    assert list(by_wall.within(0.1)) == ["exact", "other"]
    assert by_wall.figure().axes[0].get_xlabel() == "wall time (s)"


# input


def test_the_number_of_steps_is_read():
    assert [sample_size(s) for s in (False, None, True, 3)] == [None, None, SAMPLES, 3]


@pytest.mark.slow
def test_the_command_compares_step_wise(tmp_path):
    scene, out = tmp_path / "pair.toml", tmp_path / "out"
    scene.write_text(PAIR.with_changes({"coupling_step": "10 s"}).to_toml())
    arguments = ["compare", str(scene), "--stepwise", "--methods", "euler", "--json"]
    options = ["--clock", "cpu", "--repeats", "1", "-o", str(out), "--quiet"]
    done = CliRunner().invoke(main, [*arguments, *options])
    assert done.exit_code == 0, done.output
    modes = {row["mode"] for row in json.loads(done.stdout)}
    assert modes == {"step-wise, 24 of 30 coupling steps"}
    assert "Judged by CPU time" in (out / "report.html").read_text(encoding="utf-8")
    rows = csv.DictReader(io.StringIO((out / "conditioning.csv").read_text()))
    assert {float(row["shift_um"]) for row in rows} == {0.01}
    words = [str(scene), "--stepwise", "3", "-o", str(tmp_path / "other")]
    assert main.commands["compare"].make_context("compare", words).params["stepwise"] == 3
