"""Adhesion and a crypt of Osborne et al. (2017) by overlapping spheres.

All numbers are those of the authors' programs, in diameters and hours; nothing is tuned. The paper
shows curves; what it has of numbers are cells that can be counted in the authors' pictures.
"""

from itertools import pairwise

import numpy as np
import pytest
from overlapping_spheres import DIAMETER, GROWING, HOUR, SPRING, lattice, placed, tissue
from scipy.optimize import brentq
from sorting import mixed

import multicell as mc
from multicell.cells import State

SUBJECT, SOURCE = "biology", "osborne2017"
COUNT = 400  # cells that sort


# --- adhesion ------------------------------------------------------------------------------------


def sorting(unlike, seed, hours=20):
    """Return the part of contacts between unlike types, every 2 h."""
    like = {"a": {"a": 1.0, "b": unlike}, "b": {"a": unlike, "b": 1.0}}
    scene = mc.Scene.from_dict({
        **tissue(cutoff=2.5), "duration": hours * HOUR, "coupling_step": "10 min", "seed": seed,
        "initial": {"count": COUNT, "spacing": 1.0},
        "cells": {"division_radius": DIAMETER / 2 * 2 ** (1 / 3)},
        "motility": {"diffusion": 0.05 * DIAMETER**2 / HOUR},
        "types": {name: {"fraction": 0.5, "adhesion_with": row} for name, row in like.items()},
        "output": {"every": "2 h"},
    })  # fmt: skip
    return np.array([mixed(frame) for frame in mc.run(scene, report=False).frames])


@pytest.mark.slow
def test_types_sort_out(compare):
    """400 cells attract each other, unlike ones a tenth as strongly, and diffuse with 0.05."""
    runs = np.array([sorting(0.1, seed) for seed in (1, 2)])
    even = 0.5 * COUNT / (COUNT - 1)
    what = "400 spheres that sort, 2 seeds: unlike contacts over all"
    # some 1,100 contacts share 400 cells: by 0.02 seeds differ
    compare.value(f"{what}, at the start", round(even, 4), runs[:, 0].mean(), 0.04)
    mean = runs.mean(axis=0)[::2]
    rise = max(0.0, float(np.diff(mean).max()))
    compare.deviation(f"{what}, largest rise in 4 h of 20 h", "falls throughout", rise, 0.01)
    assert mean[-1] < 0.85 * mean[0]
    # where unlike cells attract as strongly as like ones, nothing sorts
    alike = sorting(1.0, 1, hours=8)
    assert abs(alike[-1] - alike[0]) < 0.04


# --- proliferation and death: a crypt -------------------------------------------------------------

WIDE, LONG = 16, 12  # diameters; Wnt falls to zero along the length
COLLAR, MOUTH = 0.5 * LONG * DIAMETER, (LONG - 0.5) * DIAMETER  # µm: Wnt of 0.5; cells are shed
IN_PICTURE = 248
"""Cells that figures/Crypt_Node_08_t100.png shows."""


def crypt(seed, hours=140.0):
    """Return the run of a crypt on a cylinder, unrolled; cells divide where there is Wnt.

    A steady field between two sides is a line, as Wnt is. Centres stand on the base at 0, so the
    wall is a radius below it. Phases are the authors', from birth on: M, G1 (normal, 2 ± 1 h), S
    and G2. Compressed to 0.8 of their area, cells wait in G1: that is a pressure of a lattice.
    """
    low, high = -0.5 * DIAMETER, 13.5 * DIAMETER
    near = np.sqrt(0.8) * DIAMETER
    full = np.pi * DIAMETER**3 / 6
    pressure = SPRING * DIAMETER * np.log(DIAMETER / near) * near / full
    still = {"grows": False}
    scene = tissue(
        duration=hours * HOUR, coupling_step="30 min", seed=seed,
        domain={"x": [0, WIDE * DIAMETER], "y": [low, high], "periodic": ["x"]},
        growth={"restriction": False, "hypertrophy": False, "phases": {
            "G1": GROWING, "G2": {"duration": "5 h", **still}, "M": {"duration": "4 h", **still},
            "S": {"duration": "2 h", "distribution": "gamma", "variation": 0.5, **still},
        }},
        responses=[{"behaviour": "entry into G2", "signal": "pressure", "law": "threshold",
                    "half": pressure, "falls": True, "largest": 1.0}],
        death={"lysis_time": "10 min", "removal_fraction": 0.5},
        nutrients={"wnt": {
            "boundary": 1.0, "uptake": 0, "spacing": 20.0, "sides": {"y+": {"value": 0.0}},
            "quiescence": (high - COLLAR) / (high - low), "necrosis": (high - MOUTH) / (high - low),
        }},
        initial={"stage": "uniform"},
    )  # fmt: skip
    scene["cells"]["reaction_time"] = scene["coupling_step"]
    full, table = placed(scene, lattice(WIDE, LONG))
    return mc.run(full, cells=table, report=False)


