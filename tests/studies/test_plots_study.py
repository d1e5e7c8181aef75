"""Pictures of a study: each number in them against one that was worked out otherwise."""

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import PolyCollection
from picture_texts import check_texts
from study_tables import AXES, UNITS, grid, sampled, with_states

from multicell.errors import SceneError
from multicell.studies import picture_data, pictures
from multicell.studies.picture_data import (
    at_end,
    axes_of,
    axis_scale,
    number_text,
)
from multicell.studies.pictures import StudyPlots

OXYGEN, GLUCOSE = "oxygen.boundary", "glucose.boundary"


@pytest.fixture(scope="module")
def two():
    failed = [(0, 1, k) for k in range(5)] + [(2, 2, 0)]
    waiting = [(1, 3, k) for k in range(5)]
    return with_states(grid(OXYGEN, GLUCOSE), failed, waiting)


def plots(table):
    return StudyPlots(table, "A study")


def texts(figure):
    found = [text.get_text() for text in figure.findobj(mpl.text.Text) if text.get_visible()]
    return [line for text in found for line in text.split("\n") if line]


def test_tiles_tell_mean_and_deviation_over_the_seeds(two):
    words = texts(plots(two).heatmap("diameter"))
    last = two["diameter"].values[..., -1]
    for place in ((0, 0), (1, 1), (2, 3)):
        mean, sd = last[place].mean(), last[place].std(ddof=1)
        assert f"{mean:.0f}" in words
        assert any(w.startswith(f"± {sd:#.2g}".rstrip(".")) for w in words)


def test_tiles_tell_what_failed_or_has_not_run(two):
    words = texts(plots(two).heatmap("diameter"))
    assert words.count("failed") == 1
    assert words.count("not run") == 1
    assert sum(w.endswith("4 of 5 seeds") for w in words) == 1


def test_the_end_is_that_of_each_run_and_nothing_is_shown_that_is_gone_then():
    table = grid("law")
    cut = table.copy(deep=True)
    for name in UNITS:
        cut[name].values[0, 0, 21:] = np.nan  # this run ended sooner
    cut["viable_rim"].values[1, 1, -1] = np.nan  # here the core has gone
    assert float(at_end(cut, "diameter")[0, 0]) == table["diameter"].values[0, 0, 20]
    assert np.isnan(float(at_end(cut, "viable_rim")[1, 1]))
    assert np.isfinite(float(at_end(cut, "diameter")[1, 1]))


def test_one_seed_is_said_to_have_no_scatter():
    one = grid(OXYGEN, GLUCOSE, seeds=1)
    words = texts(plots(one).heatmap("diameter"))
    assert not any("±" in word for word in words)
    assert any("one seed: the scatter is unknown" in word for word in words)
    figure = plots(one).curves("diameter")
    assert not any(axes.collections for axes in figure.axes)


def test_an_observable_that_does_not_exist_is_none_and_not_missing():
    table = grid(OXYGEN, GLUCOSE)
    table["viable_rim"].values[0, 0] = np.nan
    assert texts(plots(table).heatmap("viable_rim")).count("none") == 1


@pytest.mark.parametrize("names", [(OXYGEN,), (OXYGEN, "law")])
def test_each_value_of_each_axis_is_named(names):
    table = grid(*names, seeds=2)
    words = " ".join(texts(plots(table).heatmap("diameter")))
    for name in names:
        assert all(text in words for text in axis_scale(table, name).texts)


def test_further_axes_are_held_at_values_that_are_said():
    table = grid(OXYGEN, GLUCOSE, "law", "cycle_time", seeds=1)
    figure = plots(table).heatmap("diameter")
    check_texts(figure)
    words = texts(figure)
    assert any("law hertz, cycle time 8 h" in word for word in words)
    chosen = table["diameter"].sel(
        {"law": "hertz", GLUCOSE: 0.8, OXYGEN: 0.07, "cycle_time": 28800.0}
    )
    assert number_text(float(chosen.isel(seed=0, time=-1))) in words


def test_tiles_too_small_for_numbers_leave_them_to_a_line():
    values = np.arange(24.0)
    coordinates = {"a": ("a", values), "b": ("b", values), "seed": [0, 1]}
    data = values[:, None, None] + values[None, :, None] + np.array([0.0, 2.0])
    states = (("a", "b", "seed"), np.full(data.shape, "done"))
    table = xr.Dataset({"cells": (("a", "b", "seed"), data), "state": states}, coordinates)
    figure = plots(table).heatmap("cells")
    assert not figure.axes[0].texts
    assert any("in the median tile" in word for word in texts(figure))
    assert any("1.4" in word for word in texts(figure) if "median" in word)


def test_bands_are_one_deviation_each_way():
    table = grid("law", seeds=4)
    axes = plots(table).curves("diameter").axes[0]
    bands = [c for c in axes.collections if isinstance(c, PolyCollection)]
    values = table["diameter"].values
    assert len(bands) == len(values)
    for band, line, courses in zip(bands, axes.lines, values, strict=True):
        mean, sd = courses.mean(axis=0), courses.std(axis=0, ddof=1)
        np.testing.assert_allclose(line.get_ydata(), mean)
        height = band.get_paths()[0].vertices[:, 1]
        assert height.max() == pytest.approx((mean + sd).max())
        assert height.min() == pytest.approx((mean - sd).min())


