"""An asynchronous start is a growing population: its ages and durations, and log N as a line."""

from functools import cache

import numpy as np
import pytest
from scipy import integrate, interpolate, optimize, stats

from multicell.biology.draws import malthusian_rate
from multicell.biology.exposure import Exposure
from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.biology.step import age_cells, decide, divide_and_remove, grow
from multicell.cells import SPHERE, State
from multicell.scene.scene import Scene

HOUR = 3600.0
TINY = {"S": {"duration": "1 s"}, "G2": {"duration": "1 s"}, "M": {"duration": "1 s"}}
PHASES = {
    "G1": {"duration": "9 h", "distribution": "shifted-gamma", "variation": 0.4, "shift": 0.3},
    "S": {"duration": "7 h", "distribution": "gamma", "variation": 0.3},
    "G2": {"duration": "4 h", "distribution": "gamma", "variation": 0.7},
    "M": {"duration": "1 h", "grows": False},
}
GROWTHS = {
    "gamma 1": {"phases": {"G1": {"duration": "24 h", "distribution": "gamma", "variation": 1.0},
                           **TINY}},
    "gamma 0.5": {"phases": {"G1": {"duration": "24 h", "distribution": "gamma",
                                    "variation": 0.5}, **TINY}},
    "phases": {"phases": PHASES},
    "fixed": {"phases": {name: {"duration": part["duration"]} for name, part in PHASES.items()}},
    "linear": {"cycle_time": "20 h", "cycle_variation": 0.5},
    "exponential": {"cycle_time": "20 h", "cycle_variation": 0.5, "law": "exponential"},
    "relaxation": {"cycle_time": "20 h", "cycle_variation": 0.4, "law": "relaxation",
                   "parameters": {"target": 1.2}},
}  # fmt: skip
"""The cycles of scenes: in phases, and by each law of growth."""


def described(growth, count=4000, **changes):
    entries = {
        "duration": "60 h", "coupling_step": "6 min", "seed": 3,
        "cells": {"young_variation": 0.0}, "contact": {"law": "hertz"},
        "initial": {"count": count, "stage": "asynchronous"}, "growth": GROWTHS[growth],
    }  # fmt: skip
    return Scene.from_dict(entries | changes)


def lived(scene, hours, step=0.1):
    """Let free cells live without mechanics; return them, times in hours and living cells then."""
    cells, time, counts = initial_cells(scene), 0.0, []
    next_id, steps = len(cells), round(hours / step)
    for number in range(1, steps + 1):
        counts.append(int((~cells.dead).sum()))
        end = number * step * HOUR
        grown = grow(biology_plan(scene), cells, {}, np.ones(len(cells)), end - time)
        cells, _ = age_cells(biology_plan(scene), cells, grown, {}, time, end)
        after = divide_and_remove(biology_plan(scene), cells, next_id, end, end - time)
        cells, next_id = after.cells.copy(), after.next_id
        exposure = Exposure(cells, {}, end - time)
        cells = decide(biology_plan(scene), cells, {}, exposure, time=end).cells
        time = end
    counts.append(int((~cells.dead).sum()))
    return cells, np.arange(steps + 1) * step, np.array(counts)


def cut_normal(mean, variation):
    cut = min(3.0, 0.9 / variation)
    return stats.truncnorm(-cut, cut, loc=mean, scale=variation * mean)


def distributions(growth):
    """Return SciPy's distributions of what a cycle is the sum of, in hours."""
    entries = GROWTHS[growth]
    if "phases" not in entries:
        return [cut_normal(20.0, entries["cycle_variation"])]
    found = []
    for part in entries["phases"].values():
        value, unit = part["duration"].split()
        mean, kind = float(value) / {"h": 1.0, "s": HOUR}[unit], part.get("distribution")
        variation, shift = part.get("variation", 0.2), part.get("shift", 0.0)
        shape = ((1.0 - shift) / variation) ** 2
        found.append({
            None: stats.uniform(mean, 1e-9),
            "gamma": stats.gamma(shape, scale=mean / shape),
            "shifted-gamma": stats.gamma(shape, mean * shift, (1.0 - shift) * mean / shape),
        }[kind])  # fmt: skip
    return found


@cache
def euler_lotka(growth):
    """Solve 2 E[exp(-rate T)] = 1 by the midpoint rule over quantiles; the rate in 1/h."""
    nodes = (np.arange(20_000) + 0.5) / 20_000
    lengths = [law.ppf(nodes) for law in distributions(growth)]

    def excess(rate):
        return 2.0 * np.prod([np.exp(-rate * length).mean() for length in lengths]) - 1.0

    return optimize.brentq(excess, 1e-4, 1.0, xtol=1e-12)


