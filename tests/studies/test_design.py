"""Designs: grids, lists, and values that go together."""

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich_medium import RICH

import multicell as mc
from multicell import SceneError
from multicell.studies.axes import parse_axis
from multicell.studies.plan import Plan

OXYGEN, GLUCOSE = "nutrients.oxygen.boundary", "nutrients.glucose.boundary"
EMT6 = mc.load_scene(RICH)
AXES = [
    parse_axis(OXYGEN, "0.07,0.14,0.28 mM", EMT6),
    parse_axis(GLUCOSE, "0.8,16.5 mM", EMT6),
    parse_axis("contact.law", "hertz,jkr", EMT6),
]


def changes(design):
    return [dict(point.changes) for point in design.points]


@given(st.permutations(AXES), st.integers(0, 3))
@settings(max_examples=20)
def test_a_grid_has_every_combination_once(axes, count):
    axes = axes[:count]
    design = Plan(EMT6, tuple(axes))
    values = itertools.product(*(axis.values for axis in axes))
    keys = [axis.key for axis in axes]
    assert changes(design) == [dict(zip(keys, row, strict=True)) for row in values]
    assert [axis.values for axis in design.axes] == [axis.values for axis in axes]


def test_coordinates_are_numbers_in_base_units_or_words():
    design = Plan(EMT6, tuple(AXES))
    assert dict(design.points[1].coordinates) == {
        "oxygen.boundary": 0.07, "glucose.boundary": 0.8, "law": "jkr",
    }  # fmt: skip
    assert [axis.name for axis in design.axes] == ["oxygen.boundary", "glucose.boundary", "law"]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Plan(EMT6, tuple(AXES), "gird"), "Did you mean 'grid'"),
        (lambda: Plan(EMT6, (AXES[0], AXES[0])), "is varied twice"),
        (lambda: Plan(EMT6, (), "list"), "points: is empty"),
        (lambda: Plan(EMT6, tuple(AXES[:2]), "list"), "lists of other lengths"),
        (
            lambda: Plan(EMT6, tuple(parse_axis(k, list(range(1, 600)), EMT6)
                                     for k in ("cells.young", "duration"))),
            "makes 358,801 points",
        ),
    ],
)  # fmt: skip
def test_what_is_no_design_is_told(make, said):
    with pytest.raises(SceneError) as error:
        make()
    assert said in str(error.value)