def test_where_a_seed_has_ended_there_is_no_mean_of_the_others():
    table = grid("law", seeds=3)
    for name in UNITS:
        table[name].values[0, 0, 30:] = np.nan
    axes = plots(table).curves("diameter").axes[0]
    first = axes.lines[0].get_ydata()
    assert np.isfinite(first[:30]).all()
    assert np.isnan(first[30:]).all()
    # the others go on as thin lines
    thin = [line for line in axes.lines if line.get_linewidth() < 1.0]
    assert sum(np.isfinite(line.get_ydata()[31:]).all() for line in thin) == 2


def test_values_without_curves_are_told_why():
    failed, waiting = ([(place, k) for k in range(5)] for place in (0, 2))
    words = texts(plots(with_states(grid(OXYGEN), failed, waiting)).curves("diameter"))
    assert "0.07 (failed)" in words
    assert "0.28 (not run)" in words


def test_a_panel_for_each_axis_of_a_sample():
    table = sampled(OXYGEN, GLUCOSE, "law")
    for draw in (plots(table).curves, plots(table).response):
        words = " ".join(texts(draw("diameter")))
        assert all(axis_scale(table, name).label in words for name in axes_of(table))
    with pytest.raises(ValueError, match="no tiles"):
        plots(table).heatmap("diameter")


def test_runs_of_few_seeds_stand_in_front_of_their_bar():
    axes = plots(grid(OXYGEN)).response("diameter").axes[0]
    (container,) = axes.containers
    runs = [line for line in axes.lines if line.get_alpha() is not None]
    assert runs[0].get_zorder() > container.lines[0].get_zorder()
    assert runs[0].get_markersize() > container.lines[0].get_markersize()


def test_points_of_a_sample_stand_at_their_values_with_their_deviation():
    table = sampled(OXYGEN, seeds=3)
    axes = plots(table).response("diameter").axes[0]
    last = table["diameter"].values[..., -1]
    (container,) = axes.containers
    line, _, (bars,) = container
    order = np.argsort(table[OXYGEN].values)
    np.testing.assert_allclose(line.get_xdata(), table[OXYGEN].values[order])
    np.testing.assert_allclose(line.get_ydata(), last.mean(axis=1)[order])
    lengths = [np.ptp(segment[:, 1]) for segment in bars.get_segments()]
    np.testing.assert_allclose(lengths, 2.0 * last.std(axis=1, ddof=1)[order])


def test_of_very_many_points_some_are_drawn_and_that_is_said():
    figure = plots(sampled(OXYGEN, count=230, seeds=2)).curves("diameter")
    assert len(figure.axes[0].lines) == 200
    assert any("200 of 230 points" in word for word in texts(figure))


def test_failed_runs_are_counted_beside_the_points():
    table = with_states(sampled(OXYGEN, GLUCOSE), failed=[(3, 0), (7, 0), (7, 1), (7, 2)])
    assert "failed (4)" in texts(plots(table).response("diameter"))


def test_a_study_of_seeds_alone_has_one_curve():
    table = grid(OXYGEN, seeds=4).isel({OXYGEN: 0}, drop=True)
    figure = plots(table).curves("diameter")
    assert len(figure.axes) == 1
    np.testing.assert_allclose(
        figure.axes[0].lines[0].get_ydata(), table["diameter"].values.mean(axis=0)
    )
    with pytest.raises(ValueError, match="nothing is varied"):
        plots(table).heatmap("diameter")


def test_an_axis_of_one_value_is_not_drawn():
    table = grid(OXYGEN, "law").isel({OXYGEN: [1]})
    assert axes_of(table) == ["law"]
    assert len(plots(table).curves("diameter").axes) == 1


def test_what_is_misspelt_is_told_the_nearest(two):
    with pytest.raises(SceneError, match="Did you mean 'viable_rim'"):
        plots(two).heatmap("viable_rin")
    with pytest.raises(SceneError, match="no course"):
        plots(two.assign(wall=two["cells"].isel(time=0, drop=True))).curves("wall")


PICTURES = {
    "heatmap": lambda p: p.heatmap("viable_rim"),
    "curves": lambda p: p.curves("diameter"),
    "response": lambda p: p.response("cells"),
}


@pytest.mark.parametrize("names", [(OXYGEN,), tuple(AXES)], ids=["one axis", "four"])
@pytest.mark.parametrize("kind", PICTURES)
def test_no_text_leaves_the_picture_or_covers_another(kind, names):
    before = dict(mpl.rcParams)
    check_texts(PICTURES[kind](plots(grid(*names, seeds=2))))
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(
    ("numbers", "log", "ticks"),
    [
        ([0.02, 0.03, 0.05], False, True),
        ([1.0, 1.001, 5.0], False, False),  # labels of the first two would overlap
        ([1.0, 10.0, 100.0], True, True),
        (list(range(1, 10)), False, False),
    ],
)
def test_ticks_stand_at_values_that_ran_where_there_is_room(numbers, log, ticks):
    assert pictures._readable(np.array(numbers, float), log) is ticks


def test_panel_of_an_axis_names_its_values():
    table = grid("oxygen.boundary", seeds=2)
    figure = StudyPlots(table, "A study").response("diameter")
    shown = [label.get_text() for label in figure.axes[0].get_xticklabels()]
    assert shown == list(picture_data.axis_scale(table, "oxygen.boundary").texts)
