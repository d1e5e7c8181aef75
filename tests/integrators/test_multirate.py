"""Multirate Euler: its parts against the whole, and its results against Euler and DOP853."""

from dataclasses import replace

import numpy as np
import pytest
from oracles import four_cells, reference
from strategies import cluster, mechanics

import multicell as mc
from multicell import JKR, Hertz
from multicell.contact.exact_jkr import ExactJKR
from multicell.integrators import driver, stepping
from multicell.integrators.loops import multirate
from multicell.integrators.loops.multirate import _grouped, adaptive_multirate
from multicell.integrators.runge_kutta import AdaptiveEuler, MultirateEuler
from multicell.integrators.stepping import compiled
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics

pytestmark = pytest.mark.kernels


@compiled
def velocities_of_a_part(source, pairs, is_fast, position, elapsed):
    """Return the velocities of the fast cells, from their pairs only."""
    part = multirate._part(source, pairs, is_fast)
    part.position[:] = position[part.member]
    drifted = multirate.forces.forces(
        part.cells, part.pairs, source.law, part.position, elapsed, True, part.rows,
        part.velocity,
    )  # fmt: skip
    return drifted, part.member[: part.fast], part.velocity[: part.fast], part.share


def everything(n, position, radius, young, chunk):
    """Return mechanics with all that compiled loops may meet: growth, bonds, pushes."""
    rng = np.random.default_rng(2)
    system = Mechanics(JKR(surface_energy=0.1), 5.0, bond_strength=0.2, chunk=chunk)
    motion = Motion(
        radius, 0.001 * radius, young, np.full(n, 0.5), 0.0, 100.0, rng.uniform(0.0, 1.0, (n, 4)),
        rng.normal(0.0, 0.1, (n, 6)),
    )  # fmt: skip
    system.begin(motion)
    return system


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [2048, 16])
@pytest.mark.parametrize("fast", [0.0, 0.05, 0.5])
def test_velocities_of_a_part_are_those_of_the_whole(fast, chunk):
    position, radius, young = cluster(80, 4)
    system = everything(80, position, radius, young, chunk)
    whole, counts = np.empty_like(position), np.zeros(5, np.int64)
    system.velocity(30.0, position, whole)
    source, pairs = driver.source_of(system, counts)
    is_fast = np.random.default_rng(1).uniform(size=80) < fast
    drifted, member, found, share = velocities_of_a_part(source, pairs, is_fast, position, 30.0)
    assert not drifted
    assert sorted(member) == list(np.flatnonzero(is_fast))
    np.testing.assert_allclose(found, whole[member], rtol=0.0, atol=1e-13 * np.abs(whole).max())
    # pairs of which at least one cell is fast; in small chunks many pairs stand twice
    if chunk > 80:
        assert share == pytest.approx(1.0 - (1.0 - is_fast.mean()) ** 2, abs=0.15)


def test_the_few_cells_with_the_largest_errors_are_the_fast_ones():
    """One cell of 500 a thousand times as bad as the others: it takes the shortest steps."""
    error, is_fast = np.full((500, 3), 1e-3), np.zeros(500, bool)
    error[17] = 1.0
    ratio, factor = _grouped(error, is_fast, 1, 16)
    assert ratio == 16
    assert list(np.flatnonzero(is_fast)) == [17]
    # the same rms: its error falls by the ratio at H and grows with H² for all
    others = 499 * 1e-6
    assert factor == pytest.approx(((1.0 + others) / (1.0 / 16**2 + others)) ** 0.25, rel=1e-12)
    # an error that is already that of short steps leaves the grouping as it is
    error[17] /= 16.0
    assert _grouped(error, is_fast, 16, 16) == (16, 1.0)
    # alike cells take alike steps, and one that has calmed down joins them
    error[:] = 1e-3
    error[17] /= 16.0
    assert _grouped(error, is_fast, 16, 16)[0] == 1
    assert not is_fast.any()


@pytest.mark.slow
@pytest.mark.parametrize("law", [JKR(surface_energy=0.1), ExactJKR(surface_energy=0.1)])
def test_one_group_is_adaptive_euler_in_every_bit(law):
    """Alike cells compiled; and scenes whose evaluations go through Python, whatever the cells."""
    position, radius, young = four_cells()
    if isinstance(law, ExactJKR):
        position, radius, young = cluster(30, 6)
    ends, works = [], []
    for kind in (MultirateEuler, AdaptiveEuler):
        system = mechanics(radius, young, law)
        outcome = kind(1e-6, 1e-3).integrate(system, position)
        assert outcome.done
        ends.append(outcome)
        works.append(system.work)
    assert np.array_equal(ends[0].position, ends[1].position)
    assert works[0] == works[1]


