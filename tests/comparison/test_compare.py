"""The work-precision harness: planted errors are found, planted failures are drawn."""

import csv
import io
import math
import time
from dataclasses import dataclass

import numba
import numpy as np
import pytest
from two_cells import (
    BOTH_EXACT,
    EXACT,
    GROWING,
    PAIR,
    RADIUS,
    Planted,
    apart_after,
    compared,
    only,
    step_method,
)

import multicell.comparison.measure as measure
from multicell import OutputError, SceneError
from multicell.comparison.ladders import find_method, settings, stiffness, weighted_cost
from multicell.comparison.norms import NORMS
from multicell.comparison.record import record
from multicell.comparison.reference import method_pair, reference
from multicell.comparison.replay import Trajectory, replay
from multicell.comparison.result import WorkPrecision
from multicell.comparison.work_precision import compare
from multicell.integrators.base import Outcome
from multicell.integrators.registry import METHODS
from multicell.integrators.runge_kutta import Euler
from multicell.mechanics.motion import Work


class Raising:
    def integrate(self, system, position):
        raise ArithmeticError("planted fault")


class NotANumber:
    def integrate(self, system, position):
        return Outcome(system.motion.end, np.full_like(position, np.nan))


@pytest.fixture(scope="module")
def exact():
    """Return the exact solution as a reference."""
    return reference(PAIR, pair=method_pair(BOTH_EXACT, PAIR, 1.0))


@pytest.fixture(scope="module")
def grown():
    return record(GROWING, Euler(5.0))


# planted errors