@pytest.mark.parametrize("growth", GROWTHS)
def test_the_rate_is_that_of_euler_and_lotka(growth):
    rate = malthusian_rate(described(growth).growth) * HOUR
    assert rate == pytest.approx(euler_lotka(growth), rel=1e-5)


@pytest.mark.parametrize("growth", GROWTHS)
def test_the_logarithm_of_the_number_of_cells_is_a_line_from_the_start(growth):
    scene = described(growth)
    _, time, counts = lived(scene, 30.0, step=0.5 if scene.growth.phases else 0.1)
    # a step of 6 min makes cycles 1.5 min longer where volume triggers division
    longer = 0.0 if scene.growth.phases else 0.25 * 6.0 / (60.0 * 20.0)
    line = np.log(4000) + euler_lotka(growth) * (1.0 - longer) * time
    scatter = np.sqrt((1.0 - np.exp(-(line - line[0]))) / 4000)  # of a process without memory
    assert (np.abs(np.log(counts) - line) <= 3.5 * scatter + 1e-9).all()


@pytest.mark.parametrize("growth", ["phases", "linear"])
def test_deaths_lower_the_rate_and_leave_the_ages(growth):
    death = 0.012
    scene = described(growth, death={"apoptosis_rate": f"{death / HOUR} 1/s"})
    cells, time, counts = lived(scene, 40.0, step=0.2)
    rate = np.polyfit(time, np.log(counts), 1)[0]
    assert rate == pytest.approx(euler_lotka(growth) - death, rel=0.05)
    early = np.log(counts[50] / counts[0]) / 10.0
    assert early == pytest.approx(euler_lotka(growth) - death, rel=0.15)
    living = cells.take(~cells.dead)
    assert stats.ks_2samp(living.age, initial_cells(described(growth)).age).pvalue > 0.01


@pytest.mark.parametrize("growth", ["gamma 1", "phases", "linear"])
def test_ages_are_those_of_renewal_theory(growth):
    """Density 2 rate exp(-rate a) P(T > a), at the start and 30 h later."""
    rate = euler_lotka(growth)
    drawn = sum(law.rvs(200_000, random_state=k) for k, law in enumerate(distributions(growth)))
    age = np.linspace(0.0, drawn.max(), 4000)
    survival = 1.0 - np.searchsorted(np.sort(drawn), age) / len(drawn)
    below = integrate.cumulative_trapezoid(
        2 * rate * np.exp(-rate * age) * survival, age, initial=0
    )
    assert below[-1] == pytest.approx(1.0, abs=0.005)
    law = interpolate.interp1d(age, below / below[-1], fill_value=1.0, bounds_error=False)
    scene = described(growth)
    for cells in (initial_cells(scene), lived(scene, 30.0, step=0.25)[0]):
        # at most the distance that 4,000 independent ages have in one sample of a thousand
        assert stats.kstest(cells.age / HOUR, law).statistic < 1.95 / np.sqrt(4000)


def test_sizes_fit_ages_and_phases():
    """The volume is that of the share of growing time that a cell has behind it."""
    scene = described("linear")
    cells = initial_cells(scene)
    birth = 0.5 * SPHERE * scene.cells.division_radius**3
    np.testing.assert_allclose(cells.volume / birth, 1.0 + cells.age / cells.cycle_time, rtol=1e-12)
    phased = initial_cells(described("phases"))
    assert (phased.progress <= phased.phase_length).all()
    assert (phased.state == State.PROLIFERATING).all()


def test_types_scale_the_stable_population():
    """A type that is slower by 2 has ages twice as large, with the same distribution otherwise."""
    types = {"quick": {}, "slow": {"cycle_scale": 2.0}}
    cells = initial_cells(described("gamma 1", types=types))
    age = [cells.age[cells.kind == k] / (k + 1) for k in (0, 1)]
    assert stats.ks_2samp(*age).pvalue > 0.01


def test_cycles_that_do_not_vary_or_are_inherited_keep_the_ages_of_powell():
    inherited = {"cells.heritable": ["cycle_time"]}
    for change in ({"growth.cycle_variation": 0.0}, inherited):
        cells = initial_cells(described("linear").with_changes(change))
        share = cells.age / cells.cycle_time
        assert stats.kstest(share, lambda s: 2.0 * (1.0 - 2.0**-s)).pvalue > 0.01
