"""Responses of behaviours to signals, against closed forms."""

import math

import numpy as np
import pytest
from running import finished, within
from scipy import stats

import multicell as mc
from multicell.behaviours import laws
from multicell.biology.plan import biology_plan
from multicell.biology.responding import value_of
from multicell.errors import SceneError

APART = {"duration": "6 h", "coupling_step": "20 min", "contact": {"law": "hertz"}}


def scene(count=60, **tables):
    """Return cells that do not grow in a field without gradients."""
    drug = {"boundary": 0.002, "uptake": 0.0, "spacing": 20.0}
    given = {**APART, "initial": {"count": count}, "nutrients": {"drug": drug}, **tables}
    return mc.Scene.from_dict(given)


def state(described, **columns):
    """Return the plan of a scene, its cells with other columns, and what they find of the drug."""
    cells = mc.Simulation(described, threads=1).cells
    for name, values in columns.items():
        setattr(cells, name, np.asarray(values))
    return biology_plan(described), cells


@mc.response(parameters={"half": ""})
def hypoxic_kill(drug, oxygen, p):
    return drug / (p.half + drug) / (1.0 + oxygen)


HILL = {"behaviour": "death rate", "signal": "drug", "law": "hill", "half": "2 uM",
        "largest": "0.1 1/h"}  # fmt: skip
KILLS = {
    "little": (1e-3, {**HILL, "power": 3, "largest": "0.2 1/h"}, 1.0 / 9.0),
    "much": (8e-3, {**HILL, "power": 3, "largest": "0.2 1/h"}, 64.0 / 65.0),
    "a law of the user's own": (
        2e-3, {"behaviour": "death rate", "signal": "drug, oxygen", "largest": "0.2 1/h",
               "law": hypoxic_kill.scene_name(), "parameters": {"half": 0.002}}, 0.5 / 1.05,
    ),
}  # fmt: skip


@pytest.mark.parametrize("kill", KILLS)
def test_survivors_of_a_drug_fall_exponentially_at_the_rate_of_the_dose(kill):
    dose, response, share = KILLS[kill]
    constant = {"uptake": 0.0, "spacing": 20.0}
    fields = {"drug": {"boundary": dose, **constant}, "oxygen": {"boundary": 0.05, **constant}}
    dead = int(finished(scene(1500, nutrients=fields, responses=[response])).cells.dead.sum())
    assert within(dead, 1500, 1.0 - math.exp(-6.0 * 0.2 * share))


def test_two_clones_under_a_constant_drug_grow_at_their_own_rates():
    """Growth is exponential, of factor times the free rate, less deaths."""
    responses = {
        "slow": {"behaviour": "growth rate", "signal": "drug", "law": "monod", "falls": True,
                 "half": "2 uM", "cells": "sensitive"},
        "kill": {"behaviour": "apoptosis rate", "signal": "drug", "law": "monod",
                 "half": "2 uM", "largest": "0.02 1/h", "base": 0, "cells": "sensitive"},
    }  # fmt: skip
    made = scene(
        400, duration="30 h", growth={"cycle_time": "20 h", "cycle_variation": 0.0},
        types={"sensitive": {}, "resistant": {}}, responses=responses,
        initial={"count": 400, "stage": "asynchronous"}, death={"apoptosis_time": "1 min"},
    )  # fmt: skip
    cells = finished(made).cells
    alive = [int(((cells.kind == kind) & ~cells.dead).sum()) for kind in (0, 1)]
    rate = math.log(2.0) / 20.0
    expected = [200 * math.exp((0.5 * rate - 0.01) * 30.0), 200 * math.exp(rate * 30.0)]
    # ages at the start scatter: by a birth process from 200 cells, var n = n (n/200 - 1) and less
    spread = [math.sqrt(n * n / 200.0) for n in expected]
    assert abs(alive[0] - expected[0]) < 4.0 * spread[0]
    assert abs(alive[1] - expected[1]) < 4.0 * spread[1]
    assert alive[1] > 2 * alive[0]


