"""The worst cell as a norm, and how a random shift of all positions changes the end of a step."""

import csv
import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from formulas import dense_jacobian
from scipy.linalg import expm
from strategies import cluster, mechanics
from two_cells import BOTH_IN_STEPS as BOTH_EXACT
from two_cells import IN_STEPS as EXACT
from two_cells import PAIR, RADIUS, PlantedInSteps, parted, step_method
from two_cells import compared_in_steps as compared

from multicell import Hertz
from multicell.comparison.conditioning import conditioning_of, shift_starts
from multicell.comparison.ladders import find_method
from multicell.comparison.norms import displacements, observe
from multicell.comparison.numbers import COMPARISON_FILES
from multicell.comparison.page import VERDICT_NORMS
from multicell.comparison.reference import method_pair, reference
from multicell.comparison.replay import ReplayProblem, Step, replay
from multicell.comparison.result import WorkPrecision

# the worst cell


def test_the_worst_cell_of_each_time_is_that_with_the_largest_displacement():
    """By hand: 3-4-5 and 6-8-10 triangles among cells that stay."""
    first, second = np.zeros((4, 3)), np.zeros((2, 3))
    moved, other = first.copy(), second.copy()
    moved[2] = (3.0, 4.0, 0.0)
    moved[3] = (0.0, 0.0, 1.0)
    other[0] = (6.0, 0.0, 8.0)
    rms, worst = displacements([moved, other], [first, second])
    np.testing.assert_allclose(worst, [5.0, 10.0], rtol=1e-15)
    np.testing.assert_allclose(rms, [math.sqrt(26.0 / 4.0), math.sqrt(50.0)], rtol=1e-15)


class OneAstray:
    """The exact end of a step, but for the second cell, which lies 0.1 µm a minute further off."""

    def integrate(self, system, position):
        outcome = PlantedInSteps().integrate(system, position)
        outcome.position[1, 2] += system.motion.end / 600.0
        return outcome


def test_the_worst_cell_is_a_norm_in_radii_and_a_column_in_um():
    """Five steps end after 1 ... 5 min: the second of two cells is off by 0.1 ... 0.5 µm."""
    result = compared([step_method(lambda _: OneAstray(), "astray")], [1.0])
    (row,) = result.table
    assert row["worst_cell_um"] == pytest.approx(0.5, rel=1e-6)
    assert row["worst_cell_median_um"] == pytest.approx(0.3, rel=1e-6)
    assert row["error_worst_cell"] == pytest.approx(0.5 / RADIUS, rel=1e-6)
    assert row["error_worst_cell_median"] == pytest.approx(0.3 / RADIUS, rel=1e-6)
    # beside it the mean square over two cells
    assert row["error_position"] == pytest.approx(0.5 / RADIUS / math.sqrt(2.0), rel=1e-6)
    assert "worst_cell_um" in result.to_csv().splitlines()[0].split(",")


# conditioning


def test_the_shift_of_two_hertz_cells_decays_as_the_closed_form_has_it():
    """Along the line of centres the derivative of the end by the distance is (h_end / h)^1.5."""
    found = reference(PAIR, pair=method_pair(BOTH_EXACT, PAIR, RADIUS), stepwise=5)
    problem, known = found.problem, found.conditioning
    moved = shift_starts(problem, 0.01)
    for k, (start, other) in enumerate(zip(problem.starts, moved.starts, strict=True)):
        ends = [parted(x, 60.0) for x in (start, other)]
        off = np.linalg.norm(ends[1] - ends[0], axis=1)
        assert known.worst_cell[k] == pytest.approx(off.max(), rel=1e-9)
        assert known.rms[k] == pytest.approx(math.sqrt((off**2).mean()), rel=1e-9)
    # the factor itself, for a shift along the line alone
    start = problem.starts[0]
    axis = (start[1] - start[0]) / np.linalg.norm(start[1] - start[0])
    small = 1e-6 * np.stack([-axis, axis])
    gap = [2.0 * RADIUS - np.linalg.norm(x[1] - x[0]) for x in (start, parted(start, 60.0))]
    solver = find_method("dopri5", PAIR, RADIUS).make(1e-12)
    one, two = (
        replay(replace(problem, steps=problem.steps[:1], starts=[x]), solver).positions[0]
        for x in (start, start + small)
    )
    decay = np.linalg.norm(two - one, axis=1) / np.linalg.norm(small, axis=1)
    assert gap[1] < gap[0]
    np.testing.assert_allclose(decay, (gap[1] / gap[0]) ** 1.5, rtol=1e-4)


def held(length):
    """Return a step-wise problem of one step in which forces from outside hold a cluster still.

    Two of its cells have just divided: the equilibrium is unstable.
    """
    position, radius, young = cluster(12, 2, spacing=0.95)
    position = np.vstack([position, position[0] + (0.9, 1.2, 0.0)])
    position[0] -= (0.9, 1.2, 0.0)
    radius, young = np.append(radius, radius[0]), np.append(young, 1.0)
    system = mechanics(radius, young, Hertz(), duration=length)
    push = np.hstack([-system.force(0.0, position), np.zeros_like(position)])
    motion = replace(system.motion, push=push)
    system.begin(motion)
    problem = ReplayProblem(PAIR, system, position, radius, [Step(motion)], [position], 1)
    return problem, system, position


