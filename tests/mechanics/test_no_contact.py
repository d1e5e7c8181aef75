"""Cells that do not act on each other: where they are, what is computed, what is refused."""

import numpy as np
import pytest
from running import finished, refused
from scipy.integrate import quad

from multicell.mechanics.motion import Motion
from multicell.report.explain.scene import explain
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

COSTS = ("evaluations", "list_builds", "steps")


def scene_of(**parts):
    return Scene.from_dict({
        "duration": "2 h", "contact": {"law": "none"}, "initial": {"count": 20}, **parts,
    })  # fmt: skip


def counts(simulation):
    return [getattr(simulation.mechanics.work, name) for name in COSTS]


def test_growing_cells_stay_in_place_and_divide_there():
    run = finished(scene_of(duration="1 d", growth={"cycle_time": "10 h"}))
    first, cells = Simulation(run.scene).cells, run.cells
    assert len(cells) > 3 * len(first)
    assert counts(run) == [0, 0, 0]
    np.testing.assert_array_equal(cells.pressure, 0.0)
    # daughters part by the way of a division and by nothing else
    mean = cells.volume @ cells.position / cells.volume.sum()
    away = np.linalg.norm(cells.position - mean, axis=1).max()
    start = np.linalg.norm(first.position - first.position.mean(axis=0), axis=1).max()
    assert away < start + 5 * first.radius.max()


def test_cells_at_one_place_stay_there():
    places = {"x_um": np.zeros(5000), "y_um": np.zeros(5000), "z_um": np.zeros(5000)}
    run = Simulation(scene_of(duration="10 min"), cells=places)
    run.step()
    assert not run.cells.position.any()
    assert counts(run) == [0, 0, 0]


def test_motile_cells_cross_each_other_exactly():
    """All have one direction: v = F / (6πηr), which no neighbour slows down."""
    motility = {"force": "2 nN", "bias": 1.0, "direction": [1, 0, 0]}
    run = Simulation(scene_of(motility=motility))
    start = run.cells
    finished(run)
    order = np.argsort(start.id), np.argsort(run.cells.id)
    moved = run.cells.position[order[1]] - start.position[order[0]]
    speed = 2.0 / (6 * np.pi * 5.0 * start.radius[order[0]])
    np.testing.assert_allclose(moved[:, 0], 7200.0 * speed, rtol=1e-12)
    np.testing.assert_allclose(moved[:, 1:], 0.0, atol=1e-12)
    assert counts(run) == [0, 0, 0]


@pytest.mark.parametrize("rate", [0.0, 1e-9, 4e-8, -4e-8, 1e-6, 3e-3, -4e-3])
def test_the_way_of_growing_cells_is_the_integral(rate):
    """x' = (F + F' t) / (6πη (r + r' t)), by quadrature."""
    radius, push = np.array([5.0]), np.array([[1.0, -2.0, 0.5, 1e-3, 3e-3, 0.0]])
    motion = Motion(radius, np.array([rate]), radius, radius, 100.0, 700.0, push=push)
    drag = 6 * np.pi * 5.0
    exact = [
        quad(lambda t, a=a: (push[0, a] + push[0, 3 + a] * t) / (drag * (5.0 + rate * t)), 0, 600,
             epsrel=1e-13)[0]
        for a in range(3)
    ]  # fmt: skip
    np.testing.assert_allclose(motion.drift(drag)[0], exact, rtol=1e-11)


def test_walls_hold_cells_that_share_a_place():
    domain = {"x": [-30, 30], "y": [-30, 30], "z": [-30, 30]}
    motility = {"force": "2 nN", "bias": 1.0, "direction": [1, 0, 0]}
    scene = scene_of(
        domain=domain, motility=motility, integrator="euler-adaptive", cells={"young_variation": 0}
    )
    places = {"x_um": np.zeros(1500), "y_um": np.zeros(1500), "z_um": np.zeros(1500)}
    run = finished(Simulation(scene, cells=places))
    cells = run.cells
    # F = E_iw √r h^(3/2) with two equal solids
    modulus = 1.0 / (2 * 0.75 * (1 - 0.5**2) / cells.young[0])
    depth = (2.0 / (modulus * np.sqrt(cells.radius[0]))) ** (2 / 3)
    np.testing.assert_allclose(cells.position[:, 0], 30.0 - cells.radius[0] + depth, atol=0.02)
    assert counts(run)[1] == 0


def test_contacts_are_counted_where_a_response_asks():
    """A pair that overlaps and one that does not; neither moves.

    Of the pair the one that dies later has no living neighbour any more, and stays alive.
    """
    response = {
        "behaviour": "apoptosis rate", "signal": "neighbours", "law": "threshold", "half": 0.5,
        "base": "0 1/h", "largest": "1000 1/h",
    }  # fmt: skip
    scene = scene_of(responses={"crowded": response}, death={}, duration="1 h")
    places = {"x_um": np.array([0.0, 5.0, 40.0, 49.0]), "y_um": np.zeros(4), "z_um": np.zeros(4)}
    run = Simulation(scene, cells=places)
    radius = run.cells.radius[0]
    assert 5.0 < 2 * radius < 9.0
    assert run.state.contacts.tolist() == [[0, 1]]
    finished(run)
    dead = run.cells.dead[np.argsort(run.cells.id)]
    assert dead[:2].sum() == 1
    assert not dead[2:].any()


@pytest.mark.parametrize(
    ("part", "value"),
    [("friction", {}), ("compression", {}), ("pull", {"force": "1 nN"})],
)
def test_parts_that_act_where_cells_touch_are_refused(part, value):
    with refused(part, "contact.law = 'none'"):
        scene_of(**{part: value})


def test_surface_energies_are_refused():
    with refused("types.a.surface_energy", "needs a contact law with a surface energy"):
        scene_of(types={"a": {"surface_energy": {"a": 0.1}}})


def test_explain_states_no_contacts():
    told = str(explain(scene_of(growth={"cycle_time": "2 h"})))
    assert "cells do not act on each other" in told
    assert "equilibrium distance" not in told
    assert "explicit step limit" not in told
