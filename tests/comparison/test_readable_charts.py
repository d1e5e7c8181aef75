"""Charts that can be read: few colours, told apart by everyone, axes that end with the data."""

import itertools
import math
import re
from html import unescape

import numpy as np
import pytest
from matplotlib.colors import to_hex
from two_cells import EXACT, PAIR, ladders, result_of

from multicell.comparison.measure import TimedPoint, time_again
from multicell.comparison.replay import Trajectory
from multicell.comparison.styles import (
    MAX_COLOURED,
    ChartPoint,
    appearance,
    in_colour,
    pareto_front,
    points,
)
from multicell.integrators.registry import METHODS
from multicell.report.plots.colour_vision import (
    APART,
    PALE,
    SPARE,
    cielab,
    distance,
    distinguishable_colours,
)


def crowd(count):
    return result_of(ladders([f"method {k}" for k in range(count)]))


def series(axes):
    """Return the lines of the methods by name."""
    return {line.get_label(): line for line in axes.lines}


def panels(figure):
    return [axes for axes in figure.axes if axes.get_label() != "failures"]


# which series are in colour


@pytest.mark.parametrize("count", [1, 9])
def test_at_most_eight_series_are_coloured_and_all_are_drawn(count):
    result = crowd(count)
    for axes in panels(result.figure()):
        lines = series(axes)
        assert set(lines) == set(result.methods)
        coloured = [n for n, line in lines.items() if to_hex(line.get_color()) != PALE]
        assert len(coloured) == min(count, MAX_COLOURED)
        colours = {to_hex(line.get_color()) for line in lines.values()}
        assert len(colours) == len(coloured) + (count > MAX_COLOURED)
        assert all(distance(a, b) >= APART for a, b in itertools.combinations(colours, 2))
        front = min(line.get_zorder() for n, line in lines.items() if n in coloured)
        pale = [line.get_zorder() for n, line in lines.items() if n not in coloured]
        assert all(zorder < front for zorder in pale)


def test_the_front_is_what_no_other_solve_beats():
    rng = np.random.default_rng(0)
    solves = [ChartPoint(str(k), *10.0 ** rng.uniform(-3, 0, 2), 0.0, 0.0) for k in range(200)]
    expected = [
        p
        for p in solves
        if not any(q.cost <= p.cost and q.error <= p.error and q != p for q in solves)
    ]
    assert pareto_front(solves) == sorted(expected, key=lambda p: p.cost)


@pytest.mark.parametrize("seed", range(2))
def test_methods_on_the_front_are_always_coloured(seed):
    rng = np.random.default_rng(seed)
    names = [f"method {k}" for k in range(20)]
    solves = [(name, *10.0 ** rng.uniform(-2, 1, 2)) for name in names for _ in range(2)]
    result = result_of(solves, named=names[::-1])
    holders = {p.method for p in pareto_front(points(result, "position", "wall"))}
    assert len(holders) <= MAX_COLOURED
    assert holders <= set(in_colour(result, "position"))
    # the rest are those that the user named, in that order
    named = [name for name in names[::-1] if name not in holders]
    assert in_colour(result, "position")[len(holders) :] == named[: MAX_COLOURED - len(holders)]


def test_after_the_front_come_the_default_and_auto_and_outside_references_last():
    names = [*METHODS, "my own"]
    solves = [("my own", 1e-3, 1e-6), *((name, 1.0, 1e-2) for name in METHODS)]
    kept = in_colour(result_of(solves), "position")
    assert PAIR.integrator.method == "auto"
    assert kept[:2] == ["my own", "auto"]
    outside = [name for name in names if name in METHODS and METHODS[name].outside]
    assert outside
    assert not set(outside) & set(kept)


# colours


def test_distances_are_those_of_cielab():
    # values of CIE 15:2004 for the primaries of sRGB under D65
    assert cielab("#ff0000") == pytest.approx([53.24, 80.09, 67.20], abs=0.02)
    assert cielab("#0000ff") == pytest.approx([32.30, 79.19, -107.86], abs=0.02)
    assert cielab("white") == pytest.approx([100.0, 0.0, 0.0], abs=0.01)
    # without the pigment for green, red and green come close; black and white do not
    assert distance("#b08a00", "#7fa000") < 0.6 * np.linalg.norm(
        cielab("#b08a00") - cielab("#7fa000")
    )
    assert distance("black", "white") == pytest.approx(100.0, abs=0.1)


def test_all_methods_have_colours_of_their_own_that_a_deuteranope_tells_apart():
    colours = {name: info.colour for name, info in METHODS.items()} | {"pale": PALE}
    for (one, a), (other, b) in itertools.combinations(colours.items(), 2):
        assert distance(a, b) >= APART, (one, other)
    assert distinguishable_colours({name: colours[name] for name in METHODS}) == {
        name: info.colour for name, info in METHODS.items()
    }


