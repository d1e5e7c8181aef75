"""Stability: planted failures are found and named, limits meet the theory, pictures show them."""

import csv
import math
import time
from dataclasses import dataclass, replace

import numpy as np
import pytest
from formulas import dense_jacobian
from picture_texts import check_texts

from multicell import OutputError, SceneError
from multicell.comparison.ladders import Method, find_method
from multicell.comparison.stability_limits.charts import TRIAL_COLOURS
from multicell.comparison.stability_limits.result import STABILITY_FILES, StabilityMap
from multicell.comparison.stability_limits.search import bisect, bracket, stability
from multicell.comparison.stability_limits.state import (
    MIN_NOTICED,
    PUSH,
    largest_decay,
    settled_state,
)
from multicell.comparison.stability_limits.trial import (
    BLOW_UP,
    STABLE,
    STALL,
    TRIAL_ENDS,
    TRIAL_STEPS,
    WRONG,
    judge,
    run_trial,
)
from multicell.integrators.base import Outcome
from multicell.integrators.rkc import Rkc2
from multicell.report.plots.colour_vision import APART, distance
from multicell.scene.scene import Scene, load_scene
from multicell.scene.start_table import with_cells

CLUSTER = Scene.from_dict(
    {
        "title": "Fifty <b>sticky</b> cells",
        "duration": "1 h",
        "initial": {"count": 50, "spacing": 0.86, "jitter": 0.03},
        "contact": {"law": "jkr", "surface_energy": 0.1},
    }
)
SMALL = CLUSTER.with_changes({"initial.count": 14})


@pytest.fixture(scope="module")
def cluster():
    return settled_state(CLUSTER, 1)


@pytest.fixture(scope="module")
def small():
    return settled_state(SMALL, 1)


# the state


def test_largest_decay_rate_is_the_lowest_eigenvalue_of_a_differenced_jacobian(small):
    rate, mode = largest_decay(small.system(0.0, 1.0), small.start)
    matrix = dense_jacobian(small.system(0.0, 1.0), small.start, 1e-5)
    assert -np.linalg.eigvals(matrix).real.min() == pytest.approx(rate, rel=1e-5)
    np.testing.assert_allclose(
        matrix @ mode.ravel(), -rate * mode.ravel(), atol=1e-4 * rate * np.abs(mode).max()
    )


@pytest.mark.parametrize("friction", [False, True])
def test_lanczos_meets_the_dense_eigenvalues(cluster, friction):
    system = cluster.system(0.0, 1.0)
    if friction:
        system = replace(system, friction=(0.05, 0.05))
        cluster.ready(system, 0.0, 1.0)
    dense, mode = largest_decay(system, cluster.start)
    sparse, other = largest_decay(system, cluster.start, dense=10)
    # with friction a product itself is a linear system, solved to 1e-4
    assert sparse == pytest.approx(dense, rel=1e-3 if friction else 1e-6)
    cosine = (mode * other).sum() / np.linalg.norm(mode) / np.linalg.norm(other)
    assert abs(cosine) == pytest.approx(1.0, abs=0.02 if friction else 1e-6)


def test_a_settled_cluster_starts_with_the_push_and_comes_to_rest(cluster):
    time = 400.0 / cluster.rate
    moved = np.linalg.norm(cluster.at(time) - cluster.start, axis=1).max()
    assert moved == pytest.approx(PUSH / MIN_NOTICED * cluster.noticed, rel=0.05)
    system = cluster.system(0.0, 1.0)
    force = system.force(0.0, cluster.at(time))
    assert np.abs(force).max() < 1e-7 * system.drag * cluster.radius**2 * cluster.rate
    # the answer does not depend on what was asked before
    again = settled_state(CLUSTER, 1)
    np.testing.assert_allclose(again.at(0.5 * time), cluster.at(0.5 * time), atol=1e-7)


