"""Thresholds of fields that differ between types: who rests and who dies, where and when."""

import math

import numpy as np
import pytest
from running import finished, refused

import multicell as mc
from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.biology.responding import rate_of_harm, wants_rest
from multicell.cells import State
from multicell.report.explain.scene import explain
from multicell.scene.responses import shared_threshold, type_thresholds
from multicell.scene.scene import Scene

OXYGEN = {"quiescence": 0.04, "necrosis": 0.01, "boundary": 0.1}


def scene(types, field=None, **rest):
    """Return cells that do not act on each other and find a field of their medium."""
    entries = {
        "duration": "1 h", "coupling_step": "10 min", "initial": {"count": 40},
        "contact": {"law": "none"}, "growth": {"cycle_time": "40 h"}, "types": types,
        "nutrients": {"oxygen": {"uptake": 0.0, **OXYGEN, **(field or {})}}, **rest,
    }  # fmt: skip
    return Scene.from_dict(entries)


def three():
    """Return three types; thresholds of 0 are never passed."""
    return {
        "usual": {},
        "frugal": {"quiescence_of": {"oxygen": 0.5}, "necrosis_of": {"oxygen": 0.0}},
        "greedy": {"quiescence_of": {"oxygen": 2.0}, "necrosis_of": {"oxygen": 3.0}},
    }


LEVELS = np.array([0.09, 0.07, 0.035, 0.025, 0.015, 0.005])
RESTS = {"usual": 0.04, "frugal": 0.02, "greedy": 0.08}
DIES = {"usual": 0.01, "frugal": 0.0, "greedy": 0.03}


@pytest.mark.parametrize(("kind", "name"), list(enumerate(RESTS)))
def test_each_type_rests_and_dies_below_its_own_thresholds(kind, name):
    described = scene(three()).with_changes({"initial.count": len(LEVELS)})
    plan, cells = biology_plan(described), initial_cells(described)
    cells.kind[:] = kind
    found = {"oxygen": LEVELS}
    np.testing.assert_array_equal(wants_rest(plan, cells, found), RESTS[name] > LEVELS)
    rate = rate_of_harm(plan, "necrosis rate", found, cells)
    np.testing.assert_array_equal(np.isinf(rate), DIES[name] > LEVELS)
    assert type_thresholds(described, "oxygen", "quiescence")[name] == pytest.approx(RESTS[name])
    assert type_thresholds(described, "oxygen", "necrosis")[name] == pytest.approx(DIES[name])


def test_one_factor_of_all_types_is_a_threshold_of_the_field():
    alike = {
        name: {"quiescence_of": {"oxygen": 0.5}, "necrosis_of": {"oxygen": 1.5}} for name in "ab"
    }
    scaled, plain = scene(alike), scene({"a": {}, "b": {}}, {"quiescence": 0.02, "necrosis": 0.015})
    assert shared_threshold(scaled, "oxygen", "quiescence") == 0.02
    plans = [biology_plan(s).responses for s in (scaled, plain)]
    for behaviour, parts in plans[0].items():
        for mine, theirs in zip(parts, plans[1][behaviour], strict=True):
            assert mine.effect == theirs.effect
            assert mine.mask is None


def test_cells_of_two_types_die_at_their_rate_where_only_one_starves():
    """At 0.02 mM greedy cells die at k, exp(-kt) of them live; nobody else does."""
    kinds = {name: {"fraction": 1, **of} for name, of in three().items() if name != "frugal"}
    death = {"necrosis_rate": "1 1/h", "lysis_time": "1e4 h"}
    described = scene(kinds, {"boundary": 0.02}, death=death, initial={"count": 2000},
                      growth={"cycle_time": "1e4 h"})  # fmt: skip
    cells = finished(described).cells
    greedy = cells.kind == 1
    assert not (cells.dead & ~greedy).any()
    alive, spread = math.exp(-1.0), math.sqrt(math.exp(-1.0) * (1.0 - math.exp(-1.0)) / 1000)
    assert abs((~cells.dead[greedy]).mean() - alive) < 4.0 * spread
    assert (cells.state[~greedy] == State.QUIESCENT).all()


