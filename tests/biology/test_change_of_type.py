"""Columns of a cell that becomes another type: as one that was born so, and back again."""

import math
from dataclasses import fields

import numpy as np
import pytest
from running import finished

import multicell as mc
from multicell.biology.division import change_types
from multicell.biology.exposure import Exposure
from multicell.biology.plan import biology_plan
from multicell.biology.step import bind_changed, divide_and_remove
from multicell.cells import HAZARDS, Cells, Phase
from multicell.scene.parts import CellType
from multicell.schema import specs
from multicell.simulation import Simulation

HOUR = 3600.0
GAMMA = {"distribution": "gamma", "variation": 0.4}
CYCLES = {
    "volume": {"law": "exponential"},
    "phases": {"phases": {p: {"duration": h * HOUR, **GAMMA} for p, h in
                          zip(("G1", "S", "G2", "M"), (9, 7, 4, 1), strict=True)}},
    "no growth": None,
}  # fmt: skip
CYCLES["rate"] = {**CYCLES["phases"], "law": "relaxation", "parameters": {"target": 1.2},
                  "volume_doubling_time": 9 * HOUR}  # fmt: skip

# the columns of a cell: what its type scales or sets, and what is its own
OF_TYPE = {
    "kind", "young", "cycle_time", "progress", "phase_length", "lag", "receptor", "ligand",
}  # fmt: skip
OWN = {
    "id", "parent", "position", "radius", "poisson", "state", "age", "pressure", "phase", "doomed",
    "damage",
}  # fmt: skip

ALIKE = {"receptor": 1.0, "ligand": 1.0, "surface_energy": {"a": 0.1, "b": 0.1}}
# the keys of a type, with a value that differs from what types are alike in
KEYS = {
    "fraction": None,  # of the cells at the start
    "young": 3.0,
    "surface_energy": {"a": 0.1, "b": 0.3},
    "adhesion_with": {"b": 3.0},
    "receptor": 2.0,
    "ligand": 2.0,
    "cycle_scale": 0.3,
    "volume_doubling_time": 3.0 * HOUR,
    "uptake_scale": 3.0,
    "secretion_scale": 3.0,
    "uptake_of": {"oxygen": 0.1},
    "secretion_of": {"signal": 0.1},
    "quiescence_of": {"oxygen": 1e3},
    "necrosis_of": {"oxygen": 1e3},
    "division_radius_scale": 1.5,
    "motility_scale": 4.0,
    "diffusion_scale": 3.0,
    "chemotaxis_of": {"signal": -0.5},
}


# what some of them scale
MOVED = {
    "diffusion_scale": {"motility": {"force": 0.2, "persistence": 600.0, "diffusion": 1e-3}},
    "chemotaxis_of": {"chemotaxis": {"signal": {"force": 0.2, "half": 1e-6}}},
    **{
        f"{key}_of": {
            "nutrients": {"oxygen": {"boundary": 0.1, "spacing": 10.0, key: 1e-3}},
            "cells": {"reaction_time": 60.0},
        }
        for key in ("quiescence", "necrosis")
    },
}


def scene(cycle="phases", b=None, changes=True, **rest):
    """Return cells of type a, which all become b in a step where ``changes`` says so."""
    alike = dict(ALIKE)
    if "adhesion_with" in (b or {}):  # the other way to say it, of the same energy for all
        del alike["surface_energy"]
    given = {
        "duration": "1 h", "coupling_step": "1 min", "seed": 4,
        "initial": {"count": 12, "spacing": 0.8, "stage": "uniform"},
        "cells": {"young_variation": 0.2}, "contact": {"law": "jkr", "surface_energy": 0.1},
        "adhesion": {"strength": 0.05}, "motility": {"force": 0.2, "persistence": 600.0},
        "nutrients": {
            "oxygen": {"boundary": 0.1, "spacing": 10.0},
            "signal": {"boundary": 0.0, "uptake": 0.0, "secretion": 50.0, "spacing": 10.0},
        },
        "types": {"a": {"fraction": 1, **alike}, "b": {"fraction": 0, **alike, **(b or {})}},
        **rest,
    }  # fmt: skip
    if CYCLES[cycle] is not None:
        given["growth"] = {"restriction": False, **CYCLES[cycle]}
    if changes:
        to_b = {"behaviour": "change to b", "law": "constant", "largest": 1.0, "cells": "a"}
        given["responses"] = [to_b]
    return mc.Scene.from_dict(given)


def born(described, kind):
    """Return the cells at the start of a scene if all are of one type."""
    fractions = {f"types.{name}.fraction": float(name == kind) for name in described.types}
    return Simulation(described.with_changes(fractions), threads=1).cells


def become(described, cells, kind):
    """Return cells that have become another type."""
    response = {"behaviour": f"change to {kind}", "law": "constant", "largest": 1.0}
    plan = biology_plan(described.with_changes({"responses": [response]}))
    after = change_types(plan, cells, Exposure(cells, {}, 1e6))
    return bind_changed(plan, cells, after, {}, 0.0)


B = {"young": 2.5, "cycle_scale": 0.3, "receptor": [[0.0, 5.0]], "ligand": [[0.0, 0.0]]}


def of_b(cycle):
    """Return the keys of type b, with one that only a rate of growth allows."""
    return {**B, **({"volume_doubling_time": 3.0 * HOUR} if cycle == "rate" else {})}


def test_each_column_and_each_key_of_a_type_is_classified():
    """A new column or key must say here what becomes of it, and how it is tested."""
    # hazards are those of a cell and event: a change begins the next one
    # what networks hold is begun anew or dropped by themselves: tests/networks/test_inside.py
    assert {*OF_TYPE, *OWN, *HAZARDS, "inside"} == {column.name for column in fields(Cells)}
    assert set(KEYS) == set(specs(CellType))


