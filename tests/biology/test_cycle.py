"""The cell cycle in phases, death by the clock, and the adhesion programme."""

import numpy as np
import pytest
from running import refused, within
from scipy import stats

import multicell as mc
from multicell.biology.cycle import advance_cycle, enter_cycle
from multicell.biology.division import divide
from multicell.biology.draws import draw_lengths, quantile
from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.cells import Phase, State
from multicell.scene.parts import PhaseLength
from multicell.scene.scene import Scene
from multicell.scene.sizes import birth_volume

HOUR = 3600.0
FIXED = {
    "G1": {"duration": "6 h"},
    "S": {"duration": "5 h"},
    "G2": {"duration": "3 h"},
    "M": {"duration": "1 h", "grows": False},
}


def scene(**changes):
    entries = {
        "duration": "1 d",
        "initial": {"count": 1},
        "cells": {"young_variation": 0.0},
        "contact": {"law": "hertz"},
        "growth": {"phases": FIXED},
    }
    return Scene.from_dict(entries).with_changes({k.replace("__", "."): v for k, v in
                                                  changes.items()})  # fmt: skip


def cells_of(described, count, stage="birth"):
    described = described.with_changes({"initial.count": count, "initial.stage": stage})
    return initial_cells(described)


def lived(described, cells, hours, dt):
    """Let cells go through their cycle without mechanics; return them and their number in time."""
    counts, next_id = [len(cells)], int(cells.id.max()) + 1
    for _ in range(round(hours * HOUR / dt)):
        n = len(cells)
        now = advance_cycle(biology_plan(described), cells, np.ones(n), np.zeros(n, bool), dt)
        cells = cells.take(np.arange(n))
        cells.radius = np.cbrt(now.volume / (4 / 3 * np.pi))
        cells.state, cells.phase = now.state, now.phase
        cells.progress, cells.phase_length = now.progress, now.phase_length
        cells, next_id = divide(biology_plan(described), cells, next_id, dt)
        counts.append(len(cells))
    return cells, np.array(counts)


@pytest.mark.parametrize("dt", [600.0, 7 * 600.0, 4 * HOUR])
def test_a_fixed_cycle_doubles_volume_and_number_whatever_the_step(dt):
    described = scene()
    start = cells_of(described, 3)
    cells, _ = lived(described, start, 28, dt)
    assert len(cells) == 6
    # 28 h are one cycle and 13 h: the daughters have grown through G1 and S, and 2 h of G2
    assert (cells.phase == Phase.G2).all()
    np.testing.assert_allclose(cells.progress, 2 * HOUR, rtol=1e-9)
    birth = birth_volume(described)
    np.testing.assert_allclose(cells.volume, birth * (1 + 13 / 14), rtol=1e-9)


@pytest.mark.parametrize("dt", [60.0, 600.0, 4 * HOUR])
def test_a_first_phase_shorter_than_a_step_loses_no_time(dt):
    """G1 lasts 3 min here: the rest of the step belongs to S."""
    phases = {"G1": {"duration": "3 min", "grows": False}, "S": {"duration": "8 h"},
              "G2": {"duration": "4 h"}, "M": {"duration": "2 h"}}  # fmt: skip
    described = scene(**{"growth.phases": phases, "growth.restriction": False})
    cells, _ = lived(described, cells_of(described, 3), 20, dt)
    assert len(cells) == 6
    # one cycle of 14 h 3 min, and then G1 and 5 h 54 min of S
    assert (cells.phase == Phase.S).all()
    np.testing.assert_allclose(cells.progress, 5.9 * HOUR, rtol=1e-9)
    birth = birth_volume(described)
    np.testing.assert_allclose(cells.volume, birth * (1 + 5.9 / 14), rtol=1e-9)


