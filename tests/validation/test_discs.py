"""Discs of cells in a plane: uptake at a constant rate, and in proportion to what is there.

A sink with the symmetry of a disc, with c₀ on a border round it, has outside the mean over the
angle c₀ + Q / 2πD ln(r / ρ), with Q what the disc takes up for each height, and ρ the conformal
radius of the border: K(1/√2)⁻¹ 2a of a square of side 2a, thus 1.0787 a. The border is a dish, the
square that follows the cells, a layer of even width round them, or their own rim.
"""

import numpy as np
import pytest
from scipy.special import ellipk, i0, i1

import multicell as mc

SUBJECT, SOURCE = "fields", "closed form"
D, LEVEL, HEIGHT = 1000.0, 0.1, 10.0  # µm²/s, mM, µm
HALF, APART = 200.0, 4.0  # half a side of the square, distance of cells, µm
BORDERS = {
    "in a dish": None,
    "in a square that follows it": {"margin": 50.0},
    "in a layer of even width": {"margin": 50.0, "margin_shape": "tissue"},
    "with medium at its rim": {"margin": 0.0, "margin_shape": "tissue"},
}


def disc(uptake, half, border):
    """Return radii and concentrations of cells of a disc on a lattice, and both radii."""
    line = APART * (np.arange(-30, 30) + 0.5)
    x, y = (values.ravel() for values in np.meshgrid(line, line))
    inside = np.hypot(x, y) < 100.0
    dish = {"domain": {"x": [-HALF, HALF], "y": [-HALF, HALF]}} if border is None else {}
    scene = mc.Scene.from_dict({
        "duration": "1 min", "dimensions": 2, "contact": {"law": "none"},
        "cells": {"division_radius": 2.5}, **dish,
        "nutrients": {"food": {
            "diffusion": D, "boundary": LEVEL, "uptake": uptake, "half_saturation": half,
            "spacing": 4.0, "height": HEIGHT, **(border or {}),
        }},
    })  # fmt: skip
    run = mc.Simulation(scene, cells={"x_um": x[inside], "y_um": y[inside]})
    end = conformal(run.cells, border)
    radius = min(APART * np.sqrt(len(run.cells) / np.pi), end)  # cells beyond it lie in medium
    return np.hypot(*run.cells.position[:, :2].T), run.concentrations["food"], radius, end


def conformal(cells, border):
    """Return the conformal radius of the border; where that is nearly round, its mean radius."""
    place = cells.position[:, :2]
    if border is None or "margin_shape" not in border:
        half = HALF if border is None else place.max() + border["margin"]
        return 2 * half / ellipk(0.5)
    reach = max(border["margin"], cells.radius.max())
    angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    along = place[:, :1] * np.cos(angle) + place[:, 1:] * np.sin(angle)
    left = reach**2 - (place**2).sum(axis=1)[:, None] + along**2
    return np.where(left > 0.0, along + np.sqrt(np.maximum(left, 0.0)), 0.0).max(axis=0).mean()


def rings(r, c, exact):
    """Return the largest deviation of means over rings of 10 µm, over the medium's level."""
    ring = (r / 10.0).astype(int)
    count = np.bincount(ring)
    off = np.bincount(ring, c - exact(r)) / count
    return np.abs(off[count >= 12]).max() / LEVEL


@pytest.mark.parametrize("where", BORDERS)
def test_constant_uptake(where, compare):
    """c = c(R) - s (R² - r²) / 4D."""
    rate = 0.012  # mM/s in the disc
    r, c, radius, end = disc(rate * APART**2 * HEIGHT, 1e-6, BORDERS[where])
    drop = rate * radius**2 / D

    def exact(r):
        return LEVEL - drop / 2 * np.log(end / radius) - drop / 4 * (1 - (r / radius) ** 2)

    assert 0.1 * LEVEL < exact(0) < 0.8 * LEVEL
    off = rings(r, c, exact)
    compare.deviation(f"disc {where}, constant uptake: c over the level", "c(R) − s (R² − r²)/4D",
                      off, 0.01)  # fmt: skip
    assert np.abs(c - exact(0.9 * radius)).max() > 0.1 * LEVEL


@pytest.mark.parametrize("strength", [1.0, 3.0])
@pytest.mark.parametrize("where", BORDERS)
def test_uptake_in_proportion(where, strength, compare):
    """c = A I₀(mr), m² = k / D."""
    half = 1000.0 * LEVEL  # of which uptake in proportion is off by a thousandth at most
    linear = strength**2 * D / 100.0**2
    r, c, radius, end = disc(linear * half * APART**2 * HEIGHT, half, BORDERS[where])
    m = np.sqrt(linear / D)
    scale = i0(m * radius) + m * radius * i1(m * radius) * np.log(end / radius)
    off = rings(r, c, lambda r: LEVEL * i0(m * r) / scale)
    what = f"disc {where}, uptake in proportion, mR = {strength:g}: c over the level"
    compare.deviation(what, "A I₀(mr)", off, 0.01)