def test_in_a_plane_nothing_leaves_it():
    flat = settled_state(SMALL.with_changes({"dimensions": 2}), 1)
    assert np.all(flat.start[:, 2] == 0.0)
    assert flat.rate > 0.0


def painted(x, law):
    """Cells of radius 4 µm along a line."""
    zero = np.zeros(len(x))
    cells = {"x_um": np.array(x), "y_um": zero, "z_um": zero, "radius_um": zero + 4.0}
    return with_cells(Scene.from_dict({"duration": "2 h", "contact": {"law": law}}), cells)


@pytest.mark.parametrize(
    ("x", "most"), [([0, 8], 2), ([0, 8 - 1e-12], 2), ([0, 7, 40, 80], 2), ([0, 8, 16], 3)]
)
def test_springs_decay_as_fast_as_their_laplacian_says(x, most):
    """λ = m k / γ, with m = 2 for a pair and 3 for a chain of three, and k = 1 nN/µm."""
    drag = 6.0 * np.pi * 5.0 * 4.0
    assert settled_state(painted(x, "linear"), 1).rate == pytest.approx(most / drag, rel=1e-6)


@pytest.mark.parametrize("gap", [-1e-14, -1e-6])
def test_adhesive_cells_that_touch_by_rounding_pull_each_other_in(gap):
    """Their limit is that of cells that began where they overlap."""
    near = settled_state(painted([0, 8 + gap], "jkr"), 1)
    assert near.rate == pytest.approx(settled_state(painted([0, 7], "jkr"), 1).rate, rel=1e-4)
    assert near.stiff_limit < 1e4


def within(x, law, **domain):
    """Such cells in a box."""
    scene, sides = painted(x, law), {axis: ["-50 um", "50 um"] for axis in "xyz"}
    return scene.with_changes({"domain": {**sides, **domain}})


@pytest.mark.parametrize("law", ["linear", "jkr"])
def test_cells_that_touch_through_a_periodic_face_are_as_those_inside(law):
    across = settled_state(within([-47, 46.5], law, periodic=["x"]), 1)
    inside = settled_state(within([0, 6.5], law, periodic=["x"]), 1)
    assert across.rate == pytest.approx(inside.rate, rel=1e-6)
    assert across.noticed == pytest.approx(inside.noticed, rel=1e-3)


@pytest.mark.parametrize("law", ["linear", "jkr", "hertz"])
def test_walls_alone_hold_no_cells_together(law):
    with pytest.raises(SceneError, match=r"nothing holds|no cells touch"):
        settled_state(within([-47, 46.5], law), 1)


@pytest.mark.parametrize(
    ("x", "law", "words"),
    [
        ([0], "jkr", "needs two cells"),
        ([0, 20], "jkr", "no cells touch"),
        ([0, 20, 40, 60], "linear", "no cells touch"),
        ([0, 8], "hertz", "nothing holds|no cells touch"),
        ([0, 7, 40], "hertz", "nothing holds"),
    ],
)
def test_where_nothing_bounds_the_step_there_is_no_limit(x, law, words):
    with pytest.raises(SceneError, match=words):
        settled_state(painted(x, law), 1)


# planted failures


@dataclass(frozen=True)
class Planted:
    """A true method; where ``fault`` is given it has the last word on each step."""

    fault: object = None
    rest: object = None

    def integrate(self, system, position):
        """Return the true end of the step, or a false one."""
        if self.rest is None:
            outcome = Rkc2(1e-8, 1e-6).integrate(system, position)
        else:
            outcome = Outcome(system.motion.end, 0.5 * (position + self.rest))
        if self.fault is None:
            return outcome
        return self.fault(system, position, outcome)


def index_of(system):
    motion = system.motion
    return round(motion.begin / (motion.end - motion.begin))


def blows_up(system, position, outcome):
    grown = position + 0.05 * position * 2.0 ** min(index_of(system), 30)
    return Outcome(outcome.time, grown)


