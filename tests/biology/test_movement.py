"""Random motion, persistent and biased, and chemotaxis against closed forms."""

import numpy as np
import pytest
from running import refused
from scipy import integrate, stats

import multicell as mc
from multicell import random
from multicell.biology.active_forces import active_force, push
from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.cells import State
from multicell.scene.scene import Scene

RADIUS = 5.0 * 0.5 ** (1 / 3)
SPEED = 1.0 / (6 * np.pi * 5.0 * RADIUS)
WAY = np.array([1.0, 2.0, -2.0]) / 3.0


def free(**changes):
    """Return cells so far apart that they never touch."""
    entries = {
        "duration": "2 h",
        "coupling_step": "1 min",
        "contact": {"law": "hertz"},
        "cells": {"young_variation": 0.0},
        "integrator": {"method": "euler", "step": 60.0},
        "initial": {"count": 1, "spacing": 30.0},
        "output": {"every": "10 min"},
    }
    return Scene.from_dict(entries).with_changes({k.replace("__", "."): v for k, v in
                                                  changes.items()})  # fmt: skip


def test_drift_along_a_gradient_is_force_over_drag():
    """A field between two sides has a constant gradient g: v = F g / (g + half) / (6πηr)."""
    sides = {
        "x-": {"type": "value", "value": 0.0},
        "x+": {"type": "value", "value": 0.1},
        "*": {"type": "derivative", "derivative": 0.0},
    }
    scene = free(
        chemotaxis__guide={"force": 2.0, "half": "5e-4 mM/um"},
        nutrients__guide={"sides": sides, "uptake": 0.0, "margin": "100 um", "regime": "steady"},
    )
    simulation = mc.Simulation(scene)
    field = simulation.fields["guide"]
    gradient = 0.1 / (field.values.shape[0] * field.spacing)
    slopes = np.gradient(field.values, field.spacing)
    np.testing.assert_allclose(slopes[0], gradient, rtol=1e-9)
    np.testing.assert_allclose(slopes[1:], 0.0, atol=1e-12)
    before = simulation.cells.position.copy()
    simulation.step()
    speed = 2.0 * gradient / (gradient + 5e-4) / (6 * np.pi * 5.0 * RADIUS)
    moved = simulation.cells.position - before
    np.testing.assert_allclose(moved, [[60.0 * speed, 0.0, 0.0]], rtol=1e-9, atol=1e-9)
    away = mc.Simulation(scene.with_changes({"chemotaxis.guide.force": -2.0}))
    away.step()
    np.testing.assert_allclose(away.cells.position - before, -moved, rtol=1e-9, atol=1e-9)


def test_the_dead_do_not_move_by_themselves_and_types_differ():
    scene = free(
        motility__force=1.0, types__lazy={"motility_scale": 0.25}, types__brisk={"fraction": 1.0}
    )
    cells = initial_cells(scene.with_changes({"initial.count": 40}))
    cells.state[:4] = State.NECROTIC
    cells.state[4:8] = State.APOPTOTIC
    size = np.linalg.norm(push(biology_plan(scene), cells, 0.0, {})[:, :3], axis=1)
    np.testing.assert_allclose(size[:8], 0.0)
    np.testing.assert_allclose(size[8:], np.where(cells.kind[8:] == 0, 0.25, 1.0))


def test_taxis_without_a_field_is_refused():
    scene = mc.load_scene("spheroid")
    with refused("chemotaxis.oxigen", "is not a field"):
        scene.with_changes({"chemotaxis.oxigen": {}})


# biased random motion


def walking(count=4000, dimensions=3, nutrients=None, **motility):
    """Return such cells that walk."""
    parts = {"initial.count": count, "nutrients": nutrients or {}, "dimensions": dimensions}
    return free(**parts, motility={"force": 1.0, "persistence": 600.0, **motility})


def mean_along(bias, dimensions):
    """Return <d·u> of d = (b u + (1 - b) e) / |...| for b >= 0.

    In space the mean of |b u + c e| over the sphere is that of the distance from a shell of
    radius c to a point at b, and <d·u> its derivative by b (Newton's shell theorem). In the plane
    by quadrature.
    """
    c = 1.0 - bias
    if dimensions == 3:
        return 2 * bias / (3 * c) if bias < c else 1.0 - c * c / (3 * bias * bias)

    def part(angle):
        x, y = bias + c * np.cos(angle), c * np.sin(angle)
        return x / np.hypot(x, y)

    return integrate.quad(part, 0.0, np.pi, epsabs=1e-10)[0] / np.pi