def test_the_short_form_and_its_response_give_the_same_bits():
    """Monod growth, thresholds and pressure, written in both ways."""
    base = {
        "duration": "40 h", "initial": {"count": 30},
        "growth": {"cycle_time": "10 h"},
    }  # fmt: skip
    oxygen = {"boundary": 0.05, "spacing": 20.0}
    short = mc.Scene.from_dict({
        **base, "growth": {"cycle_time": "10 h", "critical_pressure": 0.05},
        "nutrients": {"oxygen": {**oxygen, "growth_half_saturation": 0.02, "quiescence": 0.02}},
    })  # fmt: skip
    long = mc.Scene.from_dict({
        **base, "nutrients": {"oxygen": oxygen},
        "responses": [
            {"behaviour": "growth rate", "signal": "oxygen", "law": "monod", "half": 0.02},
            {"behaviour": "growth rate", "signal": "pressure", "law": "linear", "falls": True,
             "begin": 0, "end": 0.05},
            {"behaviour": "rest", "signal": "oxygen", "law": "threshold", "half": 0.02,
             "falls": True, "largest": 1},
            {"behaviour": "rest", "signal": "pressure", "law": "threshold", "half": 0.05,
             "largest": 1},
        ],
    })  # fmt: skip
    one, other = finished(short).cells, finished(long).cells
    assert len(one) > 60
    for name, column in one.columns():
        np.testing.assert_array_equal(column, getattr(other, name), err_msg=name)


def test_types_that_switch_are_a_markov_chain():
    """p(t) relaxes to the ratio of the rates with the sum of them."""
    up, down = 0.3, 0.1
    made = scene(
        2000, types={"a": {"fraction": 1.0}, "b": {"fraction": 0.0}},
        responses=[
            {"behaviour": "change to b", "law": "constant", "largest": f"{up} 1/h", "cells": "a"},
            {"behaviour": "change to a", "law": "constant", "largest": f"{down} 1/h", "cells": "b"},
        ],
        coupling_step="2 min",
    )  # fmt: skip
    cells = finished(made).cells
    share = up / (up + down) * (1.0 - math.exp(-(up + down) * 6.0))
    assert within(int((cells.kind == 1).sum()), 2000, share)


@pytest.mark.slow
def test_mutants_are_those_of_luria_and_delbruck():
    """Without back mutation P(0) = exp(-μ (N - N0)) and the mean is μ N log2(N/N0), near enough."""
    chance, cultures = 0.004, 60
    found = []
    for seed in range(cultures):
        made = mc.Scene.from_dict({
            "duration": "61 h", "coupling_step": "1 h", "seed": seed, "initial": {"count": 1},
            "growth": {"cycle_time": "10 h", "cycle_variation": 0.0},
            "types": {"wild": {}, "mutant": {"fraction": 0.0}},
            "responses": [{"behaviour": "mutation to mutant", "law": "constant",
                           "largest": chance, "cells": "wild"}],
            "drag": {"viscosity": 50.0}, "contact": {"law": "hertz"},
            "cells": {"young": "0.05 kPa"},
        })  # fmt: skip
        cells = finished(made).cells
        assert len(cells) == 64
        found.append(int((cells.kind == 1).sum()))
    # each of the 126 daughters mutates unless her mother has: P(0) is exact
    none = (1.0 - chance) ** 126
    assert within(found.count(0), cultures, none)
    # each of the six generations adds the part of cells that mutate in it
    mean = 64.0 * (1.0 - (1.0 - chance) ** 6)
    spread = np.std(found) / math.sqrt(cultures)
    assert abs(np.mean(found) - mean) < 4.0 * max(spread, 0.05)


def test_drift_of_an_inherited_trait_adds_up_over_generations():
    """The variance of ln(modulus) is sd² times the generations, of a normal cut at 3 sd."""
    made = mc.Scene.from_dict({
        "duration": "50.5 h", "coupling_step": "30 min", "initial": {"count": 40},
        "growth": {"cycle_time": "10 h", "cycle_variation": 0.0},
        "cells": {"young": "0.05 kPa", "young_variation": 0.0, "heritable": ["young"],
                  "drift": {"young": 0.1}},
        "contact": {"law": "hertz"}, "drag": {"viscosity": 50.0},
    })  # fmt: skip
    cells = finished(made).cells
    assert len(cells) == 40 * 32
    cut = stats.truncnorm(-3, 3).var()
    logs = np.log(cells.young / 0.05)
    # sisters share their past: the mean scatters more than that of independent cells
    assert np.var(logs) == pytest.approx(5 * 0.1**2 * cut, rel=0.2)