def becomes_no_number(system, position, outcome):
    return Outcome(outcome.time, np.full_like(position, np.nan))


def refuses(system, position, outcome):
    words = "a step of 9 s would move the cell by 0.9 of its radius (allowed: 0.5)"
    return Outcome(system.motion.begin, position, words, "", 3)


def stalls(system, position, outcome):
    return Outcome(system.motion.begin, position, "steps became too short to go on", "", 0)


def oscillates(system, position, outcome):
    shifted = outcome.position.copy()
    shifted[3] += 0.04 * (-1.0) ** index_of(system) * np.array([4.0, 0.0, 0.0])
    return Outcome(outcome.time, shifted)


def swaps(system, position, outcome):
    after = outcome.position.copy()
    if index_of(system) == 7:
        i, j = system.contacts(system.motion.begin, position)[0]
        after[[i, j]] = after[[j, i]]
    return Outcome(outcome.time, after)


def outermost(position):
    away = np.linalg.norm(position - position.mean(axis=0), axis=1)
    return int(away.argmax())


def separates(system, position, outcome):
    """Draw the outermost cell away slowly until nothing touches it."""
    cell = outermost(position)
    after = outcome.position.copy()
    touching = system.contacts(system.motion.begin, position)
    if (touching == cell).any():
        outward = position[cell] - position.mean(axis=0)
        after[cell] = position[cell] + 0.08 * outward / np.linalg.norm(outward)
    else:
        after[cell] = position[cell]
    return Outcome(outcome.time, after)


def settles_wrongly(system, position, outcome):
    """Squeeze the cluster by two per cent within forty steps, and leave it so."""
    if index_of(system) >= 40:
        return Outcome(outcome.time, position)
    middle = position.mean(axis=0)
    return Outcome(outcome.time, middle + 0.98 ** (1 / 40) * (position - middle))


SAID = {
    "alternates": "alternate",
    "swaps": "pair distances differ",
    "separates": "pair distances differ",
    "squeezed": "energy ends",
}
PLANTS = {
    "grows": (blows_up, BLOW_UP),
    "no number": (becomes_no_number, BLOW_UP),
    "refused": (refuses, BLOW_UP),
    "out of steps": (stalls, STALL),
    "alternates": (oscillates, WRONG),
    "swaps": (swaps, WRONG),
    "separates": (separates, WRONG),
    "squeezed": (settles_wrongly, WRONG),
}


def planted(name, fault, above, control="step", rest=None):
    return Method(name, control, lambda s: Planted(fault if s > above else None, rest))


@pytest.mark.parametrize("name", PLANTS)
def test_a_planted_failure_is_found_and_named(small, name):
    fault, kind = PLANTS[name]
    setting = 0.5 * small.stiff_limit
    found, words = judge(small, run_trial(small, planted(name, fault, 0.0), setting))
    assert found == kind
    assert SAID.get(name, "") in words != ""
    assert judge(small, run_trial(small, planted(name, None, 0.0), setting)) == (STABLE, "")


def test_a_method_that_takes_too_long_is_a_stall(small):
    trace = run_trial(small, planted("slow", None, 0.0), small.stiff_limit, patience=0.0)
    assert len(trace.times) == 2
    assert judge(small, trace)[0] == STALL


@pytest.fixture(scope="module")
def map_of_plants():
    state = settled_state(SMALL, 1)
    scale = state.stiff_limit
    # where no fault is planted the cells simply come half the way to rest in each step
    rest = state.at(400.0 / state.rate)
    methods = [planted(n, fault, 3.0 * scale, rest=rest) for n, (fault, _) in PLANTS.items()]
    return scale, stability(SMALL, methods, threads=1)


@pytest.mark.slow
def test_the_limit_of_a_planted_failure_is_found_to_three_per_cent(map_of_plants):
    scale, result = map_of_plants
    for row in result.limits():
        assert row["limit"] <= 3.0 * scale < row["beyond"] <= 1.031 * row["limit"]
        assert row["kind"] == PLANTS[row["method"]][1]
    assert set(result.kinds) == set(TRIAL_ENDS)


