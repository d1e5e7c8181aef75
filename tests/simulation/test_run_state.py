"""The state of a run is a value: stored whole, not written to, and open to a user's own writes."""

from dataclasses import dataclass, field, fields, replace
from functools import cache, partial

import numpy as np
import pytest

import multicell as mc
import multicell.simulation.coupling_step as coupling_step
from multicell.biology.growth import growth_factor
from multicell.cells import HAZARDS, Cells, Phase, State
from multicell.nutrient.field import Solution
from multicell.nutrient.fields import FieldsState, FieldSystem
from multicell.results.frame import Progress
from multicell.results.lineage import LINEAGE_COLUMNS, Lineage
from multicell.results.records import arrays_of, frame_of, log_arrays
from multicell.simulation import Simulation
from multicell.simulation.run_state import RunState

HOUR = 3600.0
ALIKE = {"surface_energy": {"a": 0.1, "b": 0.1}, "ligand": 1.0}
DRUGGED = {"signal": "drug", "law": "hill", "half": 0.5}


@mc.network(states={"A": 1.0}, inputs={"source": 0.0}, parameters={"k": 2e-4})
def relax(t, y, u, p, out):
    """Relaxation towards an input."""
    out[0] = p[0] * (u[0] - y[0])


SCENE = mc.Scene.from_dict(
    {
        "duration": "2 d", "coupling_step": "20 min", "seed": 5,
        "initial": {"count": 30, "spacing": 0.85, "stage": "asynchronous"},
        "cells": {"young_variation": 0.2, "reaction_time": "1 h"},
        "growth": {"phases": {p: {"duration": h * HOUR, "distribution": "gamma", "variation": 0.4}
                              for p, h in zip(("G1", "S", "G2", "M"), (5, 4, 2, 1), strict=True)}},
        "death": {"lysis_time": "2 h", "damage_time": "30 h", "apoptosis_rate": "1e-6 1/s"},
        "adhesion": {"strength": 0.05}, "motility": {"force": 0.2, "persistence": 600.0},
        "radiation": {"course": {"dose": "2 Gy", "alpha": 0.3, "beta": 0.03,
                                 "mitotic_divisions": 2, "times": ["1.5 h"]}},
        "types": {"a": {**ALIKE, "receptor": [[0, 1], ["9 h", 3]]},
                  "b": {**ALIKE, "receptor": 2.0}},
        "networks": {"relax": {"network": relax, "inputs": {"source": "oxygen"},
                               "parameters": {"k": {"mean": 2e-4, "variation": 0.3}}}},
        "motions": {"m": {"cells": [0, 1], "velocity": ["1 nm/s", 0, 0]}},
        "nutrients": {
            "oxygen": {"boundary": 0.05, "quiescence": 0.03, "growth_half_saturation": 0.02},
            "drug": {"boundary": 1.0, "regime": "transient", "finite_medium": {"volume": 1e8}},
        },
        "responses": [
            {"behaviour": "growth rate", "signal": "pressure", "law": "hill", "half": "0.2 kPa",
             "falls": True},
            {"behaviour": "change to b", **DRUGGED, "largest": 3e-5},
            {"behaviour": "necrosis rate", **DRUGGED, "largest": 3e-6},
            {"behaviour": "apoptosis rate", **DRUGGED, "largest": 3e-6},
            {**DRUGGED, "behaviour": "damage rate", "signal": "neighbours", "half": 9,
             "largest": 3e-6},
        ],
    }
)  # fmt: skip
"""A scene in which every column of the cells changes and every part has a state."""

GEL = mc.load_scene("confined").with_changes({"initial.count": 8})
SCENES = {"parts": SCENE, "gel": GEL, "pull": mc.load_scene("doublet")}


@cache
def after(steps, name="parts"):
    """Return the state and the frame of a run after some steps."""
    simulation = Simulation(SCENES[name], threads=1)
    for _ in range(steps):
        simulation.step()
    return simulation.state, simulation.frame()


def at(steps, name="parts"):
    """Return a run at a state, with machinery that has not seen another one."""
    state, frame = after(steps, name)
    return Simulation(SCENES[name], threads=1, frame=frame, lineage=state.lineage)


def plain(value):
    """Return a value as nested tuples of bytes and numbers, which can be compared."""
    if isinstance(value, Cells):
        return plain(dict(value.columns()))
    if isinstance(value, Lineage):
        return plain(value.logs)
    if isinstance(value, Solution):
        return plain((value.field("x"), value.medium))
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, value.tobytes()
    if isinstance(value, dict):
        return tuple((key, plain(value[key])) for key in sorted(value))
    if isinstance(value, tuple | list):
        return tuple(plain(entry) for entry in value)
    return plain(vars(value)) if hasattr(value, "__dict__") else value


