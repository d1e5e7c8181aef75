"""Discs of cells in a square dish: uptake at a constant rate, and in proportion to what is there.

A sink with the symmetry of a disc, in a square of side 2a with c₀ on its sides, has outside the
mean over the angle c₀ + Q / 2πD ln(r / ρ), with Q what the disc takes up for each height, and ρ the
conformal radius of the square, K(1/√2)⁻¹ 2a, thus 1.0787 a.
"""

import numpy as np
import pytest
from scipy.special import ellipk, i0, i1

import multicell as mc

SUBJECT, SOURCE = "fields", "closed form"
D, LEVEL, HEIGHT = 1000.0, 0.1, 10.0  # µm²/s, mM, µm
HALF, APART = 200.0, 4.0  # half a side of the square, distance of cells, µm
CONFORMAL = 2 * HALF / ellipk(0.5)


def disc(uptake, half):
    """Return radii and concentrations of cells of a disc on a lattice, and the disc's radius."""
    line = APART * (np.arange(-30, 30) + 0.5)
    x, y = (values.ravel() for values in np.meshgrid(line, line))
    inside = np.hypot(x, y) < 100.0
    scene = mc.Scene.from_dict({
        "duration": "1 min", "dimensions": 2, "contact": {"law": "none"},
        "cells": {"division_radius": 2.0},
        "domain": {"x": [-HALF, HALF], "y": [-HALF, HALF]},
        "nutrients": {"food": {
            "diffusion": D, "boundary": LEVEL, "uptake": uptake, "half_saturation": half,
            "spacing": 4.0, "height": HEIGHT,
        }},
    })  # fmt: skip
    run = mc.Simulation(scene, cells={"x_um": x[inside], "y_um": y[inside]})
    radius = APART * np.sqrt(len(run.cells) / np.pi)
    return np.hypot(*run.cells.position[:, :2].T), run.concentrations["food"], radius


def rings(r, c, exact):
    """Return the largest deviation of means over rings of 10 µm, over the medium's level."""
    ring = (r / 10.0).astype(int)
    count = np.bincount(ring)
    off = np.bincount(ring, c - exact(r)) / count
    return np.abs(off[count >= 12]).max() / LEVEL


def test_constant_uptake(compare):
    """c = c(R) - s (R² - r²) / 4D."""
    rate = 0.012  # mM/s in the disc
    r, c, radius = disc(rate * APART**2 * HEIGHT, 1e-6)
    drop = rate * radius**2 / D

    def exact(r):
        return LEVEL - drop / 2 * np.log(CONFORMAL / radius) - drop / 4 * (1 - (r / radius) ** 2)

    assert 0.1 * LEVEL < exact(0) < 0.4 * LEVEL
    off = rings(r, c, exact)
    compare.deviation("disc in a dish, constant uptake: c over the level", "c(R) − s (R² − r²)/4D",
                      off, 0.01)  # fmt: skip
    assert np.abs(c - exact(0.9 * radius)).max() > 0.1 * LEVEL


@pytest.mark.parametrize("strength", [1.0, 3.0])
def test_uptake_in_proportion(strength, compare):
    """c = A I₀(mr), m² = k / D."""
    half = 1000.0 * LEVEL  # of which uptake in proportion is off by a thousandth at most
    linear = strength**2 * D / 100.0**2
    r, c, radius = disc(linear * half * APART**2 * HEIGHT, half)
    m = np.sqrt(linear / D)
    scale = i0(m * radius) + m * radius * i1(m * radius) * np.log(CONFORMAL / radius)
    off = rings(r, c, lambda r: LEVEL * i0(m * r) / scale)
    what = f"disc in a dish, uptake in proportion, mR = {strength:g}: c over the level"
    compare.deviation(what, "A I₀(mr)", off, 0.01)
