"""Springs in runs: which pairs are joined, and what becomes of them."""

import numpy as np
import pytest

import multicell as mc
from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.biology.spring_graph import after_divisions, springs_at_start
from multicell.cells import State
from multicell.errors import SceneError
from multicell.mechanics.neighbours import neighbour_pairs
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

RADIUS = 5.0 * 0.5 ** (1 / 3)
DRAG = 6 * np.pi * 5.0 * RADIUS


def scene_of(count=6, spacing=0.95, springs=None, **parts):
    return Scene.from_dict({
        "duration": "10 min",
        "coupling_step": "1 min",
        "initial": {"count": count, "spacing": spacing},
        "cells": {"young_variation": 0.0},
        "contact": {"law": "hertz"},
        "integrator": {"atol": 1e-6, "rtol": 1e-9},
        "springs": {} if springs is None else {"net": springs},
        **parts,
    })  # fmt: skip


def distances(simulation):
    i, j = simulation.cells.rows_of(simulation.springs.pair).T
    x = simulation.cells.position
    return np.linalg.norm(x[j] - x[i], axis=1)


@pytest.mark.parametrize("method", ["auto", "cvode", "rkc2", "rosenbrock", "multirate-euler"])
def test_two_distant_cells_come_to_the_length_at_rest(method):
    """d - L falls like exp(-2 k t / Γ), and the history tells the tension k (d - L)."""
    law = {"stiffness": "0.2 nN/um", "rest": "150 um", "pairs": [[1, 0]]}
    result = mc.run(
        scene_of(2, 30.0, law, integrator={"method": method, "rtol": 1e-9, "atol": 1e-4})
    )
    start = 30.0 * 2 * RADIUS
    time = np.array(result.history["time"])
    exact = 0.2 * (start - 150.0) * np.exp(-2 * 0.2 * time / DRAG)
    np.testing.assert_allclose(result.history["largest_tension"], exact, atol=5e-4 * exact[0])
    assert set(result.history["springs"]) == {1}


def test_without_a_length_springs_rest_as_they_are_and_energy_falls():
    near = neighbour_pairs(initial_cells(scene_of(30, 0.85)).position, 8.0)
    scene = scene_of(30, 0.85, {"stiffness": 0.3, "pairs": near.tolist()})
    simulation = Simulation(scene, threads=1)
    assert len(simulation.springs) > 60
    np.testing.assert_allclose(distances(simulation), simulation.springs.rest, rtol=1e-14)
    assert simulation.springs.rest.max() <= 8.0
    energy = [simulation.energy()]
    while not simulation.finished:
        simulation.step()
        energy.append(simulation.energy())
    assert (np.diff(energy) < 0.0).all()
    mean = simulation.cells.position.mean(axis=0)
    np.testing.assert_allclose(mean, initial_cells(scene).position.mean(axis=0), atol=1e-6)


def daughters_of(cells, mothers, first, shift):
    """Return cells in which mothers have divided along x, ``shift`` µm to both sides."""
    left = np.flatnonzero(~np.isin(cells.id, mothers))
    rows = np.repeat(cells.rows_of(np.sort(mothers)), 2)
    born = cells.take(rows)
    born.parent = born.id.copy()
    born.id = first + np.arange(len(rows))
    born.position[::2, 0] += shift
    born.position[1::2, 0] -= shift
    return cells.replaced(left, born)


def test_the_nearer_daughter_takes_a_spring_over():
    scene = scene_of(3, springs={"stiffness": 1, "pairs": [[0, 1], [1, 2]]}, growth={})
    before = initial_cells(scene)
    before.position[:] = [[0, 0, 0], [10, 0, 0], [20, 0, 0]]
    springs = springs_at_start(biology_plan(scene), before)
    assert springs.pair.tolist() == [[0, 1], [1, 2]]
    # 1 -> 3 at 11, 4 at 9: 4 is nearer to 0, 3 nearer to 2
    after = daughters_of(before, [1], 3, 1.0)
    found = after_divisions(springs, before, after)
    assert found.pair.tolist() == [[0, 4], [2, 3]]
    np.testing.assert_allclose(found.rest, [10, 10])
    # both ends divide: 0 -> 3 at 1, 4 at -1 and 1 -> 5 at 11, 6 at 9
    both = after_divisions(springs, before, daughters_of(before, [0, 1], 3, 1.0))
    assert both.pair.tolist() == [[2, 5], [3, 6]]
    # an end that is gone takes its spring along
    gone = after.take(after.id != 0)
    assert after_divisions(springs, before, gone).pair.tolist() == [[2, 3]]


def test_springs_go_with_the_death_of_a_cell():
    scene = scene_of(
        3, springs={"stiffness": 1.0, "pairs": [[0, 1], [1, 2]]},
        death={"apoptosis_rate": "0.02 1/s", "apoptosis_time": "1 d"}, growth={},
    )  # fmt: skip
    simulation = Simulation(scene, threads=1)
    while not simulation.finished:
        simulation.step()
        dead = simulation.cells.id[simulation.cells.state == State.APOPTOTIC]
        assert not np.isin(simulation.springs.pair, dead).any()
    assert len(dead) > 0
    np.testing.assert_equal(simulation.history_row()["springs"], len(simulation.springs))


@pytest.mark.parametrize(
    ("law", "path", "words"),
    [
        ({"stiffness": 1}, "springs.net.pairs", "must be given"),
        ({"stiffness": 0, "pairs": [[0, 1]]}, "springs.net.stiffness", "above 0"),
        ({"stiffness": 1, "pairs": []}, "springs.net.pairs", "list of pairs"),
        ({"stiffness": 1, "pairs": [[0, 1, 2]]}, "springs.net.pairs", "list of pairs"),
        ({"stiffness": 1, "pairs": [[0, "1"]]}, "springs.net.pairs", "whole numbers"),
        ({"stiffness": 1, "pairs": [[0, 1], [1, 0]]}, "springs.net.pairs", "twice"),
        ({"stiffness": 1, "pairs": [[2, 2]]}, "springs.net.pairs", "to itself"),
    ],
)
def test_springs_without_meaning_are_refused(law, path, words):
    with pytest.raises(SceneError) as caught:
        scene_of(springs=law)
    assert caught.value.path == path
    assert words in caught.value.problem


def test_springs_that_find_no_cells_are_refused_at_the_start():
    with pytest.raises(SceneError, match="the cell 99") as caught:
        Simulation(scene_of(springs={"stiffness": 1, "pairs": [[0, 99]]}))
    assert caught.value.path == "springs.net.pairs"


def test_springs_too_stiff_for_double_precision_are_refused():
    scene = scene_of(springs={"stiffness": 1e8, "pairs": [[0, 1]]}, drag={"viscosity": 1e-6})
    from multicell.errors import StepFailed

    with pytest.raises(StepFailed, match="double precision"):
        Simulation(scene, threads=1).step()
