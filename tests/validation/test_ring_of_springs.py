"""A ring of cells on springs: each wave relaxes at its own rate, as phonons of a chain do."""

import numpy as np
import pytest

import multicell as mc

SUBJECT, SOURCE = "motion", "closed form"
COUNT, STIFFNESS, VISCOSITY = 16, 2.0, 1.0


def ring(mode, **integrator):
    """Return a run of a ring, its first displacements and places at rest, µm, and the rate due."""
    radius = 5.0 * 0.5 ** (1 / 3)
    length, drag = 2.0 * radius * COUNT, 6 * np.pi * VISCOSITY * radius
    rate = 4.0 * STIFFNESS / drag * np.sin(np.pi * mode / COUNT) ** 2
    scene = mc.Scene.from_dict({
        "duration": 2.0 / rate, "coupling_step": 0.2 / rate, "cells": {"young_variation": 0},
        "contact": {"law": "linear", "stiffness_at_rest": STIFFNESS, "cutoff": 1.1},
        "drag": {"viscosity": VISCOSITY}, "integrator": integrator,
        "domain": {"x": [0, length], "y": [-50, 50], "z": [-50, 50], "periodic": ["x"]},
    })  # fmt: skip
    away = 0.02 * radius * np.sin(2 * np.pi * mode * (np.arange(COUNT) + 0.3) / COUNT)
    place = 2.0 * radius * np.arange(COUNT) + away
    nothing = np.zeros(COUNT)
    run = mc.Simulation(scene, cells={"x_um": place, "y_um": nothing, "z_um": nothing})
    return run, away, place - away, rate


@pytest.mark.parametrize("mode", [1, 3, 8])
def test_waves_relax_at_their_rates(mode, compare):
    """Of springs k between cells with drag γ: 4 (k / γ) sin²(π m / N)."""
    run, away, rest, exact = ring(mode, method="rk4-adaptive", atol=1e-9, rtol=1e-10)
    while not run.finished:
        run.step()
    left = run.cells.position[np.argsort(run.cells.id), 0] - rest
    found = -np.log((left @ away) / (away @ away)) / run.time
    what = f"ring of 16 springs, wave {mode}: rate over 4 (k/γ) sin²(πm/N)"
    compare.value(what, 1.0, found / exact, 1e-6)


def test_a_ring_keeps_its_place_and_loses_the_energy_of_its_wave():
    """Momentum: Σ γ v = 0, so that the centre stays. Energy: a wave's falls at twice its rate."""
    run, _, rest, rate = ring(3, method="rk4-adaptive", atol=1e-9, rtol=1e-10)
    centre, energy = run.cells.position.mean(axis=0), None
    resting = np.stack([rest, *np.zeros((2, COUNT))], axis=1)
    while not run.finished:
        run.step()
        system, end = run.mechanics, run.mechanics.motion.end
        # springs that rest have the energy of their cutoff
        now = system.energy(end, run.cells.position) - system.energy(end, resting)
        if energy is not None:
            assert now / energy == pytest.approx(np.exp(-2.0 * rate * 0.2 / rate), rel=1e-6)
        energy = now
        np.testing.assert_allclose(run.cells.position.mean(axis=0), centre, atol=1e-12)
