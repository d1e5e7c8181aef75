"""Lineages of stem cells: each daughter remains a stem cell with a chance p (Lander et al. 2009).

Divisions at a rate v make of the stem cells a birth-and-death process whose mean, variance and
extinction are closed forms (D. G. Kendall, Ann. Math. Stat. 19 (1948) 1); their progeny dies at a
rate d, with the mean of the paper's equations.
"""

import numpy as np
import pytest
from families import by_founder, cycle_of
from running import finished
from scipy import stats

import multicell as mc

SUBJECT, SOURCE = "biology", "lander2009"
LINEAGES, HOURS = 1000, 20.0
V, D = 0.1, 0.05  # 1/h: divisions of stem cells, deaths of their progeny
ERRORS = 3.5
"""Standard errors within which a mean and a variance lie: one row in 2,000 would not."""


def lineages(responses, hours=HOURS, **parts):
    """Return the run of a thousand stem cells that divide at the rate V."""
    resting = {"cells": "progeny", "behaviour": "growth rate", "law": "constant", "largest": 0}
    return finished(mc.Scene.from_dict({
        "duration": f"{hours} h", "coupling_step": "1 h", "seed": 3, "contact": {"law": "none"},
        "initial": {"count": LINEAGES}, "death": {},
        "types": {"stem": {}, "progeny": {"fraction": 0}},
        "growth": {"restriction": False, "phases": cycle_of(3600.0 / V, 1)},
        "responses": [resting, *responses], **parts,
    }))  # fmt: skip


def moments(compare, what, counts, mean, variance):
    """Compare the mean and the variance of counts, one a lineage."""
    error = np.sqrt(variance / len(counts))
    compare.value(f"{what}: mean", mean, counts.mean(), ERRORS * error)
    fourth = ((counts - counts.mean()) ** 4).mean()
    error = np.sqrt((fourth - counts.var() ** 2) / len(counts))
    # the scatter is that of these lineages: two digits, so that the tolerance is reproducible
    compare.value(f"{what}: variance", variance, counts.var(ddof=1), float(f"{ERRORS * error:.2g}"))


@pytest.mark.parametrize("p", [0.6, 0.5, 0.4])
def test_stem_cells_renew_themselves_with_a_chance(p, compare):
    stay = {"cells": "stem", "behaviour": "mutation to progeny", "law": "constant",
            "largest": 1 - p}  # fmt: skip
    die = {"cells": "progeny", "behaviour": "apoptosis rate", "law": "constant",
           "largest": f"{D} 1/h"}  # fmt: skip
    run = lineages([stay, die])
    stems = by_founder(run, (run.cells.kind == 0) & ~run.cells.dead)
    up, down, rate = V * p**2, V * (1 - p) ** 2, V * (2 * p - 1)
    if rate:
        grown = np.exp(rate * HOURS)
        variance = (up + down) / rate * grown * (grown - 1)
        ended = down * (grown - 1) / (up * grown - down)
    else:
        grown, variance = 1.0, 2 * up * HOURS
        ended = up * HOURS / (1 + up * HOURS)
    what = f"1,000 lineages, p = {p:g}"
    moments(compare, f"{what}: stem cells", stems, grown, variance)
    low, high = stats.binom.interval(0.9995, LINEAGES, ended)
    near = min(LINEAGES * ended - low, high - LINEAGES * ended)
    compare.value(f"{what}: without stem cells", LINEAGES * ended, int((stems == 0).sum()), near)
    progeny = by_founder(run, (run.cells.kind == 1) & ~run.cells.dead)
    mean = 2 * (1 - p) * V * (grown - np.exp(-D * HOURS)) / (rate + D)
    error = float(f"{ERRORS * progeny.std() / np.sqrt(LINEAGES):.2g}")
    compare.value(f"{what}: progeny, mean", mean, progeny.mean(), error)


def test_asymmetric_divisions_keep_stem_cells(compare):
    """Of each division one stem cell with the chance a, else two: a Yule process of v (1 - a)."""
    chance = 0.7
    one = {"cells": "stem", "behaviour": "asymmetric division to progeny", "law": "constant",
           "largest": chance}  # fmt: skip
    run = lineages([one])
    stems = by_founder(run, run.cells.kind == 0)
    grown = np.exp(V * (1 - chance) * HOURS)
    moments(compare, "1,000 lineages of asymmetric divisions, a = 0.7: stem cells", stems, grown,
            grown * (grown - 1))  # fmt: skip
    assert stems.min() >= 1