def directions(scene, times):
    cells = initial_cells(scene)
    return np.stack([active_force(biology_plan(scene), cells, t) for t in times])


@pytest.mark.parametrize(
    ("dimensions", "renewal", "bias"),
    [(3, "regular", 0.2), (3, "random", 0.5), (2, "regular", 0.8), (2, "random", 0.2),
     (3, "regular", -0.3)],
)  # fmt: skip
def test_the_mean_direction_is_that_of_the_closed_form(dimensions, renewal, bias):
    way = WAY if dimensions == 3 else np.array([0.6, -0.8, 0.0])
    scene = walking(
        dimensions=dimensions, bias=bias, direction=list(3.0 * way), renewal=renewal
    )  # fmt: skip
    found = directions(scene, 1e4 + 6000.0 * np.arange(8))
    np.testing.assert_allclose(np.linalg.norm(found, axis=2), 1.0, rtol=1e-12)
    along = found @ way
    error = along.std() / np.sqrt(along.size)
    exact = np.sign(bias) * mean_along(abs(bias), dimensions)
    assert along.mean() == pytest.approx(exact, abs=4 * error)
    across = found - along[..., None] * way
    np.testing.assert_allclose(across.mean(axis=(0, 1)), 0.0, atol=4 / np.sqrt(along.size))


@pytest.mark.parametrize("renewal", ["regular", "random"])
def test_a_full_bias_goes_straight_and_none_keeps_the_bits(renewal):
    scene = walking(50, bias=1.0, direction=[0, 0, -2], renewal=renewal)
    np.testing.assert_array_equal(
        directions(scene, [0.0, 1e5]), np.broadcast_to([0.0, 0.0, -1.0], (2, 50, 3))
    )
    cells, plain = initial_cells(walking(50)), walking(50)
    shift = (cells.id + 1) * 0.5 * (np.sqrt(5.0) - 1.0) % 1.0
    interval = np.floor(5000.0 / 600.0 + shift).astype(int)
    exact = np.stack([
        random.directions(0, random.Purpose.MOTILITY, int(k), np.array([i]), 3)[0]
        for i, k in zip(cells.id, interval, strict=True)
    ])  # fmt: skip
    np.testing.assert_array_equal(active_force(biology_plan(plain), cells, 5000.0), exact)


@pytest.mark.slow
def test_random_moments_are_a_poisson_process():
    """Times between changes are exponential, with the polarisation time as their mean.

    Directions are seen on a grid of times only: cells are observed for 10 polarisation times.
    """
    scene = walking(600, renewal="random")
    times = 12.0 * np.arange(500)
    found = directions(scene, times)
    changed = (np.diff(found, axis=0) != 0.0).any(axis=2)
    # changes in a time are Poisson numbers; two between two looks, each 2 % of τ, are seen as one
    seen = 1.0 - np.exp(-0.02)
    error = 4 * np.sqrt(seen / changed.size)
    assert changed.mean() == pytest.approx(seen, abs=error)
    first = changed.argmax(axis=0)[changed.any(axis=0)]
    waited = 0.02 * (first + np.random.default_rng(0).random(first.size))
    assert stats.kstest(waited, stats.expon.cdf).statistic < 1.63 / np.sqrt(first.size)
    counts = changed[:495].reshape(9, 55, 600).sum(axis=1)
    # of numbers that are independent in disjoint times
    assert abs(np.corrcoef(counts[:-1].ravel(), counts[1:].ravel())[0, 1]) < 4 / np.sqrt(4800)
    assert counts.var() == pytest.approx(counts.mean(), rel=0.06)
    again = directions(scene, times[::-1][:50])[::-1]
    np.testing.assert_array_equal(again, found[-50:])


