"""Networks in the cells of a scene: inputs, division, neighbours, signals, frames and resuming."""

from __future__ import annotations

import math
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from network_models import WRITTEN

import multicell as mc
from multicell.biology.inside import _binomial
from multicell.biology.responding import _weighted
from multicell.errors import SceneError, StepFailed
from multicell.networks.custom import network

LINE = {"duration": "3 h", "initial.count": 4, "initial.stage": "uniform", "output.every": "1 h",
        "growth.cycle_time": "6 h"}  # fmt: skip
STILL = {"duration": "2 h", "initial.count": 2, "growth": None, "output.every": "1 h"}


@network(states={"A": 1.0}, inputs={"source": 0.0}, parameters={"k": 2e-4})
def relax(t, y, u, p, out):
    """Relaxation towards an input."""
    out[0] = p[0] * (u[0] - y[0])


@network(states={"M": 8.0, "C": 2.0}, parameters={"made": 1e-3}, amounts=("M",))
def made(t, y, u, p, out):
    """An amount that is made at a constant rate, and a concentration that nothing changes."""
    out[0] = p[0]
    out[1] = 0.0


def _run(changes, name="growth", **networks):
    scene = mc.load_scene(name).with_changes({**changes, "networks": networks})
    simulation = mc.Simulation(scene, threads=1)
    while not simulation.finished:
        simulation.step()
    return simulation


def _column(simulation, name):
    return simulation.cells.inside[:, simulation.plan.networks.columns.index(name)]


def test_an_input_that_rises_in_time_gives_the_closed_form():
    own = {"network": relax, "inputs": {"source": "time"}, "tolerance": 1e-8}
    for step in ("10 min", "40 min"):
        simulation = _run({**STILL, "coupling_step": step}, relax=own)
        k, end = 2e-4, 7200.0
        want = end - 1.0 / k + (1.0 + 1.0 / k) * math.exp(-k * end)
        np.testing.assert_allclose(_column(simulation, "relax.A"), want, rtol=1e-6)


def test_amounts_are_halved_when_the_cell_divides_and_not_at_the_end_of_the_step():
    simulation = _run({**LINE, "coupling_step": "50 min"}, made={"network": made})
    cells = simulation.cells
    born = cells.parent >= 0
    assert born.sum() >= 2
    before = simulation.time - cells.age[born]
    np.testing.assert_allclose(
        _column(simulation, "made.M")[born], 0.5 * (8.0 + 1e-3 * before) + 1e-3 * cells.age[born],
        rtol=1e-9,
    )  # fmt: skip
    np.testing.assert_allclose(_column(simulation, "made.M")[~born], 8.0 + 1e-3 * simulation.time)


def test_a_concentration_falls_as_the_cell_grows_unless_it_must_not():
    first = _run({**LINE, "duration": "0 h 1 s"}, made={"network": made})
    simulation = _run({**LINE, "duration": "40 min"}, made={"network": made, "tolerance": 1e-8})
    cells = simulation.cells
    same = first.cells.rows_of(cells.id)
    alive = same >= 0
    ratio = first.cells.volume[same[alive]] / cells.volume[alive]
    assert (ratio < 0.95).any()
    np.testing.assert_allclose(_column(simulation, "made.C")[alive], 2.0 * ratio, rtol=2e-4)
    simulation = _run(LINE, made={"network": made, "dilution": False})
    assert (_column(simulation, "made.C") == 2.0).all()


@pytest.mark.parametrize(("rule", "state", "factor"), [
    ("keep", "M", 1.0), ("halve", "M", 0.5), ("reset", "C", None), ("keep", "C", 1.0),
])  # fmt: skip
def test_rules_of_division(rule, state, factor):
    own = {"network": made, "divide": {state: rule}, "dilution": False}
    simulation = _run({**LINE, "coupling_step": "50 min"}, made=own)
    cells = simulation.cells
    born = cells.parent >= 0
    at = {"M": 8.0 + 1e-3 * (simulation.time - cells.age[born]), "C": 2.0}[state]
    want = {"M": 8.0, "C": 2.0}[state] if factor is None else factor * at
    want = want + (1e-3 * cells.age[born] if state == "M" else 0.0)
    np.testing.assert_allclose(_column(simulation, f"made.{state}")[born], want, rtol=1e-9)