RULES = {
    "product": lambda v: v[0] * v[1],
    "minimum": min,
    "maximum": max,
}


@pytest.mark.parametrize("rule", RULES)
def test_responses_of_a_factor_combine_by_their_rule(rule):
    made = scene(
        5, growth={},
        responses=[
            {"behaviour": "growth rate", "signal": "drug", "law": "monod", "half": 0.001,
             "combine": rule},
            {"behaviour": "growth rate", "signal": "age", "law": "linear", "begin": 0,
             "end": "10 h", "base": 0.2, "combine": rule},
        ],
    )  # fmt: skip
    plan, cells = state(made, age=[0.0, 9e3, 1.8e4, 3.6e4, 9e4])
    found = {"drug": np.array([0.0, 0.001, 0.002, 0.004, 0.1])}
    value = value_of(plan, "growth rate", 1.0, found, cells)
    one = found["drug"] / (0.001 + found["drug"])
    other = 0.2 + 0.8 * np.clip(cells.age / 36000.0, 0.0, 1.0)
    expected = [RULES[rule](pair) for pair in zip(one, other, strict=True)]
    np.testing.assert_allclose(value, expected, rtol=1e-14)


def test_rates_add_and_physicells_rule_is_that_of_its_formula():
    rising = {"behaviour": "death rate", "signal": "drug", "law": "hill", "half": 0.002,
              "power": 4, "largest": 0.01}  # fmt: skip
    falling = {"behaviour": "death rate", "signal": "age", "law": "hill", "half": 3600.0,
               "power": 2, "largest": 0.0, "combine": "sum"}  # fmt: skip
    death = {"apoptosis_rate": 0.004}
    x, age = np.array([0.0, 0.001, 0.002, 0.02]), np.array([0.0, 3600.0, 7200.0, 1e5])
    hill_x = x**4 / (0.002**4 + x**4)
    hill_age = age**2 / (3600.0**2 + age**2)
    plan, cells = state(scene(4, death=death, responses=[rising, falling]), age=age)
    value = value_of(plan, "apoptosis rate", 0.004, {"drug": x}, cells)
    np.testing.assert_allclose(value, 0.004 + 0.006 * hill_x - 0.004 * hill_age, atol=1e-15)
    both = [{**part, "combine": "physicell"} for part in (rising, falling)]
    plan, cells = state(scene(4, death=death, responses=both), age=age)
    value = value_of(plan, "apoptosis rate", 0.004, {"drug": x}, cells)
    # one signal each: the multivariate Hill functions are those of one variable
    raised = (1 - hill_x) * 0.004 + hill_x * 0.01
    np.testing.assert_allclose(value, (1 - hill_age) * raised, rtol=1e-12)


def test_a_response_of_one_type_takes_the_place_of_that_of_all():
    made = scene(
        6, growth={}, types={"soft": {}, "tough": {}},
        nutrients={"drug": {"boundary": 0.1, "uptake": 0.0, "necrosis": 0.05}},
        responses=[{"behaviour": "necrosis rate", "signal": "drug", "law": "threshold",
                    "half": "0.01 mM", "falls": True, "cells": "tough"}],
    )  # fmt: skip
    plan, cells = state(made, kind=np.array([0, 0, 0, 1, 1, 1], dtype=np.int16))
    from multicell.biology.responding import rate_of_harm

    found = {"drug": np.array([0.04, 0.06, 0.005, 0.04, 0.06, 0.005])}
    hazard = rate_of_harm(plan, "necrosis rate", found, cells)
    np.testing.assert_array_equal(np.isinf(hazard), [True, False, True, False, False, True])


def test_a_chance_of_rest_is_the_part_of_cells_that_rests():
    made = scene(
        4000, growth={},
        responses=[{"behaviour": "rest", "signal": "drug", "law": "hill", "half": 0.006,
                    "largest": 1}],
    )  # fmt: skip
    cells = mc.Simulation(made, threads=1).cells
    resting = int((cells.state == mc.State.QUIESCENT).sum())
    assert within(resting, 4000, 0.25)


