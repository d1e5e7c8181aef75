"""The neighbour list leaves more room round cells that move far, and misses no pair."""

from dataclasses import replace

import numpy as np
import pytest
from strategies import cluster, mechanics

from multicell.contact.hertz import Hertz
from multicell.integrators.runge_kutta import Euler
from multicell.mechanics.motion import StateRejected


def forces_of(system, position):
    out = np.empty_like(position)
    system.velocity(0.0, position, out)
    return out


@pytest.fixture
def tissue():
    position, radius, young = cluster(600, 5)
    return position, radius, young


def walk(tissue, steps, length, movers):
    """Yield states in which some cells go straight on by ``length`` mean radii a step."""
    position, radius, _ = tissue
    ways = np.random.default_rng(3).normal(size=(len(movers), 3))
    ways *= length * radius.mean() / np.linalg.norm(ways, axis=1)[:, None]
    for _ in range(steps):
        position = position.copy()
        position[movers] += ways
        yield position


def test_forces_on_the_way_are_those_of_a_list_of_their_own(tissue):
    _, radius, young = tissue
    system = mechanics(radius, young, Hertz())
    movers = np.arange(0, 600, 60)
    largest = 0.0
    for state in walk(tissue, 80, 0.02, movers):
        alone = forces_of(mechanics(radius, young, Hertz()), state)
        found = forces_of(system, state)
        largest = max(largest, float(np.abs(alone).max()))
        np.testing.assert_allclose(found, alone, atol=1e-12 * largest)
    # 1.6 radii on the way, and 0.1 of a radius without more room
    assert 3 <= system.work.list_builds <= 8
    still = np.setdiff1d(np.arange(600), movers)
    assert (system.neighbours.margin[still] == system.neighbours.least).all()
    assert (system.neighbours.margin[movers] > 3.0 * system.neighbours.least).all()


def test_room_is_given_back_where_cells_rest(tissue):
    position, radius, young = tissue
    system = mechanics(radius, young, Hertz())
    for moved in (np.arange(10), np.arange(300, 310)):
        for state in walk((position, radius, young), 40, 0.05, moved):
            forces_of(system, state)
    assert (system.neighbours.margin[:10] == system.neighbours.least).all()
    assert (system.neighbours.margin[300:310] > 3.0 * system.neighbours.least).all()


def test_each_coupling_step_begins_with_the_same_margins(tissue):
    _, radius, young = tissue
    system = mechanics(radius, young, Hertz())
    for state in walk(tissue, 20, 0.05, np.arange(10)):
        forces_of(system, state)
    system.begin(system.motion)
    assert (system.neighbours.margin == system.neighbours.least).all()


def test_few_daughters_have_room_from_the_beginning(tissue):
    _, radius, young = tissue
    builds = []
    for born in (0, 10, 300):
        system = mechanics(radius, young, Hertz())
        newborn = np.arange(600) < born
        system.begin(replace(system.motion, newborn=newborn))
        for state in walk(tissue, 12, 0.05, np.arange(10)):
            found = forces_of(system, state)
        alone = forces_of(mechanics(radius, young, Hertz()), state)
        np.testing.assert_allclose(found, alone, atol=1e-12 * np.abs(alone).max())
        builds.append(system.work.list_builds)
    # a list with much room for all of them would have several times as many pairs
    assert builds[1] == 1 < builds[0] == builds[2]


@pytest.mark.parametrize("compiled", [False, True])
def test_after_a_state_that_is_too_crowded_no_pair_is_missed(compiled):
    position, radius, young = cluster(20_000, 2)
    system = mechanics(radius, young, Hertz(), duration=1e-3)
    forces_of(system, position)
    crowded = np.zeros_like(position)
    if compiled:
        outcome = Euler(1e-3).integrate(system, crowded)
        assert "on top of each other" in outcome.problem
    else:
        with pytest.raises(StateRejected, match="on top of each other"):
            forces_of(system, crowded)
    # less than the margins that the jump asked for, and more than those of the first list
    ways = np.random.default_rng(4).normal(size=position.shape)
    near = position + 2.5 * ways / np.linalg.norm(ways, axis=1)[:, None]
    assert system.neighbours.least < 0.6 < 2.5 < system.neighbours.margin.min()
    alone = forces_of(mechanics(radius, young, Hertz()), near)
    found = forces_of(system, near)
    np.testing.assert_allclose(found, alone, atol=1e-12 * np.abs(alone).max())