@pytest.fixture(scope="module")
def divided():
    """Settled Hertz cells of which two have just been put into the place of one."""
    position, radius, young = cluster(120, 5, spacing=0.97)
    settled = reference(mechanics(radius, young, Hertz(), duration=3e4), position, 1e-6)
    mother = int(np.square(settled - settled.mean(axis=0)).sum(axis=1).argmin())
    place = np.vstack([settled, settled[mother] + [1.5, 0.3, -0.4]])
    place[mother] -= [1.5, 0.3, -0.4]
    radius = np.append(radius, 0.8 * radius[mother])
    radius[mother] *= 0.8
    young = np.append(young, 1.0)
    exact = reference(mechanics(radius, young, Hertz(), duration=60.0), place, 1e-10)
    return place, radius, young, exact


def solved(kind, divided, atol, **options):
    place, radius, young, exact = divided
    system = mechanics(radius, young, Hertz(), duration=60.0, **options)
    outcome = kind(1e-9, atol, max_steps=10**6).integrate(system, place)
    assert outcome.done
    return np.abs(outcome.position - exact).max(), system.work


@pytest.mark.slow
def test_after_a_division_it_meets_dop853_with_order_one(divided):
    """Error and number of steps are inverse to each other."""
    found = [solved(MultirateEuler, divided, atol) for atol in 10.0 ** -np.arange(2.0, 5.0)]
    errors, steps = np.array([e for e, _ in found]), np.array([w.steps for _, w in found])
    assert errors[-1] < 1e-4
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(-1.0, abs=0.15)


@pytest.mark.slow
def test_one_division_among_many_cells_costs_less_than_with_equal_steps(divided):
    error, work = solved(MultirateEuler, divided, 1e-3)
    single, equal = solved(AdaptiveEuler, divided, 1e-3)
    assert error < 1.5 * single
    assert work.evaluations < 0.7 * equal.evaluations
    assert work.steps < 0.6 * equal.steps


def test_a_refused_step_is_not_made_longer_by_another_grouping():
    """Stiff cells that loose tolerances left unsettled; groupings took turns here for ever."""
    simulation = mc.Simulation(mc.load_scene("stiff-inclusions"))
    for atol in 0.4 * 0.97 ** np.arange(30):
        position = simulation.cells.position
        for _ in range(3):
            system = simulation.prepared()
            system.work.steps = system.work.rejections = 0
            outcome = MultirateEuler(1e-3, atol, max_steps=10_000).integrate(system, position)
            assert outcome.done, (atol, outcome.problem)
            assert system.work.rejections <= 15 + 0.5 * system.work.steps
            position = outcome.position


def test_steps_that_are_refused_without_end_end_a_loop():
    control = driver.control(MultirateEuler(), mechanics(np.ones(2), np.ones(2)), 2.0, lower=1)
    walk, counts = stepping.control_state(10.0), np.zeros(5, np.int64)
    tried = 0
    while stepping.stop_reason(walk, counts, control, 600.0) == stepping.DONE:
        assert stepping.refuse_step(walk, counts, control, stepping.MOVED, 1.0)
        walk[stepping.DT] = 10.0
        tried += 1
        assert tried < 1000
    assert counts[stepping.REJECTIONS] == tried > 100
    assert stepping.stop_reason(walk, counts, control, 600.0) == stepping.STALLED


@pytest.mark.slow
def test_threads_and_chunks_keep_the_result(divided):
    serial, work = solved(MultirateEuler, divided, 1e-3, chunk=16)
    shared, other = solved(MultirateEuler, divided, 1e-3, chunk=16, threads=2, shared_chunks=2)
    assert serial == shared
    assert work == other


def test_lists_are_built_anew_among_the_short_steps(divided):
    """With hardly any margin a fast cell leaves the list's reach within a long step."""
    place, radius, young, exact = divided
    system = mechanics(radius, young, Hertz(), duration=60.0, skin=1e-5)
    outcome = MultirateEuler(1e-9, 1e-3, max_steps=10**6).integrate(system, place)
    assert np.abs(outcome.position - exact).max() < 1e-3
    assert system.work.list_builds > 3 * system.work.steps / 2
    wide = mechanics(radius, young, Hertz(), duration=60.0)
    other = MultirateEuler(1e-9, 1e-3, max_steps=10**6).integrate(wide, place)
    np.testing.assert_allclose(outcome.position, other.position, atol=1e-12)


def test_a_state_without_velocity_ends_it(divided):
    place, radius, young, _ = divided
    system = mechanics(radius, young, Hertz(), duration=60.0)
    assert not MultirateEuler().integrate(system, np.where(place == place[3], np.nan, place)).done
    few = replace(MultirateEuler(1e-9, 1e-4), max_steps=3).integrate(system, place)
    assert "largest number of internal steps" in few.problem
    assert adaptive_multirate.signatures