def test_a_spare_colour_is_left_for_every_one_of_eight_series():
    for a, b in itertools.combinations(SPARE, 2):
        assert distance(a, b) > 2.0 * APART
    rng = np.random.default_rng(0)
    for _ in range(20):
        wanted = {f"{k}": to_hex(rng.uniform(0.3, 0.45, 3)) for k in range(5)}
        given = distinguishable_colours(wanted | {"x": "", "y": "", "z": "#d3d9de"})
        assert given["0"] == wanted["0"]
        for a, b in itertools.combinations([PALE, *given.values()], 2):
            assert distance(a, b) >= APART


# axes


@pytest.mark.parametrize("uncertainty", [1e-3, math.nan])
def test_axes_end_where_the_data_end_and_decades_are_squares(uncertainty):
    result = result_of(
        ladders(["a", "b"]), [("a", 1e-6), ("b", 1e5), ("b", 2.0)], uncertainty=uncertainty
    )
    figure = result.figure()
    for axes in panels(figure):
        x, y = (
            np.concatenate(part) for part in zip(*map(data, series(axes).values()), strict=True)
        )
        for values, ends in ((x, axes.get_xlim()), (y, axes.get_ylim())):
            assert 1.0 <= values.min() / ends[0] < 1.5
            assert 1.0 <= ends[1] / values.max() < 1.5
        figure.draw_without_rendering()
        box = axes.get_window_extent()
        wide, high = (math.log10(b / a) for a, b in (axes.get_xlim(), axes.get_ylim()))
        assert box.width / wide == pytest.approx(box.height / high, rel=1e-6)
        assert 0.0 < box.x0 < box.x1 < figure.bbox.width
        assert 0.0 < box.y0 < box.y1 < figure.bbox.height


def data(line):
    return np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)


def test_failures_beyond_the_axis_are_triangles_at_its_ends():
    figure = result_of(ladders(["a", "b"]), [("a", 1e-6), ("b", 1e5), ("b", 2.0)]).figure()
    strip = next(axes for axes in figure.axes if axes.get_label() == "failures")
    panel = panels(figure)[0]
    assert strip.get_xlim() == panel.get_xlim()
    ends = [float(c.get_offsets()[0][0]) for c in strip.collections]
    assert ends == pytest.approx(list(panel.get_xlim()))


def test_one_method_with_one_solve_is_drawn():
    figure = result_of([("only", 1.0, 1e-3)]).figure()
    for axes in panels(figure):
        low, high = axes.get_xlim()
        assert 2.0 < high / low < 10.0
        assert len(series(axes)["only"].get_xdata()) == 1


def test_failures_only_and_exact_zeros_are_drawn():
    failures = result_of([], [("a", 0.1), ("b", 10.0)])
    strip = next(axes for axes in failures.figure().axes if axes.get_label() == "failures")
    low, high = strip.get_xlim()
    assert low < 0.1 < 10.0 < high
    assert {line.get_label() for line in strip.lines} == {"a failed", "b failed"}
    zeros = result_of([("a", 0.1, 0.0)])
    for axes in panels(zeros.figure()):
        assert [text.get_text() for text in axes.texts] == ["no error above zero"]
    for result in (failures, zeros):
        assert any(result.page()["verdicts"]["position"].values()) == (result is zeros)


# spread of the repeats


def test_points_are_medians_with_bars_from_the_shortest_to_the_longest(monkeypatch):
    walls = iter([5.0, 4.0, 9.0])
    monkeypatch.setattr(
        "multicell.comparison.measure.replay",
        lambda *_: Trajectory([], None, next(walls), cpu=1.0),
    )
    result = result_of([("a", 2.0, 1e-2)])
    row = result.table[0]
    time_again([TimedPoint(row, EXACT, 100.0, 2.0, [(2.0, 1.5)])], None, 4)
    assert (row["wall"], row["wall_median"], row["wall_longest"]) == (2.0, 4.5, 9.0)
    assert (row["cpu"], row["cpu_longest"]) == (1.0, 1.5)
    panel = panels(result.figure())[0]
    assert series(panel)["a"].get_xdata() == pytest.approx([4.5])
    (bars,) = panel.collections
    np.testing.assert_allclose(bars.get_segments(), [[[2.0, 1e-2], [9.0, 1e-2]]])
    assert panel.get_xlim()[0] < 2.0 < 9.0 < panel.get_xlim()[1]


# the page


@pytest.mark.slow
def test_every_pale_series_is_named_in_the_page(tmp_path):
    result = result_of(ladders(["<b>mine</b>", *(f"method {k}" for k in range(14))]))
    page = result.save(tmp_path).read_text(encoding="utf-8")
    pale = [name for name, (colour, _, _) in appearance(result).items() if colour == PALE]
    assert len(pale) == 15 - MAX_COLOURED
    keys = re.search(r'<ul class="keys">(.*?)</ul>', page, re.S)[1]
    shown = re.findall(r"background:(#\w+)[^>]*></span>([^<]+)</li>", keys)
    assert {unescape(name): colour for colour, name in shown} == {
        name: colour for name, (colour, _, _) in appearance(result).items()
    }
    assert "<script" not in page
    assert "<b>mine" not in page
