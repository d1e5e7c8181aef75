"""Axes and ranges: how they are read, and how what cannot be is told."""

import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich_medium import RICH

import multicell as mc
from multicell import SceneError
from multicell.studies.axes import parse_axis, parse_range, with_unique_names
from multicell.studies.keys import _keys_of, no_effect
from multicell.studies.plan import axis_line

OXYGEN = "nutrients.oxygen.boundary"


@pytest.fixture(scope="module")
def emt6():
    return mc.load_scene(RICH)


@pytest.mark.parametrize(
    ("key", "text", "values", "numbers"),
    [
        (OXYGEN, "0.07,0.14,0.28 mM", ("0.07 mM", "0.14 mM", "0.28 mM"), (0.07, 0.14, 0.28)),
        (OXYGEN, "70 uM, 0.14 mM", ("70 uM", "0.14 mM"), (0.07, 0.14)),
        (OXYGEN, "0.07, 0.14", (0.07, 0.14), (0.07, 0.14)),
        (OXYGEN, "0.1:0.2:3 mM", ("0.1 mM", "0.15 mM", "0.2 mM"), (0.1, 0.15, 0.2)),
        (OXYGEN, "log 0.05:0.2:3 mM", ("0.05 mM", "0.1 mM", "0.2 mM"), (0.05, 0.1, 0.2)),
        (OXYGEN, [0.07, "140 uM"], (0.07, "140 uM"), (0.07, 0.14)),
        (OXYGEN, np.array([0.07, 0.14]), (0.07, 0.14), (0.07, 0.14)),
        ("contact.law", "jkr, hertz", ("jkr", "hertz"), None),
        ("initial.count", "10:30:3", (10, 20, 30), (10.0, 20.0, 30.0)),
        ("growth.phases.M.grows", "true,false", (True, False), None),
        ("cells.heritable", '[["young"], []]', (["young"], []), None),
    ],
)  # fmt: skip
def test_values_are_read(emt6, key, text, values, numbers):
    axis = parse_axis(key, text, emt6)
    assert axis.values == values
    assert axis.numbers == (None if numbers is None else pytest.approx(numbers, rel=1e-14))


def test_an_entry_of_a_table_of_numbers_is_an_axis():
    scene = mc.load_scene("sorting")
    kind, other = list(scene.types)[:2]
    key = f"types.{kind}.surface_energy.{other}"
    axis = parse_axis(key, "0.1,0.2 mN/m", scene)
    assert (axis.numbers, axis.unit) == ((0.1, 0.2), "nN/um")
    with pytest.raises(SceneError, match="name one of its keys"):
        parse_axis(f"types.{kind}.surface_energy", "0.1", scene)
    with pytest.raises(SceneError, match="is not a key of this scene"):
        parse_axis(f"types.{kind}.surface_energy.x", "0.1", scene)


def test_the_unit_of_a_rate_constant_follows_from_its_reaction():
    scene = mc.load_scene("growth").with_changes(
        {
            "domain.x": ["-50 um", "50 um"],
            "domain.y": ["-50 um", "50 um"],
            "domain.z": ["-50 um", "50 um"],
            "nutrients.a": {"spacing": 10.0},
            "nutrients.b": {"spacing": 10.0},
            "reactions.bind": {"rate": 0.1, "consumes": {"a": 1, "b": 1}},
        }
    )
    axis = parse_axis("reactions.bind.rate", "0.1,0.2 1/mM/s", scene)
    assert (axis.numbers, axis.unit) == ((0.1, 0.2), "1/mM/s")
    with pytest.raises(SceneError, match="a reaction of order 2 has 1/mM/s"):
        parse_axis("reactions.bind.rate", "1 1/s", scene)


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        ("nutrients.oxygen.boundry", "1 mM", "Did you mean 'nutrients.oxygen.boundary'"),
        ("boundary", "1 mM", "'nutrients.oxygen.boundary' or 'nutrients.glucose.boundary'"),
        ("wholly.unknown", "1 mM", "is not a key of this scene"),
        ("nutrients.oxygen", "1 mM", "is a table, not a value"),
        ("friction.normal", "1,2 kPa s/um", "the scene has no 'friction'"),
        (OXYGEN, "1,2 mMol", "unknown unit"),
        (OXYGEN, "", "has no values. For example '1,2,5 mM'"),
        (OXYGEN, 3, "must have a list"),
        (OXYGEN, "1 mM, 2", "with units and without"),
        (OXYGEN, "3:1:5 mM", "the lower end first"),
        (OXYGEN, "[1, 2", "not valid TOML"),
        (OXYGEN, "high", "must be a number and a unit"),
        ("seed", "1,2", "give the number of seeds"),
        ("", "1", "not a dotted key"),
    ],
)  # fmt: skip
def test_what_is_no_axis_is_told(emt6, key, text, said):
    with pytest.raises(SceneError) as error:
        parse_axis(key, text, emt6)
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("text", "low", "high", "log"),
    [
        ("8:25 h", 28800.0, 90000.0, False),
        ("log 8:25 h", 28800.0, 90000.0, True),
        (("8 h", "25 h"), 28800.0, 90000.0, False),
        ((28800, 90000, "log"), 28800.0, 90000.0, True),
    ],
)
def test_ranges_are_read(emt6, text, low, high, log):
    free = parse_range("growth.phases.G1.duration", text, emt6)
    assert (free.low, free.high, free.log, free.unit, free.whole) == (low, high, log, "s", False)


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        (OXYGEN, "1 mM", "two numbers with a colon"),
        (OXYGEN, "2:1 mM", "the lower end first"),
        (OXYGEN, "log 0:1 mM", "has no logarithm"),
        (OXYGEN, (1.0,), "must be two values"),
        ("contact.law", "1:2", "is no number"),
    ],
)
def test_what_is_no_range_is_told(emt6, key, text, said):
    with pytest.raises(SceneError) as error:
        parse_range(key, text, emt6)
    assert said in str(error.value)


