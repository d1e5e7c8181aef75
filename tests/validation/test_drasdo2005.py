"""A monolayer grows exponentially, then its radius linearly (Drasdo & Höhme 2005).

Cells have the diameter, modulus, Poisson's ratio and cycle of the paper. Above a pressure they do
not grow: that pressure is assumed, and sets the speed; the crossover and the line follow from it.
"""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import t as student
from scipy.stats import truncnorm

import multicell as mc

SUBJECT, SOURCE = "biology", "drasdo2005"
HOUR, CYCLE = 3600.0, 18.0  # s, and the mean, h
SEEDS = (1, 2, 3, 4)


def monolayer(pressure, hours, seed):
    """Return times, h, numbers of cells, and radii of discs with the radius of gyration, µm."""
    scene = mc.Scene.from_dict({
        "duration": hours * HOUR, "coupling_step": "30 min", "dimensions": 2, "seed": seed,
        "initial": {"count": 10, "stage": "asynchronous"}, "contact": {"law": "hertz"},
        "cells": {"young": "450 Pa", "poisson": 0.4, "young_variation": 0,
                  "division_radius": "5 um", "heritable": []},
        "growth": {"cycle_time": "18 h", "cycle_variation": 2 / 18, "critical_pressure": pressure},
        "drag": {"viscosity": "0.5 kPa s"}, "output": {"every": "5 h"},
    })  # fmt: skip
    frames = mc.run(scene, report=False).frames
    places = [frame.cells.position[:, :2] for frame in frames]
    radius = [np.sqrt(2.0 * ((x - x.mean(axis=0)) ** 2).sum(axis=1).mean()) for x in places]
    times = np.array([frame.time for frame in frames]) / HOUR
    return times, np.array([len(x) for x in places]), np.array(radius)


def euler_lotka():
    """Return the rate k of free growth, 1/h: twice the mean of exp(-k x cycle) is 1."""
    cycle = truncnorm(-3, 3, loc=CYCLE, scale=2.0)
    return brentq(lambda k: 2.0 * cycle.expect(lambda x: np.exp(-k * x)) - 1.0, 0.02, 0.06)


def half_interval(values):
    """Return half of the interval of 95 % for the mean over seeds, by Student."""
    return student.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values))


@pytest.mark.slow
def test_a_monolayer_grows_linearly_once_it_is_pressed(compare):
    off, other, speed = [], [], []
    for seed in SEEDS:
        times, count, radius = monolayer("0.0015 kPa", 180, seed)
        late = times >= 110
        t, r = times[late], radius[late]
        slope, start = np.polyfit(t, r, 1)
        rising = np.exp(np.polyval(np.polyfit(t, np.log(r), 1), t))
        off.append(np.abs(slope * t + start - r).max() / r.mean())
        other.append(np.abs(rising - r).max() / r.mean())
        speed.append(slope)
        assert r[-1] > 1.8 * r[0] > 3.0 * 1.8 * radius[0]
        last = np.log(count[-1] / count[-8]) / (times[-1] - times[-8])
        assert last < 0.5 * euler_lotka()
    what = "monolayer, a pressure assumed, 4 seeds"
    compare.deviation(f"{what}: radius from 110 to 180 h, relative", "a straight line", max(off),
                      0.02)  # fmt: skip
    assert np.mean(other) > 1.5 * np.mean(off)
    half = half_interval(speed) / np.mean(speed)
    compare.deviation(
        f"{what}: speed, half of its interval of 95 %, relative", "no scatter", half, 0.05
    )


def test_a_monolayer_that_nothing_presses_grows_by_its_cycle(compare):
    found, rate = [], euler_lotka()
    for seed in SEEDS:
        times, count, _ = monolayer("1 GPa", 100, seed)
        late = times >= 30
        found.append(np.polyfit(times[late], np.log(count[late]), 1)[0])
    # of the few cells of the beginning: with one seed 4 %
    what = "monolayer without a pressure, 4 seeds: growth rate by the equation of Euler and Lotka"
    compare.value(what, round(rate, 5), np.mean(found), 0.02 * rate, "1/h")
    half = half_interval(found) / rate
    compare.deviation("the same: half of its interval of 95 %, relative", "no scatter", half, 0.03)
