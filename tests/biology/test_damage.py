"""Damage that cells accumulate: closed forms of survival, daughters, files, words."""

import numpy as np
import pytest
from running import refused
from scipy import integrate, stats

import multicell as mc
from multicell import Scene, SceneError, Simulation
from multicell.biology.plan import biology_plan
from multicell.biology.responding import rate_of_harm
from multicell.cells import State
from multicell.errors import DataError
from multicell.units import to_base

HOUR = 3600.0
COUNT = 3000


def starving(death, *, count=COUNT, dt="1 h", oxygen=0.01, **more):
    """Return cells at rest in a constant field below their threshold."""
    field = {"boundary": oxygen, "uptake": 0.0, "necrosis": 0.02}
    return Scene.from_dict(
        {"contact": {"law": "hertz"}, "duration": "40 h", "coupling_step": dt, "seed": 4,
         "output": {"every": "40 h"}, "initial": {"count": count, "spacing": 3.0},
         "nutrients": {"oxygen": field}, "death": {"lysis_time": "100 d", **death}, **more}
    )  # fmt: skip


def deaths(scene):
    """Return the times of death, (n,) h, infinite for survivors."""
    times = mc.run(scene, threads=1).lineage["death_time"] / HOUR
    return np.where(np.isnan(times), np.inf, times)


@pytest.mark.slow
@pytest.mark.parametrize(("variation", "dt"), [(0.25, "15 min"), (0.7, "5 h"), (1.0, "1 h")])
def test_survival_is_that_of_the_tolerances(variation, dt):
    """In a constant field times of death are gamma variates of mean T."""
    death = {"damage_time": "20 h", "damage_variation": variation}
    found, step = deaths(starving(death, dt=dt)), to_base(dt, "s") / HOUR
    law = stats.gamma(a=variation**-2, scale=20.0 * variation**2)
    ends = np.arange(step, 40.0 + 0.5 * step, step)
    dead = np.array([(found <= end * (1 + 1e-9)).mean() for end in ends])
    expected = law.cdf(ends)
    allowed = 4.5 * np.sqrt(expected * (1.0 - expected) / COUNT) + 1e-3
    assert (np.abs(dead - expected) < allowed).all()


@pytest.mark.slow
def test_the_step_does_not_matter():
    """Each cell dies at the same time, whatever the length."""
    death = {"damage_time": "30 h", "damage_variation": 0.5}
    fine, coarse = (deaths(starving(death, count=300, dt=dt)) for dt in ("10 min", "4 h"))
    np.testing.assert_allclose(coarse, fine)
    assert 50 < np.isfinite(fine).sum() < 300


def test_all_die_together_without_variation():
    found = deaths(starving({"damage_time": "6 h"}, count=20, dt="10 min"))
    np.testing.assert_allclose(found, 6.0)


def test_damage_is_the_solution_of_its_equation():
    """A medium that comes and goes, not at ends of whole steps: as an outside solver has it."""
    death = {"damage_time": "8 h", "damage_variation": 0.4}
    media = [["0 h", 0.01], ["3.3 h", 0.2], ["9.05 h", 0.01], ["13 h", 0.2]]
    scene = starving(death, count=60).with_changes({"nutrients.oxygen.media": media})
    simulation = Simulation(scene, threads=1)
    twin = Simulation(scene, threads=1)
    for _ in range(2):
        twin.step()
    tolerance = 2.0 / 8.0 / twin.cells.damage  # of all who live for two hours
    alive, worst = tolerance > 0.6, 0.0
    order = np.argsort(twin.cells.id)

    def rate(t, damage):
        starved = 1.0 / 8.0 if (0.0 <= t < 3.3) or (9.05 <= t < 13.0) else 0.0
        return starved / tolerance[order][alive[order]]

    damage, begin = np.zeros(int(alive.sum())), 0.0
    while begin < 16.0:
        simulation.step()
        end = simulation.time / HOUR
        damage = integrate.solve_ivp(
            rate, (begin, end), damage, rtol=1e-10, atol=1e-12, max_step=0.5 * (end - begin)
        ).y[:, -1]  # fmt: skip
        begin, cells = end, simulation.cells
        found = cells.damage[np.argsort(cells.id)][alive[order]]
        living = damage < 1.0
        worst = max(worst, float(np.abs(found - damage)[living].max()))
        damage[~living] = found[~living]
    assert worst < 1e-8
    assert simulation.step_index == 18  # 3.3 and 9.05 h end steps of their own
    assert simulation.cells.damage.max() > 0.0