def test_a_small_shift_of_an_unstable_state_ends_as_exp_jt_has_it():
    _, system, position = held(1.0)
    jacobian = dense_jacobian(system, position)
    rate = np.linalg.eigvals(jacobian).real.max()
    length = 4.0 / rate
    problem, *_ = held(length)
    solver = find_method("dopri5", PAIR, RADIUS).make(1e-12)
    found, exact = (observe(p, replay(p, solver)) for p in (shift_starts(problem, 1e-6), problem))
    np.testing.assert_allclose(exact.positions[0], position, rtol=0, atol=1e-10)
    known = conditioning_of(problem, 1e-6, found, exact)
    begin = shift_starts(problem, 1e-6).starts[0] - position
    end = (expm(length * jacobian) @ begin.ravel()).reshape(-1, 3)
    off = np.linalg.norm(end, axis=1)
    assert known.worst_cell[0] == pytest.approx(off.max(), rel=1e-3)
    assert known.rms[0] == pytest.approx(math.sqrt((off**2).mean()), rel=1e-3)
    # e⁴ = 55 for the part along one of its 39 directions
    assert known.amplification[0] > 5.0
    assert known.floor["worst_cell"] == pytest.approx(off.max() / problem.mean_radius, rel=1e-3)


def test_cells_of_a_plane_stay_in_it_and_a_whole_run_has_no_conditioning():
    flat = PAIR.with_changes({"dimensions": 2})
    pair = method_pair([("dopri5", 1e-6), ("dopri5", 1e-5)], flat, RADIUS)
    problem = reference(flat, pair=pair, stepwise=2).problem
    for start, other in zip(problem.starts, shift_starts(problem, 0.01).starts, strict=True):
        np.testing.assert_array_equal(start[:, 2], other[:, 2])
        assert (start[:, :2] != other[:, :2]).all()
    whole = reference(PAIR, pair=method_pair(BOTH_EXACT, PAIR, RADIUS))
    assert whole.conditioning is None
    with pytest.raises(ValueError, match="single coupling steps"):
        shift_starts(whole.problem, 0.01)


# chart, page and files


@pytest.fixture(scope="module")
def judged():
    """Return a comparison with one solve far above the floor, and one below it."""
    off = step_method(lambda s: PlantedInSteps(shift=s * RADIUS), "off")
    return compared([EXACT, off], [0.1, 1e-5])


def test_an_error_is_judged_by_what_a_shift_does(judged):
    known = judged.conditioning
    below = [(row["method"], row["setting"]) for row in judged.below_floor()]
    assert below == [("exact", 0.1), ("exact", 1e-5), ("off", 1e-5)]
    (row,) = [r for r in judged.rows("off") if r["setting"] == 0.1]
    over = 0.1 * RADIUS / np.median(known.worst_cell)
    assert row["worst_cell_over_shift"] == pytest.approx(over, rel=1e-6)
    bare = compared([EXACT], [1.0], shift=0)
    assert bare.conditioning is None
    assert bare.below_floor() == []
    assert math.isnan(bare.table[0]["worst_cell_over_shift"])


def test_the_chart_draws_the_floor_with_its_words(judged):
    for norm in ("position", "worst_cell", "worst_cell_median"):
        figure = judged.figure(norm)
        for axes in (a for a in figure.axes if a.get_label() in (f"{norm} time", f"{norm} cost")):
            (band,) = (p for p in axes.patches if p.get_label() == "_floor")
            corners = band.get_path().transformed(band.get_patch_transform()).vertices
            assert max(corners[:, 1]) == pytest.approx(judged.conditioning.floor[norm])
        floor = f"a shift of 0.01 µm moves the end by {judged.conditioning.floor[norm]:.0e}: yellow"
        assert any(floor in text.get_text() for text in figure.texts)
    whole = compared([EXACT], [1.0], stepwise=False).figure()
    assert not any(p.get_label() == "_floor" for axes in whole.axes for p in axes.patches)


def test_page_csv_and_json_hold_it_with_units(judged, tmp_path):
    page = judged.save(tmp_path).read_text(encoding="utf-8")
    assert {path.name for path in tmp_path.iterdir()} == set(COMPARISON_FILES)
    assert "the difference of trajectories means nothing" in page
    assert page.count("below the floor</small>") == 3
    norms = [norm for norm in VERDICT_NORMS if norm in judged.uncertainty]
    assert len(norms) == 6  # the others are of networks
    for norm in norms:
        assert f"ends off by {judged.conditioning.floor[norm]:.1e}: smaller errors" in page
    rows = list(csv.DictReader(io.StringIO((tmp_path / "conditioning.csv").read_text())))
    assert list(rows[0]) == ["step", "shift_um", "begin_s", "rms_um", "worst_cell_um"]
    assert [float(row["begin_s"]) for row in rows] == [0.0, 60.0, 120.0, 180.0, 240.0]
    worst = [float(row["worst_cell_um"]) for row in rows]
    assert worst == judged.conditioning.worst_cell.tolist()
    held = json.loads((tmp_path / "workprecision.json").read_text())["conditioning"]
    assert held == judged.conditioning.to_dict()
    again = WorkPrecision.read(tmp_path / "workprecision.json")
    assert again.conditioning.to_dict() == held
    whole = compared([EXACT], [1.0], stepwise=False)
    assert list(whole.tables()) == ["workprecision.csv"]
    assert whole.page()["conditioning"] == {}