def parts(state):
    """Return the parts of a state by name; entries of the fields' state by their own names."""
    found = {f.name: getattr(state, f.name) for f in fields(state) if f.name != "fields"}
    found |= state.fields._asdict() | {"timeline": (state.timeline.step_index, state.timeline.time)}
    return {name: plain(value) for name, value in found.items()}


def stored(kind):
    """Return where each field of a state is stored."""
    return {f.name: f.metadata["stored"] for f in fields(kind)}


def test_every_field_of_the_state_is_stored_or_declared_derived():
    places = stored(RunState)
    assert set(places.values()) <= {"frame", "logs", "progress", "derived"}
    assert [name for name, place in places.items() if place == "derived"] == ["growth"]
    entries = {f.metadata["entry"] or f.name for f in fields(RunState) if "entry" in f.metadata}
    of_fields = FieldsState({}, {}, {}, {}, {}, {}).progress().keys()
    assert entries | of_fields == {f.name for f in fields(Progress)}


def test_a_field_that_says_nothing_is_found():
    @dataclass(frozen=True)
    class Later:
        known: int = field(metadata={"stored": "frame"})
        forgotten: int = 0

    with pytest.raises(KeyError, match="stored"):
        stored(Later)


@pytest.mark.parametrize("name", SCENES)
def test_a_file_gives_back_the_whole_state(name):
    """All that is not derived, bit by bit, after frame and logs were written and read."""
    state, frame = after(9, name)
    written = frame_of(arrays_of(frame, SCENES[name].nutrients), SCENES[name].nutrients)
    logs = log_arrays(state.lineage, dict.fromkeys(LINEAGE_COLUMNS, 0))
    resumed = Simulation(SCENES[name], threads=1, frame=written, lineage=Lineage.of(logs))
    expected, found = parts(state), parts(resumed.state)
    del expected["growth"], found["growth"], expected["taken"], found["taken"]
    assert found == expected


def test_the_scene_has_all_that_a_state_can_hold():
    """Else the tests here would hold for what is not there."""
    state, _ = after(9)
    alike = {name for name, column in state.cells.columns() if len(np.unique(column)) == 1}
    assert alike <= {"poisson", "ligand"}
    assert all(getattr(state.cells, name) is not None for name in HAZARDS)
    assert state.divisions > 0
    assert state.named["motions.m"].size == 2
    assert state.exposures["error"] != 0.0
    assert state.growth is not None
    assert state.lineage.counts()["deaths"] > 0
    assert after(9, "gel")[0].cavity > GEL.domain.radius


@pytest.mark.parametrize("name", SCENES)
def test_what_is_derived_changes_no_bit_where_it_is_left_out(name):
    simulation = at(6, name)
    simulation.step()
    state = simulation.state
    simulation.step()
    expected = parts(simulation.state)
    simulation.state = replace(state, growth=None, fields=state.fields._replace(taken={}))
    simulation.step()
    assert parts(simulation.state) == expected


@pytest.mark.parametrize("name", SCENES)
def test_a_step_writes_into_nothing_of_the_state_before_it(name):
    simulation = Simulation(SCENES[name], threads=1)
    states, seen = [], []
    for _ in range(9):
        states.append(simulation.state)
        seen.append(parts(simulation.state))
        simulation.step()
        simulation.history_row()
        simulation.summary()
        simulation.energy()
        assert [parts(state) for state in states] == seen


@pytest.mark.parametrize("name", SCENES)
def test_an_earlier_state_is_returned_to_by_an_assignment(name):
    """Along another way as well, and back to a state of the first one."""
    simulation = Simulation(SCENES[name], threads=1)
    states = [simulation.state]
    for _ in range(8):
        simulation.step()
        states.append(simulation.state)
    seen = [parts(state) for state in states]
    simulation.state = states[2]
    simulation.cells.position[:] *= 1.2
    for _ in range(6):
        simulation.step()
    assert parts(simulation.state) != seen[8]
    simulation.state = states[5]
    simulation.step()
    assert parts(simulation.state) == seen[6]
    assert [parts(state) for state in states] == seen


STEP_FUNCTIONS = (
    "grow", "age_cells", "divide_and_remove", "decide", "irradiate", "mutate_as_found",
    "change_types", "bind_changed", "lag_after", "growth_factor", "remainders", "sorted_in_space",
)  # fmt: skip


