"""Cell sorting by overlapping spheres, the second case study of Osborne et al. (2017).

400 cells attract each other by Chaste's springs, unlike ones a tenth as strongly, and diffuse. All
numbers are those of TestCellSortingLiteratePaper.hpp of the authors, in diameters and hours: a
spring of 50, a range of 2.5, D = 0.05. Nothing is tuned. The paper shows curves and no numbers.
"""

import numpy as np
import pytest
from sorting import mixed

import multicell as mc

SUBJECT, SOURCE = "biology", "osborne2017"
HOUR, DIAMETER = 3600.0, 10.0  # s, µm
COUNT = 400


def sorting(unlike, seed, hours=20):
    """Return the part of contacts between unlike types, every 2 h."""
    drag = 6 * np.pi * DIAMETER / 2  # of 1 kPa s, in nN s / µm
    like = {"a": {"a": 1.0, "b": unlike}, "b": {"a": unlike, "b": 1.0}}
    scene = mc.Scene.from_dict({
        "duration": hours * HOUR, "coupling_step": "10 min", "dimensions": 2, "seed": seed,
        "initial": {"count": COUNT, "spacing": 1.0},
        "cells": {"division_radius": DIAMETER / 2 * 2 ** (1 / 3)},
        "contact": {
            "law": "generalised-linear", "cutoff": 2.5, "stiffness_at_rest": 50 * drag / HOUR,
        },
        "drag": {"viscosity": 1.0}, "motility": {"diffusion": 0.05 * DIAMETER**2 / HOUR},
        "types": {name: {"fraction": 0.5, "adhesion_with": row} for name, row in like.items()},
        "output": {"every": "2 h"},
    })  # fmt: skip
    return np.array([mixed(frame) for frame in mc.run(scene, report=False).frames])


@pytest.mark.slow
def test_types_sort_out(compare):
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