def test_the_picture_shows_every_kind_planted_where_it_was_planted(map_of_plants):
    from matplotlib.colors import to_hex

    _, result = map_of_plants
    figure = result.figure()
    axes = figure.axes[0]
    assert [tick.get_text() for tick in axes.get_yticklabels()] == list(PLANTS)
    for level, (name, (_, kind)) in enumerate(PLANTS.items()):
        bars = [bar for bar in axes.patches if (bar.get_gid() or "").startswith(f"{name}|")]
        failed = [bar for bar in bars if bar.get_gid() == f"{name}|{kind}"]
        assert failed
        assert {to_hex(bar.get_facecolor()) for bar in failed} == {TRIAL_COLOURS[kind]}
        assert min(bar.get_x() for bar in failed) == pytest.approx(3.0, rel=0.03)
        assert all(abs(bar.get_y() + 0.5 * bar.get_height() - level) < 1e-9 for bar in bars)
        assert len(bars) == len(result.rows(name))
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert set(TRIAL_ENDS) <= set(legend)
    colours = list(TRIAL_COLOURS.values())
    assert set(TRIAL_COLOURS) == set(TRIAL_ENDS)
    for k, first in enumerate(colours):
        assert all(distance(first, other) > APART for other in colours[k + 1 :])


# real methods

LAWS = {"euler": 2.0, "heun": 2.0, "rk4": 2.785, "ab2": 1.0}


@pytest.fixture(scope="module")
def limits():
    methods = [*LAWS, "rkc2-9", "backward-euler", "cvode"]
    return stability(CLUSTER, methods, threads=1)


@pytest.mark.parametrize("method", [*LAWS, "rkc2-9"])
def test_the_limit_of_an_explicit_method_meets_the_theory(limits, method):
    row = limits.limit(method)
    law = LAWS.get(method, 2.0 / 3.0 * (9**2 - 1) * (1.0 - 2.0 / 15.0 * 2.0 / 13.0))
    within = 0.05 if law <= 2.0 else 0.1
    assert row["limit"] == pytest.approx(law / row["rate"], rel=within)
    assert row["beyond"] <= 1.031 * row["limit"]


def test_euler_alternates_and_heun_settles_wrongly_just_beyond(limits):
    """R(z) leaves the unit disc at -1 for Euler, but at +1 for Heun: no alternation."""

    def beyond(method):
        return next(row for row in limits.rows(method) if row["kind"] != STABLE)

    assert {beyond(name)["kind"] for name in ("euler", "ab2", "heun")} == {WRONG}
    assert "alternate" in beyond("euler")["words"]
    assert "alternate" in beyond("ab2")["words"]
    assert "energy ends" in beyond("heun")["words"]
    assert limits.rows("euler")[-1]["kind"] == BLOW_UP


def test_implicit_methods_have_no_limit(limits):
    cvode, backward = limits.limit("cvode"), limits.limit("backward-euler")
    assert math.isinf(cvode["beyond"])
    assert cvode["limit"] == pytest.approx(0.1)
    assert cvode["of_euler"] > 5.0
    assert math.isinf(backward["beyond"])
    assert backward["of_euler"] == pytest.approx(1000.0)
    assert math.isinf(backward["theory"])


@pytest.mark.slow
def test_limits_follow_the_viscosity():
    thin, thick = (
        stability(SMALL.with_changes({"drag.viscosity": eta}), ["euler"], threads=1).limit("euler")
        for eta in (0.05, 5.0)
    )
    assert thick["limit"] == pytest.approx(100.0 * thin["limit"], rel=0.05)
    for row in (thin, thick):
        assert row["of_theory"] == pytest.approx(1.0, abs=0.05)


# search and input