@given(
    st.floats(1e-3, 1e3), st.floats(1.001, 1e6), st.booleans(),
    st.lists(st.floats(0.0, 1.0), max_size=9),
)  # fmt: skip
@settings(max_examples=100, deadline=None)
def test_shares_of_a_range_rise_from_end_to_end(low, ratio, log, shares):
    free = parse_range("duration", (low, low * ratio, *(["log"] if log else [])), GROWTH)
    values = [free.value(share) for share in (0.0, *sorted(shares), 1.0)]
    assert values == sorted(values)
    assert (values[0], values[-1]) == (free.low, free.high)
    for share in shares:
        assert free.share(free.value(share)) == pytest.approx(share, abs=1e-9)


GROWTH = mc.load_scene("growth")


@pytest.mark.parametrize("log", [False, True])
def test_whole_numbers_are_drawn_in_their_proportions(log):
    free = parse_range("initial.count", (1, 4, *(["log"] if log else [])), GROWTH)
    drawn = [free.value(share) for share in np.linspace(0.0, 1.0, 4001)]
    weights = np.log([2, 3 / 2, 4 / 3, 5 / 4]) if log else np.ones(4)
    found = np.bincount(np.array(drawn, dtype=int), minlength=5)[1:] / 4001
    assert found == pytest.approx(weights / weights.sum(), abs=1e-3)
    assert free.setting(drawn[7]) == drawn[7]
    assert type(free.setting(drawn[7])) is int


def test_names_are_as_long_as_makes_them_unique(emt6):
    keys = {
        OXYGEN: "oxygen.boundary",
        "nutrients.glucose.boundary": "glucose.boundary",
        "cells.young": "young",
        "integrator.step": "integrator.step",  # histories have a column 'step'
        "growth.phases.G1.duration": "G1.duration",
        "duration": "duration",
    }
    axes = with_unique_names(parse_axis(key, [1.0], emt6) for key in keys)
    assert [axis.name for axis in axes] == list(keys.values())


@pytest.mark.parametrize("name", ["emt6", "sorting-signal", "treatment", "wm983b"])
def test_every_value_of_a_scene_is_an_axis_of_itself(name):
    """Each of its keys, taken for an axis of the value that is there, changes nothing."""
    scene = mc.load_scene(name)
    for key in (key.name for key in _keys_of(scene, scene, "", [])):
        assert isinstance(no_effect(scene, key), str)
        value = scene.to_dict()
        for step in key.split("."):
            value = value.get(step) if isinstance(value, dict) else None
        if value is None:
            continue
        axis = parse_axis(key, [value], scene)
        assert scene.with_changes({key: axis.values[0]}) == scene
        assert axis.coordinates == (value if isinstance(value, str) else axis.coordinates[0],)
        if isinstance(value, float):
            assert axis.numbers == (value,)
        written = tomllib.loads(axis_line(axis))
        for step in key.split("."):
            written = written[step]
        assert parse_axis(key, written, scene) == axis
