"""Stability from states that are not settled, and methods that damp what should grow."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from strategies import mechanics

from multicell import Hertz, SceneError
from multicell.cli.main import main
from multicell.comparison.ladders import find_method
from multicell.comparison.stability_limits.charts import COLOURS
from multicell.comparison.stability_limits.moving_states import (
    COMPRESSED,
    SNAP,
    STATES,
    complete_state,
    state_of,
)
from multicell.comparison.stability_limits.search import stability
from multicell.comparison.stability_limits.state import MAX_UNNOTICED, State
from multicell.comparison.stability_limits.trial import (
    DAMPED,
    KINDS,
    STABLE,
    WRONG,
    judge,
    run_trial,
)
from multicell.contact.law import compliance
from multicell.mechanics.walls import Walls
from multicell.report.plots.colour_vision import APART, distance
from multicell.scene.scene import Scene

SMALL = Scene.from_dict(
    {
        "title": "Sticky cells",
        "duration": "2 d",
        "coupling_step": "10 min",
        "initial": {"count": 14, "spacing": 0.86, "jitter": 0.03, "stage": "uniform"},
        "contact": {"law": "jkr", "surface_energy": 0.1},
        "growth": {"cycle_time": "15 h"},
    }
)
EVEN = SMALL.with_changes({"initial.count": 50, "initial.stage": "birth"})
RADIUS, DISTANCE, SOFT, VISCOSITY, TINY = 5.0, 8.0, 0.5, 2.0, 1e-3


def contact_force(h):
    """Hertz between two of these cells, nN: E* = E / (1 - ν²) / 2, r = R / 2."""
    modulus = 1.0 / 0.75 / 2.0
    return 4.0 / 3.0 * modulus * math.sqrt(0.5 * RADIUS) * max(h, 0.0) ** 1.5


def wall_force(h):
    soft = compliance(np.ones(1), np.full(1, 0.5))[0] + SOFT
    return math.sqrt(RADIUS) / soft * max(h, 0.0) ** 1.5


class Chain:
    """Three cells between two walls, written by hand: nothing of the package but constants."""

    drag = 6.0 * math.pi * VISCOSITY * RADIUS
    force = contact_force(2.0 * RADIUS - DISTANCE)
    indentation = (force / wall_force(1.0)) ** (2.0 / 3.0)
    wall = DISTANCE + RADIUS - indentation
    rate = 3.0 * force / (DISTANCE * drag)
    """Across the chain J is F / (d Γ) times the graph's Laplacian, with eigenvalues 0, 1, 3."""

    def __call__(self, time, y):
        x = y.reshape(3, 2)
        out = np.zeros_like(x)
        for i, j in ((0, 1), (1, 2), (0, 2)):
            line = x[j] - x[i]
            d = np.linalg.norm(line)
            push = contact_force(2.0 * RADIUS - d) * line / d
            out[i] -= push
            out[j] += push
        for i in range(3):
            out[i, 0] += wall_force(RADIUS - (x[i, 0] + self.wall))
            out[i, 0] -= wall_force(RADIUS - (self.wall - x[i, 0]))
        return (out / self.drag).ravel()


@pytest.fixture(scope="module")
def chain():
    """Return the chain pressed straight, but for a tiny zigzag."""
    inf = np.inf
    walls = Walls(np.array([-Chain.wall, -inf, -inf]), np.array([Chain.wall, inf, inf]), SOFT)
    system = mechanics(np.full(3, RADIUS), np.ones(3), Hertz(), viscosity=VISCOSITY, walls=walls)
    zigzag = TINY * RADIUS * np.array([0.5, -1.0, 0.5])
    start = np.stack([DISTANCE * np.array([-1.0, 0.0, 1.0]), zigzag, np.zeros(3)], axis=1)
    scene = SMALL.with_changes({"dimensions": 2})
    state = State(scene, system, system.motion, start, math.nan, math.nan, MAX_UNNOTICED)
    return complete_state(state, 40.0 / Chain.rate)


def test_a_compressed_chain_has_the_growth_rate_of_its_prestress(chain):
    assert chain.unstable.rate == pytest.approx(Chain.rate, rel=1e-4)
    assert sorted(chain.unstable.rates) == pytest.approx([Chain.rate / 3.0, Chain.rate], rel=1e-4)
    # a rigid motion and one along the chain are no growth
    still = np.array([[1.0, 1.0, 0.0]] * 3)
    assert chain.unstable.unstable_part(still, 0.0) == pytest.approx(np.zeros(3), abs=1e-3)