@pytest.mark.slow
@pytest.mark.parametrize("renewal", ["regular", "random"])
def test_free_cells_drift_and_spread_as_the_closed_forms_say(renewal):
    """Drift v <d>, and spread of independent runs of length τ (or exponential ones, twice that)."""
    scene = walking(2000, bias=0.4, direction=[0, 1, 0], renewal=renewal, persistence="2 min")
    frames = mc.run(scene).frames
    first, last = frames[0].cells, frames[-1].cells
    moved = last.position[np.argsort(last.id)] - first.position[np.argsort(first.id)]
    time, tau = 7200.0, 120.0
    mean = mean_along(0.4, 3)
    error = moved[:, 1].std() / np.sqrt(len(moved))
    assert moved[:, 1].mean() == pytest.approx(SPEED * mean * time, abs=4 * error)

    def square(height):  # of the part of d along u
        along = 0.4 + 0.6 * height
        return along**2 / (0.4**2 + 0.6**2 + 2 * 0.4 * 0.6 * height) / 2

    variance = integrate.quad(square, -1.0, 1.0)[0] - mean**2
    if renewal == "regular":  # <v(0) v(t)> falls linearly to zero at τ
        spread = SPEED**2 * variance * tau * (time - tau / 3)
    else:  # it falls like exp(-t / τ)
        spread = 2 * SPEED**2 * variance * tau * (time - tau * (1 - np.exp(-time / tau)))
    noise = 4 * spread * np.sqrt(2 / len(moved))
    # positions follow forces of the beginnings of coupling steps, half a polarisation time long
    assert moved[:, 1].var() == pytest.approx(spread, abs=noise + 0.03 * spread)


def test_a_bias_follows_the_gradient_of_a_field():
    """Between two sides the gradient is constant: the drift is that of a fixed direction."""
    sides = {
        "x-": {"type": "value", "value": 0.0},
        "x+": {"type": "value", "value": 0.1},
        "*": {"type": "derivative", "derivative": 0.0},
    }
    signal = {
        "diffusion": 100.0, "boundary": 0.1, "uptake": 0.0, "margin": 30.0, "spacing": 20.0,
        "sides": sides,
    }  # fmt: skip
    scene = walking(40, bias=-0.5, towards="signal", nutrients={"signal": signal})
    simulation = mc.Simulation(scene, threads=1)
    simulation.step()
    found = simulation._motion(60.0, 120.0, simulation.cells.radius).push[:, :3]
    fixed = walking(40, bias=-0.5, direction=[1, 0, 0])
    np.testing.assert_allclose(found, active_force(fixed, simulation.cells, 60.0), atol=1e-9)


@pytest.mark.parametrize(
    ("motility", "path", "words"),
    [
        ({"bias": 0.3}, "motility.bias", "needs a direction"),
        ({"bias": 0.3, "direction": [1, 0, 0], "towards": "o"}, "motility.bias", "not both"),
        ({"direction": [1, 0, 0]}, "motility.direction", "has no effect"),
        ({"bias": 0.3, "direction": [0, 0, 0]}, "motility.direction", "is zero"),
        ({"bias": 0.3, "direction": [1]}, "motility.direction", "three numbers"),
        ({"bias": 0.3, "direction": "x"}, "motility.direction", "three numbers"),
        ({"bias": 0.3, "towards": "oxygne"}, "motility.towards", "not a field"),
        ({"bias": 0.3, "direction": [0, 0, 1]}, "motility.direction", "out of the plane"),
    ],
)
def test_a_bias_without_meaning_is_refused(motility, path, words):
    with refused(path, words):
        walking(1, dimensions=2, **motility)


def test_types_follow_fields_by_factors_of_their_own():
    """One goes the other way along one field, one ignores it; forces of two fields add up."""
    fields = {name: {"uptake": 0, "regime": "steady"} for name in ("guide", "food")}
    scene = free(
        initial__count=60,
        types={
            "a": {"chemotaxis_of": {"guide": -2}},
            "b": {"chemotaxis_of": {"guide": 0, "food": 0.5}, "motility_scale": 3.0},
            "c": {},
        },
        nutrients=fields,
        chemotaxis={"guide": {"force": 2.0}, "food": {"force": -1.0, "half": 1e-3}},
    )
    plan, cells = biology_plan(scene), initial_cells(scene)
    guide, food = np.random.default_rng(1).normal(0.0, 1e-3, (2, 60, 3))
    alone = [
        force * g / (np.linalg.norm(g, axis=1, keepdims=True) + half)
        for force, half, g in ((2.0, 1e-4, guide), (-1.0, 1e-3, food))
    ]
    factors = np.array([[-2.0, 1.0], [0.0, 1.5], [1.0, 1.0]])[cells.kind]
    exact = factors[:, :1] * alone[0] + factors[:, 1:] * alone[1]
    assert set(cells.kind) == {0, 1, 2}
    found = push(plan, cells, 0.0, {"guide": guide, "food": food})
    np.testing.assert_allclose(found[:, :3], exact, rtol=1e-12)
    with refused("types.a.chemotaxis_of.fod", "food"):
        free(types={"a": {"chemotaxis_of": {"fod": 1}}}, nutrients=fields, chemotaxis={"food": {}})