def test_neighbours_are_counted_by_type_and_the_dead_apart():
    made = mc.Scene.from_dict({
        "duration": "1 h", "initial": {"count": 3}, "growth": {},
        "types": {"a": {}, "b": {}},
        "responses": [
            {"behaviour": "rest", "signal": name, "law": "threshold", "half": 1.5, "largest": 1}
            for name in ("neighbours", "dead neighbours", "contacts with b")
        ],
    })  # fmt: skip
    from multicell.biology.responding import other_signals

    plan, cells = state(made)
    cells.kind[:] = [0, 1, 1]
    cells.state[:] = [0, 0, mc.State.NECROTIC]
    ids = cells.id
    contacts = np.array([[ids[0], ids[1]], [ids[1], ids[2]]])
    found = other_signals(plan, cells, contacts, 0.0)
    assert found["neighbours"].tolist() == [1.0, 1.0, 1.0]
    assert found["dead neighbours"].tolist() == [0.0, 1.0, 0.0]
    assert found["contacts with b"].tolist() == [1.0, 0.0, 1.0]


def test_uptake_responds_to_another_field_and_the_ledger_closes():
    tables = {
        "nutrients": {
            "drug": {"boundary": 0.002, "uptake": 0.0, "spacing": 20.0},
            "oxygen": {"boundary": 0.07, "uptake": "20 amol/s", "spacing": 20.0},
        },
    }  # fmt: skip
    plain = finished(scene(30, **tables))
    halved = finished(scene(30, **tables, responses=[
        {"behaviour": "uptake of oxygen", "signal": "drug", "law": "monod", "falls": True,
         "half": "2 uM"},
    ]))  # fmt: skip
    ratio = halved.ledger["oxygen"].uptake / plain.ledger["oxygen"].uptake
    assert 0.5 < ratio < 0.56  # more oxygen is left, and saturation is short of one
    assert abs(halved.ledger["oxygen"].relative_remainder) < 1e-6