def test_the_true_zigzag_grows_exponentially_as_an_outside_solver_has_it(chain):
    assert np.abs(Chain()(0.0, chain.start[:, :2].copy() * [1.0, 0.0])).max() < 1e-12
    times = np.array([1.0, 2.0, 3.0]) / Chain.rate
    solved = solve_ivp(
        Chain(), (0.0, times[-1]), chain.start[:, :2].ravel(), "DOP853", times, rtol=1e-12,
        atol=1e-12,
    )  # fmt: skip
    for time, y in zip(times, solved.y.T, strict=True):
        np.testing.assert_allclose(chain.at(time)[:, :2], y.reshape(3, 2), atol=1e-5)
        grown = np.abs(y.reshape(3, 2)[1, 1]) / (TINY * RADIUS)
        assert grown == pytest.approx(math.exp(Chain.rate * time), rel=2e-3)


@pytest.mark.parametrize("product", [7.0, 12.0])
def test_backward_euler_goes_where_the_energy_falls_and_damps_no_real_instability(chain, product):
    far = chain.scene.with_changes({"integrator.max_displacement": 1.0})
    step = chain.length / round(chain.length * Chain.rate / product)
    trace = run_trial(chain, find_method("backward-euler", far, RADIUS), step)
    assert judge(chain, trace).kind == STABLE
    assert np.abs(trace.positions[1][:, 1]).max() > 0.8 * RADIUS
    true = np.abs(chain.at(chain.length)[:, 1]).max()
    assert np.abs(trace.positions[-1][:, 1]).max() == pytest.approx(true, rel=0.01)
    # what the scene allows a cell to move in a step is another matter
    trace = run_trial(chain, find_method("backward-euler", chain.scene, RADIUS), step)
    assert "would move the cell" in judge(chain, trace).words


@pytest.mark.parametrize("name", ["backward-euler", "euler"])
def test_short_steps_follow_what_grows(chain, name):
    method = find_method(name, chain.scene, RADIUS)
    verdict = judge(chain, run_trial(chain, method, chain.length / 800))
    assert (verdict.kind, verdict.words) == (STABLE, "")


@pytest.mark.parametrize(("tolerance", "kind"), [(0.03, STABLE), (0.3, DAMPED)])
def test_cvode_damps_it_where_its_tolerance_hides_the_disturbance(chain, tolerance, kind):
    method = find_method("cvode", chain.scene, RADIUS)
    verdict = judge(chain, run_trial(chain, method, tolerance))
    assert verdict.kind == kind
    assert ("unstable modes" in verdict.words) == (kind == DAMPED)
    assert any("energy ends" in words for words in verdict.also) == (kind == DAMPED)


def test_an_end_that_is_wrong_in_spite_of_growth_is_a_wrong_state(chain):
    """A method that stops where the motion is not linear any more has not damped its growth."""
    method = find_method("backward-euler", chain.scene, RADIUS)
    trace = run_trial(chain, method, chain.length / 800)
    aside = [np.abs(x[:, 1]).max() for x in trace.positions]
    first = next(k for k, y in enumerate(aside) if y > 0.7 * aside[-1])
    held = [trace.positions[min(k, first)] for k in range(len(aside))]
    stopped = replace(trace, positions=held)
    assert judge(chain, stopped).kind == WRONG
    # explicit methods lag behind growth, but never damp it
    assert judge(chain, replace(stopped, step=10.0 / Chain.rate, implicit=False)).kind == WRONG
    assert judge(chain, replace(stopped, step=10.0 / Chain.rate)).kind == WRONG


@pytest.fixture(scope="module")
def pressed():
    methods = ["euler", "ab2", "backward-euler"]
    return stability(EVEN, methods, threads=1, state="compressed")


def test_backward_euler_is_bounded_by_how_far_cells_may_move_and_not_by_eulers_limit(pressed):
    assert pressed.limit("backward-euler")["of_euler"] > 10.0


@pytest.mark.parametrize(("method", "law"), [("euler", 2.0), ("ab2", 1.0)])
def test_the_limit_of_an_explicit_method_lies_between_the_worst_state_and_the_last(
    pressed, method, law
):
    row = pressed.limit(method)
    first = pressed.rows(method)[0]
    assert row["theory"] == pytest.approx(law / first["rate"])
    assert 0.97 * law / first["rate"] <= row["limit"] <= 1.05 * law / first["end_rate"]
    assert first["end_rate"] <= first["rate"]
    assert first["growth_rate"] > 0.0
    assert {r["kind"] for r in pressed.rows(method)} > {STABLE}


