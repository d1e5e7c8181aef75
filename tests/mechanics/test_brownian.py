"""Brownian motion against its closed forms: the path, free cells, a spring, pairs in contact."""

import numpy as np
import pytest
from running import finished, refused
from scipy.integrate import quad

import multicell as mc
from multicell.mechanics.brownian import BrownianPaths
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

pytestmark = pytest.mark.kernels

SPAN = 600.0 * 2.0**5
RADIUS = 5.0 * 0.5 ** (1 / 3)
DRAG = 6 * np.pi * 5.0 * RADIUS
LIMIT = 2.5
"""Standard errors within which a mean must lie."""


def paths(longest=60.0, seed=1, dimensions=3, step=600.0):
    return BrownianPaths(seed, dimensions, step, longest)


def moves(given, times, ids):
    return np.array(list(given.moves(list(times), np.asarray(ids))))


def placed(cells):
    return cells.position[np.argsort(cells.id)]


def is_variance(values, exact, most=0.004):
    """Check a mean square of independent normal numbers, whose error is at most a part of it."""
    error = exact * np.sqrt(2.0 / values.size)
    assert error <= most * exact
    assert np.square(values).mean() == pytest.approx(exact, abs=LIMIT * error)


def test_moves_are_independent_with_the_variance_of_their_times():
    times = np.array([0.0, 37.5, 75.0, 600.0, 1200.0, SPAN, SPAN + 300.0, 3 * SPAN])
    found = moves(paths(), times, np.arange(50_000)) / np.sqrt(np.diff(times))[:, None, None]
    for one in found:
        is_variance(one, 1.0)
    together = np.corrcoef(found.transpose(0, 2, 1).reshape(3 * len(found), -1))
    np.testing.assert_allclose(together, np.eye(3 * len(found)), atol=4.5 / np.sqrt(50_000))


@pytest.mark.parametrize("times", [
    [0.0, 37.5, 600.0, 900.0], [0.0, 0.1, 7.3, 600.0, 611.1, SPAN - 1.0, SPAN, SPAN + 5.3],
    [SPAN - 0.7, 2 * SPAN + 0.3, 5 * SPAN],
])  # fmt: skip
def test_a_path_does_not_depend_on_where_it_is_cut(times):
    ids = [3, 0, 77]
    whole = moves(paths(), [times[0], times[-1]], ids)[0]
    np.testing.assert_allclose(moves(paths(), times, ids).sum(axis=0), whole, atol=1e-11)


def test_shorter_steps_visit_the_places_of_longer_ones():
    ids = np.arange(5)
    coarse, fine = paths(150.0), paths(70.0, step=300.0)
    assert (coarse.dt, fine.dt) == (150.0, 37.5)
    places = [
        np.cumsum(moves(given, given.times(600.0, 1200.0), ids), axis=0) for given in (coarse, fine)
    ]
    np.testing.assert_allclose(places[1][3::4], places[0], atol=1e-12)


def test_a_path_belongs_to_its_cell():
    alone, among = moves(paths(), [0, 600], [7])[0], moves(paths(), [0, 600], [2, 7, 9])[0]
    np.testing.assert_array_equal(alone[0], among[1])
    other = moves(paths(seed=2), [0, 600], [7])[0]
    assert (other != alone).all()


def test_internal_steps_lie_on_one_grid():
    given = paths(200.0)
    assert given.dt == 150.0
    assert given.times(600.0, 1200.0) == [600.0, 750.0, 900.0, 1050.0, 1200.0]
    assert given.times(700.0, 1000.0) == [700.0, 750.0, 900.0, 1000.0]
    assert given.times(760.0, 770.0) == [760.0, 770.0]
    assert paths(1e9).dt == SPAN


def test_paths_of_a_plane_stay_in_it():
    found = moves(paths(dimensions=2), [0, 600], np.arange(100))
    assert (found[..., 2] == 0.0).all()
    assert (found[..., :2] != 0.0).all()


# -- free cells

FREE = {
    "duration": "4 min", "coupling_step": "20 s", "contact": {"law": "none"},
    "initial": {"count": 4000}, "motility": {"diffusion": "0.1 um^2/s"},
    "output": {"every": "20 s"},
}  # fmt: skip


