"""Pictures in dark mode: what they hold must be seen, data keep their colours, pages hold both."""

import base64
import io
import re

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from synthetic import SCENE, growing_frames, history_of, spheroid

from multicell.report.plots.colour_vision import PALE
from multicell.report.plots.embedded import embedded
from multicell.report.plots.marks import NAMED
from multicell.report.plots.night import CARD, ON_COLOUR, at_night, darken, luminance
from multicell.report.plots.run import Plots
from multicell.report.plots.style import (
    BLUE,
    COLOURS,
    INK,
    QUIET,
    RED,
    blank,
    styled,
    type_colours,
)
from multicell.report.result import Result, history_arrays


def contrast(colour, ground=CARD):
    light, dark = sorted((luminance(colour), luminance(ground)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("colour", [INK, QUIET, RED, "#000000", "#333333"])
def test_what_is_written_can_be_read_at_night(colour):
    assert contrast(at_night(colour)) >= 4.5


@pytest.mark.parametrize(
    "colour", [BLUE, *COLOURS.values(), *type_colours(map(str, range(7))).values()]
)
def test_what_is_drawn_can_be_seen_at_night(colour):
    assert contrast(at_night(colour)) >= 2.9


def test_paper_becomes_the_page_and_pale_marks_stay_pale():
    assert at_night("#ffffff") == CARD
    assert luminance(at_night("#f4f6f8")) < 0.05
    assert contrast(at_night(PALE)) < 3.0


def test_every_text_of_the_pictures_of_a_run_can_be_read_at_night():
    frames = growing_frames()
    plots = Plots(frames, history_arrays(history_of(frames)), SCENE)
    for figure in (plots.growth(), plots.section(), plots.fields(), plots.profiles()):
        figure.draw_without_rendering()
        darken(figure)
        assert mpl.colors.to_hex(figure.get_facecolor()) == CARD
        for text in figure.findobj(mpl.text.Text):
            if text.get_text() and text.get_visible():
                assert contrast(text.get_color()) >= 4.5, text


def test_what_lies_on_colours_of_numbers_stays():
    figure = Figure()
    axes = figure.add_subplot()
    mesh = axes.pcolormesh(np.arange(4.0).reshape(2, 2), cmap="viridis")
    text = axes.text(0.5, 0.5, "1", color="#22303c", gid=ON_COLOUR)
    figure.draw_without_rendering()
    before = mesh.get_facecolor().copy()
    darken(figure)
    figure.draw_without_rendering()
    np.testing.assert_array_equal(mesh.get_facecolor(), before)
    assert text.get_color() == "#22303c"


@styled
def marked():
    figure = blank("A title that the page has", "what is shown", (6.0, 4.0))
    axes = figure.add_axes((0.2, 0.2, 0.7, 0.6))
    axes.plot([1.0, 2.0], [1.0, 2.0], "o", color="#f04040", ms=12, gid=f"{NAMED}a")
    axes.set(xlim=(0, 3), ylim=(0, 3))
    return figure


def pixels(text):
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB")).astype(int)


def test_a_page_holds_a_picture_without_its_title_and_its_marks_lie_where_they_did():
    shown = embedded(marked())
    for picture in (shown.light, shown.dark):
        drawn = pixels(picture)
        assert drawn.shape == (shown.high, shown.wide, 3)
        assert (shown.wide, shown.high) == (960, 576)
        for mark in shown.marks:
            at = drawn[round(mark.y * shown.high), round(mark.x * shown.wide)]
            np.testing.assert_allclose(at, (0xF0, 0x40, 0x40), atol=40)
    assert len(shown.marks) == 2
    assert pixels(shown.light)[0, 0].tolist() == [255, 255, 255]
    np.testing.assert_allclose(pixels(shown.dark)[0, 0], (0x18, 0x23, 0x2A), atol=2)


def test_a_report_shows_its_pictures_for_both_modes_in_no_more_than_before(tmp_path):
    frames = growing_frames()
    result = Result(None, frames, history_arrays(history_of(frames)), {}, SCENE)
    page = result.report(tmp_path).read_text("utf-8")
    dark = re.findall(r'<source media="\(prefers-color-scheme:dark\)" srcset="([^"]+)"', page)
    light = re.findall(r'<img [^>]*src="([^"]+)"', page)
    assert len(dark) == len(light) == 3
    whole = sum(map(len, dark + light))
    # two pictures with few colours are no larger than the one file of many, in base64
    assert whole < 4 / 3 * sum(path.stat().st_size for path in tmp_path.glob("*.png"))


def test_the_cells_behind_a_section_fade_into_the_page():
    figure = Plots([spheroid(3000)], {}, SCENE).section()
    faded = figure.axes[0].collections[0]
    before = faded.get_facecolor()[:, :3].mean()
    darken(figure)
    assert faded.get_facecolor()[:, :3].mean() < before
