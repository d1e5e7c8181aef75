"""Contacts that form within a step: steps that miss them are refused."""

from pathlib import Path

import numpy as np
import pytest

from multicell import JKR
from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.hertz import Hertz
from multicell.contact.springs import CubicSpring
from multicell.integrators import registry
from multicell.mechanics.forces import forming_pairs
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.mechanics.watch import ContactWatch
from multicell.scene.parts import IntegratorOptions

pytestmark = pytest.mark.kernels

STATES = np.load(Path(__file__).with_name("passed-contacts.npz"))
"""Coupling steps of cells that move by themselves, recorded from runs of 51 cells at 0.01 kPa s.

``loose``: two cells graze each other at 130 s, and hold on to each other from then on. ``packed``:
a contact forms at 65 s while escaped cells move by half a radius in each step. ``end`` is by LSODA
at 1e-9 on another right-hand side (tests/benchmarks/worst_cell.py); ``shift``, µm, is what normal
shifts of all coordinates by 0.01 µm do to the worst cell, the most of twelve.
"""


def recorded(state):
    """Return the mechanics of a recorded coupling step, its start, end and conditioning."""

    def get(name):
        return STATES[f"{state}_{name}"]

    energy, viscosity = get("medium")
    system = Mechanics(JKR(surface_energy=float(energy)), float(viscosity))
    cells = (get(name) for name in ("radius", "radius_rate", "young", "poisson"))
    system.begin(Motion(*cells, *map(float, get("span")), push=get("push")))
    return system, get("start"), get("end"), float(get("shift"))


@pytest.mark.parametrize("method", ["rosenbrock", "cvode"])
@pytest.mark.parametrize("state", ["loose", "packed"])
def test_driven_cells_are_no_further_off_than_thrice_a_shift(state, method):
    system, start, end, shift = recorded(state)
    options = IntegratorOptions(method=method)
    assert options.tolerance == 0.01
    outcome = registry.from_options(options).integrate(system, start)
    assert outcome.problem == ""
    worst = np.sqrt(np.square(outcome.position - end).sum(axis=1).max())
    assert worst <= 3.0 * shift, (worst, shift)


def pair(law, gap, speed, step, touching=None):
    """Return a system of two cells with a gap, places and velocities at the ends of a free step."""
    system, ones = Mechanics(law, 0.05), np.ones(2)
    motion = Motion(4.0 * ones, 0.0 * ones, ones, 0.5 * ones, 0.0, 60.0, touching=touching)
    system.begin(motion)
    before = np.array([[0.0, 0.0, 0.0], [8.0 + gap, 0.0, 0.0]])
    velocity = np.array([[0.0, 0.0, 0.0], speed])
    after = before + step * velocity
    system.force(step, after)
    return system, before, after, velocity


def part(law, gap, speed, step, tolerance=0.01):
    system, before, after, velocity = pair(law, gap, speed, step)
    moved = np.linalg.norm(after - before, axis=1).max() / 4.0
    return system.missed_contact(0.0, step, before, after, velocity, velocity, moved, tolerance)


def test_a_pair_that_passes_contact_sideways_is_found():
    # past each other by 1 um in 10 s: nearest in the middle, where they overlap by 0.015 um, or not
    for apart, missed in ((7.985, True), (8.02, False)):
        system, ones = Mechanics(JKR(), 0.05), np.ones(2)
        system.begin(Motion(4.0 * ones, 0.0 * ones, ones, 0.5 * ones, 0.0, 60.0))
        before = np.array([[0.0, 0.0, 0.0], [apart, -0.5, 0.0]])
        velocity = np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]])
        after = before + 10.0 * velocity
        assert min(np.linalg.norm(x[1] - x[0]) for x in (before, after)) > 8.0
        system.force(10.0, after)
        found = system.missed_contact(0.0, 10.0, before, after, velocity, velocity, 0.25, 0.01)
        assert (found < 1.0) == missed


@pytest.mark.parametrize("law", [JKR(), ExactJKR()], ids=repr)
def test_a_contact_that_forms_long_before_the_end_is_missed_and_a_late_one_is_not(law):
    # without force they would meet after a tenth, or at the very end, of 5 s
    assert part(law, 0.001, [-0.002, 0.0, 0.0], 5.0) < 0.9
    assert part(law, 0.001, [-0.0002, 0.0, 0.0], 5.0) == 1.0
    # what is far away, touches already or parts is no contact that forms
    assert part(law, 0.5, [-0.01, 0.0, 0.0], 5.0) == 1.0
    assert part(law, -0.01, [-0.01, 0.0, 0.0], 5.0) == 1.0
    assert part(law, 0.001, [0.01, 0.0, 0.0], 5.0) == 1.0
    # a coarser tolerance allows more
    assert part(law, 0.001, [-0.002, 0.0, 0.0], 5.0, tolerance=10.0) == 1.0