@pytest.mark.parametrize("cycle", CYCLES)
def test_a_changed_cell_is_as_one_that_was_born_so(cycle):
    described = scene(cycle, of_b(cycle), changes=False)
    first, wanted = born(described, "a"), born(described, "b")
    after = become(described, first, "b")
    for name in OF_TYPE:
        mine, theirs = getattr(after, name), getattr(wanted, name)
        np.testing.assert_allclose(mine, theirs, rtol=1e-12, err_msg=name)
    for name in OWN:
        np.testing.assert_array_equal(getattr(after, name), getattr(first, name), err_msg=name)
    # all that is of the type differs here where it can
    for name in OF_TYPE - {"lag"}:
        differs = getattr(after, name) != getattr(first, name)
        none = name in ("progress", "phase_length") and cycle not in ("phases", "rate")
        none |= name == "cycle_time" and cycle == "no growth"
        assert differs.all() != none, name


@pytest.mark.parametrize("scale", [0.01, 0.7, 1e12])
@pytest.mark.parametrize("cycle", CYCLES)
def test_a_cell_that_comes_back_is_the_same(cycle, scale):
    described = scene(cycle, {**of_b(cycle), "cycle_scale": scale}, changes=False)
    first = born(described, "a")
    first.lag = np.linspace(-60.0, 60.0, len(first))
    now = first
    for _ in range(50):
        now = become(described, become(described, now, "b"), "a")
    for name, column in first.columns():
        np.testing.assert_allclose(getattr(now, name), column, rtol=1e-13, err_msg=name)


@pytest.mark.parametrize("key", [key for key, value in KEYS.items() if value is not None])
def test_each_key_of_a_type_acts_on_a_cell_that_has_become_it(key):
    """Two steps, the change in the first: a key of the new type makes the second another one."""

    def after(b):
        cycle = {"cycle_scale": "volume", "volume_doubling_time": "rate"}.get(key, "phases")
        run = Simulation(scene(cycle, b, **MOVED.get(key, {})), threads=1)
        run.step()
        assert (run.cells.kind == 1).all()
        frame = run.frame()
        run.step()
        # nothing of the old type is left anywhere but in the state that a frame holds
        again = Simulation(run.scene, frame=frame, threads=1)
        again.step()
        found = [dict(r.frame().cells.columns()) | dict(r.concentrations) for r in (run, again)]
        for name, column in found[0].items():
            np.testing.assert_array_equal(column, found[1][name], err_msg=name)
        return found[0]

    plain, keyed = after({}), after({key: KEYS[key]})
    assert any(not np.array_equal(plain[name], keyed[name]) for name in plain)


def test_daughters_of_another_type_have_all_of_theirs():
    """Mothers at the end of M, each of whose daughters becomes b: what is scaled is scaled once."""
    described = scene("phases", B, changes=False)
    mothers = born(described, "a")
    mothers.phase[:] = Phase.M
    mothers.progress = mothers.phase_length + 7.0
    response = {"behaviour": "mutation to b", "law": "constant", "largest": 1.0}
    plan = biology_plan(described.with_changes({"responses": [response]}))
    daughters = divide_and_remove(plan, mothers, 12, 60.0, 60.0).cells
    assert len(daughters) == 24
    alike = divide_and_remove(biology_plan(described), mothers, 12, 60.0, 60.0).cells
    for name, ratio in (("phase_length", 0.3), ("cycle_time", 0.3), ("young", 2.5)):
        expected = ratio * getattr(alike, name)
        np.testing.assert_allclose(getattr(daughters, name), expected, rtol=1e-12, err_msg=name)
    np.testing.assert_allclose(daughters.progress, 7.0, rtol=1e-9)  # since the division, in s
    assert (daughters.receptor == 5.0).all()
    assert (daughters.ligand == 0.0).all()


def waiting(kind, other, scale):
    """Return 50 cells of one type that become another at once; they divide at 0.0005/min."""
    instant = {"duration": "1 s"}
    phases = {"G1": {"duration": "2000 min", "distribution": "gamma", "variation": 1},
              "S": instant, "G2": instant, "M": instant}  # fmt: skip
    return {
        "duration": "24 h", "coupling_step": "6 min",
        "initial": {"count": 50, "spacing": 5, "stage": "asynchronous"},
        "growth": {"restriction": False, "phases": phases},
        "types": {kind: {"fraction": 1, "cycle_scale": scale}, other: {"fraction": 0}},
        "responses": [{"cells": kind, "behaviour": f"change to {other}", "law": "constant",
                       "largest": "1 1/min"}],
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "scale"), [("resting", 1e6), ("hasty", 0.1)])
def test_cells_that_change_divide_at_the_rate_of_their_new_type(kind, scale):
    """They leave the phase at k = 0.0005/min whatever they were: 50 e^(kt) cells, a Yule process.

    Its standard deviation is that of a sum of 50 geometric numbers.
    """
    grown = math.exp(0.0005 * 24 * 60)
    mean, spread = 50.0 * grown, math.sqrt(50.0 * grown * (grown - 1.0))
    given = waiting(kind, "dividing", scale)
    numbers = [len(finished(mc.Scene.from_dict({**given, "seed": n})).cells) for n in range(4)]
    # hasty ones are in a stage of cycles of 200 min, and leave it within the first minutes
    assert abs(np.mean(numbers) - mean) < 3.5 * spread / 2.0
