"""Tension of the surface: Laplace's pressure, and cores that close."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from synthetic import cells_at

import multicell as mc
from multicell import SceneError, Simulation
from multicell.biology.surface import surface_force
from multicell.cells import SPHERE, State
from multicell.population.extents import Extent

TENSION = 0.3


def _plan(tension=1.0):
    return SimpleNamespace(surface_tension=tension)


def _ball(n=2000, birth=10.0, squeeze=(1.0, 1.0, 1.0)):
    """Cells of random sizes, pushed apart from random places in a ball or an ellipsoid."""
    rng = np.random.default_rng(1)
    radius = birth * 2.0 ** (rng.random(n) / 3.0)
    x = rng.normal(size=(n, 3))
    x *= ((radius**3).sum() / 0.68 * rng.random(n)).reshape(-1, 1) ** (1 / 3) / np.linalg.norm(
        x, axis=1, keepdims=True
    )
    x *= squeeze
    for _ in range(200):
        pairs = cKDTree(x).query_pairs(2.0 * radius.max(), output_type="ndarray")
        along = x[pairs[:, 1]] - x[pairs[:, 0]]
        d = np.linalg.norm(along, axis=1)
        overlap = np.maximum(0.93 * radius[pairs].sum(axis=1) - d, 0.0)
        move = 0.25 * (overlap / d)[:, None] * along
        np.add.at(x, pairs[:, 1], move)
        np.subtract.at(x, pairs[:, 0], move)
    return cells_at(x, radius=radius)


@pytest.fixture(scope="module")
def ball():
    return _ball()


def _scene():
    return mc.Scene.from_dict(
        {
            "duration": "300 h", "coupling_step": "1 h",
            "cells": {"division_radius": "12.6 um"},
            "contact": {"surface_energy": "0.02 nN/um"}, "drag": {"viscosity": "0.5 kPa s"},
            "death": {"lysis_time": "24 h", "removal_fraction": 0.1},
            "surface": {"tension": TENSION},
        }
    )  # fmt: skip


def _at_rest(cells, hours):
    simulation = Simulation(_scene(), threads=1, cells=cells)
    while simulation.time < hours * 3600.0 - 1.0:
        simulation.step()
    return simulation


@pytest.fixture(scope="module")
def rested(ball):
    """A ball at rest under its tension, in which nothing is dead."""
    return _at_rest(ball, 24).cells


def _with_core(cells):
    """The same cells, of which those within 0.7 radii are dead."""
    cells = cells.copy()
    away = cells.position - np.average(cells.position, axis=0, weights=cells.volume)
    cells.state[np.linalg.norm(away, axis=1) < 0.7 * Extent(cells, 3).radius()] = State.NECROTIC
    cells.age[:] = 0.0
    return cells


def _occupied(cells, shells=3, points=100_000):
    """Part of each shell of equal thickness within 0.9 radii that lies in a cell, by lots."""
    radius = 0.9 * Extent(cells, 3).radius()
    rng = np.random.default_rng(3)
    x = rng.normal(size=(points, 3))
    far = radius * np.cbrt(rng.random(points))
    x *= (far / np.linalg.norm(x, axis=1))[:, None]
    x += np.average(cells.position, axis=0, weights=cells.volume)
    near, which = cKDTree(cells.position).query(x, k=12)
    inside = (near < cells.radius[which]).any(axis=1)
    return [inside[far // (radius / shells) == k].mean() for k in range(shells)]


@pytest.mark.slow
@pytest.mark.parametrize(("n", "low"), [(2000, 0.8), (6000, 0.9)])
def test_virial_of_the_surface_is_laplaces_pressure(n, low):
    """A pressure p on a ball has the virial -3 p V, with p = 2γ/R that is -8πγR²."""
    cells = _ball(n)
    force = surface_force(_plan(), cells)
    away = cells.position - np.average(cells.position, axis=0, weights=cells.volume)
    ratio = (force * away).sum() / (-8.0 * np.pi * Extent(cells, 3).radius() ** 2)
    assert low < ratio < 1.1
    assert np.abs(force.sum(axis=0)).max() < 1e-9 * np.abs(force).sum()


def test_surface_rounds_an_ellipsoid_and_presses_on_its_ends():
    cells = _ball(3000, squeeze=(0.8, 0.8, 1.5625))
    force = surface_force(_plan(), cells)
    z = cells.position[:, 2] - cells.position[:, 2].mean()
    # a prolate body: its poles, of curvature 2c/a², are pressed more than its flanks
    pole = np.abs(z) > 0.85 * np.abs(z).max()
    pressed = -(force[:, 2] * np.sign(z))[pole].sum()
    flank = np.abs(z) < 0.3 * np.abs(z).max()
    across = cells.position[:, :2] - cells.position[:, :2].mean(axis=0)
    rho = np.linalg.norm(across, axis=1)
    held = -(force[:, :2] * across).sum(axis=1) / rho
    outer = flank & (rho > 0.8 * rho[flank].max())
    assert pressed / pole.sum() > 1.5 * held[outer].mean() > 0.0


def test_tension_is_proportional_and_absent_without(ball):
    assert surface_force(_plan(0.0), ball) is None
    assert surface_force(_plan(), ball.take(np.arange(1))) is None
    np.testing.assert_allclose(
        surface_force(_plan(2.0), ball), 2.0 * surface_force(_plan(), ball), rtol=1e-12
    )


@pytest.mark.slow
def test_a_core_that_is_lost_closes(rested):
    """Nothing grows: the ball ends with the volume that is left, R³ - lost volume over packing."""
    start = _with_core(rested)
    run = _at_rest(start, 80)
    end, before = run.cells, Extent(start, 3).radius()
    assert not end.dead.any()
    lost = start.volume.sum() - end.volume.sum()
    assert run.released == pytest.approx(lost, rel=1e-9)
    packing = start.volume.sum() / (SPHERE * before**3)
    expected = np.cbrt(before**3 - lost / packing / SPHERE)
    assert Extent(end, 3).radius() == pytest.approx(expected, rel=0.01)
    occupied = _occupied(end)
    assert min(occupied) > 0.6
    assert max(occupied) < 0.85


@pytest.mark.slow
def test_a_growing_rim_and_a_core_that_is_lost_balance():
    """Growth less loss is the change of the ball, which stays packed and round."""
    scene = mc.Scene.from_dict(
        {
            "duration": "14 d", "coupling_step": "1 h",
            "initial": {"count": 500, "stage": "asynchronous", "spacing": 0.93, "jitter": 0.1},
            "cells": {"division_radius": "20 um"},
            "contact": {"surface_energy": "0.02 nN/um"}, "drag": {"viscosity": "0.5 kPa s"},
            "growth": {"cycle_time": "40 h", "cycle_variation": 0.2},
            "death": {"lysis_time": "60 h"}, "surface": {"tension": TENSION},
            "nutrients": {"oxygen": {
                "diffusion": "2000 um^2/s", "boundary": "0.2 mM", "layer": "10 um",
                "diffusion_medium": "2600 um^2/s", "uptake_per_volume": "0.08 mM/s",
                "half_saturation": "0.005 mM", "quiescent_uptake": 1.0, "quiescence": "0.1 mM",
                "necrosis": "0.01 mM", "geometry": "radial", "spacing": "10 um",
            }},
        }
    )  # fmt: skip
    simulation, seen = Simulation(scene, threads=1), []
    for end in (6.0, 11.0):
        while simulation.time < end * 86400.0 - 1.0:
            simulation.step()
        cells = simulation.cells
        ball = SPHERE * Extent(cells, 3).radius() ** 3
        seen.append((cells.volume.sum(), ball, simulation.released))
    (before, ball, released), (after, larger, lost) = seen
    packing = after / larger
    assert 0.7 < packing < 0.8
    grown = after - before + lost - released
    # a third and more of what grows is lost, and the packing stays
    assert (lost - released) / grown > 0.33
    assert packing * (larger - ball) == pytest.approx(after - before, rel=0.1)
    occupied = _occupied(cells)
    assert min(occupied) > 0.6
    assert max(occupied) < 0.85
    axes = np.sqrt(np.linalg.eigvalsh(np.cov(cells.position.T)))
    assert axes[2] / axes[0] < 1.1


def test_wrong_surfaces_are_refused():
    scene = _scene()
    with pytest.raises(SceneError, match=r"surface\.tension: is 0 nN/um, must be above 0"):
        scene.with_changes({"surface.tension": 0})
    with pytest.raises(SceneError, match=r"surface: has no meaning in a scene of 2 dimensions"):
        scene.with_changes({"dimensions": 2})


def test_a_tension_that_throws_cells_about_in_one_step_is_refused():
    """Held for 10 s it carries cells through each other, and out of the other side."""
    scene = mc.load_scene("settle").with_changes(
        {"initial.count": 9, "drag.viscosity": 0.005, "coupling_step": "10 s", "duration": "30 s",
         "surface": {"tension": "0.5 nN/um"}}
    )  # fmt: skip
    with pytest.raises(mc.StepFailed, match=r"diameters in a coupling step, .* shorter coupling"):
        mc.run(scene, threads=1)


def test_cells_that_are_too_far_apart_for_the_grid_of_their_surface_are_refused():
    cells = _ball(100).copy()
    cells.position[0] += 1e5
    with pytest.raises(mc.StepFailed, match="needs a grid of"):
        surface_force(_plan(), cells, 60.0)
