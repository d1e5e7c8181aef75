"""Survival of radiation: the linear-quadratic model, and oxygen by Alper & Howard-Flanders."""

import numpy as np
import pytest
from scipy import stats

from multicell.cells import State
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

SUBJECT, SOURCE = "biology", "alper1956"
COURSE = {"dose": "2 Gy", "start": 0.0, "alpha": "0.3 1/Gy", "beta": "0.03 1/Gy^2"}


def described(count, course, **parts):
    """Return cells so far apart that they never touch."""
    return Scene.from_dict({
        "duration": "10 h", "coupling_step": "1 h", "seed": 5, "contact": {"law": "hertz"},
        "initial": {"count": count, "spacing": 4.0},
        "radiation": {"course": {**COURSE, **course}}, **parts,
    })  # fmt: skip


def clonogens(simulation):
    return int(simulation.history_row()["clonogens"])


def compare_counts(compare, what, count, trials, chance):
    """Compare a binomial count with its mean: the narrower side of 99.99 %, or half a cell."""
    low, high = stats.binom.interval(0.9999, trials, chance)
    mean = trials * chance
    compare.value(what, mean, count, max(min(mean - low, high - mean), 0.5), "cells")


@pytest.mark.parametrize(("dose", "beta"), [(0.0, 0.05), (2.0, 0.0), (2.0, 0.05), (6.0, 0.05)])
def test_survivors_are_those_of_the_linear_quadratic_model(dose, beta, compare):
    simulation = Simulation(described(20000, {"dose": dose, "beta": beta}))
    chance = np.exp(-0.3 * dose - beta * dose**2)
    what = f"20,000 cells after {dose:g} Gy, α = 0.3, β = {beta:g}: survivors"
    compare_counts(compare, what, clonogens(simulation), 20000, chance)
    dead = simulation.cells.state == State.APOPTOTIC
    assert dead.sum() == 20000 - clonogens(simulation)
    died = simulation.lineage.rows("deaths", 0)
    np.testing.assert_array_equal(died["id"], np.sort(simulation.cells.id[dead]))
    assert (died["time"] == 0.0).all()


@pytest.mark.parametrize("pressure", [0.3, 3.0, 60.0])
def test_cells_without_oxygen_survive_by_alper_and_howard_flanders(pressure, compare):
    """In a field that is the same everywhere, given as a partial pressure in mmHg."""
    field = {"boundary": f"{pressure} mmHg", "uptake": 0.0, "spacing": 10.0}
    course = {"dose": "4 Gy", "oxygen": "oxygen", "oer": 2.8, "half_oxygen": "2.5 mmHg"}
    scene = described(4000, course, initial={"count": 4000}, nutrients={"oxygen": field})
    ratio = (2.8 * pressure + 2.5) / (pressure + 2.5)
    dose = 4.0 * ratio / 2.8
    chance = np.exp(-0.3 * dose - 0.03 * dose**2)
    law, kpa = scene.radiation["course"], pressure * 0.133322387415
    assert law.survival(kpa) == pytest.approx(chance, rel=1e-12)
    assert law.survival() < law.survival(kpa) < law.survival(0.0)
    what = f"4,000 cells after 4 Gy at {pressure:g} mmHg of oxygen: survivors"
    compare_counts(compare, what, clonogens(Simulation(scene)), 4000, chance)
