"""Tension of the surface, inflow of medium: Laplace's pressure, cores that close or stay fluid."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from synthetic import cells_at

import multicell as mc
from multicell import SceneError, Simulation
from multicell.biology.motion import inflow_velocity
from multicell.biology.surface import surface_force
from multicell.cells import SPHERE, State
from multicell.results.observables import Extent

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


def _scene(**death):
    return mc.Scene.from_dict(
        {
            "duration": "300 h", "coupling_step": "1 h",
            "cells": {"division_radius": "12.6 um"},
            "contact": {"surface_energy": "0.02 nN/um"}, "drag": {"viscosity": "0.5 kPa s"},
            "death": {"lysis_time": "24 h", "removal_fraction": 0.1, **death},
            "surface": {"tension": TENSION},
        }
    )  # fmt: skip


def _at_rest(cells, hours, **death):
    simulation = Simulation(_scene(**death), threads=1, cells=cells)
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


def test_a_fluid_core_stays_and_holds_up_the_rim(rested):
    run = _at_rest(_with_core(rested), 48, core="fluid")
    assert run.released == pytest.approx(0.0, abs=1e-8)  # volumes are made of radii and back
    np.testing.assert_allclose(np.sort(run.cells.radius), np.sort(rested.radius), rtol=1e-13)
    radius = Extent(run.cells, 3).radius()
    assert radius == pytest.approx(Extent(rested, 3).radius(), rel=0.01)
    row = run.history_row()
    filled = rested.volume.sum() / (SPHERE * radius**3)
    # Laplace's pressure on the tissue, of which cells are a part
    assert row["core_pressure"] * filled == pytest.approx(2.0 * TENSION / radius, rel=0.3)


@pytest.mark.slow
def test_a_growing_rim_and_a_core_that_is_lost_balance():
    """What grows less what is lost is the change of the ball, which stays packed and round."""
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
    with pytest.raises(SceneError, match=r"death\.core"):
        scene.with_changes({"death.core": "solid"})


# the medium flows in to what dead cells lose, and the tissue with it


def _cloud(n=3000, radius=100.0, dimensions=3):
    rng = np.random.default_rng(2)
    x = rng.normal(size=(n, 3))
    x[:, dimensions:] = 0.0
    x /= np.linalg.norm(x, axis=1)[:, None]
    x *= (radius * rng.random(n) ** (1 / dimensions))[:, None]
    return cells_at(x, radius=4.0)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_flow_through_a_sphere_is_the_volume_of_tissue_lost_within(dimensions):
    """Gauss: 4πr² u(r), in a plane 2πr u(r), is the loss within r over the packing."""
    cells = _cloud(dimensions=dimensions)
    cells.state[:] = State.NECROTIC
    after = 0.99 * cells.radius
    u = inflow_velocity(cells, after, 60.0, dimensions, 0.0)
    size = (lambda r: 4 / 3 * np.pi * r**3) if dimensions == 3 else (lambda r: np.pi * r**2)
    area = (lambda r: 4 * np.pi * r**2) if dimensions == 3 else (lambda r: 2 * np.pi * r)
    weights = size(cells.radius)
    origin = np.average(cells.position, axis=0, weights=weights)
    away = cells.position - origin
    r = np.linalg.norm(away, axis=1)
    spread = np.average(r**2, weights=weights) + dimensions / (dimensions + 2) * 16.0
    packing = weights.sum() / size(np.sqrt((dimensions + 2) / dimensions * spread))
    lost = (weights - size(after)) / 60.0
    inward = -(u * away).sum(axis=1) / r
    for k in np.argsort(r)[[10, 500, 2999]]:
        expected = lost[r < r[k]].sum() / packing / area(r[k])
        assert inward[k] == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(u, -inward[:, None] * away / r[:, None], atol=1e-15)


def test_nothing_lost_nothing_flows():
    cells = _cloud(100)
    assert inflow_velocity(cells, 0.9 * cells.radius, 60.0, 3, 0.0) is None
    cells.state[:] = State.NECROTIC
    assert inflow_velocity(cells, cells.radius, 60.0, 3, 0.0) is None
    assert inflow_velocity(cells, 1.1 * cells.radius, 60.0, 3, 0.0) is None  # they swell


def test_walls_refuse_inflow():
    scene = mc.load_scene("wm983b")
    walls = {axis: ["-500 um", "500 um"] for axis in "xyz"}
    with pytest.raises(SceneError, match=r"death\.inflow: has no meaning in a domain"):
        scene.with_changes({"domain": walls, "nutrients": None})