@pytest.mark.parametrize("size", [0.3, 1e-8])
def test_a_planted_shift_is_found_in_the_positions_only(size):
    result = compared([step_method(lambda s: Planted(shift=s * RADIUS))], [size])
    row = only(result)
    for norm in ("position", "position_median", "position_final"):
        assert row[f"error_{norm}"] == pytest.approx(size, rel=1e-6)
    for norm in ("energy", "gyration"):
        assert row[f"error_{norm}"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("size", [0.1])
def test_cells_drawn_apart_are_found_in_every_norm(size):
    row = only(compared([step_method(lambda s: Planted(apart=s * RADIUS))], [size]))
    # each of the two cells is off by half of what they are apart
    assert row["error_position"] == pytest.approx(0.5 * size, rel=1e-6)
    closest = apart_after(60.0) / RADIUS
    assert row["error_gyration"] == pytest.approx(size / closest, rel=1e-6)
    overlap = 2.0 * RADIUS - apart_after(60.0 * np.arange(1, 6))
    loss = np.maximum(overlap - size * RADIUS, 0.0) ** 2.5 - overlap**2.5
    expected = np.abs(loss).max() / (overlap**2.5).max()
    assert row["error_energy"] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("order", [1, 2, 4])
def test_a_planted_order_is_found_by_regression(order):
    method = step_method(lambda s: Planted(apart=RADIUS * 1e-3 * s**order))
    result = compared([method], [4.0, 2.0, 1.0, 0.5])
    assert result.order("planted") == pytest.approx(order, abs=1e-3)
    assert [row["setting"] for row in result.table] == [4.0, 2.0, 1.0, 0.5]


def test_an_order_needs_three_points_above_the_uncertainty():
    method = step_method(lambda s: Planted(apart=RADIUS * s))
    off = step_method(lambda s: Planted(shift=0.021 * RADIUS))
    result = compared([method], [0.8, 0.6, 0.4, 0.2], references=[(EXACT, 1.0), (off, 1.0)])
    assert math.isnan(result.order("planted"))


def test_euler_has_order_one_on_two_cells():
    result = compared(["euler"], [8.0, 4.0, 2.0, 1.0])
    assert result.order("euler", "position") == pytest.approx(1.0, abs=0.15)
    assert [r["evaluations"] for r in result.table] == [40, 75, 150, 300]
    assert [r["cost"] for r in result.table] == [40, 75, 150, 300]


def test_cvode_follows_its_tolerance():
    ladder = {"tolerance": [1e-3, 1e-5, 1e-7]}
    result = compare(PAIR, ["cvode"], ladder, references=BOTH_EXACT, repeats=1)
    for row in result.table:
        assert row["error_position"] < 30.0 * row["setting"]
        assert row["linear_iterations"] > 0
        work = Work(row["evaluations"], row["linearisations"], row["jacobian_products"])
        assert row["cost"] == weighted_cost(work) >= row["evaluations"]


# planted failures


@pytest.fixture(scope="module")
def failing():
    """Return a comparison in which one setting of one method fails, and two methods always."""
    make = {2.0: Planted(fail_after=130.0, words="out of <steps>"), 1.0: Planted(shift=0.01)}
    methods = [
        EXACT,
        step_method(make.__getitem__, "fragile"),
        step_method(lambda _: Raising(), "raising"),
        step_method(lambda _: NotANumber(), "nan"),
    ]
    off = step_method(lambda s: Planted(shift=1e-4 * RADIUS), "off")
    return compared(methods, [2.0, 1.0], references=[(EXACT, 1.0), (off, 1.0)])


def test_a_planted_failure_stays_in_the_table_as_nan_with_its_words(failing):
    row = only(failing, method="fragile", setting=2.0)
    assert row["status"] == "failed"
    assert row["words"] == "out of <steps> (t = 180 s)"
    numbers = ["wall", "cost", "evaluations", "steps", *(f"error_{norm}" for norm in NORMS)]
    assert all(math.isnan(row[name]) for name in numbers)
    assert row["spent"] > 0.0
    assert only(failing, method="fragile", setting=1.0)["status"] == "done"
    assert "planted fault (ArithmeticError" in failing.rows("raising", "failed")[0]["words"]
    assert "not a number" in failing.rows("nan", "failed")[1]["words"]
    assert len(failing.failures()) == 5
    assert failing.methods == ["exact", "fragile", "raising", "nan"]


def test_failures_are_drawn_as_crosses_in_the_colour_of_their_method(failing):
    from multicell.comparison.styles import appearance

    figure = failing.figure()
    strip = next(axes for axes in figure.axes if axes.get_label() == "failures")
    crosses = {line.get_label(): line for line in strip.lines}
    assert set(crosses) == {"fragile failed", "raising failed", "nan failed"}
    for name, count in (("fragile", 1), ("raising", 2), ("nan", 2)):
        line = crosses[f"{name} failed"]
        assert line.get_marker() == "x"
        assert line.get_color() == appearance(failing)[name].colour
        spent = [row["spent"] for row in failing.rows(name, "failed")]
        np.testing.assert_array_equal(line.get_xdata(), spent)
        assert len(spent) == count
    assert any(text.get_text() == "failed solve" for text in figure.legends[0].get_texts())
    fine = compared([step_method(lambda s: Planted(shift=s))], [0.1])
    assert all(axes.get_label() != "failures" for axes in fine.figure().axes)


def test_the_curves_are_those_of_the_table(failing):
    figure = failing.figure("position_final")
    axes = {a.get_label(): a for a in figure.axes}
    for cost, label in (("cpu", "time"), ("cost", "cost")):
        (line,) = (
            line for line in axes[f"position_final {label}"].lines if line.get_label() == "fragile"
        )
        row = only(failing, method="fragile", setting=1.0)
        assert line.get_xdata() == pytest.approx([row[cost]])
        assert line.get_ydata() == pytest.approx([row["error_position_final"]])
    band = next(p for p in axes["position_final time"].patches if p.get_label() == "_uncertainty")
    top = max(band.get_path().transformed(band.get_patch_transform()).vertices[:, 1])
    assert top == pytest.approx(failing.uncertainty["position_final"])


def test_the_fastest_is_the_least_time_of_those_that_reach_the_error(failing):
    times = {"exact": 3.0, "fragile": 1.0}
    for row in failing.table:
        if row["status"] == "done":
            row["cpu"] = times[row["method"]] + row["setting"]
    slack = failing.uncertainty["position"]
    assert failing.fastest(0.01)["method"] == "fragile"
    assert failing.fastest(slack + 0.009 / RADIUS)["method"] == "exact"
    assert failing.fastest(slack + 0.009 / RADIUS)["setting"] == 1.0
    assert list(failing.within(0.01)) == ["fragile", "exact"]
    assert failing.fastest(0.5 * slack) is None
    with pytest.raises(ValueError, match="no norm 'size'"):
        failing.fastest(0.1, norm="size")


# time


def planted_walls(monkeypatch, walls):
    left = list(walls)

    def planted(problem, integrator, limit=math.inf):
        found = replay(problem, integrator)
        return Trajectory(found.positions, found.work, left.pop(0), problem=found.problem)

    monkeypatch.setattr(measure, "replay", planted)
    return left


def test_the_wall_time_is_the_minimum_after_a_warm_up(monkeypatch):
    # loading, the solve of the errors, warm-up, then three that count
    left = planted_walls(monkeypatch, [9.0, 0.8, 0.01, 0.5, 0.3, 0.4])
    row = only(compared([EXACT], [1.0], repeats=3))
    assert (row["wall"], row["spent"], left) == (0.3, 0.8, [])


def test_repeats_go_round_all_methods(monkeypatch):
    """A machine that is slow for a while is not held against the method that it was timing."""
    # of each: loading, errors, warm-up, time; then twice around, each after a warm-up
    walls = [9.0, 0.01, 0.01, 0.015, 9.0, 0.01, 0.01, 0.01]
    left = planted_walls(monkeypatch, [*walls, 9.0, 0.002, 9.0, 0.003, 9.0, 0.004, 9.0, 0.001])
    other = step_method(lambda _: Planted(), "other")
    result = compared([EXACT, other], [1.0], repeats=3)
    assert left == []
    assert [row["wall"] for row in result.table] == [0.002, 0.001]


def test_a_long_solve_is_repeated_once(monkeypatch):
    left = planted_walls(monkeypatch, [9.0, 6.0, 5.0])
    row = only(compared([EXACT], [1.0], repeats=3, patience=10.0))
    assert (row["wall"], left) == (5.0, [])


def test_what_would_take_too_long_is_skipped_and_not_called_a_failure(monkeypatch):
    planted_walls(monkeypatch, [9.0, 6.0, 5.0, 11.0, 11.0])
    result = compared([EXACT], [4.0, 2.0, 1.0], patience=10.0)
    assert [row["status"] for row in result.table] == ["done", "done", "skipped"]
    assert "about 22 s" in result.table[2]["words"]
    assert math.isnan(result.table[2]["wall"])
    assert result.failures() == []


def test_the_budget_is_shared_by_the_methods_that_are_left(monkeypatch):
    now = iter(range(0, 10**6, 3))  # every look at the clock is three seconds later
    monkeypatch.setattr(measure.clock, "perf_counter", lambda: float(next(now)))
    planted_walls(monkeypatch, [1.0] * 100)
    result = compared([EXACT], [8.0, 4.0, 2.0, 1.0], budget=1000.0, patience=100.0)
    assert [row["status"] for row in result.table] == ["done"] * 4
    result = compared([EXACT], [8.0, 4.0, 2.0, 1.0], budget=1.0, patience=100.0)
    assert [row["status"] for row in result.table] == ["done"] + ["skipped"] * 3


def test_a_solve_beyond_patience_ends_with_words(exact):
    stopped = replay(exact.problem, Planted(), limit=0.0)
    assert stopped.problem == "not done after 0 s of wall time (t = 60 s)"


def test_a_solve_that_never_ends_is_stopped_within_its_step(exact):
    class Endless:
        def integrate(self, system, position):
            out = np.empty_like(position)
            while True:
                system.velocity(system.motion.begin, position, out)

    stopped = replay(exact.problem, Endless(), limit=0.05)
    assert stopped.problem == "not done after 0.05 s of wall time (in the step from t = 0 s)"
    assert stopped.wall > 0.05
    assert stopped.positions == []
    # the mechanics of the problem itself is not touched
    assert replay(exact.problem, Planted()).done


# methods and ladders


def test_the_kind_of_a_method_is_seen_from_its_integrator():
    assert find_method("euler", PAIR, 4.0).control == "step"
    assert find_method("euler", PAIR, 4.0).make(3.0).step == 3.0
    assert find_method("backward-euler", PAIR, 4.0).control == "step"
    cvode = find_method("cvode", PAIR, 4.0)
    assert cvode.control == "tolerance"
    made = cvode.make(1e-4)
    assert (made.rtol, made.atol) == pytest.approx((1e-6, 4e-4))


def test_default_steps_halve_from_four_times_the_limit_of_euler(grown):
    problem, trajectory = grown
    rate = stiffness(problem, trajectory)
    steps = settings(find_method("euler", GROWING, 4.0), None, problem, rate)
    np.testing.assert_allclose(np.array(steps[:-1]) / steps[1:], 2.0)
    length = GROWING.coupling_step
    assert 0.5 * min(8.0 / rate, length) < steps[0] <= min(8.0 / rate, length)
    counts = length / np.array(steps)
    np.testing.assert_allclose(counts, counts.round())
    # a hundred times less viscous, a hundred times faster
    assert (
        settings(find_method("euler", GROWING, 4.0), None, problem, 100 * rate)[0] < 0.02 * steps[0]
    )


def test_the_bound_on_decay_rates_is_above_the_true_rate(exact):
    overlap = 0.4 * RADIUS
    modulus = 1.0 / (0.75 * 0.75 * 2.0)
    slope = 1.5 * modulus * math.sqrt(0.5 * RADIUS * overlap)
    rate = 2.0 * slope / (6.0 * math.pi * 5.0 * RADIUS)
    found = stiffness(exact.problem, exact.trajectory)
    assert rate * (1.0 - 1e-12) <= found <= 2.0 * rate


@pytest.mark.parametrize(
    ("methods", "given", "match"),
    [
        (["cvod"], {}, "no method is called 'cvod'.*'cvode'"),
        (["cvode"], {"ladder": {"tolerance": [1e-16]}}, "tolerance: is 1e-16.*Double precision"),
        (["euler"], {"ladder": {"euler": [0.0]}}, "ladder.euler: is 0.0, must be above 0 s"),
        (["euler"], {"ladder": {"step": [math.nan]}}, "must be above 0 s"),
        (["euler"], {"ladder": {"step": []}}, "is empty"),
        (["euler"], {"ladder": {"steps": [1.0]}}, "ladder.steps: is no method here.*'step'"),
        ([EXACT], {"metrics": {"energy": np.sum}}, "metrics.energy: is the name of a norm"),
        ([EXACT], {"metrics": {"a b": np.sum}}, "metrics.a b: is no identifier"),
        ([EXACT], {"clock": "sun"}, "clock: is 'sun', must be 'wall' or 'cpu'"),
        *(([EXACT], {"stepwise": n}, "stepwise: is .* of 1 or more") for n in (0, 2.5, "all")),
        *(([EXACT], {"stepwise": 3, "shift": s}, "shift") for s in (-1.0, "3 s", math.nan)),
    ],
)
def test_bad_input_is_refused_before_anything_is_written(methods, given, match, tmp_path):
    with pytest.raises(SceneError, match=match):
        compare(PAIR, methods, output=tmp_path / "out", **given, references=BOTH_EXACT)
    assert not list((tmp_path / "out").glob("*"))


def test_no_methods_are_refused():
    with pytest.raises(ValueError, match="methods is empty"):
        compare(PAIR, [])


@pytest.mark.slow
def test_every_method_there_is_meets_the_exact_solution():
    # of order one, which takes 1 / tolerance steps
    first = {"euler-adaptive": [1e-5], "multirate-euler": [1e-5]}
    ladder = {"tolerance": [1e-6], "step": [0.5], **first}
    result = compare(PAIR, None, ladder, references=BOTH_EXACT, repeats=1, patience=1e3, budget=1e4)
    assert result.methods == list(METHODS)
    assert result.facts["named"] == []
    assert result.failures() == []
    for row in result.table:
        assert row["error_position"] < (1e-3 if row["control"] == "step" else 3e-5), row["method"]


# files


def test_the_folder_holds_table_pictures_and_page(failing, tmp_path):
    page = failing.save(tmp_path / "out").read_text(encoding="utf-8")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "out/workprecision.csv").read_text())))
    assert [r["method"] for r in rows] == [r["method"] for r in failing.table]
    assert [math.isnan(float(r["wall"])) for r in rows] == [
        r["status"] != "done" for r in failing.table
    ]
    for name in ("workprecision.png", "worst-cell.png"):
        assert (tmp_path / "out" / name).read_bytes().startswith(b"\x89PNG")
    assert "out of &lt;steps&gt;" in page
    assert "out of <steps>" not in page
    assert "Two Hertz cells &lt;b&gt;part&lt;/b&gt;" in page
    # two pictures, each for light and dark
    assert page.count("data:image/png;base64,") == 4
    # pictures are written in letters that hold "http" now and then, but no colon
    assert "://" not in page


