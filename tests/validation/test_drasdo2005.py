"""A monolayer grows exponentially, then its radius linearly (Drasdo & Höhme 2005).

Cells have the diameter, modulus, Poisson's ratio and cycle of the paper. Above a pressure they do
not grow: that pressure is assumed, and sets the speed; the crossover and the line follow from it.
"""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import truncnorm

import multicell as mc

SUBJECT, SOURCE = "biology", "drasdo2005"
HOUR, CYCLE = 3600.0, 18.0  # s, and the mean, h


def monolayer(pressure, hours):
    """Return times, h, numbers of cells, and radii of discs with the radius of gyration, µm."""
    scene = mc.Scene.from_dict({
        "duration": hours * HOUR, "coupling_step": "30 min", "dimensions": 2, "seed": 3,
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


@pytest.mark.slow
def test_a_monolayer_grows_linearly_once_it_is_pressed(compare):
    times, count, radius = monolayer("0.0015 kPa", 180)
    late = times >= 110
    t, r = times[late], radius[late]
    line = np.polyval(np.polyfit(t, r, 1), t)
    rising = np.exp(np.polyval(np.polyfit(t, np.log(r), 1), t))
    off, other = (np.abs(fit - r).max() / r.mean() for fit in (line, rising))
    what = "monolayer, a pressure assumed: radius from 110 to 180 h, relative"
    compare.deviation(what, "a straight line", off, 0.02)
    assert other > 1.5 * off
    assert r[-1] > 1.8 * r[0] > 3.0 * 1.8 * radius[0]
    last = np.log(count[-1] / count[-8]) / (times[-1] - times[-8])
    assert last < 0.5 * euler_lotka()


def test_a_monolayer_that_nothing_presses_grows_by_its_cycle(compare):
    times, count, _ = monolayer("1 GPa", 100)
    rate, late = euler_lotka(), times >= 30
    found = np.polyfit(times[late], np.log(count[late]), 1)[0]
    # of the few cells of the beginning
    what = "monolayer without a pressure: growth rate by the equation of Euler and Lotka"
    compare.value(what, round(rate, 5), found, 0.04 * rate, "1/h")