def test_only_cells_that_do_not_rest_grow():
    """At 0.03 mM frugal cells grow, by V_b t / T, and the others rest from the start."""
    kinds = {name: {"fraction": 1, **of} for name, of in three().items() if name != "greedy"}
    described = scene(kinds, {"boundary": 0.03})
    start, end = mc.Simulation(described).cells, finished(described).cells
    frugal = end.kind == 1
    ratio = end.volume / start.volume
    np.testing.assert_array_equal(ratio[~frugal], 1.0)
    own = start.volume[frugal] * 3600.0 / start.cycle_time[frugal]
    np.testing.assert_allclose(end.volume[frugal] - start.volume[frugal], own, rtol=1e-9)


def test_responses_take_the_place_of_thresholds_of_their_types_only():
    named = {
        "behaviour": "rest", "signal": "oxygen", "law": "threshold", "half": "0.06 mM",
        "largest": 1.0, "falls": True,
    }  # fmt: skip
    for whom, expected in (
        ("frugal", {**RESTS, "frugal": 0.06}),
        ("", {name: max(level, 0.06) for name, level in RESTS.items()}),
    ):
        described = scene(
            three(), responses={"own": {**named, **({"cells": whom} if whom else {})}}
        )
        described = described.with_changes({"initial.count": len(LEVELS)})
        plan, cells = biology_plan(described), initial_cells(described)
        for kind, name in enumerate(RESTS):
            cells.kind[:] = kind
            rests = wants_rest(plan, cells, {"oxygen": LEVELS})
            np.testing.assert_array_equal(rests, expected[name] > LEVELS, err_msg=f"{whom} {name}")


def test_other_thresholds_of_a_field_stay():
    described = scene({"a": {"necrosis_of": {"oxygen": 2.0}}, "b": {}}, {"necrosis_above": 0.08})
    described = described.with_changes({"initial.count": len(LEVELS)})
    plan, cells = biology_plan(described), initial_cells(described)
    for kind, level in enumerate((0.02, 0.01)):
        cells.kind[:] = kind
        rate = rate_of_harm(plan, "necrosis rate", {"oxygen": LEVELS}, cells)
        np.testing.assert_array_equal(np.isinf(rate), (level > LEVELS) | (LEVELS > 0.08))


def test_forecasts_are_those_of_the_most_numerous_type():
    few = {"a": {"fraction": 1, "quiescence_of": {"oxygen": 0.5}}, "b": {"fraction": 9}}
    plain = {"a": {"fraction": 1}, "b": {"fraction": 9}}
    many = {**few, "a": {**few["a"], "fraction": 19}}
    field = {"boundary": 0.03}
    cells = [
        {n["name"]: n["value"] for n in explain(scene(kinds, field, duration="200 h"))["numbers"]}[
            "expected cells"
        ]
        for kinds in (plain, few, many)
    ]
    assert cells[0] == cells[1] == 40
    assert cells[2] > 400


def test_what_has_no_threshold_or_the_wrong_order_is_refused():
    with refused("types.a.quiescence_of.oxygen", "a field with quiescence"):
        scene({"a": {"quiescence_of": {"oxygen": 2.0}}}, {"quiescence": None, "necrosis": None})
    with refused("types.a.necrosis_of.oxgen", "oxygen"):
        scene({"a": {"necrosis_of": {"oxgen": 2.0}}})
    with refused("types.a.necrosis_of.oxygen", "wrong order"):
        scene({"a": {"necrosis_of": {"oxygen": 5.0}}})
    with refused("types.a.quiescence_of.oxygen", "wrong order"):
        scene({"a": {"quiescence_of": {"oxygen": 0.1}}})
    assert scene({"a": {"quiescence_of": {"oxygen": 0.0}}}).types
