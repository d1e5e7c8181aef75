"""Rates by contact: epidemics on small graphs of fixed cells, against their master equation."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm

import multicell as mc
from multicell.biology.encounters import with_encounters
from multicell.simulation import coupling_step

BETA, GAMMA, TIME, STEP = 0.5, 0.2, 3.0, 60.0  # per step, per step, steps, s
COPIES = 1500
GRAPHS = {
    "pair": [(0.0, 0.0), (1.0, 0.0)],
    "chain": [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0)],
    "complete": [(0.0, 0.0), (0.9, 0.0), (0.9, 0.9), (0.0, 0.9)],
}
APART = 9.5  # µm, between neighbours of radius 5; diagonals of the square touch as well


def graph(name):
    """Return the places of cells of a graph, µm, and who touches whom."""
    place = APART * np.array(GRAPHS[name]) * (0.7 if name == "complete" else 1.0)
    far = np.hypot(*(place[:, None] - place).T)
    return place, (far < 10.0) & (far > 0.0)


def expected(name, gamma):
    """Return the mean numbers of susceptible, infected and recovered cells at the end.

    By the matrix exponential of the master equation over all states of the graph.
    """
    _, touch = graph(name)
    states = list(product(range(3), repeat=len(touch)))
    number = {state: k for k, state in enumerate(states)}
    rates = np.zeros((len(states), len(states)))
    for state, k in number.items():
        ill = np.array(state) == 1
        for cell, now in enumerate(state):
            rate = {0: BETA * (touch[cell] & ill).sum(), 1: gamma}.get(now, 0.0)
            if rate:
                after = number[(*state[:cell], now + 1, *state[cell + 1 :])]
                rates[after, k] += rate
                rates[k, k] -= rate
    chance = expm(TIME * rates)[:, number[(1, *(0,) * (len(touch) - 1))]]
    return np.array([chance @ [state.count(kind) for state in states] for kind in range(3)])


def copies(name):
    """Return the columns of a table of many graphs far from each other, the first cell infected."""
    place, _ = graph(name)
    corner = np.stack(np.divmod(np.arange(COPIES), 50), axis=1) * 60.0
    x, y = (corner[:, None] + place).reshape(-1, 2).T
    ill = np.arange(len(x)) % len(place) == 0
    return {"x_um": x, "y_um": y, "radius_um": np.full(len(x), 5.0), "ill": ill}


def scene(step, responses, **parts):
    return mc.Scene.from_dict({
        "duration": TIME * STEP, "coupling_step": step * STEP, "dimensions": 2, "seed": 3,
        "contact": {"law": "none"}, "cells": {"division_radius": 5.0 * 2 ** (1 / 3)},
        "responses": responses, **parts,
    })  # fmt: skip


def by_contact(behaviour, signal, cells):
    return {"cells": cells, "behaviour": behaviour, "signal": signal, "law": "linear",
            "begin": 0, "end": 20, "base": 0, "largest": 20 * BETA / STEP}  # fmt: skip


def epidemic(name, step, gamma):
    """Return the types of cells at the end, by identity."""
    catch = by_contact("change to infected", "contacts with infected", "susceptible")
    heal = {"cells": "infected", "behaviour": "change to recovered", "law": "constant",
            "largest": gamma / STEP}  # fmt: skip
    cells = copies(name)
    cells["type"] = np.where(cells.pop("ill"), "infected", "susceptible")
    types = {"susceptible": {}, "infected": {"fraction": 0}, "recovered": {"fraction": 0}}
    made = scene(step, [catch, heal] if gamma else [catch], types=types)
    end = mc.run(made, cells=cells, report=False, threads=1).frames[-1].cells
    return end.kind[np.argsort(end.id)]


@pytest.mark.parametrize("gamma", [0.0, GAMMA])
@pytest.mark.parametrize("name", GRAPHS)
def test_an_epidemic_is_that_of_its_master_equation_at_any_step(name, gamma):
    """Who catches it within a step passes it on from that moment; all steps infect the same."""
    ends = {step: epidemic(name, step, gamma) for step in (1.0, 0.25)}
    wanted = expected(name, gamma)
    per_graph = (ends[1.0].reshape(COPIES, -1, 1) == np.arange(3)).sum(axis=1)
    spread = per_graph.std(axis=0) / math.sqrt(COPIES)
    assert np.all(np.abs(per_graph.mean(axis=0) - wanted) <= 3.0 * spread + 1e-12)
    np.testing.assert_array_equal(ends[1.0], ends[0.25])


@pytest.mark.parametrize("behaviour", ["apoptosis rate", "necrosis rate", "damage rate"])
def test_deaths_by_contact_follow_from_each_other_within_a_step(behaviour):
    """Each dead neighbour kills; who is dead at the start begins it."""
    harm = by_contact(behaviour, "dead neighbours", "target")
    ends = []
    for step in (1.5, 0.25):
        cells = copies("chain")
        cells["type"] = np.where(cells["ill"], "source", "target")
        cells["state"] = np.where(cells.pop("ill"), "necrotic", "proliferating")
        made = scene(step, [harm], types={"source": {"fraction": 0}, "target": {}},
                     death={"lysis_time": "1e5 h", "apoptosis_time": "1e5 h"})  # fmt: skip
        end = mc.run(made, cells=cells, report=False, threads=1).frames[-1].cells
        ends.append(end.dead[np.argsort(end.id)])
    np.testing.assert_array_equal(*ends)
    dead = ends[0].reshape(COPIES, -1).sum(axis=1)
    if behaviour == "damage rate":  # who has had one dead neighbour for 2 steps, in turn
        assert set(dead) == {2}
    else:
        spread = dead.std() / math.sqrt(COPIES)
        assert abs(dead.mean() - expected("chain", 0.0)[1]) < 3.0 * spread


def lively(seed):
    """Return a run of cells that move, divide, die and change by contact."""
    per_hour = 1.0 / 3600.0
    rate = {"signal": "contacts with b", "law": "linear", "begin": 0, "end": 10, "base": 0,
            "largest": 4 * per_hour}  # fmt: skip
    responses = [
        {**rate, "behaviour": "change to b", "cells": "a"},
        {**rate, "behaviour": "change to a", "cells": "b", "signal": "neighbours"},
        {**rate, "behaviour": "apoptosis rate", "signal": "dead neighbours"},
    ]  # fmt: skip
    return mc.Simulation(mc.Scene.from_dict({
        "duration": "6 h", "coupling_step": "30 min", "dimensions": 2, "seed": seed,
        "initial": {"count": 60, "spacing": 0.9}, "motility": {"force": 0.5, "persistence": 600.0},
        "growth": {"cycle_time": "5 h"}, "types": {"a": {}, "b": {"fraction": 0.3}},
        "death": {"apoptosis_rate": "0.05 1/h", "apoptosis_time": "2 h"}, "responses": responses,
    }), threads=1)  # fmt: skip


def test_what_neighbours_do_in_a_step_leads_to_the_signals_at_its_end(monkeypatch):
    seen, jumped = [], 0

    def watched(*given):
        found = with_encounters(*given)
        seen.append(found[0])
        return found

    monkeypatch.setattr(coupling_step, "with_encounters", watched)
    run = lively(1)
    while not run.finished:
        run.step()
        exposure, signals = seen[-1], run.signals
        if exposure.jumps is None:
            continue
        jumped += 1
        kept = exposure.cells.rows_of(run.cells.id)
        for name in ("neighbours", "dead neighbours", "contacts with b"):
            first, last = exposure.before[name][exposure.row], exposure.signals[name]
            course = np.array([
                first + part * (last - first) + exposure.jumps.sizes(name, part, part)
                for part in np.linspace(0.0, 1.0, 41)
            ])  # fmt: skip
            assert course.min() > -1e-9, name
            np.testing.assert_allclose(course[-1][kept], signals[name], atol=1e-9, err_msg=name)
    assert jumped > 6


def test_daughters_and_their_neighbours_count_each_other_from_birth_on():
    run = lively(2)
    born = 0
    while not run.finished:
        before = run.cells.id.max()
        run.step()
        cells = run.cells
        new = np.flatnonzero((cells.id > before) & ~cells.dead)
        if not new.size:
            continue
        born += new.size
        far = np.linalg.norm(cells.position[:, None] - cells.position[new], axis=-1)
        near = far < cells.radius[:, None] + cells.radius[new]
        near[new, np.arange(new.size)] = False
        living = (near & ~cells.dead[:, None]).sum(axis=0)
        np.testing.assert_array_equal(run.signals["neighbours"][new], living)
    assert born > 20