def test_a_compressed_state_is_the_settled_one_scaled():
    state = state_of("compressed", SMALL, 1)
    rest = state_of("settled", SMALL, 1)
    spread = [np.linalg.norm(s.start - s.start.mean(axis=0), axis=1) for s in (state, rest)]
    assert spread[0] == pytest.approx(COMPRESSED * spread[1], rel=1e-2, abs=1e-2)
    again = state_of("compressed", SMALL, 1)
    assert np.array_equal(state.start, again.start)
    assert (state.rate, state.length) == (again.rate, again.length)


def test_every_tenth_cell_has_just_divided():
    state = state_of("divided", SMALL, 1)
    assert len(state.start) == 14 + 2
    before, radius = state_of("settled", SMALL, 1).motion.radius, state.motion.radius
    assert (radius**3).sum() == pytest.approx((before**3).sum())
    mothers = np.flatnonzero(radius[:14] != before)
    assert len(mothers) == 2
    assert sorted(radius[mothers] ** 3) == pytest.approx(sorted(0.5 * before[mothers] ** 3))
    between = np.linalg.norm(state.start[mothers] - state.start[14:], axis=1)
    assert between == pytest.approx(2.0 * before[mothers] * (1.0 - 0.5 ** (1.0 / 3.0)))
    assert state.unstable.rate > 0.3 * state.rate


def test_a_growing_state_grows_on_in_the_trial():
    state = state_of("growing", SMALL, 1)
    assert len(state.start) > 14
    later = state.system(100.0, 200.0).motion.radius
    np.testing.assert_allclose(later, state.motion.radius + 100.0 * state.motion.radius_rate)
    assert (state.motion.radius_rate > 0.0).any()
    method = find_method("rkc2", SMALL, state.radius)
    assert judge(state, run_trial(state, method, 1e-4)).kind == STABLE


@pytest.mark.parametrize("count", [2, 14])
def test_at_the_snap_one_contact_is_as_far_from_its_turning_point_as_said(count):
    scene = SMALL.with_changes({"contact.law": "exact-jkr", "initial.count": count})
    state = state_of("snap", scene, 1)
    i, j = state.motion.touching.T
    distance_ = np.linalg.norm(state.start[i] - state.start[j], axis=1)
    young, r = state.motion.young, state.motion.radius
    # k from the law's definition: (π² w² r / (64 E*²))^(1/3)
    star = 1.0 / (0.75 / young[i] + 0.75 / young[j])
    reduced = r[i] * r[j] / (r[i] + r[j])
    unit = np.cbrt((math.pi * 0.1 / (8.0 * star)) ** 2 * reduced)
    left = (r[i] + r[j] - distance_) / unit + 3.0
    assert left.min() == pytest.approx(3.0 * SNAP, rel=1e-6)
    assert state.unstable.rate > 0.0


def test_bad_states_are_refused_with_words():
    with pytest.raises(SceneError, match=r"compresed.*compressed"):
        stability(SMALL, ["euler"], state="compresed")
    with pytest.raises(SceneError, match="exact-jkr"):
        stability(SMALL, ["euler"], state="snap")
    with pytest.raises(SceneError, match="growth"):
        stability("settle", ["euler"], state="growing")


def test_the_command_takes_a_state_and_the_page_names_it(tmp_path):
    asked = ["stability", "settle", "-o", str(tmp_path / "o"), "--methods", "euler",
             "--set", "initial.count=12", "--state", "compressed", "--json"]  # fmt: skip
    done = CliRunner().invoke(main, asked)
    assert done.exit_code == 0, done.output
    assert {row["state"] for row in json.loads(done.stdout)} == {"compressed"}
    text = (tmp_path / "o" / "report.html").read_text()
    assert STATES["compressed"] in text
    assert DAMPED in text
    assert "2/λmax at the end" in text


def test_every_kind_has_a_colour_of_its_own():
    assert set(COLOURS) == set(KINDS)
    colours = list(COLOURS.values())
    for k, first in enumerate(colours):
        assert all(distance(first, other) > APART for other in colours[k + 1 :])