def check_phase_fractions(described, order, hours):
    """Compare phases at the start and 20 h later with those of steady growth."""
    cells = cells_of(described, 20000, "asynchronous")
    ends = np.cumsum([0, *hours]) / 15
    expected = 2.0 * (2.0 ** -ends[:-1] - 2.0 ** -ends[1:])
    for population in (cells, lived(described, cells, 20, 1800.0)[0]):
        found = np.bincount(population.phase, minlength=len(Phase)) / len(population)
        np.testing.assert_allclose(found[order], expected, atol=4 * 0.5 / np.sqrt(20000))
        assert found[Phase.G0] == 0


def test_phase_fractions_are_those_of_the_age_distribution():
    check_phase_fractions(scene(), [Phase.G1, Phase.S, Phase.G2, Phase.M], [6, 5, 3, 1])


@pytest.mark.parametrize(
    ("phase", "law"),
    [
        ({"distribution": "gamma", "variation": 0.4}, stats.gamma(1 / 0.16, scale=0.16)),
        (
            {"distribution": "shifted-gamma", "variation": 0.2, "shift": 0.6},
            stats.gamma(4.0, loc=0.6, scale=0.1),
        ),
    ],
)
def test_durations_follow_their_distribution(phase, law):
    length = PhaseLength(duration=1000.0, **phase)
    u = np.linspace(0.001, 0.999, 999)
    np.testing.assert_allclose(quantile(length, u) / 1000.0, law.ppf(u), rtol=1e-9)
    described = scene(growth__phases={**FIXED, "S": {"duration": 1000.0, **phase}})
    drawn = (
        draw_lengths(biology_plan(described), np.arange(3000), np.zeros(3000, np.int16))[:, 1]
        / 1000.0
    )
    assert stats.kstest(drawn, law.cdf).pvalue > 0.01


def test_cells_that_find_too_little_rest_at_the_end_of_g1_only():
    described = scene(nutrients__oxygen={"quiescence": 0.02})
    cells = cells_of(described, 200, "asynchronous")
    n = len(cells)
    now = advance_cycle(
        biology_plan(described), cells, np.full(n, 0.5), np.ones(n, bool), 20 * HOUR
    )
    began = cells.phase == Phase.G1
    assert (now.phase[began] == Phase.G0).all()
    assert (now.state[began] == State.QUIESCENT).all()
    # the others went on, at half speed where they grow; those that got through M wait to divide
    assert (now.phase[~began] >= Phase.S).all()
    assert (now.state[~began] == State.PROLIFERATING).all()
    rich = advance_cycle(biology_plan(described), cells, np.ones(n), np.zeros(n, bool), 20 * HOUR)
    assert not (rich.phase == Phase.G0).any()


def test_rest_ends_in_s_when_conditions_are_good_again():
    """A whole run: the medium is poor for a day, then rich, and all cells go on."""
    described = scene(
        duration="40 h",
        initial__count=30,
        initial__stage="asynchronous",
        coupling_step="20 min",
        nutrients__oxygen={
            "boundary": 0.01, "media": [["24 h", 0.2]], "uptake": 1.0, "quiescence": 0.02,
        },
        output__every="4 h",
    )  # fmt: skip
    result = mc.run(described)
    poor, rich = result.frames[5].cells, result.frames[-1].cells
    assert (poor.state == State.QUIESCENT).all()
    assert (poor.phase == Phase.G0).all()
    assert not (rich.phase == Phase.G0).any()
    assert len(rich) > len(poor)


def test_daughters_inherit_what_is_heritable_and_draw_the_rest():
    described = scene(cells__young_variation=0.2, cells__heritable=["young"])
    mothers = cells_of(described, 50)
    mothers.phase[:] = Phase.M
    mothers.progress = mothers.phase_length + 60.0
    daughters, _ = divide(biology_plan(described), mothers, 100)
    np.testing.assert_array_equal(daughters.young, np.repeat(mothers.young, 2))
    np.testing.assert_allclose(daughters.progress, 60.0)
    assert (daughters.phase == Phase.G1).all()
    other = described.with_changes({"cells.heritable": []})
    drawn, _ = divide(biology_plan(other), mothers, 100)
    assert (drawn.young != daughters.young).all()