@pytest.mark.parametrize("rule", ["binomial", "share"])
def test_what_chance_divides_is_kept_in_sum(rule):
    own = {"network": made, "parameters": {"made": 0.0}, "divide": {"M": rule}}
    simulation = _run({**LINE, "initial.count": 12}, made=own)
    cells, amount = simulation.cells, _column(simulation, "made.M")
    born = cells.parent >= 0
    assert len(np.unique(amount[born])) > 1
    assert amount.sum() == pytest.approx(12 * 8.0, rel=1e-12)
    if rule == "binomial":
        assert (amount == np.round(amount)).all()


def test_molecules_are_divided_with_the_variance_of_a_fair_coin():
    rng, count = np.random.default_rng(3), 20000
    for total in (1.0, 7.0, 400.0):
        z = rng.uniform(size=count)
        first = _binomial(np.full(count, total), z, np.zeros(count, bool))
        second = _binomial(np.full(count, total), z, np.ones(count, bool))
        assert (first + second == total).all()
        assert first.min() >= 0.0
        assert first.mean() == pytest.approx(0.5 * total, abs=4.0 * math.sqrt(total / 4 / count))
        assert first.var() == pytest.approx(0.25 * total, rel=0.05)


@network(states={"A": 1.0}, inputs={"around": 0.0}, parameters={"k": 2e-4, "self": 1.0})
def exchanged(t, y, u, p, out):
    """Exchange with the neighbours."""
    out[0] = p[0] * (u[0] - p[1] * y[0])


def test_neighbours_are_solved_with_order_two():
    # two equal cells that touch: y' = k (other - 2 y) = -k y
    errors, steps = [], (600.0, 300.0, 150.0, 75.0)
    for step in steps:
        changes = {**STILL, "coupling_step": step, "initial.spacing": 0.9}
        own = {"network": exchanged, "inputs": {"around": "neighbours.pair.A"}, "tolerance": 1e-10,
               "parameters": {"self": 2.0}}  # fmt: skip
        simulation = _run(changes, pair=own)
        found = _column(simulation, "pair.A")
        want = math.exp(-2e-4 * simulation.time)
        errors.append(abs(found[0] - want))
        assert found[0] == found[1]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.15)


def test_a_cell_without_neighbours_finds_none_and_the_sum_counts_them():
    own = {"network": exchanged, "inputs": {"around": "sum of neighbours.pair.A"}}
    lonely = _run({**STILL, "initial.count": 1}, pair=own)
    want = math.exp(-2e-4 * 7200.0)
    assert _column(lonely, "pair.A")[0] == pytest.approx(want, rel=1e-3)
    row = _run(
        {
            **STILL,
            "initial.count": 3,
            "initial.shape": "row",
            "initial.spacing": 0.9,
            "duration": "1 s",
        },
        pair=own,
    )
    around = np.sort(_column(row, "pair.~input around"))
    np.testing.assert_allclose(around, [1.0, 1.0, 2.0], rtol=1e-3)


def test_neighbours_count_by_the_area_of_their_contact_where_asked():
    # radii 6, 5, 4 in a row; contacts of overlap 1 and 0.5: A = π h R r / (R + r)
    names = [
        f"{word}neighbours.pair.A" for word in ("", "sum of ", "weighted ", "weighted sum of ")
    ]
    table = {"network": exchanged, "inputs": {"around": names[0]}}
    count = {"initial.count": 3, "initial.shape": "row"}
    scene = mc.load_scene("growth").with_changes({**STILL, **count, "networks": {"pair": table}})
    simulation = mc.Simulation(scene, threads=1)
    cells, networks = simulation.cells, simulation.plan.networks
    cells.position[:] = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [18.5, 0.0, 0.0]]
    cells.radius[:] = [6.0, 5.0, 4.0]
    cells.inside[:, networks.columns.index("pair.A")] = values = np.array([2.0, 3.0, 7.0])
    contacts = np.array([[cells.id[0], cells.id[1]], [cells.id[1], cells.id[2]]])
    pairs = partial(_weighted, cells, None, contacts)
    found = networks.signals(names, cells, 0.0, pairs)
    one, other = np.pi * 1.0 * 30.0 / 11.0, np.pi * 0.5 * 20.0 / 9.0
    total = np.array([one * values[1], one * 2.0 + other * 7.0, other * values[1]])
    np.testing.assert_allclose(found[names[0]], [3.0, 4.5, 3.0])
    np.testing.assert_allclose(found[names[1]], [3.0, 9.0, 3.0])
    np.testing.assert_allclose(found[names[2]], total / [one, one + other, other])
    np.testing.assert_allclose(found[names[3]], total)