def test_a_scene_is_compared_from_its_file_and_nothing_is_overwritten(tmp_path):
    path = tmp_path / "pair.toml"
    path.write_text(PAIR.with_changes({"duration": "120 s"}).to_toml())
    options = {"ladder": {"euler": [30.0]}, "references": BOTH_EXACT}
    options |= {"methods": ["euler"], "output": tmp_path / "out"}
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="not empty"):
        compare(path, **options)
    result = compare(path, overwrite=True, **options)
    assert result.facts["coupling_steps"] == 2
    assert (tmp_path / "out" / "report.html").exists()
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"


def test_what_is_compiled_at_a_finer_setting_is_not_held_against_the_method():
    @dataclass
    class CompilesOnce:
        called: int = 0

        def integrate(self, system, position):
            self.called += 1
            if self.called == 20:
                numba.njit(lambda x: x + 1.0)(1.0)
                time.sleep(0.3)
            return Planted().integrate(system, position)

    late = CompilesOnce()
    method = step_method(lambda _: late, "late")
    result = compared([method], [4.0, 2.0, 1.0, 0.5], patience=0.25, budget=0.25)
    assert late.called > 20
    assert [row["status"] for row in result.table] == ["done"] * 4
    assert all(row["spent"] < 0.25 for row in result.table)