REFUSED = {
    "behaviour": ({**HILL, "behaviour": "deth rate"}, "behaviour: .*Did you mean"),
    "signal": ({**HILL, "signal": "drog"}, "signal: .*Did you mean 'drug'"),
    "unit of the signal": ({**HILL, "half": "2 h"}, "half: "),
    "unit of the behaviour": ({**HILL, "largest": "2 um"}, "largest: "),
    "beyond use": ({**HILL, "largest": "20 1/s"}, "largest: .*at most 1 1/s"),
    "type": ({**HILL, "cells": "soft"}, "cells: names 'soft'"),
    "no half": ({k: x for k, x in HILL.items() if k != "half"}, "half: is missing"),
    "no effect": ({k: x for k, x in HILL.items() if k != "largest"}, "largest: is missing"),
    "no growth": ({**HILL, "behaviour": "growth rate", "largest": 2}, "without .growth."),
    "no phases": ({**HILL, "behaviour": "entry into S", "largest": 2}, "behaviour: "),
    "no ATP": ({**HILL, "signal": "ATP", "half": "1 mM/s"}, "the scene has no energy"),
    "another law's key": ({**HILL, "begin": 0}, "begin: has no effect"),
    "own field": ({**HILL, "behaviour": "uptake of drug", "largest": 2}, "behaviour: "),
    "two rules": ([HILL, {**HILL, "signal": "age", "half": "1 h", "combine": "minimum"}],
                  "combine by one rule"),
    "two signals": ({**HILL, "signal": "drug, age"}, "signal: names several"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused_by_name(case):
    given, words = REFUSED[case]
    with pytest.raises(SceneError, match=words):
        scene(3, responses=given if isinstance(given, list) else [given])


def test_a_field_with_the_name_of_another_signal_is_refused():
    with pytest.raises(SceneError, match="name of another signal"):
        scene(3, nutrients={"age": {}}, responses=[{**HILL, "signal": "age", "half": "1 h"}])


def test_oxygen_is_given_as_a_pressure():
    made = scene(
        3, nutrients={"oxygen": {"boundary": "40 mmHg"}},
        responses=[{**HILL, "signal": "oxygen", "half": "20 mmHg"}],
    )  # fmt: skip
    assert made.responses["response_1"].half == pytest.approx(made.nutrients["oxygen"].boundary / 2)


def test_a_law_that_breaks_its_promises_is_named():
    mc.testing.check_response(hypoxic_kill(half=0.5))

    @mc.response(parameters={})
    def too_much(signal, p):
        return 2.0 * signal

    with pytest.raises(AssertionError, match="not from 0 to 1"):
        mc.testing.check_response(too_much())
    with pytest.raises(SceneError, match="which is not loaded"):
        scene(3, responses=[{**HILL, "law": "mine.py:nowhere"}])


def test_responses_are_explained_in_sentences_and_drawn(tmp_path):
    from multicell.report.explain.scene import explain
    from multicell.report.plots.responses import response_curves

    made = scene(
        3, growth={"critical_pressure": 0.1}, types={"a": {}, "b": {}},
        responses=[{**HILL, "cells": "a"}, {**HILL, "cells": "b", "half": "20 uM"}],
    )  # fmt: skip
    words = {part["part"]: part["what"] for part in explain(made)["parts"]}
    assert (
        "the apoptosis rate of a cells goes from 0 1/h to 0.1 1/h" in words["responses.response_1"]
    )
    figure = response_curves(made)
    assert [axes.get_title("left") for axes in figure.axes] == ["growth rate", "rest",
                                                           "apoptosis rate, 1/h"]  # fmt: skip
    with pytest.raises(ValueError, match="nothing to draw"):
        response_curves(scene(3))


@pytest.mark.parametrize("falls", [False, True])
@pytest.mark.parametrize(
    "law",
    [laws.Monod(0.01), laws.Hill(0.01, 3.0), laws.Threshold(0.01), laws.LinearResponse(0.0, 0.02)],
    ids=lambda law: type(law).__name__,
)
def test_shares_stay_between_none_and_all_under_tension(law, falls):
    """Pressure is below zero in tension, and may be the half value with the other sign."""
    signal = np.array([-1e9, -0.011, -0.01, -0.00999999, -1e-12, 0.0, 1e-12, 0.01, 1e9])
    share = np.asarray(law.share(signal, falls=falls), dtype=float)
    assert ((share >= 0.0) & (share <= 1.0)).all()
    assert (np.diff(share) <= 0.0).all() if falls else (np.diff(share) >= 0.0).all()
    assert (share[:5] == share[5]).all()


RATE = {"death": {}, "responses": {"kill": {
    "behaviour": "apoptosis rate", "signal": "pressure", "law": "hill", "half": 0.1,
    "largest": "1 1/h", "combine": "product"}}}  # fmt: skip


def test_a_product_on_a_base_of_zero_is_refused():
    """It divided by zero: nobody died of a rate that was not a number."""
    with pytest.raises(SceneError, match=r"responses.kill.combine: is 'product', but the apopt.*0"):
        mc.Scene.from_dict({"duration": "1 h", **RATE})
    with_base = {**RATE, "death": {"apoptosis_rate": "0.1 1/h"}}
    assert mc.Scene.from_dict({"duration": "1 h", **with_base}).responses


@pytest.mark.parametrize(
    ("law", "key"),
    [
        ({"law": "hill", "half": 1.0, "base": 0, "largest": 2}, "base"),
        ({"law": "monod", "half": 1.0}, "base"),
        ({"law": "linear", "begin": 0, "end": 1, "base": 1, "largest": 0}, "largest"),
        ({"law": "table", "points": [[0, 1.0], [1, 0.0]]}, "points"),
        ({"law": "hill", "half": 1.0, "base": 1, "largest": 2, "combine": "sum"}, "combine"),
    ],
)
def test_cells_keep_some_stiffness(law, key):
    part = {"behaviour": "Young's modulus", "signal": "pressure", **law}
    with pytest.raises(SceneError, match=rf"responses.soft.{key}"):
        mc.Scene.from_dict({"duration": "1 h", "responses": {"soft": part}})