@pytest.mark.parametrize("true", [1e-3, 0.7, 5.0, 300.0])
def test_bisection_ends_within_three_per_cent_below_the_limit(true):
    found = bracket(lambda s: s <= true, 1.0, 1000.0)
    assert true / 1.03 <= found <= true
    assert 2.0 / 1.03 <= bisect(lambda s: s <= 2.0, 1.0, 8.0) <= 2.0


@pytest.mark.slow
def test_files_hold_what_was_found(tmp_path):
    folder = tmp_path / "out"
    told = []
    scene = load_scene("settle").with_changes({"initial.count": 12, "title": "A <b>title</b>"})
    result = stability(scene, ["euler", "dopri5"], folder, progress=told.append, threads=1)
    assert isinstance(result, StabilityMap)
    found = {path.name for path in folder.iterdir()}
    assert found == {*STABILITY_FILES} - {"moments.csv"}  # which is of networks alone
    with (folder / "stability.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(result.table)
    assert float(rows[3]["setting"]) == result.table[3]["setting"]
    with (folder / "limits.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(result.limits()) == 2
    text = (folder / "report.html").read_text()
    assert "A &lt;b&gt;title&lt;/b&gt;" in text
    assert "<b>title</b>" not in text
    assert text.count("data:image/png;base64,") == 2  # for light and dark
    assert "http" not in text.replace("http-equiv", "")
    assert any("euler" in line for line in told)
    check_texts(result.figure())
    with pytest.raises(OutputError, match="not empty"):
        stability("settle", ["euler"], folder)


@pytest.mark.parametrize(
    ("scene", "options", "words"),
    [
        (SMALL, {"methods": ["eluer"]}, "euler"),
        (SMALL.with_changes({"initial.count": 1}), {"methods": ["euler"]}, "two cells"),
        (SMALL.with_changes({"initial.spacing": 3.0}), {"methods": ["euler"]}, "touch"),
    ],
)
def test_bad_input_is_refused_with_words(scene, options, words):
    with pytest.raises(SceneError, match=words):
        stability(scene, **options)


@pytest.mark.kernels
@pytest.mark.parametrize("law", ["jkr", "exact-jkr"])
def test_a_fixed_step_is_watched_step_by_step_also_for_a_method_that_looks_back(law):
    """Seen one by one, the states of AB2 are those of one integration in a single go.

    The innermost cell starts away from rest: contacts form and break on the way, and exact JKR
    remembers those of the start.
    """
    state = settled_state(SMALL.with_changes({"contact.law": law}), 1)
    start = state.start.copy()
    inner = np.linalg.norm(start - start.mean(axis=0), axis=1).argmin()
    start[inner] += 0.8 * state.radius * np.array([0.48, 0.64, 0.6])
    state = replace(state, start=start, known=[])
    method = find_method("ab2", SMALL, state.radius)
    step = 0.2 * state.stiff_limit
    trace = run_trial(state, method, step)
    assert len(trace.positions) == TRIAL_STEPS + 1
    system = state.system(0.0, TRIAL_STEPS * step)
    first = system.contacts(0.0, state.start)
    state.ready(system, 0.0, TRIAL_STEPS * step, first)
    whole = method.make(step).integrate(system, state.start)
    last = system.contacts(TRIAL_STEPS * step, whole.position)
    assert set(map(tuple, first)) != set(map(tuple, last))
    np.testing.assert_allclose(trace.positions[-1], whole.position, atol=1e-9)


def test_what_a_first_step_compiles_is_not_held_against_the_method(small):
    @dataclass
    class SlowAtFirst:
        called: int = 0

        def integrate(self, system, position):
            if not self.called:
                time.sleep(1.2)
            self.called += 1
            return Outcome(system.motion.end, position)

    trace = run_trial(small, Method("slow", "step", lambda _: SlowAtFirst()), 1e-3, patience=1.0)
    assert trace.wall < 1.2
    assert len(trace.times) == TRIAL_STEPS + 1
    assert trace.problem == ""