def test_types_have_cycles_of_their_own():
    described = scene(types__fast={"cycle_scale": 0.5}, types__slow={"cycle_scale": 2.0})
    cells = cells_of(described, 10)
    enter_cycle(biology_plan(described), cells, np.zeros(10))
    np.testing.assert_allclose(cells.phase_length, np.where(cells.kind == 0, 3 * HOUR, 12 * HOUR))


STARVED = {
    "contact": {"law": "hertz"}, "coupling_step": HOUR,
    "nutrients": {"oxygen": {"boundary": 0.01, "uptake": 0.0, "necrosis": 0.02}},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("dt", [HOUR, 5 * HOUR])
def test_necrosis_may_be_a_rate(dt):
    """Where all starve survivors fall as exp(-kt) at any step; at once where no rate is given."""
    rate, hours = 2e-5, 30
    described = Scene.from_dict(
        {**STARVED, "duration": f"{hours} h", "coupling_step": dt, "output": {"every": "30 h"},
         "initial": {"count": 3000, "spacing": 3.0},
         "death": {"necrosis_rate": rate, "lysis_time": "2 h"}}
    )  # fmt: skip
    result = mc.run(described)
    summary, table = result.summary(), result.lineage
    assert result.frames[0].cells.state.max() == State.PROLIFERATING
    assert within(summary["states"]["proliferating"], 3000, np.exp(-rate * hours * HOUR))
    assert (table["end"] == "necrotic").sum() == summary["removals"] > 0
    died = table["death_time"][np.isfinite(table["death_time"])]
    law = stats.truncexpon(b=rate * hours * HOUR, scale=1 / rate)
    assert stats.kstest(died, law.cdf).statistic < 0.03  # not only at the ends of steps
    cells = result.frames[-1].cells
    since = hours * HOUR - cells.age[cells.dead]
    assert np.abs(since[:, None] - died).min(axis=1).max() < 1e-6
    at_once = mc.Simulation(described.with_changes({"death.necrosis_rate": None}))
    assert (at_once.cells.state == State.NECROTIC).all()


@pytest.mark.parametrize("dt", [0.25 * HOUR, HOUR, 7 * HOUR])
def test_necrotic_cells_swell_and_burst_in_closed_form(dt):
    described = Scene.from_dict(
        {**STARVED, "duration": "14 h", "coupling_step": dt, "initial": {"count": 1},
         "death": {"swelling": 2.0, "swelling_time": "5 h", "lysis_time": "6 h"}}
    )  # fmt: skip
    simulation = mc.Simulation(described)
    start = float(simulation.cells.volume[0])
    while not simulation.finished:
        simulation.step()
        since = simulation.time / HOUR
        exact = 2.0 ** min(since / 5.0, 1.0) * np.exp(-max(since - 5.0, 0.0) / 6.0)
        assert simulation.cells.volume[0] == pytest.approx(start * exact, rel=1e-12)
        lost = start - simulation.cells.volume[0]
        assert simulation.released == pytest.approx(lost, rel=1e-9)


@pytest.mark.parametrize("death", [{}, {"death.swelling": 2.0, "death.necrosis_rate": "1e-4 1/s"}])
def test_volume_grown_and_released_close_the_account(death):
    described = mc.load_scene("spheroid").with_changes(
        {"duration": "20 h", "initial.count": 80, "initial.stage": "uniform",
         "nutrients.oxygen.boundary": "0.02 mM", "nutrients.oxygen.necrosis": "0.0135 mM",
         "death.swelling_time": "2 h",
         "death.lysis_time": "3 h", "death.apoptosis_rate": "5e-6 1/s", **death}
    )  # fmt: skip
    simulation = mc.Simulation(described)
    start, grown = simulation.cells.volume.sum(), 0.0
    birth = 2.0 / 3.0 * np.pi * described.cells.division_radius**3
    half, critical = (described.nutrients["oxygen"].growth_half_saturation,
                      described.growth.critical_pressure)  # fmt: skip
    while not simulation.finished:
        cells = simulation.cells
        growing = cells.state == State.PROLIFERATING
        oxygen, pressure = simulation.concentrations["oxygen"], np.maximum(cells.pressure, 0.0)
        speed = oxygen / (oxygen + half) * np.maximum(1.0 - pressure / critical, 0.0)
        # half of what earlier steps have left out is made good
        speed += np.clip(0.5 * cells.lag / described.coupling_step, -speed, speed)
        gain = speed * birth * described.coupling_step / cells.cycle_time
        grown += gain[growing].sum()
        before, first = {int(c): k for k, c in enumerate(cells.id)}, simulation.next_id
        simulation.step()
        born = simulation.cells.take(simulation.cells.id >= first)
        mother = np.array([before[int(p)] for p in born.parent], dtype=int)
        # a half of what she gained beyond the division volume, and what her daughter gained since
        beyond = (cells.volume + gain)[mother] - 2.0 * birth
        since = beyond * cells.cycle_time[mother] / born.cycle_time
        grown += (since - 0.5 * beyond).sum()
        # until it was its own a daughter is half of her mother: who dies or rests within the step
        # has not grown beyond that time
        known = {int(c): (cells.volume[k], cells.volume[k] + gain[k] * growing[k], cells.state[k])
                 for k, c in enumerate(cells.id)}  # fmt: skip
        known |= {int(c): (0.5 * cells.volume[m], birth + more, State.PROLIFERATING)
                  for c, m, more in zip(born.id, mother, since, strict=True)}  # fmt: skip
        now = simulation.cells
        for c, state, age in zip(now.id, now.state, now.age, strict=True):
            first, last, was = known[int(c)]
            dies = state > State.QUIESCENT and was <= State.QUIESCENT
            rests = state == State.QUIESCENT and int(c) in set(born.id)
            if dies or rests:
                grown -= (last - first) * age / described.coupling_step
    assert simulation.released > 0
    balance = start + grown - simulation.released
    assert simulation.cells.volume.sum() == pytest.approx(balance, rel=1e-10)


ADHESIVE = {
    "adhesion": {"strength": 0.1},
    "types": {
        "own": {
            "receptor": 2.0,
            "ligand": [[0.0, 1.0], ["10 h", 0.0]],
        }
    },
    "nutrients": {"oxygen": {"boundary": 0.01, "uptake": 0.001}},
    "responses": {
        "sticking": {
            "behaviour": "receptors", "signal": "oxygen", "cells": "own", "law": "table",
            "points": [["0 mM", 0.0], ["0.02 mM", 1.0]],
        }
    },
}  # fmt: skip


def test_receptors_follow_concentration_linearly_over_a_step():
    described = scene(**ADHESIVE, initial__count=40, initial__stage="asynchronous")
    simulation = mc.Simulation(described)
    for _ in range(3):
        cells, time = simulation.cells, simulation.time
        oxygen = simulation.concentrations["oxygen"]
        expected = dict(zip(cells.id.tolist(), 2.0 * oxygen / 0.02, strict=True))
        motion = simulation._motion(time, time + 600.0, cells.radius)
        np.testing.assert_array_equal(motion.bonds[:, 0], cells.receptor)
        ends = motion.bonds[:, 0] + 600.0 * motion.bonds[:, 2]
        np.testing.assert_allclose(ends, list(expected.values()), rtol=1e-12)
        simulation.step()
        for cell, receptor in zip(simulation.cells.id, simulation.cells.receptor, strict=True):
            if cell in expected:
                assert receptor == pytest.approx(expected[cell], rel=1e-12)
    np.testing.assert_allclose(simulation.cells.ligand, 1.0 - simulation.time / (10 * HOUR))


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        ({"growth.phases": {"G1": {"duration": "6 h"}}}, "growth.phases.S", "is missing"),
        ({"growth.phases.G3": {"duration": "6 h"}}, "growth.phases.G3", "not a known name"),
        (
            {f"growth.phases.{name}.grows": False for name in FIXED},
            "growth.phases",
            "no phase in which cells grow",
        ),
    ],
)
def test_bad_input(changes, path, words):
    with refused(path, words):
        scene().with_changes(changes)