def test_an_input_may_be_weighted_and_other_names_are_refused():
    own = {"network": exchanged, "inputs": {"around": "weighted neighbours.pair.A"}}
    row = _run({**STILL, "initial.spacing": 0.9, "duration": "1 s"}, pair=own)
    np.testing.assert_allclose(_column(row, "pair.~input around"), 1.0, rtol=1e-3)
    own["inputs"] = {"around": "weighted pair.A"}
    with pytest.raises(SceneError, match="no signal here"):
        _run(STILL, pair=own)


def test_what_is_wrong_with_a_network_is_said_of_that_one(tmp_path):
    (tmp_path / "hif.ant").write_text(WRITTEN)
    networks = {
        "first": {"network": exchanged, "inputs": {"around": "hif.HIF"}},
        "hif": {"file": str(tmp_path / "hif.ant"), "inputs": {"O3": "time"}},
    }
    with pytest.raises(SceneError, match=r"^networks\.hif\.file: .*'O3'.*'O2'"):
        mc.load_scene("growth").with_changes({**STILL, "networks": networks})


def test_drawn_parameters_are_those_of_the_cell():
    own = {"network": relax, "parameters": {"k": {"mean": 2e-4, "variation": 0.3}}}
    scene = mc.load_scene("growth").with_changes({**LINE, "networks": {"relax": own}})
    part = mc.Simulation(scene, threads=1).plan.networks.parts["relax"]
    ids = np.arange(20000)
    drawn = part.values(ids)[:, 0]
    assert drawn.mean() == pytest.approx(2e-4, rel=0.01)
    assert drawn.std() == pytest.approx(0.3 * 2e-4, rel=0.03)
    assert (part.values(ids[::-1])[::-1, 0] == drawn).all()
    simulation = _run(LINE, relax=own)
    want = np.exp(-part.values(simulation.cells.id)[:, 0] * simulation.time)
    old = simulation.cells.parent < 0
    growth = _run(LINE, relax={**own, "dilution": False})
    np.testing.assert_allclose(_column(growth, "relax.A")[old], want[old], rtol=1e-3)


def test_only_cells_of_its_types_have_a_network():
    changes = {**STILL, "initial.count": 20, "types": {"a": {}, "b": {}}}
    simulation = _run(changes, relax={"network": relax, "cells": "b"})
    values = _column(simulation, "relax.A")
    assert (np.isnan(values) == (simulation.cells.kind == 0)).all()
    assert 0 < np.isnan(values).sum() < 20


def test_a_cell_that_changes_its_type_begins_with_the_network():
    changes = {**STILL, "initial.count": 20, "types": {"a": {}, "b": {"fraction": 0.0}},
               "responses": [{"behaviour": "change to b", "law": "constant", "signal": "time",
                              "largest": "1 1/h"}]}  # fmt: skip
    changes["responses"][0].pop("signal")
    simulation = _run(changes, relax={"network": relax, "cells": "b"})
    values, kind = _column(simulation, "relax.A"), simulation.cells.kind
    assert (kind == 1).sum() > 3
    assert np.isnan(values[kind == 0]).all()
    known = values[(kind == 1) & ~np.isnan(values)]
    assert ((known > math.exp(-2e-4 * 7200.0) - 1e-9) & (known <= 1.0)).all()
    assert len(np.unique(known)) > 2


