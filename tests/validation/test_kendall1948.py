"""Generations: divisions in step, Yule's process, and cycles of gamma-distributed length."""

import numpy as np
import pytest
from families import by_founder, cycle_of, founders
from running import finished
from scipy import stats

import multicell as mc

SUBJECT, SOURCE = "biology", "kendall1948"
HOUR = 3600.0
FAMILIES = 10_000


def growing(count, hours, variation, **parts):
    """Return the run of cells that have just divided, with a cycle of 10 h."""
    return finished(mc.Scene.from_dict({
        "duration": f"{hours} h", "coupling_step": "30 min", "seed": 8, "contact": {"law": "none"},
        "initial": {"count": count, "stage": "birth"}, "output": {"every": "2 h"},
        "growth": {"restriction": False, "phases": cycle_of(10 * HOUR, variation)}, **parts,
    }))  # fmt: skip


@pytest.mark.slow
def test_families_of_exponential_cycles_are_geometric(compare):
    """A family has n cells with the chance e^(-kt) (1 - e^(-kt))^(n - 1)."""
    run = growing(FAMILIES, 20, 1)
    sizes = by_founder(run, np.ones(len(run.cells), dtype=bool))
    chance = np.exp(-2.0)
    error = 3.5 * np.sqrt((1 - chance) / chance**2 / FAMILIES)
    compare.value("10,000 families after two mean cycles, exponential: cells", 1 / chance,
                  sizes.mean(), error)  # fmt: skip
    law = stats.geom(chance)
    edges = np.array([1, 2, 3, 4, 6, 8, 11, 15, 21])
    expected = FAMILIES * np.diff(np.append(law.cdf(edges - 1), 1.0))
    found = np.histogram(sizes, np.append(edges, 10**6))[0]
    off = stats.chisquare(found, expected).statistic
    compare.deviation("the same, sizes of families in 9 classes: χ²", "geometric distribution", off,
                      round(stats.chi2(8).ppf(0.9995), 1))  # fmt: skip
    # a family has on average e^(-kt) (2kt)^g / g! cells of generation g
    known = founders(run)
    pairs = np.array([known[i] for i in run.cells.id.tolist()])
    table = np.zeros((FAMILIES, 40))
    np.add.at(table, (pairs[:, 0], pairs[:, 1]), 1)
    theirs = stats.poisson(4.0).pmf(np.arange(10)) / chance
    error = table[:, :10].std(axis=0) / np.sqrt(FAMILIES)
    off = (np.abs(table[:, :10].mean(axis=0) - theirs) / error).max()
    compare.deviation("the same, cells of generations 0 to 9", "e^(−kt) (2kt)^g / g!", off, 3.5,
                      "standard errors")  # fmt: skip


@pytest.mark.parametrize("stages", [2, 4, 16])
def test_growth_rate_of_cycles_of_several_stages(stages, compare):
    """Kendall's k stages: 2 (1 + rT/k)^(-k) = 1, thus r = k (2^(1/k) - 1) / T."""
    run = growing(4000, 20, stages**-0.5, initial={"count": 4000, "stage": "asynchronous"})
    rate = stages * (2 ** (1 / stages) - 1)
    found = np.log(len(run.cells) / 4000) / 2.0
    sizes = by_founder(run, np.ones(len(run.cells), dtype=bool))
    # error of the logarithm of a mean of 4,000 families
    error = float(f"{3.5 * sizes.std() / sizes.mean() / np.sqrt(4000) / 2.0:.2g}")
    what = f"cycle of {stages} equal stages: growth rate times mean cycle"
    compare.value(what, rate, found, error)
    assert found > np.log(2) + error  # the rate of a fixed cycle


def test_cells_in_step_double_at_once(compare):
    """Without variation 2^n cells, n the whole cycles that have passed."""
    run = mc.Simulation(mc.Scene.from_dict({
        "duration": "49 h", "coupling_step": "30 min", "contact": {"law": "none"},
        "initial": {"count": 10, "stage": "birth"},
        "growth": {"cycle_time": "10 h", "cycle_variation": 0},
    }))  # fmt: skip
    off = 0
    while not run.finished:
        run.step()
        off = max(off, abs(len(run.cells) - 10 * 2 ** int(run.time / (10 * HOUR) + 1e-9)))
    assert len(run.cells) == 160
    compare.deviation("10 cells in step, 49 h: cells", "10·2ⁿ", off, 0, "cells")
