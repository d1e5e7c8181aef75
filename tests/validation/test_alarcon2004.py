"""The cell cycle that oxygen drives of Alarcon, Byrne and Maini (2004), in growing cells."""

import math

import numpy as np
import pytest
from cycling_networks import alarcon, births_of, cycling

import multicell as mc

SUBJECT, SOURCE = "networks", "alarcon2004"


def reference_cycles(level, threshold, count=2, **values):
    """Return the lengths of cycles by SciPy, h; infinite where a cell does not come to its end."""
    from scipy.integrate import solve_ivp

    p = np.array(list({"a1": 0.05, "c1": 0.1, "cancer": 0.0, **values}.values()))

    def rates(t, y):
        out = np.empty(5)
        alarcon.rates(t, y, (level,), p, out)
        return out

    def ends(t, y):
        return y[0] - threshold

    ends.terminal, ends.direction = True, -1
    y, found = np.array([0.9, 0.01, 0.0, 5.0, 1.0]), []
    for _ in range(count):
        end = solve_ivp(rates, (0.0, 6000.0), y, "LSODA", events=ends, rtol=1e-10, atol=1e-12)
        found.append(end.t[-1] / 60.0 if end.status == 1 else math.inf)
        y = end.y[:, -1] * np.array([1.0, 1.0, 1.0, 0.5, 1.0])
    return found


OXYGEN = {"diffusion": 2000.0, "uptake": 0.0, "spacing": 20.0}


def alarcon_scene(level, after, parameters=None, **changes):
    table = {"network": alarcon, "inputs": {"P": "oxygen"}, "dilution": False,
             "divide": {"m": "halve"}, "parameters": parameters or {}}  # fmt: skip
    nutrients = {"oxygen": {**OXYGEN, "boundary": level}}
    return cycling(table, after, nutrients=nutrients, coupling_step="10 min", **changes)


@pytest.mark.parametrize("level", [1.0, 0.1, 0.02, 0.005])
def test_oxygen_sets_the_length_of_the_cycle(level, compare):
    first, second = reference_cycles(level, 0.004)
    scene = alarcon_scene(level, "cycle.x < 0.004", duration=3600.0 * (first + second + 0.5))
    simulation = mc.Simulation(scene, threads=1)
    times = births_of(simulation) / 3600.0
    assert len(simulation.cells) == 4
    off = np.abs(times - np.array([first, first + second, first + second])).max()
    what = f"two cycles of normal cells at an oxygen level of {level:g}"
    compare.deviation(what, "solve_ivp (LSODA, 1e-10)", off, 2e-3, "h")
    if level == 1.0:  # the tests of Chaste have it from ode15s
        compare.value("first cycle at an oxygen level of 1", 9.286356, times[0], 2e-3, "h")


@pytest.mark.parametrize("level", [0.02, 0.002])
def test_cancer_cells_without_oxygen_are_arrested(level, compare):
    # z comes to rest at c1 (B + P) / (c2 P): so much p27 that x stays above the threshold
    values = {"a1": 0.04, "c1": 0.007, "cancer": 1.0}
    first, _ = reference_cycles(level, 0.04, **values)
    assert (first == math.inf) == (level == 0.002)
    duration = "90 h" if level == 0.002 else "3 h"
    scene = alarcon_scene(level, "cycle.x < 0.04", parameters=values, duration=duration)
    simulation = mc.Simulation(scene, threads=1)
    times = births_of(simulation) / 3600.0
    if level == 0.002:
        assert not len(times)
        z = simulation.cells.inside[0, 2]
        what = "p27 of arrested cancer cells at an oxygen level of 0.002"
        compare.value(what, 0.007 * 0.012 / (0.01 * 0.002), z, 4e-3)
    else:
        compare.value("first cycle of cancer cells at 0.02", round(first, 4), times[0], 2e-3, "h")
