"""Biology: conservation, order independence, thresholds, and growth against closed forms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial import cKDTree

import multicell as mc
from multicell.biology.division import divide
from multicell.biology.draws import scatter_about
from multicell.biology.growth import growth_factor, volumes_after
from multicell.biology.initial import initial_cells, packed_ball
from multicell.biology.plan import biology_plan
from multicell.biology.states import deciding, lysed, update_states
from multicell.biology.step import divide_and_remove
from multicell.cells import SPHERE, Cells, State, rows_before
from multicell.random import Purpose
from multicell.scene.scene import Scene
from multicell.scene.sizes import birth_volume

HOUR = 3600.0
CYCLE = 15 * HOUR


OXYGEN = {"growth_half_saturation": 0.01, "quiescence": 0.02, "necrosis": 0.005}
BASE = {
    "duration": "1 d",
    "seed": 1,
    "initial": {"count": 200},
    "growth": {"cycle_time": CYCLE, "cycle_variation": 0.1, "critical_pressure": 0.1},
    "death": {"lysis_time": "48 h", "removal_fraction": 0.1},
    "nutrients": {"oxygen": OXYGEN},
}


def make_scene(**changes: Any) -> Scene:
    """Return a scene with all parts of biology; None takes a part away."""
    return Scene.from_dict({k: v for k, v in (BASE | changes).items() if v is not None})


def growth(**changes: Any) -> dict[str, Any]:
    """Return a growth that does not feel pressure."""
    return {"cycle_time": CYCLE, "cycle_variation": 0.1} | changes


def initial(**changes: Any) -> dict[str, Any]:
    return {"count": 200} | changes


def some_cells(n: int, seed: int = 0) -> Cells:
    """Return ``n`` cells of all sizes and states in no particular order."""
    rng = np.random.default_rng(seed)
    return Cells(
        id=rng.permutation(5 * n)[:n],
        parent=np.full(n, -1),
        position=rng.normal(scale=50.0, size=(n, 3)),
        radius=rng.uniform(3.0, 5.5, n),
        young=rng.uniform(0.8, 1.2, n),
        poisson=np.full(n, 0.5),
        state=rng.choice(3, n, p=[0.6, 0.2, 0.2]),
        age=rng.uniform(0, CYCLE, n),
        cycle_time=rng.uniform(0.9, 1.1, n) * CYCLE,
        pressure=rng.uniform(-0.05, 0.2, n),
        kind=np.arange(n) % 3,
    )


def by_id(cells: Cells) -> dict[str, np.ndarray]:
    order = np.argsort(cells.id)
    return {name: column[order] for name, column in cells.columns()}


# --- start ---------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 3000))
def test_packed_ball_is_a_close_packing_in_a_ball(count: int) -> None:
    sites = packed_ball(count)
    assert sites.shape == (count, 3)
    np.testing.assert_allclose(sites.mean(axis=0), 0.0, atol=1e-12)
    if count > 1:
        nearest = cKDTree(sites).query(sites, k=2)[0][:, 1]
        np.testing.assert_allclose(nearest, 1.0, atol=1e-12)
        # volume of the ball that holds `count` sites of a packing of density sqrt(2)
        radius = (3 * count / (4 * np.pi * np.sqrt(2))) ** (1 / 3)
        assert np.linalg.norm(sites, axis=1).max() < radius + 1.0


def test_inner_sites_have_twelve_neighbours_in_two_layers_abab() -> None:
    sites = packed_ball(2000)
    tree = cKDTree(sites)
    inner = np.linalg.norm(sites, axis=1) < 5.0
    counts = np.array([len(x) - 1 for x in tree.query_ball_point(sites[inner], 1.0 + 1e-9)])
    assert (counts == 12).all()
    # hexagonal (not cubic) packing: the layer after the next lies straight above
    above = sites[inner] + [0.0, 0.0, 2.0 * np.sqrt(2.0 / 3.0)]
    assert tree.query(above)[0].max() < 1e-9


def test_initial_cells_start_at_birth_or_spread_over_the_cycle() -> None:
    birth = initial_cells(make_scene())
    np.testing.assert_allclose(birth.radius, 5.0 * 2 ** (-1 / 3), rtol=1e-15)
    assert (birth.age == 0).all()
    scene = make_scene(initial=initial(count=5000, stage="uniform"))
    cells = initial_cells(scene)
    progress = cells.volume / birth_volume(scene) - 1.0
    assert stats.kstest(progress, "uniform").pvalue > 1e-3
    np.testing.assert_allclose(cells.age, progress * cells.cycle_time, rtol=1e-10, atol=1e-6)
    assert cells.id.tolist() == list(range(5000))
    assert (cells.parent == -1).all()
    assert (cells.state == State.PROLIFERATING).all()
    assert (cells.poisson == 0.5).all()
    assert (cells.pressure == 0).all()


def test_initial_spacing_and_jitter_are_relative_to_the_diameter() -> None:
    exact = initial_cells(make_scene(initial=initial(count=3000, spacing=0.8)))
    nearest = cKDTree(exact.position).query(exact.position, k=2)[0][:, 1]
    np.testing.assert_allclose(nearest, 0.8 * 2 * exact.radius, rtol=1e-12)
    moved = initial_cells(make_scene(initial=initial(count=3000, spacing=0.8, jitter=0.05)))
    shift = (moved.position - exact.position) / (2 * exact.radius[:, None])
    assert stats.kstest(shift.ravel(), stats.norm(scale=0.05).cdf).pvalue > 1e-3


def test_cells_in_a_row_lie_along_x() -> None:
    cells = initial_cells(make_scene(initial=initial(count=4, spacing=0.5, shape="row")))
    expected = np.array([-0.75, -0.25, 0.25, 0.75]) * 2 * cells.radius
    np.testing.assert_allclose(cells.position[:, 0], expected, rtol=1e-14)
    assert (cells.position[:, 1:] == 0).all()
    assert (np.diff(cells.id) == 1).all()


def test_moduli_and_cycle_times_are_truncated_normal_and_independent() -> None:
    cells = initial_cells(make_scene(initial=initial(count=20_000)))
    law = stats.truncnorm(-3, 3)
    z_young, z_cycle = (cells.young - 1.0) / 0.1, (cells.cycle_time / CYCLE - 1.0) / 0.1
    assert stats.kstest(z_young, law.cdf).pvalue > 1e-3
    assert stats.kstest(z_cycle, law.cdf).pvalue > 1e-3
    assert abs(np.corrcoef(z_young, z_cycle)[0, 1]) < 4 / np.sqrt(20_000)


def test_largest_variation_stays_positive_and_keeps_the_mean() -> None:
    values = scatter_about(1, Purpose.MODULI, 0, np.arange(20_000), 2.0, 0.5)
    assert values.min() >= 0.2
    law = stats.truncnorm(-1.8, 1.8, loc=2.0, scale=1.0)
    assert stats.kstest(values, law.cdf).pvalue > 1e-3
    assert values.mean() == pytest.approx(2.0, abs=4 * law.std() / np.sqrt(20_000))


def test_without_growth_cycles_are_infinite_and_ages_finite() -> None:
    scene = make_scene(growth=None, initial=initial(stage="uniform"))
    cells = initial_cells(scene)
    assert np.isinf(cells.cycle_time).all()
    assert (cells.age == 0).all()
    ripe = replace(cells, radius=np.full(200, 6.0))
    assert divide(biology_plan(scene), ripe, 200) == (ripe, 200)


def test_seed_decides_everything() -> None:
    first, again = (initial_cells(make_scene(seed=3)) for _ in range(2))
    other = initial_cells(make_scene(seed=4))
    for name, column in first.columns():
        np.testing.assert_array_equal(column, getattr(again, name))
    assert not np.isin(first.young, other.young).any()


# --- growth --------------------------------------------------------------------------------------


def test_growth_factor_values_by_hand() -> None:
    scene = make_scene()
    c = {"oxygen": np.array([0.01, 0.03, 0.0, 0.01, 0.01, 0.01])}
    p = np.array([0.0, 0.0, 0.0, 0.05, 0.2, -0.05])
    expected = [0.5, 0.75, 0.0, 0.25, 0.0, 0.5]
    np.testing.assert_allclose(growth_factor(biology_plan(scene), c, p), expected, rtol=1e-15)


def test_growth_factor_multiplies_nutrients_and_absent_parts_do_nothing() -> None:
    nutrients = {"oxygen": OXYGEN, "glucose": {"growth_half_saturation": 1.0}}
    scene = make_scene(growth=growth(), nutrients=nutrients)
    c = {"oxygen": np.array([0.03]), "glucose": np.array([3.0])}
    high = np.array([5.0])
    assert growth_factor(biology_plan(scene), c, high)[0] == pytest.approx(0.75**2)
    assert (
        growth_factor(biology_plan(make_scene(nutrients={}, growth=growth())), {}, high)[0] == 1.0
    )
    assert growth_factor(biology_plan(make_scene(nutrients={}, growth=None)), {}, high)[0] == 0.0
    with pytest.raises(KeyError, match="glucose"):
        growth_factor(biology_plan(scene), {"oxygen": np.array([0.03])}, high)
    acid = make_scene(growth=growth(), nutrients={"lactate": {"growth_inhibition": 2.0}})
    assert growth_factor(biology_plan(acid), {"lactate": np.array([6.0])}, high)[0] == 0.25


def test_volumes_after_follow_the_state() -> None:
    scene = make_scene()
    cells = some_cells(60)
    cells.state[::6] = State.APOPTOTIC
    factor = np.linspace(0.0, 1.0, 60)
    dt = 600.0
    gain = (volumes_after(biology_plan(scene), cells, factor, dt) - cells.volume) / cells.volume
    for state in State:
        mine = cells.state == state
        expected = {
            State.PROLIFERATING: factor * dt / cells.cycle_time
            * (0.5 * SPHERE * 125.0) / cells.volume,
            State.QUIESCENT: np.zeros(60),
            State.NECROTIC: np.full(60, np.expm1(-dt / (48 * HOUR))),
            State.APOPTOTIC: np.full(60, np.expm1(-dt / (8 * HOUR))),
        }[state]  # fmt: skip
        assert mine.any()
        np.testing.assert_allclose(gain[mine], expected[mine], rtol=1e-11, atol=1e-14)
    still = volumes_after(biology_plan(make_scene(growth=None, death=None)), cells, factor, dt)
    np.testing.assert_array_equal(still, cells.volume)


# --- phases --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "oxygen", "pressure", "after"),
    [
        (State.PROLIFERATING, 0.02, 0.0, State.PROLIFERATING),
        (State.PROLIFERATING, 0.0199, 0.0, State.QUIESCENT),
        (State.QUIESCENT, 0.03, 0.0, State.PROLIFERATING),
        (State.PROLIFERATING, 0.03, 0.1, State.QUIESCENT),
        (State.PROLIFERATING, 0.03, 0.0999, State.PROLIFERATING),
        (State.QUIESCENT, 0.005, 0.0, State.QUIESCENT),
        (State.QUIESCENT, 0.0049, 0.0, State.NECROTIC),
        (State.PROLIFERATING, 0.0049, 0.5, State.NECROTIC),
        (State.NECROTIC, 0.07, 0.0, State.NECROTIC),
    ],
)
def test_state_changes(before: State, oxygen: float, pressure: float, after: State) -> None:
    cells = some_cells(1)
    cells = replace(cells, state=np.array([before]), pressure=np.array([pressure]), age=np.zeros(1))
    got = update_states(biology_plan(make_scene()), cells, {"oxygen": np.array([oxygen])})
    assert got.dtype == np.int8
    assert got.tolist() == [after]
    assert cells.state.tolist() == [before]


def test_states_without_the_parts_that_change_them() -> None:
    cells = some_cells(50)
    none = update_states(biology_plan(make_scene(nutrients={}, growth=growth())), cells, {})
    assert none is cells.state
    newborn = replace(cells, age=np.zeros(50))
    pressed = update_states(biology_plan(make_scene(nutrients={})), newborn, {})
    living = cells.state != State.NECROTIC
    np.testing.assert_array_equal(pressed[living], cells.pressure[living] >= 0.1)


def test_a_cell_decides_at_birth_and_once_in_each_reaction_time() -> None:
    cells = replace(some_cells(500), id=np.arange(500), age=np.zeros(500))
    assert deciding(cells, 600.0, 7200.0).all()
    ticks = []
    for step in range(1, 37):
        ticks.append(deciding(replace(cells, age=np.full(500, 600.0 * step)), 600.0, 7200.0))
    per_window = np.array(ticks).reshape(3, 12, 500)
    assert (per_window.sum(axis=1) == 1).all()
    # and always an even share of the population, here a twelfth of 500
    assert abs(per_window.sum(axis=2) - 500 / 12).max() < 2
    assert deciding(replace(cells, age=np.full(500, 7200.0)), 7200.0, 7200.0).all()


def test_a_cell_that_is_not_due_keeps_its_state_but_dies_at_once() -> None:
    cells = replace(some_cells(500), age=np.full(500, 1e5), pressure=np.zeros(500))
    due = deciding(cells, 600.0, 7200.0)
    living = cells.state != State.NECROTIC
    starved = update_states(biology_plan(make_scene()), cells, {"oxygen": np.full(500, 0.01)})
    np.testing.assert_array_equal(starved[~due], cells.state[~due])
    assert (starved[due & living] == State.QUIESCENT).all()
    assert 20 < due.sum() < 60
    dead = update_states(biology_plan(make_scene()), cells, {"oxygen": np.full(500, 0.001)})
    assert (dead == State.NECROTIC).all()


@pytest.mark.parametrize("dt", [600.0, 300.0])
def test_uptake_feedback_settles_instead_of_switching_all_cells(dt: float) -> None:
    # A field in which all cells see the same: it lies below the threshold of 0.02 mM if none
    # rests, above if all do, and at it if half of them do.
    scene = make_scene(coupling_step=dt, growth=growth())
    cells = replace(some_cells(600), state=np.zeros(600, dtype=np.int8), age=np.zeros(600))
    parts = []
    for step in range(1, int(86_400 / dt)):
        resting = float((cells.state == State.QUIESCENT).mean())
        parts.append(resting)
        oxygen = np.full(600, 0.019 + 0.002 * resting)
        cells = replace(cells, age=np.full(600, step * dt))
        cells.state = update_states(biology_plan(scene), cells, {"oxygen": oxygen})
    late = np.array(parts[len(parts) // 2 :])
    assert np.abs(late - 0.5).max() < 1.5 * dt / scene.cells.reaction_time


# --- division ------------------------------------------------------------------------------------


def test_division_conserves_volume_and_centre_of_mass_of_every_mother() -> None:
    scene = make_scene()
    before = some_cells(400)
    after, next_id = divide(biology_plan(scene), before, 5000)
    born = after.take(after.id >= 5000)
    ripe = (before.state == State.PROLIFERATING) & (before.radius >= 5.0)
    assert next_id == 5000 + 2 * ripe.sum() == 5000 + len(born)
    assert ripe.sum() > 20
    mothers = before.take(ripe)
    mothers = mothers.take(np.argsort(mothers.id))
    a, b = born.take(np.arange(0, len(born), 2)), born.take(np.arange(1, len(born), 2))
    np.testing.assert_array_equal(a.parent, mothers.id)
    np.testing.assert_array_equal(b.parent, mothers.id)
    np.testing.assert_allclose(a.volume, mothers.volume / 2, rtol=1e-12)
    np.testing.assert_allclose(b.volume, mothers.volume / 2, rtol=1e-12)
    centre = 0.5 * (a.position + b.position)
    np.testing.assert_allclose(centre, mothers.position, rtol=1e-12, atol=1e-12)
    # each daughter touches the mother's surface from within
    reach = np.linalg.norm(a.position - mothers.position, axis=1) + a.radius
    np.testing.assert_allclose(reach, mothers.radius, rtol=1e-12)
    assert (born.age == 0).all()
    np.testing.assert_array_equal(a.pressure, mothers.pressure)
    for daughter in (a, b):
        np.testing.assert_array_equal(daughter.kind, mothers.kind)
    assert len(np.unique(born.young)) == len(np.unique(born.cycle_time)) == len(born)
    assert not np.isin(born.young, before.young).any()


def test_only_ripe_proliferating_cells_divide_and_the_rest_are_untouched() -> None:
    scene = make_scene()
    before = some_cells(400)
    untouched = {name: column.copy() for name, column in before.columns()}
    after, _ = divide(biology_plan(scene), before, 5000)
    kept = before.take((before.state != State.PROLIFERATING) | (before.radius < 5.0))
    for name, column in kept.columns():
        np.testing.assert_array_equal(getattr(after, name)[: len(kept)], column)
    for name, column in before.columns():
        np.testing.assert_array_equal(column, untouched[name])


def test_a_cell_at_the_division_volume_up_to_rounding_divides() -> None:
    cells = replace(
        some_cells(2),
        state=np.zeros(2, dtype=np.int8),
        radius=np.array([np.nextafter(5.0, 0.0), 5.0 * (1.0 - 1e-9)]),
    )
    after, next_id = divide(biology_plan(make_scene()), cells, 100)
    assert next_id == 102
    assert after.id.tolist() == [cells.id[1], 100, 101]


def test_division_does_not_depend_on_the_order_of_the_arrays() -> None:
    scene = make_scene()
    cells = some_cells(400)
    shuffled = cells.take(np.random.default_rng(5).permutation(400))
    one, next_one = divide(biology_plan(scene), cells, 9000)
    two, next_two = divide(biology_plan(scene), shuffled, 9000)
    assert next_one == next_two
    for name, column in by_id(one).items():
        np.testing.assert_array_equal(column, by_id(two)[name])


def test_division_axes_are_isotropic_and_those_of_the_mothers() -> None:
    scene = make_scene()
    mothers = replace(
        some_cells(4000), radius=np.full(4000, 5.0), state=np.zeros(4000, dtype=np.int8)
    )
    axes = []
    for first in (0, 4000):
        named = replace(mothers, id=mothers.id + first)
        born, _ = divide(biology_plan(scene), named, 20_000)
        difference = born.position[0::2] - born.position[1::2]
        axes.append(difference / np.linalg.norm(difference, axis=1)[:, None])
    for column in axes[0].T:
        assert stats.kstest(column, stats.uniform(-1, 2).cdf).pvalue > 1e-3
    assert abs((axes[0] * axes[1]).sum(axis=1).mean()) < 4 / np.sqrt(3 * 4000)


# --- death ---------------------------------------------------------------------------------------


def test_lysed_cells_are_removed_below_the_fraction_of_the_birth_volume() -> None:
    scene = make_scene()
    limit = 5.0 * (0.1 / 2) ** (1 / 3)
    cells = replace(
        some_cells(4),
        radius=np.array([limit * 0.999, limit * 1.001, limit * 0.5, 5.0]),
        state=np.array([State.NECROTIC, State.NECROTIC, State.QUIESCENT, State.NECROTIC]),
    )
    assert lysed(biology_plan(scene), cells).tolist() == [True, False, False, False]
    assert lysed(biology_plan(make_scene(death=None)), cells) is None


def test_cells_that_divide_and_those_that_are_lysed_change_places_at_once():
    """The same cells and volumes as one after the other, and known where they were."""
    plan = biology_plan(make_scene(death={"lysis_time": "1 d"}))
    rng = np.random.default_rng(3)
    radius = 5.0 * rng.uniform(0.7, 1.02, 400)
    state = rng.choice([State.PROLIFERATING, State.QUIESCENT, State.NECROTIC], 400)
    radius[state == State.NECROTIC] *= rng.uniform(0.3, 0.8, (state == State.NECROTIC).sum())
    cells = replace(some_cells(400), radius=radius, state=state)
    divided, free = divide(plan, cells, 5000)
    gone = lysed(plan, divided)
    assert free > 5000
    assert gone.sum() > 5
    after = divide_and_remove(plan, cells, 5000, 60.0, 0.0)
    assert after.cells.equals(divided.take(~gone))
    assert (after.next_id, after.removals) == (free, gone.sum())
    assert after.released == divided.volume.sum() - after.cells.volume.sum()
    np.testing.assert_array_equal(after.row, rows_before(cells, after.cells))


@pytest.mark.parametrize("swelling", [1.0, 1.5])
def test_cells_that_are_lysed_in_a_small_part_of_a_step_are_gone_at_its_end(swelling):
    """They have a radius until then, so that their neighbours know where and how large they are."""
    left = []
    for lysis in ("1 s", "2 min"):
        scene = mc.load_scene("spheroid").with_changes(
            {
                "duration": "1 h",
                "initial.count": 300,
                "coupling_step": "15 min",
                "nutrients.oxygen.boundary": "0.02 mM",
                "nutrients.oxygen.necrosis": "0.0145 mM",
                "death.lysis_time": lysis,
                "death.swelling": swelling,
                "death.swelling_time": "10 s",
            }
        )
        result = mc.run(scene, report=False)
        summary, cells = result.summary(), result.frames[-1].cells
        assert all(np.isfinite(getattr(cells, name)).all() for name in ("position", "pressure"))
        left.append((len(cells), summary["removals"]))
        assert summary["ledger"]["relative_remainder"] < 1e-9
    assert left[0][1] > 20
    assert left[0] == left[1]
