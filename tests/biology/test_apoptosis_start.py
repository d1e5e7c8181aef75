"""Random death from the start of a run: survivors are N exp(-kt) whatever the cells' ages."""

from __future__ import annotations

import numpy as np
import pytest
from running import finished, within
from scipy import stats

from multicell.biology.initial import initial_cells
from multicell.cells import State
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

HOUR = 3600.0


def described(stage="asynchronous", phases=False, step=HOUR, count=4000, rate=1e-5, cycle=1e8):
    """Return cells far apart; with the usual cycle (s) they are very old and hardly divide."""
    parts = {"G1": 0.4, "S": 0.3, "G2": 0.2, "M": 0.1}
    growth = {"cycle_time": cycle}
    if phases:
        variation = {"distribution": "gamma", "variation": 0.4}
        growth = {"phases": {n: {"duration": p * cycle, **variation} for n, p in parts.items()}}
    return Scene.from_dict(
        {"duration": "20 h", "coupling_step": step, "seed": 1,
         "initial": {"count": count, "spacing": 4.0, "stage": stage},
         "contact": {"law": "hertz"}, "growth": growth, "output": {"every": "20 h"},
         "death": {"apoptosis_rate": rate, "apoptosis_time": "1000 h"}}
    )  # fmt: skip


def alive(simulation):
    """Return the number of living cells."""
    return int(np.isin(simulation.cells.state, (State.PROLIFERATING, State.QUIESCENT)).sum())


@pytest.mark.parametrize(
    ("stage", "phases"), [("birth", False), ("uniform", True), ("asynchronous", False)]
)
def test_survivors_fall_exponentially_from_the_start(stage, phases):
    scene = described(stage, phases)
    simulation = Simulation(scene)
    assert alive(simulation) == 4000
    assert (simulation.cells.age.max() > 1e7) == (stage != "birth")
    while not simulation.finished:
        simulation.step()
        if simulation.step_index in (1, 5, 10, 20):
            chance = np.exp(-scene.death.apoptosis_rate * simulation.time)
            assert within(alive(simulation), 4000 + simulation.divisions, chance)
    assert simulation.divisions < 5


def test_cells_born_in_the_run_die_at_the_same_rate_as_those_of_the_start():
    """Deaths are a Poisson process in the time that all cells have lived together."""
    scene = described("uniform", cycle=30 * HOUR)
    simulation = finished(scene)
    table = simulation.lineage.table()
    died = np.isfinite(table["death_time"])
    end = np.where(died, table["death_time"], simulation.time)
    end = np.where(table["end"] == "division", table["end_time"], end)
    lived = end - table["birth_time"]
    # a death is not noticed in the step of a division; daughters have lived since that, half a step
    # on average before they are entered
    lived[table["end"] == "division"] -= scene.coupling_step
    lived[table["parent"] >= 0] += 0.5 * scene.coupling_step
    assert simulation.divisions > 1000
    for mine in (table["parent"] == -1, table["parent"] >= 0):
        low, high = stats.poisson.interval(0.9999, scene.death.apoptosis_rate * lived[mine].sum())
        assert low <= died[mine].sum() <= high


def test_who_dies_when_does_not_depend_on_the_coupling_step():
    """Each life is drawn once, and ends within a step of any length."""
    step = 10 * HOUR
    fine, coarse = (described(step=dt, count=500, rate=2e-5) for dt in (600.0, step))
    deaths = []
    for scene in (fine, coarse):
        simulation = finished(scene.with_changes({"growth": None}))
        deaths.append(simulation.lineage.table()["death_time"])
    np.testing.assert_allclose(deaths[1], deaths[0], rtol=1e-12)
    assert np.isfinite(deaths[0]).sum() > 50


def test_cells_handed_in_do_not_pay_for_their_age():
    """Those of an older run, with parents, too; what they lived before the start is forgotten."""
    scene = described(count=3000).with_changes({"growth": None})
    cells = initial_cells(scene)
    cells.age[:] = 1e7
    cells.parent[:] = np.arange(len(cells))
    simulation = Simulation(scene, cells=cells)
    assert alive(simulation) == 3000
    finished(simulation)
    assert within(alive(simulation), 3000, np.exp(-scene.death.apoptosis_rate * simulation.time))