@pytest.mark.parametrize("dimensions", [2, 3])
def test_mean_square_displacement_of_free_cells(dimensions):
    """2 D t along each axis, in independent intervals."""
    scene = Scene.from_dict({**FREE, "dimensions": dimensions})
    if dimensions == 2:
        scene = scene.with_changes({"initial.count": 6000})
    way = np.diff([placed(frame.cells) for frame in mc.run(scene).frames], axis=0)
    is_variance(way[..., :dimensions], 2 * 0.1 * 20.0)


def test_types_diffuse_by_their_scales_and_the_dead_not_at_all():
    scene = Scene.from_dict({
        **FREE, "types": {"slow": {"diffusion_scale": 0.25}, "still": {"diffusion_scale": 0}},
    })  # fmt: skip
    run = Simulation(scene)
    run.cells.state[::5] = mc.State.NECROTIC
    before = run.cells.copy()
    run.step()
    assert (run.cells.id == before.id).all()
    way, dead = run.cells.position - before.position, before.dead
    still = (before.kind == 1) | dead
    assert (way[still] == 0.0).all()
    is_variance(way[~still], 2 * 0.1 * 0.25 * 20.0, most=0.03)


@pytest.mark.sample("euler", "cvode")
@pytest.mark.parametrize("method", ["auto", "euler", "rk4", "rkc2", "cvode", "backward-euler"])
def test_cells_without_neighbours_have_their_path_by_every_method(method):
    """Displacements of internal steps add up to that of the path, whatever integrates."""
    scene = Scene.from_dict({
        **FREE, "contact": {"law": "hertz"}, "initial": {"count": 20, "spacing": 20.0},
        "integrator": {"method": method, "step": 2.0}, "growth": {"cycle_time": "1 h"},
        "motility": {"diffusion": "0.1 um^2/s", "diffusion_step": "5 s"}, "duration": "1 min",
    })  # fmt: skip
    run = Simulation(scene)
    start = placed(run.cells)
    finished(run)
    (way,) = BrownianPaths(0, 3, 20.0, 1e9).moves([0.0, 60.0], np.arange(20))
    atol = 1e-9 if method != "cvode" else 1e-3
    np.testing.assert_allclose(placed(run.cells) - start, np.sqrt(0.2) * way, atol=atol)


# -- cells on springs

STIFFNESS = 2.0


def spring_scene(**parts):
    return Scene.from_dict({
        "duration": "1 h", "coupling_step": "1 min", "cells": {"young_variation": 0.0},
        "contact": {"law": "linear", "stiffness_at_rest": STIFFNESS}, **parts,
    })  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("part", [pytest.param(0.25, marks=pytest.mark.slow), 0.5])
def test_variance_in_a_harmonic_spring(part):
    """D γ / k of a cell between held ones, 2 k from two sides, by (2 / κh) tanh(κh / 2).

    The factor is that of a force that is constant over h: 1 - (κh)² / 12, second order.
    """
    copies, distance, kappa = 1600, 2 * RADIUS, 2 * STIFFNESS / DRAG
    step = part / kappa
    diffusion = (0.02 * distance) ** 2 * kappa
    centre = np.zeros((copies, 3))
    centre[:, 0] = 20 * RADIUS * np.arange(copies)
    ways = distance * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    places = (centre + ways[:, None]).reshape(-1, 3)
    held = np.repeat(["free", "held"], [copies, 4 * copies])
    scene = spring_scene(
        dimensions=2, coupling_step=2.0 ** round(np.log2(3 / part)) * step, duration=1e6,
        integrator={"method": "rk4", "step": 1.01 * step},
        types={"free": {}, "held": {"diffusion_scale": 0}},
        motions={"anchor": {"type": "held"}},
        motility={"diffusion": diffusion, "diffusion_step": step * 1.001},
    )  # fmt: skip
    table = {"x_um": places[:, 0], "y_um": places[:, 1], "type": held}
    run, found = Simulation(scene, cells=table), []
    for k in range(45):
        run.step()
        if k >= 2:
            found.append((placed(run.cells)[:copies] - centre)[:, :2])
    h = run._run.mover._paths.dt
    assert h == pytest.approx(step)
    exact = diffusion / kappa * np.tanh(kappa * h / 2) / (kappa * h / 2)
    is_variance(np.array(found), exact)


