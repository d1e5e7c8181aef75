"""Fronts of dividing cells: slower than Fisher's speed by as much as a cutoff (Brunet & Derrida).

Cells diffuse with D and divide at a rate r where nobody else is, less among others. A continuum
moves at 2 √(rD); N cells in a length of √(D/r) do so more slowly, since growth ends where less
than one cell is due: u_t = D u_xx + r u (1 - u) for u > 1/N, without growth below.
"""

from __future__ import annotations

import numpy as np
import pytest
from families import cycle_of
from scipy.integrate import solve_ivp

import multicell as mc

SUBJECT, SOURCE = "biology", "brunet1997"
RATE, D = 0.1 / 3600.0, 1.0  # 1/s and µm²/s
ACROSS = np.sqrt(D / RATE)  # 190 µm
REACH = 40.0  # µm, within which others count
WIDTH = 2.1 * REACH
BEGIN, END = 10, 20  # in units of 1/r


def continuum(number):
    """Return the speed of the continuum whose growth ends at 1/N, in units of √(rD)."""
    step = 0.1
    grid = np.arange(0.0, 60.0, step)

    def change(_, u):
        bent = np.diff(np.concatenate([[u[0]], u, [0.0]]), 2) / step**2
        return bent + np.where(u > 1.0 / number, u * (1 - u), 0.0)

    how = {"t_eval": [BEGIN, END], "lband": 1, "uband": 1, "rtol": 1e-5, "atol": 1e-8}
    found = solve_ivp(change, (0, END), (grid < 1.0).astype(float), "LSODA", **how)
    places = [np.interp(-0.5, -u, grid) for u in found.y.T]
    return (places[1] - places[0]) / (END - BEGIN)


def fronts(full, seed):
    """Return the speeds of two fronts, (2,), and how many cells are in √(D/r) far behind them.

    Those with ``full`` others within reach do not divide.
    """
    due = full * WIDTH * ACROSS / (np.pi * REACH**2)
    half = 55.0 * ACROSS
    crowd = {"behaviour": "growth rate", "signal": "neighbours", "law": "linear", "falls": True,
             "begin": 0, "end": full}  # fmt: skip
    scene = mc.Scene.from_dict({
        "duration": END / RATE, "coupling_step": 0.1 / RATE, "seed": seed, "dimensions": 2,
        "contact": {"law": "none"}, "motility": {"diffusion": D}, "responses": [crowd],
        "growth": {"restriction": False, "phases": cycle_of(1.0 / RATE, 1)},
        "cells": {"division_radius": REACH / 2},
        "domain": {"x": [-half, half], "y": [0, WIDTH], "periodic": ["x", "y"]},
    })  # fmt: skip
    rng = np.random.default_rng(seed)
    first = round(2 * due)
    places = {"x_um": rng.uniform(-ACROSS, ACROSS, first), "y_um": rng.uniform(0, WIDTH, first)}
    run = mc.Simulation(scene, cells=places)
    rank, ends = round(due / 4), []
    while not run.finished:
        run.step()
        if round(run.time * RATE / 0.1) in (BEGIN * 10, END * 10):
            x = np.sort(run.cells.position[:, 0])
            assert np.abs(x[[0, -1]]).max() < 0.9 * half
            ends.append([-x[rank], x[-1 - rank]])
    behind = (np.abs(x) < 10 * ACROSS).sum() / 20
    return (np.array(ends[1]) - ends[0]) / ACROSS / (END - BEGIN), behind


@pytest.mark.slow
def test_fronts_of_few_cells_are_as_slow_as_a_cutoff_makes_them(compare):
    runs = [fronts(10, seed) for seed in range(1, 11)]
    speeds, number = np.concatenate([run[0] for run in runs]), np.mean([run[1] for run in runs])
    error = speeds.std(ddof=1) / np.sqrt(len(speeds))
    free, cut = continuum(1e12), continuum(number)
    # 0.2 is 4 standard errors of twenty fronts, and less than what the cutoff makes
    what = "twenty fronts of 52 cells in √(D/r), from 10 to 20/r (1.88 without a cutoff): speed"
    compare.value(what, round(cut, 2), speeds.mean(), 0.2, "√(rD)")
    assert round(number) == 52
    assert free == pytest.approx(1.88, abs=0.005)
    assert speeds.mean() < free - 3.0 * error