@pytest.mark.parametrize("law", [Hertz(), JKR(surface_energy=0.0), CubicSpring()], ids=repr)
def test_laws_that_do_not_snap_cost_no_look_at_the_pairs(law):
    assert not law.snaps
    assert part(law, 0.001, [-0.01, 0.0, 0.0], 5.0) == 1.0


def test_the_part_to_be_taken_is_that_in_which_the_missed_attraction_is_allowed():
    """The time is that of h' = v + m c h^{3/4} from contact on, up to half the tolerance."""
    law, gap, speed, step, tolerance = JKR(), 0.01, 0.02, 5.0, 0.01
    found = part(law, gap, [-speed, 0.0, 0.0], step, tolerance)
    mobility = 2.0 / (4.0 * 6.0 * np.pi * 0.05)
    modulus = 1.0 / (2.0 * 0.75 * 0.75)
    t, drawn, dt = gap / speed, 0.0, 1e-4
    while drawn < 0.5 * tolerance:
        h = speed * (t - gap / speed) + drawn
        drawn += dt * mobility * max(-float(law.force(max(h, 1e-9), modulus, 2.0)), 0.0)
        t += dt
    assert found * step == pytest.approx(t, abs=2.0 * step / 16.0)


def all_forming(system, begin, end, path, way, tolerance):
    """Return the places of pairs that come into contact, of all in the list."""
    pairs, motion = system._pair_data, system.motion
    ranges = zip(pairs.start, pairs.outer_end, strict=True)
    places = np.concatenate([np.arange(*ends) for ends in ranges])
    found = np.empty_like(places)
    cells = motion.radius, motion.radius_rate
    step = begin - motion.begin, end - begin, way, tolerance
    return found[: forming_pairs(places, pairs, *cells, *path, *step, found)]


@pytest.mark.parametrize("law", [JKR(), ExactJKR()], ids=repr)
@pytest.mark.parametrize("seed", range(4))
def test_the_pairs_that_are_watched_have_all_that_come_into_contact(seed, law):
    """Cells at random, most of them slow; steps of all lengths, some of them tried anew."""
    rng, n, renewed = np.random.default_rng(seed), 150, 0
    # the list itself lasts longer than what is watched of it
    system = Mechanics(law, 0.05, skin=2.0)
    ones, rate = np.ones(n), 10.0 ** rng.uniform(-6.0, -3.0, n)
    # of some pairs exact JKR holds on to contacts until they break, at a gap that grows
    held = np.array([[i, i + 1] for i in range(0, n, 2)]) if law.remembers else None
    system.begin(Motion(4.0 * ones, rate, ones, 0.5 * ones, 0.0, 600.0, touching=held))
    watch, position, time = ContactWatch(system.motion), 42.0 * rng.random((n, 3)), 0.0
    pace = 10.0 ** rng.uniform(-5.0, -1.0, (n, 1))
    seen, looked = [], 0.0
    for k in range(240):
        dt = 10.0 ** rng.uniform(-0.5, 0.5)
        speed, later = (pace * rng.normal(size=(n, 3)) for _ in range(2))
        path = position, position + 0.5 * dt * (speed + later), speed, later
        system.force(time + dt, path[1])
        way = 2.0 * np.linalg.norm(path[1] - position, axis=1).max() + 2.0 * rate.max() * dt
        before, step = watch._since, (time, time + dt)
        kernel = system._cells, system._pair_data, system._law, system.rows
        pairs = system.neighbours.pairs
        watch.missed_contact(pairs, kernel, path, *step, way, 0.01)
        arrays, known = watch._watched, watch._known
        watched, closed = arrays.places[:known], arrays.closed
        near = arrays.gap[:known] <= closed[arrays.first[:known]] + closed[arrays.second[:known]]
        found = all_forming(system, *step, path, way, 0.01)
        assert np.isin(found, watched[near]).all()
        looked += near.sum() / known / 240
        seen.append(len(found))
        renewed += watch._since != before
        if k % 5:
            time, position = time + dt, path[1]
    assert sum(seen) >= 10
    assert 3 <= renewed <= 30, renewed
    assert looked < 0.5, looked
    assert len(watched) < 0.5 * np.sum(pairs.outer_end - pairs.start)


def test_a_contact_with_a_cell_that_is_driven_towards_another_one_is_found():
    system, ones = Mechanics(JKR(), 0.05), np.ones(2)
    velocity = np.array([[0.0, 0.0, 0.0], [-0.002, 0.0, 0.0]])
    held = np.array([False, True])
    motion = Motion(
        4.0 * ones, 0.0 * ones, ones, 0.5 * ones, 0.0, 60.0, held=held, velocity=velocity
    )
    system.begin(motion)
    # to integrators both stand still
    place, still = np.array([[0.0, 0.0, 0.0], [8.001, 0.0, 0.0]]), np.zeros((2, 3))
    system.force(5.0, place)
    assert system.missed_contact(0.0, 5.0, place, place, still, still, 0.0, 0.01) < 0.9
