"""Persistent random motion, chemotaxis and haptotaxis against closed forms."""

import numpy as np
import pytest
from running import refused

import multicell as mc
from multicell.biology.active_forces import push
from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.cells import State
from multicell.scene.scene import Scene

RADIUS = 5.0 * 0.5 ** (1 / 3)


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


@pytest.mark.parametrize("dimensions", [2, 3])
def test_mean_square_displacement_of_the_persistent_walk(dimensions):
    """Directions last for τ, with a random phase: <v(0) v(t)> = v² (1 - t/τ) up to τ, then 0."""
    persistence, force, count = 1200.0, 2.0, 2000
    scene = free(
        dimensions=dimensions,
        initial__count=count,
        motility__force=force,
        motility__persistence=persistence,
    )
    frames = mc.run(scene).frames
    speed = force / (6 * np.pi * 5.0 * RADIUS)
    start = frames[0].cells
    home = start.position[np.argsort(start.id)]
    for frame in frames[1:]:
        t = frame.time
        moved = np.square(frame.cells.position[np.argsort(frame.cells.id)] - home).sum(axis=1)
        if t < persistence:
            exact = speed**2 * (t**2 - t**3 / (3 * persistence))
        else:
            exact = speed**2 * persistence * (t - persistence / 3)
        error = moved.std() / np.sqrt(count)
        assert moved.mean() == pytest.approx(exact, abs=4 * error + 1e-9 * exact)


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


@pytest.mark.parametrize(
    ("landscape", "potential"),
    [
        ("gradient", lambda x, L: x[0]),
        ("stripes", lambda x, L: L / (2 * np.pi) * np.cos(2 * np.pi * x[0] / L)),
        ("spot", lambda x, L: L * np.exp(0.5 - (x @ x) / (2 * L**2))),
    ],
)
def test_haptotaxis_climbs_its_landscape(landscape, potential):
    scene = free(haptotaxis={"landscape": landscape, "force": 1.5, "length": "40 um"})
    cells = initial_cells(scene.with_changes({"initial.count": 30}))
    force = push(biology_plan(scene), cells, 0.0, {})[:, :3]
    for place, pull in zip(cells.position, force, strict=True):
        steps = 1e-4 * np.eye(3)
        slope = [(potential(place + s, 40.0) - potential(place - s, 40.0)) / 2e-4 for s in steps]
        np.testing.assert_allclose(pull, 1.5 * np.array(slope), atol=1e-6)
    assert np.linalg.norm(force, axis=1).max() <= 1.5 * (1 + 1e-12)


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


def test_bad_input():
    scene = mc.load_scene("spheroid")
    with refused("chemotaxis.oxigen", "is not a field"):
        scene.with_changes({"chemotaxis.oxigen": {}})
    with refused("haptotaxis.axis", "2 dimensions"):
        scene.with_changes({"haptotaxis.axis": "z", "dimensions": 2, "nutrients": {}})
