"""Motion whose course is known: two Hertz cells that part, and a persistent walk."""

import numpy as np
import pytest
from two_cells import PAIR, apart_after

import multicell as mc

SUBJECT, SOURCE = "motion", "closed form"
FIXED = {"euler": 1, "backward-euler": 1, "heun": 2, "ab2": 2, "rk4": 4}
STEPS = np.array([30.0, 20.0, 15.0, 10.0, 6.0])  # s


def error(**integrator):
    """Return the error of the distance of two cells after 300 s, µm."""
    scene = PAIR.with_changes({"coupling_step": "300 s", "integrator": integrator})
    x = mc.run(scene).frames[-1].cells.position
    return abs(float(np.linalg.norm(x[1] - x[0])) - apart_after(300.0))


@pytest.mark.parametrize("method", FIXED)
def test_two_hertz_cells_part_with_the_order_of_the_method(method, compare):
    errors = [error(method=method, step=float(step), atol=1e-9) for step in STEPS]
    found = np.polyfit(np.log(STEPS), np.log(errors), 1)[0]
    compare.value(f"two Hertz cells part, `{method}`: order", FIXED[method], found, 0.15)


@pytest.mark.parametrize(
    "method", ["ab2-adaptive", "dopri5", "rkc2", "rosenbrock", "cvode", "auto"]
)
def test_two_hertz_cells_part_within_the_tolerance(method, compare):
    off = error(method=method, rtol=1e-6, atol=1e-4)
    what = f"two Hertz cells part, `{method}` at 10⁻⁴ µm: distance"
    compare.deviation(what, "h^−½ grows linearly", off, 1e-3, "µm")


@pytest.mark.parametrize("dimensions", [2, 3])
def test_mean_square_displacement_of_the_persistent_walk(dimensions, compare):
    """Directions last for τ, with a random phase: <v(0) v(t)> = v² (1 - t/τ) up to τ, then 0."""
    persistence, force, count = 1200.0, 2.0, 2000
    scene = mc.Scene.from_dict({
        "duration": "2 h", "coupling_step": "1 min", "contact": {"law": "hertz"},
        "dimensions": dimensions, "initial": {"count": count, "spacing": 30.0},
        "cells": {"young_variation": 0.0}, "output": {"every": "10 min"},
        "integrator": {"method": "euler", "step": 60.0},
        "motility": {"force": force, "persistence": persistence},
    })  # fmt: skip
    frames = mc.run(scene).frames
    speed = force / (6 * np.pi * 5.0 * 5.0 * 0.5 ** (1 / 3))
    start = frames[0].cells
    home = start.position[np.argsort(start.id)]
    off = []
    for frame in frames[1:]:
        t = frame.time
        moved = np.square(frame.cells.position[np.argsort(frame.cells.id)] - home).sum(axis=1)
        if t < persistence:
            exact = speed**2 * (t**2 - t**3 / (3 * persistence))
        else:
            exact = speed**2 * persistence * (t - persistence / 3)
        scatter = moved.std() / np.sqrt(count)
        off.append(abs(moved.mean() - exact) / (scatter + 1e-9 * exact))
    what = f"persistent walk, 2,000 cells in {dimensions}D: mean square displacement, 12 times"
    compare.deviation(what, "v² τ (t − τ/3)", max(off), 4.0, "standard errors")