def test_a_cell_that_changes_its_type_responds_from_then_on():
    grow = {"behaviour": "growth rate", "signal": "relax.A", "cells": "b", "half": 0.5}
    die = {"behaviour": "apoptosis rate", "signal": "relax.A", "cells": "b", "half": 0.5,
           "largest": "0.1 1/h"}  # fmt: skip
    become = {"behaviour": "change to b", "law": "constant", "largest": "1 1/h"}
    changes = {**LINE, "initial.count": 20, "types": {"a": {}, "b": {"fraction": 0.0}},
               "responses": {"grow": grow, "become": become, "die": die}}  # fmt: skip
    simulation = _run(changes, relax={"network": relax, "cells": "b"})
    cells = simulation.cells
    assert (cells.kind == 1).sum() > 10
    assert np.isfinite(cells.radius).all()
    assert np.isfinite(cells.age).all()
    # where nothing changes the level, a type that has it from the start does the same
    same = {**grow, "law": "threshold", "half": 1e-3}
    changes = {**changes, "responses": {"grow": same, "become": become}}
    plain = _run({**changes, "responses": {"become": become}}, relax={"network": relax})
    driven = _run(changes, relax={"network": relax, "cells": "b"})
    np.testing.assert_array_equal(driven.cells.id, plain.cells.id)
    np.testing.assert_allclose(driven.cells.radius, plain.cells.radius, rtol=1e-12)


@pytest.mark.parametrize(("changes", "path"), [
    ({"responses.die": {"behaviour": "apoptosis rate", "signal": "relax.A", "half": 0.5,
                        "largest": "1 1/h"}}, "responses.die.signal"),
    ({"responses.grow": {"behaviour": "growth rate", "signal": "relax.A", "half": 0.5,
                         "cells": "a, b"}}, "responses.grow.signal"),
    ({"networks.other": {"network": relax, "inputs": {"source": "relax.A"}}},
     "networks.other.inputs.source"),
])  # fmt: skip
def test_cells_without_a_network_respond_to_none(changes, path):
    scene = mc.load_scene("growth").with_changes({
        "types": {"a": {}, "b": {}}, "networks.relax": {"network": relax, "cells": "b"},
    })  # fmt: skip
    with pytest.raises(SceneError, match=r"cells of type 'a' have no network 'relax'") as found:
        scene.with_changes(changes)
    assert found.value.path == path
    assert "cells = 'b'" in found.value.hint
    own = next(iter(changes.values()))
    key = next(iter(changes))
    scene.with_changes({key: {**own, "cells": "b"}})
    scene.with_changes({"networks.relax.cells": "a, b", key: own})
    if key.startswith("responses"):  # all cells find what it is around them
        scene.with_changes({key: {**own, "signal": "neighbours.relax.A"}})


def test_a_species_drives_a_behaviour():
    kill = {"behaviour": "apoptosis rate", "signal": "relax.A", "law": "threshold", "falls": True,
            "half": 0.5, "largest": "20 1/h"}  # fmt: skip
    changes = {**STILL, "initial.count": 10, "death": {}, "responses": [kill], "duration": "1 h"}
    own = {"network": relax, "dilution": False}
    before = _run({**changes, "duration": "55 min"}, relax=own)
    assert not before.cells.dead.any()  # exp(-2e-4 t) is one half at 57.8 min
    after = _run({**changes, "duration": "80 min"}, relax=own)
    assert after.cells.dead.sum() >= 9


def test_a_steady_start_is_at_rest_under_its_inputs():
    changes = {**STILL, "duration": "1 s"}
    own = {"network": relax, "inputs": {"source": "volume"}, "start": "steady"}
    simulation = _run(changes, relax=own)
    np.testing.assert_allclose(_column(simulation, "relax.A"), simulation.cells.volume, rtol=1e-3)


def test_a_network_that_cannot_be_solved_ends_the_step_with_the_cell():
    @network(states={"A": 1.0})
    def burst(t, y, u, p, out):
        out[0] = 1e-3 * y[0] * y[0]

    with pytest.raises(StepFailed, match=r"network burst.*cell|cell.*network burst") as failed:
        _run(STILL, burst={"network": burst})
    assert failed.value.time == pytest.approx(1000.0, rel=1e-3)