# what is handed on


def test_a_metric_of_ones_own_is_a_norm():
    """The cells of a pair are drawn apart by a known length; their centre stays."""
    metrics = {
        "centre": lambda x: float(np.linalg.norm(x.mean(axis=0))),
        "gap": lambda x: 2.0 * float(np.linalg.norm(x[0] - x[1])),
    }
    method = step_method(lambda s: Planted(apart=s))
    result = compared([method], [0.1, 0.01, 0.001], metrics=metrics)
    for row, length in zip(result.table, (0.1, 0.01, 0.001), strict=True):
        assert row["error_centre"] == pytest.approx(0.0, abs=1e-12)
        assert row["error_gap"] == pytest.approx(2.0 * length, rel=1e-6)
    assert result.order(method.name, "gap") == pytest.approx(1.0)
    assert result.norms["gap"] == "gap, largest over the common times"
    again = WorkPrecision.from_dict(result.to_dict())
    assert again.fastest(0.03, "gap")["error_gap"] <= 0.03


def test_tables_are_handed_out_with_their_columns():
    result = compared([EXACT, step_method(lambda s: Planted(shift=s), "off")], [2.0, 1.0])
    table = result.to_pandas()
    assert list(table.columns) == list(result.table[0])
    assert table["setting"].tolist() == [2.0, 1.0, 2.0, 1.0]
    assert table.attrs["mode"] == "whole run"
    data = result.to_xarray()
    assert dict(data.sizes) == {"integrator": 2, "rung": 2}
    off = data["error_position"].sel(integrator="off").values
    np.testing.assert_array_equal(off, [row["error_position"] for row in result.rows("off")])
    assert data.attrs["coupling_steps"] == result.facts["coupling_steps"]
