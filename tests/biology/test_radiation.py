"""Irradiation: who survives by the linear-quadratic model, who dies when, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from running import finished, refused, within

from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.biology.states import irradiate
from multicell.cells import Phase
from multicell.errors import DataError
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

HOUR = 3600.0
COURSE = {"dose": "2 Gy", "start": 0.0, "alpha": "0.3 1/Gy", "beta": "0.03 1/Gy^2"}


def described(count=4000, course=None, **parts):
    """Return cells so far apart that they never touch."""
    return Scene.from_dict({
        "duration": "10 h", "coupling_step": "1 h", "seed": 5, "contact": {"law": "hertz"},
        "initial": {"count": count, "spacing": 4.0},
        "radiation": {"course": {**COURSE, **(course or {})}},
        **parts,
    })  # fmt: skip


def growing(course=None, count=300, **parts):
    """Return cells that all divide after 8 h, 16 h, ..."""
    growth = {"cycle_time": "8 h", "cycle_variation": 0.0}
    course = {"dose": "3 Gy", **(course or {})}
    return described(count, course, growth=growth, **{"duration": "17 h", **parts})


def clonogens(simulation):
    return int(simulation.history_row()["clonogens"])


def test_fractions_without_growth_multiply():
    course = {"start": "90 min", "every": "2 h", "fractions": 3}
    simulation = Simulation(described(10000, course), threads=1)
    counts = [clonogens(simulation)]
    while not simulation.finished:
        simulation.step()
        counts.append(clonogens(simulation))
    # with fixed steps a fraction falls at the end of the step that holds its time
    # each fraction ends a step of its own: at 1, 1.5, 2, 3, 3.5 h ...
    assert [n for n in range(1, 14) if counts[n] < counts[n - 1]] == [2, 5, 8]
    chance = np.exp(-0.3 * 2.0 - 0.03 * 4.0)
    for step, fractions in ((1, 0), (2, 1), (5, 2), (13, 3)):
        assert within(counts[step], 10000, chance**fractions)
    times = described(10000, {"start": None, "times": ["1.5 h", "3.5 h", "5.5 h"]})
    assert times.radiation["course"].schedule == tuple(HOUR * np.array([1.5, 3.5, 5.5]))
    assert clonogens(finished(times)) == counts[-1]


@pytest.mark.parametrize("divisions", [1, 2])
def test_doomed_cells_die_in_place_of_a_division(divisions):
    scene = growing({"mitotic_divisions": divisions})
    simulation = Simulation(scene, threads=1)
    doomed = int(simulation.history_row()["doomed"])
    sound = 300 - doomed
    assert within(sound, 300, np.exp(-0.9 - 0.27))
    assert clonogens(simulation) == sound
    # (sound, doomed, dead) after each division: the doomed divide as often as they may before
    expected = {1: [(2 * sound, 0, doomed), (4 * sound, 0, doomed)],
                2: [(2 * sound, 2 * doomed, 0), (4 * sound, 0, 2 * doomed)]}[divisions]  # fmt: skip
    while not simulation.finished:
        simulation.step()
        alive = [(sound, doomed, 0), *expected][int(simulation.time // (8 * HOUR))]
        row = simulation.history_row()
        assert (row["clonogens"], row["doomed"], row["apoptotic"]) == alive
    died = simulation.lineage.rows("deaths", 0)
    assert set(died["time"]) == {8 * HOUR * divisions}


def test_the_sooner_death_counts():
    courses = {
        "a": {**COURSE, "dose": 50, "mitotic_divisions": 3},
        "b": {**COURSE, "dose": 50, "start": "2 h", "mitotic_divisions": 1},
        "c": {**COURSE, "dose": 50, "start": "4 h", "mitotic_divisions": 2},
    }
    simulation = Simulation(growing(count=5, radiation=courses), threads=1)
    found = []
    while not simulation.finished:
        found.append(set(simulation.cells.doomed.tolist()))
        simulation.step()
    assert found[:8] == [{3}, {3}, {1}, {1}, {1}, {1}, {1}, {1}]
    assert simulation.history_row()["apoptotic"] == 5
    assert simulation.divisions == 0


def test_survivors_do_not_depend_on_the_coupling_step():
    course = {"start": "100 min", "every": "61 min", "fractions": 2}
    runs = [finished(described(1000, course, coupling_step=dt, duration="4 h"))
            for dt in ("5 min", "31 min", "2 h")]  # fmt: skip
    dead = [set(run.cells.id[run.cells.dead].tolist()) for run in runs]
    assert dead[0] == dead[1] == dead[2]
    assert within(1000 - len(dead[0]), 1000, np.exp(-2 * 0.72))


def test_phases_and_types_differ_in_what_they_survive():
    phases = {name: {"duration": "5 h"} for name in ("G1", "S", "G2", "M")}
    course = {"phase_factor": {"S": 0.25, "M": 2.0}, "cells": "tumour"}
    scene = described(
        12000, course, growth={"phases": phases}, types={"tumour": {}, "normal": {}},
        initial={"count": 12000, "spacing": 4.0, "stage": "uniform"},
    )  # fmt: skip
    cells = Simulation(scene).cells
    assert not cells.dead[cells.kind == 1].any()
    for phase, factor in ((Phase.G1, 1.0), (Phase.S, 0.25), (Phase.G2, 1.0), (Phase.M, 2.0)):
        here = (cells.phase == phase) & (cells.kind == 0)
        alive = int((here & ~cells.dead).sum())
        assert within(alive, int(here.sum()), np.exp(-factor * (0.6 + 0.12)))


def test_the_order_of_cells_does_not_matter():
    scene = described(500, {"oxygen": "oxygen", "mitotic_divisions": 2}, growth={},
                      nutrients={"oxygen": {}})  # fmt: skip
    plan, cells = biology_plan(scene), initial_cells(scene)
    oxygen = np.linspace(0.0, 0.05, 500)
    order = np.random.default_rng(1).permutation(500)
    one, _ = irradiate(plan, cells, {"oxygen": oxygen}, -np.inf, 0.0)
    other, _ = irradiate(plan, cells.take(order), {"oxygen": oxygen[order]}, -np.inf, 0.0)
    np.testing.assert_array_equal(one.doomed[order], other.doomed)
    assert 0 < (one.doomed > 0).sum() < 500
    assert not cells.doomed.any()


def test_a_table_of_cells_keeps_how_often_they_may_divide():
    scene = growing({"start": "3 h", "mitotic_divisions": 2}, count=20)
    simulation = Simulation(scene, threads=1)
    while simulation.time < 10 * HOUR:
        simulation.step()
    start = simulation.frame().to_pandas()
    assert set(start["doomed"]) == {0, 1}
    again = Simulation(scene.with_changes({"radiation": None}), cells=start)
    np.testing.assert_array_equal(again.cells.doomed[np.argsort(again.cells.id)],
                                  start.sort_values("id")["doomed"])  # fmt: skip
    with pytest.raises(DataError, match=r"is 0\.5, must be a whole number from 0 to 100"):
        Simulation(scene, cells=start.assign(doomed=0.5))


@pytest.mark.parametrize(
    ("course", "path", "words"),
    [
        ({"start": None}, "start", "is missing"),
        ({"times": ["1 h"]}, "start", "has no effect: times say when"),
        ({"start": None, "times": ["-1 h", "1 h"]}, "times", "must be at least 0 s"),
        ({"start": None, "times": ["2 h", "1 h"]}, "times", "must have times that rise"),
        ({"start": None, "times": "1 h"}, "times", "must be a list of times"),
        ({"start": None, "times": [1.0], "fractions": 2}, "fractions", "has no effect"),
        ({"dose": "100 Gy"}, "dose", "at most 50 Gy"),
        ({"alpha": 0.0, "beta": 0.0}, "alpha", "no cell would die"),
        ({"oxygen": "oxigen"}, "oxygen", "not a field of this scene. Did you mean 'oxygen'"),
        ({"cells": "b, a"}, "cells", "names 'b', which is no type"),
        ({"phase_factor": {"S": 0.5}}, "phase_factor", "the scene has no phases"),
        ({"phase_factor": {"s": 0.5}}, "phase_factor.s", "is not a phase of the cycle"),
        ({"mitotic_divisions": 1}, "mitotic_divisions", "without [growth] no cell divides"),
        ({"doses": "2 Gy"}, "doses", "Did you mean 'dose'"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(course, path, words):
    with refused(f"radiation.course.{path}", words):
        described(3, course, nutrients={"oxygen": {}}, types={"a": {}})