def test_daughters_have_the_damage_of_their_mother_and_tolerances_of_their_own():
    death = {"damage_time": "100 h", "damage_variation": 0.3}
    scene = starving(death, count=50, growth={"cycle_time": "10 h", "cycle_variation": 0.0})
    simulation = Simulation(scene.with_changes({"initial.stage": "birth"}), threads=1)
    while simulation.divisions < 50:
        before = simulation.cells
        simulation.step()
    born = simulation.cells.take(np.argsort(simulation.cells.id))
    done = simulation.step_index
    simulation.step()
    cells = simulation.cells.take(np.argsort(simulation.cells.id))
    gained = cells.damage - born.damage  # in a step, by the tolerance of each
    mothers = before.damage[before.rows_of(born.parent)]
    # until it was born by the tolerance of the mother
    share = born.age / HOUR
    expected = mothers + (1.0 - share) * mothers / (done - 1) + share * gained
    np.testing.assert_allclose(born.damage, expected, rtol=1e-9)
    assert len(np.unique(gained)) == 100


def test_responses_add_to_the_thresholds():
    """A waste product harms in proportion, besides a threshold and a constant rate."""
    responses = [
        {"behaviour": "damage rate", "signal": "waste", "law": "linear", "begin": 0, "end": 4.0,
         "largest": "0.1 1/h"},
        {"behaviour": "damage rate", "law": "constant", "largest": "0.02 1/h"},
    ]  # fmt: skip
    waste = {"nutrients.waste": {"boundary": 2.0, "uptake": 0.0}, "responses": responses}
    scene = starving({"damage_time": "20 h"}, count=5).with_changes(waste)
    simulation = Simulation(scene, threads=1)
    found = rate_of_harm(
        biology_plan(scene), "damage rate", simulation.concentrations, simulation.cells
    )
    np.testing.assert_allclose(found * HOUR, 0.05 + 0.02 + 0.05, rtol=1e-9)
    simulation.step()
    np.testing.assert_allclose(simulation.cells.damage, 0.12, rtol=1e-9)


def test_a_table_of_cells_keeps_their_damage():
    scene = starving({"damage_time": "10 h", "damage_variation": 0.5}, count=30, growth={})
    simulation = Simulation(scene, threads=1)
    simulation.step()
    last = simulation.frame().to_pandas()
    again = Simulation(scene, cells=last)
    found = again.cells.take(np.argsort(again.cells.id))
    assert found.damage.any()
    np.testing.assert_array_equal(found.damage, last.sort_values("id")["damage"])
    with pytest.raises(DataError, match="must not be negative"):
        Simulation(scene, cells=last.assign(damage=-0.5))


def test_nobody_is_dead_of_damage_at_the_start():
    scene = mc.load_scene("spheroid").with_changes(
        {"initial.count": 8000, "death.damage_time": "2 h", "duration": "4 h"}
    )
    simulation = Simulation(scene, threads=1)
    assert not simulation.cells.dead.any()
    while simulation.time < 1.99 * HOUR:
        simulation.step()
        if simulation.time < 1.9 * HOUR:
            assert not simulation.cells.dead.any()
    assert (simulation.cells.state == State.NECROTIC).sum() > 100


def test_bad_input():
    with refused("death.necrosis_rate", "contradicts"):
        starving({"damage_time": "1 h", "necrosis_rate": "1 1/h"}, count=1)
    threshold = {"behaviour": "damage rate", "signal": "oxygen", "law": "threshold", "half": 0.1}
    with pytest.raises(SceneError, match="largest"):
        starving({}, count=1, responses=[threshold])