def test_no_function_of_biology_changes_what_it_is_given(monkeypatch):
    called = set()

    def watched(name, function, *given, **named):
        cells = [value for value in (*given, *named.values()) if isinstance(value, Cells)]
        before = [plain(value) for value in cells]
        found = function(*given, **named)
        assert [plain(value) for value in cells] == before, name
        called.add(name)
        return found

    for name in STEP_FUNCTIONS:
        function = getattr(coupling_step, name)
        monkeypatch.setattr(coupling_step, name, partial(watched, name, function))
    simulation = Simulation(SCENE, threads=1)
    for _ in range(9):
        simulation.step()
    assert called == set(STEP_FUNCTIONS)


def changed_in_a_step(owners, step):
    """Return which attributes of objects are others after a step, or hold something else."""

    def seen(value):
        if isinstance(value, dict):
            return tuple((key, seen(value[key])) for key in sorted(value, key=str))
        if isinstance(value, list | tuple | set):
            return len(value), tuple(map(seen, value))
        return value.tobytes() if isinstance(value, np.ndarray) else (id(value), repr(value)[:200])

    before = [{name: seen(value) for name, value in vars(owner).items()} for owner in owners]
    step()
    changed = {}
    for owner, old in zip(owners, before, strict=True):
        kind = changed.setdefault(type(owner).__name__, set())
        kind |= {name for name, value in vars(owner).items() if seen(value) != old.get(name)}
    return changed


HELD = {
    "Simulation": {"_state", "_draft"},
    "Machinery": {"wall"},
    "Mover": set(),
    # all but courses, which belong to a step, the time and the tissue, which is made anew for other
    # cells, stand in FieldsState
    "FieldSystem": {
        "_tissue",
        "ledger",
        "concentrations",
        "reports",
        "courses",
        "time",
        "_changes",
        "_uptake",
    },
    # all of these stand in Solution
    "NutrientField": {"_layout", "values", "_conditions", "well_mixed"},
}


def owners_of(simulation):
    system = simulation.field_system
    return [simulation, simulation._run, simulation.mover, system, *system.fields.values()]


def test_all_that_a_step_changes_belongs_to_the_state():
    simulation = at(3)
    for _ in range(5):
        changed = changed_in_a_step(owners_of(simulation), simulation.step)
        assert {name: set() for name in changed} | changed == changed
        for name, attributes in changed.items():
            assert attributes <= HELD[name], name


def test_an_attribute_that_the_state_does_not_know_is_found(monkeypatch):
    advance = FieldSystem.advance

    def noting(system, *given, **named):
        system.noted = getattr(system, "noted", 0) + 1
        return advance(system, *given, **named)

    monkeypatch.setattr(FieldSystem, "advance", noting)
    simulation = at(3)
    simulation.step()
    changed = changed_in_a_step(owners_of(simulation), simulation.step)
    assert changed["FieldSystem"] - HELD["FieldSystem"] == {"noted"}


# ---- what users write -------------------------------------------------------------------------


def rewritten(name, column):
    """Return other values for a column of the cells, which a run can have."""
    if name == "id":
        return column[::-1].copy()
    if name == "state":
        return np.where(column == State.PROLIFERATING, State.QUIESCENT, column).astype(column.dtype)
    if name == "phase":
        return np.full_like(column, Phase.G2)
    if name in ("kind", "doomed"):
        return (column + 1) % 2
    if name in ("parent", "type_changes"):
        return column + 1
    if name == "pressure":
        return column + 0.05
    return column * 1.03 + 0.001


def in_place(simulation, name, values):
    getattr(simulation.cells, name)[...] = values


def by_name(simulation, name, values):
    cells = simulation.cells
    assert len(cells) == len(values)
    getattr(cells, name)[...] = values


def assigned(simulation, name, values):
    setattr(simulation.cells, name, values)


def all_anew(simulation, name, values):
    simulation.cells = simulation.cells.changed(**{name: values})


WAYS = {"in place": in_place, "by a name": by_name, "assigned": assigned, "all anew": all_anew}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("column", Cells.schema())
def test_what_is_written_into_cells_counts_at_once(column, way):
    """As in a run that is resumed from a frame with these cells."""
    simulation, (_, frame) = at(7), after(7)
    simulation.history_row()
    values = rewritten(column, getattr(frame.cells, column))
    WAYS[way](simulation, column, values)
    np.testing.assert_array_equal(getattr(simulation.frame().cells, column), values)
    cells, rows = frame.cells.changed(**{column: values}), slice(None)
    if column == "id":  # who is where has changed, and with them what they find
        rows = frame.cells.rows_of(values)
    found = {name: level[rows] for name, level in frame.concentrations.items()}
    changed = replace(frame, cells=cells, concentrations=found)
    expected = Simulation(SCENE, threads=1, frame=changed, lineage=after(7)[0].lineage)
    simulation.step()
    expected.step()
    assert parts(simulation.state) == parts(expected.state)