def pairs(count, length, **parts):
    """Return a run of pairs of cells at rest, far from each other."""
    places = np.zeros((count, 2, 3))
    places[..., 0] = 40 * RADIUS * np.arange(count)[:, None]
    places[:, 1, 0] += length
    columns = zip(("x_um", "y_um", "z_um"), places.reshape(-1, 3).T, strict=True)
    return Simulation(spring_scene(**parts), cells=dict(columns))


def lengths_of(run):
    both = placed(run.cells).reshape(-1, 2, 3)
    return np.linalg.norm(both[:, 1] - both[:, 0], axis=1)


@pytest.mark.slow
def test_pairs_in_contact_follow_boltzmann():
    """The distance has the density r² exp(-U / D γ)."""
    kappa, length = 2 * STIFFNESS / DRAG, 2 * RADIUS
    diffusion = 0.006 * STIFFNESS * length**2 / DRAG
    step = 0.15 / kappa
    run = pairs(
        1500, length, coupling_step=16 * step, duration=1e6,
        integrator={"method": "rk4", "step": 1.01 * step},
        motility={"diffusion": diffusion, "diffusion_step": step * 1.001},
    )  # fmt: skip
    found = []
    for k in range(90):
        run.step()
        if k >= 5:
            found.append(lengths_of(run))
    found = np.array(found)
    energy = DRAG * diffusion

    def moment(power):
        """Within the cutoff, from which none gets away: the well is 20 energies deep."""

        def weight(r):
            return r ** (2 + power) * np.exp(-0.5 * STIFFNESS * (r - length) ** 2 / energy)

        return quad(weight, 0.2 * length, 1.5 * length)[0]

    mean = moment(1) / moment(0)
    spread = np.sqrt(moment(2) / moment(0) - mean**2)
    # lengths of one pair at the ends of two coupling steps are correlated
    alike = np.exp(-16 * step * kappa)
    error = spread / np.sqrt(found.size) * np.sqrt((1.0 + alike) / (1.0 - alike))
    assert found.mean() == pytest.approx(mean, abs=LIMIT * error)
    is_variance(found - found.mean(), spread**2)


@pytest.mark.slow
def test_weak_order_by_regression():
    """Mean square lengths of pairs by steps that are halves of each other, on one path."""
    kappa, length = 2 * STIFFNESS / DRAG, 2 * RADIUS
    diffusion = 0.006 * STIFFNESS * length**2 / DRAG
    coupling, means = 3.2 / kappa, []
    parts = [0.8, 0.4, 0.2, 0.1, 0.05]
    for part in parts:
        step = part / kappa
        run = pairs(
            3000, length, coupling_step=coupling, duration=1e6,
            integrator={"method": "rk4", "step": 0.051 / kappa},
            motility={"diffusion": diffusion, "diffusion_step": step * 1.001},
        )  # fmt: skip
        for _ in range(4):
            run.step()
        means.append(np.square(lengths_of(run)).mean())
    change = np.abs(np.diff(means))
    order = np.polyfit(np.log(parts[:-1]), np.log(change), 1)[0]
    assert 0.85 < order < 2.0


def test_refusals():
    with refused("motility.diffusion_step", "no motility.diffusion"):
        spring_scene(motility={"diffusion_step": "1 s"})
    with refused("motility.bias", "has no effect"):
        spring_scene(motility={"diffusion": 0.1, "bias": 0.5, "direction": [1, 0, 0]})
    with refused("motility.diffusion_step", "6e+07 internal steps"):
        spring_scene(motility={"diffusion": 0.1, "diffusion_step": "1e-6 s"})
    with refused("motility.diffusion", "more than a million"):
        spring_scene(motility={"diffusion": "1e6 um^2/s"})
    assert Scene.from_dict({**FREE, "motility": {"diffusion": 1e6}}).motility.diffusion == 1e6
    scene = spring_scene(motility={"diffusion": "0.1 um^2/s"}, initial={"count": 3})
    assert scene.motility.force == 0.0
    assert spring_scene(motility={}).motility.force == 0.1
    for ask in (mc.ode_problem, lambda scene: mc.compare(scene, methods=["euler", "rk4"])):
        with refused("motility.diffusion", "makes motion random"):
            ask(scene)
