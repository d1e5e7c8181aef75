"""Epidemics of walkers: the SIR model of BioDynaMo against the equations of Kermack and McKendrick.

S' = -β S I / N,  I' = β S I / N - γ I

"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import multicell as mc

SUBJECT, SOURCE = "biology", "breitwieser2022"
BETA, GAMMA = 0.06719, 0.00521  # per step: measles, with 12.9 new infections by each of the first
STEP = 60.0  # s, one step of theirs
SIDE = 100.0  # µm, of a cube that repeats
TYPES = ("susceptible", "infected", "recovered")


def equations(counts, steps, beta, gamma):
    """Return S, I and R at whole steps, (3, steps + 1)."""
    count = sum(counts)

    def change(_, y):
        caught, healed = beta * y[0] * y[1] / count, gamma * y[1]
        return [-caught, caught - healed, healed]

    times = np.arange(steps + 1)
    return solve_ivp(change, (0, steps), counts, t_eval=times, rtol=1e-10, atol=1e-8).y


def epidemic(counts, steps, seed, catch, radius, motility, cut=1):
    """Return S, I and R at whole steps of walkers that infect by contact, (3, steps + 1).

    - ``catch``: law by which a susceptible catches it, and its rate, per step
    - ``radius``: half the distance of contact, µm
    - ``cut``: coupling steps in a step of theirs
    """
    rate = 1.0 / STEP
    ill = {"cells": "susceptible", "behaviour": "change to infected",
           "signal": "contacts with infected", **catch}  # fmt: skip
    heal = {"cells": "infected", "behaviour": "change to recovered", "law": "constant",
            "largest": -np.log1p(-GAMMA) * rate}  # fmt: skip
    scene = mc.Scene.from_dict({
        "duration": steps * STEP, "coupling_step": STEP / cut, "seed": seed,
        "contact": {"law": "none"}, "motility": motility,
        "cells": {"division_radius": radius * 2 ** (1 / 3)},
        "types": {"susceptible": {}, "infected": {"fraction": 0}, "recovered": {"fraction": 0}},
        "domain": {axis: [0, SIDE] for axis in "xyz"} | {"periodic": ["x", "y", "z"]},
        "responses": [ill, heal],
    })  # fmt: skip
    place = np.random.default_rng(seed).uniform(0.0, SIDE, (sum(counts), 3))
    names = np.repeat(TYPES, counts)
    cells = dict(zip(("x_um", "y_um", "z_um"), place.T, strict=True)) | {"type": names}
    run = mc.Simulation(scene, cells=cells)
    rows = [np.bincount(run.cells.kind, minlength=3)]
    while not run.finished:
        run.step()
        rows.append(np.bincount(run.cells.kind, minlength=3))
    return np.array(rows[::cut]).T


REACH = 10.5092197414493**0.5
"""Distance of infection in the published walkers, µm; their file has its square."""


def observed_rate(counts):
    """Return new infections over the sum of S I / N, by the trapezoidal rule, per step."""
    product = (counts[0] * counts[1]).astype(float)
    whole = ((product[1:] + product[:-1]) / 2).sum() / counts[:, 0].sum()
    return (counts[0, 0] - counts[0, -1]) / whole


def from_half(counts, steps):
    """Return I from where half are no longer susceptible on, so that the onset does not count."""
    left = counts[0] - counts[:, 0].sum() / 2
    begin = np.flatnonzero(left <= 0)[0]
    at = begin - left[begin] / (left[begin] - left[begin - 1]) + np.arange(steps)
    return np.interp(at, np.arange(counts.shape[1]), counts[1])


@pytest.mark.slow
def test_well_mixed_walkers_follow_the_equations(compare):
    """Each contact infects at a rate k: β is k times the mean number of others within reach."""
    steps, start, seeds = 90, [1900, 110, 0], (1, 2)
    rate = BETA * SIDE**3 / sum(start) / (4 / 3 * np.pi * REACH**3) / STEP
    catch = {"law": "linear", "begin": 0, "end": 20, "base": 0, "largest": 20 * rate}
    # by 60 µm along each axis in a quarter of a step, so that no two stay together
    stir = {"diffusion": 60.0**2 / 2 / (STEP / 4)}
    theirs = from_half(equations(start, steps, BETA, -np.log1p(-GAMMA)), 40)
    runs = [epidemic(start, steps, seed, catch, REACH / 2, stir, cut=4) for seed in seeds]
    what = "well-mixed walkers, 2 seeds"
    found = np.mean([observed_rate(run) for run in runs])
    # three standard errors of about 3,700 infections
    compare.value(f"{what}: infections over S I / N, per step", BETA, found, 0.05 * BETA)
    ours = np.mean([from_half(run, 40) for run in runs], axis=0)
    off = 100 * np.abs(ours - theirs).max() / sum(start)
    what = f"{what}: infected from half an epidemic on, 40 steps"
    compare.deviation(what, "the equations of SIR", off, 3.0, "% of all")
    for run in runs:
        assert (run.sum(axis=0) == sum(start)).all()


@pytest.mark.slow
def test_walkers_of_the_measles_demo_infect_as_often_as_published(compare):
    """Whoever has an infected one within reach catches it with a chance, in each step.

    The authors chose reach, chance and speed (files sim-param.h and measles.json of their
    demonstration) so that the walkers follow the equations with BETA; here they are not tuned.
    """
    steps, start = 120, [2000, 10, 0]
    catch = {"law": "threshold", "half": 0.5, "base": 0,
             "largest": -np.log1p(-0.285097276954021) / STEP}  # fmt: skip
    drag = 6 * np.pi * 5.0 * REACH / 2  # of the default viscosity, in nN s / µm
    walk = {"force": 5.78594372145249 / STEP * drag, "persistence": STEP}
    found, most = [], []
    for seed in (1, 2, 3):
        run = epidemic(start, steps, seed, catch, REACH / 2, walk)
        found.append(observed_rate(run))
        most.append(run[1].max())
    what = "measles of 2,010 walkers, 3 seeds: infections over S I / N, per step"
    # theirs pass it on from the next step on, ours from the moment at which they catch it
    compare.value(what, BETA, np.mean(found), 0.12 * BETA)
    peak = equations(start, steps, BETA, GAMMA)[1].max()
    compare.value("the same: most that are infected at once", peak, np.mean(most), 0.05 * peak)