def free_rate():
    """Return the rate of free growth by the equation of Euler and Lotka, 1/h: gamma and 10 h."""
    return brentq(lambda k: 2.0 * np.exp(-10.0 * k) * (1.0 + 0.5 * k) ** -4 - 1.0, 0.01, 0.1)


def settled(run, begin):
    """Return the frames from a time in h on, by hours."""
    return [frame for frame in run.frames if frame.time >= begin * HOUR]


def speeds(frames, edges):
    """Return mean speeds of living cells upwards, µm/h, and their numbers, by height."""
    moved, pairs, count = np.zeros((3, len(edges) - 1))
    for before, after in pairwise(frames):
        y = np.maximum(before.cells.position[~before.cells.dead, 1], edges[0])
        count += np.histogram(y, edges)[0]
        _, i, j = np.intersect1d(before.cells.id, after.cells.id, return_indices=True)
        there = ~after.cells.dead[j]
        y0, y1 = before.cells.position[i[there], 1], after.cells.position[j[there], 1]
        middle = np.maximum(0.5 * (y0 + y1), edges[0])
        moved += np.histogram(middle, edges, weights=y1 - y0)[0]
        pairs += np.histogram(middle, edges)[0]
    return moved / pairs, count / (len(frames) - 1)


@pytest.mark.slow
def test_a_crypt_renews_itself(compare):
    """Cells that the collar makes go up and are shed: v(y) is what is born below y over density."""
    begin, edges, counts, births, speed, profile = 40, np.arange(0.0, 111.0, 10.0), [], [], [], []
    for seed in (1, 2):
        run = crypt(seed)
        frames = settled(run, begin)
        counts.append([np.count_nonzero(~frame.cells.dead) for frame in frames])
        found, count = speeds(frames, edges)
        speed.append(found)
        profile.append(count)
        born = np.count_nonzero(run.lineage["birth_time"] > begin * HOUR) / 2
        collar = np.mean(
            [np.count_nonzero(frame.cells.state == State.PROLIFERATING) for frame in frames]
        )
        births.append(born / (len(frames) - 1) / collar)
    what = "crypt, 2 seeds, 100 h"
    scatter = 3.0 * 5.0  # standard deviations of the number at one time
    compare.value(f"{what}: cells (a picture of the authors)", IN_PICTURE, np.mean(counts), scatter)
    parts = np.reshape(np.array(counts)[:, 1:], (-1, 25)).mean(axis=1)
    drift = np.abs(parts / parts.mean() - 1.0).max()
    compare.deviation(f"{what}: cells, means over 25 h", "steady", drift, 0.03)
    rate = free_rate()
    compare.value(f"{what}: births over cells of the collar, by Euler and Lotka", round(rate, 5),
                  np.mean(births), 0.02 * rate, "1/h")  # fmt: skip
    count, found = np.mean(profile, axis=0), np.mean(speed, axis=0)
    below = np.cumsum(count)
    collar = below[round(COLLAR / DIAMETER) - 1]
    made = rate * np.minimum(below - 0.5 * count, collar)  # up to the middle of each height
    off = np.abs(found - made * DIAMETER / count) / (rate * collar * DIAMETER / count[-2])
    of = "births below / density"
    compare.deviation(f"{what}: speed at 11 heights, over that at the mouth", of,
                      off.max(), 0.08)  # fmt: skip