def test_a_write_after_a_step_has_been_looked_at_is_not_lost():
    """A growth factor that was found at the end of a step counts no more."""
    simulation = at(6)
    simulation.step()
    cells = simulation.cells
    assert simulation.state.growth is not None
    cells.pressure += 0.3
    assert simulation.state.growth is None
    simulation.step()
    untouched = at(6)
    untouched.step()
    untouched.step()
    assert plain(simulation.cells) != plain(untouched.cells)


def test_cells_of_an_earlier_step_are_left_behind():
    simulation, untouched = at(6), at(6)
    cells = simulation.cells
    simulation.step()
    for _, column in cells.columns():
        column[...] = 1
    simulation.step()
    untouched.step()
    untouched.step()
    assert parts(simulation.state) == parts(untouched.state)


def test_reading_the_cells_changes_nothing():
    simulation, untouched = at(6), at(6)
    for _ in range(3):
        assert simulation.cells.volume.sum() > 0.0
        assert simulation.cells is simulation.cells
        state = simulation.state
        assert simulation.state is state
        simulation.step()
        untouched.step()
    assert parts(simulation.state) == parts(untouched.state)


def test_cells_survive_a_step_that_fails_and_can_be_written_then(monkeypatch):
    simulation = at(6)
    cells = simulation.cells
    cells.kind[:] = 1
    with monkeypatch.context() as patch:
        patch.setattr(coupling_step, "lag_after", lambda *_: (_ for _ in ()).throw(MemoryError))
        with pytest.raises(MemoryError):
            simulation.step()
    assert simulation.cells is cells
    cells.kind[:] = 0
    assert not simulation.frame().cells.kind.any()


def test_cells_can_be_taken_out_and_put_in_another_order():
    simulation = at(6)
    state, rows = simulation.state, np.arange(len(simulation.cells))[::-1][4:]
    simulation.cells = simulation.cells.take(rows)
    after_it = simulation.state
    for name, found in state.fields.concentrations.items():
        np.testing.assert_array_equal(after_it.fields.concentrations[name], found[rows])
    assert after_it.removals == state.removals + 4
    table = simulation.lineage.table()
    gone = set(state.cells.id) - set(after_it.cells.id)
    assert set(table["id"][table["end_time"] == simulation.time]) == gone
    assert np.isin(after_it.contacts, after_it.cells.id).all()
    for _ in range(3):
        simulation.step()
    assert len(simulation.cells) > 0


def twice(cells):
    cells.id = np.full(len(cells), cells.id[0])


def foreign(cells):
    cells.id[0] = 10**6


def short(cells):
    cells.state = cells.state[:-1]


@pytest.mark.parametrize(
    ("write", "words"),
    [(twice, "none of them twice"), (foreign, "run's own cells"), (short, "cells.state has shape")],
)
def test_cells_that_are_none_of_the_run_are_refused(write, words):
    simulation = at(6)
    write(simulation.cells)
    with pytest.raises(ValueError, match=words):
        simulation.step()
    assert simulation.step_index == 6


def test_growth_is_that_of_its_state():
    state, _ = after(9)
    simulation = at(9)
    expected = growth_factor(simulation.plan, simulation.signals, state.cells.pressure, state.cells)
    np.testing.assert_array_equal(state.growth, expected)


@pytest.mark.parametrize(
    ("column", "value"),
    [("radius", -4.0), ("radius", np.nan), ("position", np.inf), ("young", 0.0),
     ("state", 77), ("kind", 1), ("kind", -1)],
)  # fmt: skip
def test_a_value_that_no_cell_can_have_is_refused(column, value):
    simulation = mc.Simulation(mc.load_scene("growth").with_changes({"duration": "1 h"}))
    before = simulation.state
    getattr(simulation.cells, column)[0] = value
    with pytest.raises(ValueError, match=rf"cells\.{column}\[0\] is .* must be"):
        simulation.step()
    simulation.state = before
    simulation.step()
    assert simulation.time == before.timeline.time + simulation.scene.coupling_step


@pytest.mark.parametrize(
    ("name", "words"), [("radios", "no column 'radios'; did you mean 'radius'"), ("x", "no column")]
)
def test_a_column_that_cells_do_not_have_is_refused(name, words):
    run = mc.Simulation(mc.load_scene("growth").with_changes({"initial.count": 2}), threads=1)
    with pytest.raises(AttributeError, match=words):
        setattr(run.cells, name, np.ones(2))
    with pytest.raises(AttributeError, match="volume"):
        run.cells.volume = np.ones(2)
    assert not hasattr(run.cells, name)
