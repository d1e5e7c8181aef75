"""Designs: grids, lists, samples, and values that go together."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich_medium import RICH
from scipy.stats import qmc

import multicell as mc
from multicell import SceneError
from multicell.studies.axes import parse_axis, parse_range
from multicell.studies.design import Design, parse_axis_or_range

OXYGEN, GLUCOSE = "nutrients.oxygen.boundary", "nutrients.glucose.boundary"
LENGTH = "growth.phases.G1.duration"
EMT6 = mc.load_scene(RICH)
AXES = [
    parse_axis(OXYGEN, "0.07,0.14,0.28 mM", EMT6),
    parse_axis(GLUCOSE, "0.8,16.5 mM", EMT6),
    parse_axis("contact.law", "hertz,jkr", EMT6),
]
RANGES = [
    parse_range(LENGTH, "8:25 h", EMT6),
    parse_range("cells.young", "log 0.1:10 kPa", EMT6),
    parse_range("initial.count", "1:8", EMT6),
]


def changes(design):
    return [dict(point.changes) for point in design.points]


@given(st.permutations(AXES), st.integers(0, 3))
@settings(max_examples=20)
def test_a_grid_has_every_combination_once(axes, count):
    axes = axes[:count]
    design = Design(axes=tuple(axes))
    values = itertools.product(*(axis.values for axis in axes))
    keys = [axis.key for axis in axes]
    assert changes(design) == [dict(zip(keys, row, strict=True)) for row in values]
    assert [axis.values for axis in design.axes] == [axis.values for axis in axes]


def test_coordinates_are_numbers_in_base_units_or_words():
    design = Design(axes=tuple(AXES))
    assert dict(design.points[1].coordinates) == {
        "oxygen.boundary": 0.07, "glucose.boundary": 0.8, "law": "jkr",
    }  # fmt: skip
    assert [axis.name for axis in design.axes] == ["oxygen.boundary", "glucose.boundary", "law"]


@pytest.mark.parametrize("kind", ["lhs", "sobol"])
def test_samples_fill_their_ranges_evenly(kind):
    design = Design(kind, tuple(RANGES), size=64, sample_seed=3)
    again = Design(kind, tuple(RANGES), size=64, sample_seed=3)
    assert again.points == design.points
    assert Design(kind, tuple(RANGES), size=64, sample_seed=4).points != design.points
    rows = [[p.coordinates[name] for name in ("duration", "young", "count")] for p in design.points]
    duration, young, count = np.array(rows).T
    # one point in each of 64 equal parts, of the logarithm too, and 8 of each whole number
    parts = np.sort(np.floor((duration / 3600.0 - 8.0) / 17.0 * 64))
    assert parts.tolist() == list(range(64))
    assert np.sort(np.floor((np.log10(young) + 1.0) / 2.0 * 64)).tolist() == list(range(64))
    assert np.bincount(count.astype(int), minlength=9)[1:].tolist() == [8] * 8
    assert all(type(p.changes["initial.count"]) is int for p in design.points)


def test_a_sobol_sequence_is_scipys_and_goes_on_when_it_is_doubled():
    design = Design("sobol", tuple(RANGES[:2]), size=16, sample_seed=5)
    shares = qmc.Sobol(2, scramble=True, rng=5).random(16)
    found = [p.coordinates["duration"] / 3600.0 for p in design.points]
    assert found == pytest.approx((8.0 + 17.0 * shares[:, 0]).tolist(), rel=1e-12)
    double = Design("sobol", tuple(RANGES[:2]), size=32, sample_seed=5)
    assert double.points[:16] == design.points


def test_words_are_sampled_equally_often():
    design = Design("lhs", (RANGES[0], AXES[2]), size=20, sample_seed=1)
    laws = [p.coordinates["law"] for p in design.points]
    assert (laws.count("jkr"), laws.count("hertz")) == (10, 10)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Design("gird", tuple(AXES)), "Did you mean 'grid'"),
        (lambda: Design("grid", (RANGES[0],)), "needs values. '28800:90000:5 s' are five"),
        (lambda: Design("grid", (AXES[0], AXES[0])), "is varied twice"),
        (lambda: Design("grid", (AXES[0],), size=5), "size: has no meaning"),
        (lambda: Design("sobol", (RANGES[0],), size=12), "take 8 or 16"),
        (lambda: Design("lhs", (), size=12), "vary: is empty"),
        (lambda: Design("list", ()), "points: is empty"),
        (lambda: Design("list", tuple(AXES[:2])), "lists of other lengths"),
        (
            lambda: Design(axes=tuple(parse_axis(k, list(range(1, 600)), EMT6)
                                      for k in ("cells.young", "duration"))),
            "makes 358,801 points",
        ),
    ],
)  # fmt: skip
def test_what_is_no_design_is_told(make, said):
    with pytest.raises(SceneError) as error:
        make()
    assert said in str(error.value)


def test_one_colon_is_a_range_two_are_values():
    assert parse_axis_or_range(LENGTH, "8:25 h", EMT6) == parse_range(LENGTH, "8:25 h", EMT6)
    assert parse_axis_or_range(LENGTH, "8:25:3 h", EMT6).numbers == (28800.0, 59400.0, 90000.0)