def test_history_summary_and_tables_have_the_states(tmp_path):
    scene = mc.load_scene("growth").with_changes({**LINE, "networks": {"relax": {
        "network": relax, "inputs": {"source": "time"}}}})  # fmt: skip
    result = mc.run(scene, output=tmp_path / "out", threads=1, report=False)
    frame = result.frames[-1]
    assert frame.inside["relax.A"].shape == (len(frame.cells),)
    assert result.history["network_mean_relax_A"][-1] == frame.inside["relax.A"].mean()
    assert result.summary()["networks"]["relax_A"]["mean"] == frame.inside["relax.A"].mean()
    low, high = (result.history[f"network_{x}_relax_A"][-1] for x in ("low", "high"))
    assert low <= frame.inside["relax.A"].mean() <= high
    assert "relax.A" in frame.to_pandas()
    assert "relax.A" in frame.to_xarray()
    frame.plot(colour="relax.A")
    assert mc.load_result(tmp_path / "out").frames[-1].inside["relax.A"].tolist() == frame.inside[
        "relax.A"].tolist()  # fmt: skip


def test_a_scene_with_a_network_is_read_back_as_it_was(tmp_path):
    own = {"network": relax, "inputs": {"source": "time"}, "divide": {"A": "reset"},
           "parameters": {"k": {"mean": 1e-4, "variation": 0.1}}}  # fmt: skip
    scene = mc.load_scene("growth").with_changes({**LINE, "networks": {"relax": own}})
    file = tmp_path / "scene.toml"
    file.write_text(scene.to_toml(), encoding="utf-8")
    assert mc.load_scene(file) == scene
    changed = scene.with_changes({"networks.relax.parameters.k": 3e-4})
    assert changed.networks["relax"].parameters["k"] == 3e-4


BAD = {
    "inputs.sorce": ({"inputs": {"sorce": "time"}}, "source"),
    "inputs.source": ({"inputs": {"source": "tme"}}, "time"),
    "parameters.kk": ({"parameters": {"kk": 1.0}}, "'k'"),
    "divide.A": ({"divide": {"A": "halv"}}, "halve"),
    "fluxes.oxygen": ({"fluxes": {"oxygen": "uptake: A"}}, "not a field"),
    "cells": ({"cells": "a"}, "no type"),
    "step": ({"method": "rk4"}, "missing"),
    "file": ({"network": None, "file": "nowhere/own.ant"}, "n.file: there is no file"),
    "units.A": ({"units": {"B": "mM"}}, "units.B"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_with_path_and_hint(case):
    given, words = BAD[case]
    with pytest.raises(SceneError) as refused:
        mc.load_scene("growth").with_changes({"networks": {"n": {"network": relax, **given}}})
    assert words in str(refused.value)
    assert refused.value.path.startswith("networks.n.")


def test_the_nearest_value_of_a_network_is_named():
    response = {"behaviour": "growth rate", "signal": "relx.A", "half": 1.0}
    with pytest.raises(SceneError, match=r"Did you mean 'relax\.A'"):
        mc.load_scene("growth").with_changes(
            {"networks": {"relax": {"network": relax}}, "responses": [response]}
        )


def test_an_input_in_another_unit_is_converted_and_a_wrong_one_refused():
    def model(unit):
        @network(states={"A": 1.0}, inputs={"source": 0.0}, units={"source": unit})
        def follow(t, y, u, p, out):
            out[0] = u[0] - y[0]

        return follow

    own = {"network": model("min"), "inputs": {"source": "time"}}
    simulation = _run(STILL, follow=own)
    assert _column(simulation, "follow.~input source")[0] == pytest.approx(120.0)
    with pytest.raises(SceneError, match="mM") as found:
        _run(STILL, follow={"network": model("mM"), "inputs": {"source": "time"}})
    assert found.value.hint == "Where that is meant, scales.source says how many mM one s is."


def test_networks_in_a_circle_are_refused():
    one = {"network": relax, "inputs": {"source": "two.A"}}
    two = {"network": relax, "inputs": {"source": "one.A"}}
    with pytest.raises(SceneError, match="circle"):
        mc.load_scene("growth").with_changes({"networks": {"one": one, "two": two}})


def test_a_scene_without_networks_loads_nothing_of_them():
    code = (
        "import sys, multicell as mc; mc.run(mc.load_scene('growth').with_changes("
        "{'duration': '1 h'}), threads=1); print([m for m in sys.modules if "
        "m.startswith('multicell.networks') or m == 'multicell.biology.inside'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().splitlines()[-1] == "[]"
