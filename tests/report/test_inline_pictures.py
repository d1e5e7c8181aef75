"""Pictures in pages: without their titles, and to be seen in dark mode too."""

import base64
import io
import re
from importlib.resources import files

import numpy as np
import pytest
from letters import smallest_letters
from matplotlib.colors import to_hex, to_rgb

from multicell.integrators.registry import METHODS
from multicell.report.plots import style
from multicell.report.plots.colour_vision import PALE
from multicell.report.plots.dark import CARD, STAGE, contrast, darken, in_dark
from multicell.report.plots.section import draw_discs, frame_window
from multicell.report.plots.style import (
    BLUE,
    INK,
    QUIET,
    RED,
    STATE_COLOURS,
    blank,
    inline_picture,
    styled,
    type_colours,
)

STYLE = (files("multicell.report") / "templates" / "style.css").read_text()
DARK = STYLE[STYLE.index("prefers-color-scheme:dark") :]


def test_white_becomes_the_card_and_pale_marks_stay_pale():
    assert re.search(r"--card:(#\w+)", DARK)[1] == CARD
    assert to_hex(in_dark("white")) == CARD
    assert contrast(in_dark(PALE)) < 3.0


@pytest.mark.parametrize("colour", [INK, QUIET, RED, "#000000", "#333333", BLUE])
def test_what_is_written_can_be_read_in_dark_mode(colour):
    assert contrast(in_dark(colour, 4.5)) >= 4.5


@pytest.mark.parametrize("colour", [BLUE, RED, INK, *(m.colour for m in METHODS.values())])
def test_what_is_drawn_can_be_seen_in_dark_mode(colour):
    assert contrast(in_dark(colour)) >= 3.0


@pytest.mark.parametrize(
    "colour", [*STATE_COLOURS.values(), *type_colours(map(str, range(7))).values()]
)
def test_states_and_types_keep_their_colours_in_dark_mode(colour):
    assert to_hex(in_dark(colour)) == colour


@pytest.mark.parametrize("opacity", [0.4, 0.6, 1.0])
def test_what_is_half_transparent_can_be_seen_in_dark_mode(opacity):
    figure = blank("", "", (4.0, 3.0))
    [line] = figure.subplots().plot([1, 2], [1, 2], "o-", color=BLUE, alpha=opacity)
    darken(figure)
    card = np.array(to_rgb(CARD))
    for colour in (line.get_color(), line.get_markerfacecolor()):
        assert contrast(card + opacity * (np.array(to_rgb(colour)) - card)) >= 3.0


def test_paper_is_light_whatever_the_screen():
    """Browsers print with the colours of the screen where a page does not say otherwise."""
    assert re.findall(r"@media ([^{]*prefers-color-scheme[^{]*)\{", STYLE) == [
        "screen and (prefers-color-scheme:dark) "
    ]


def test_view_has_the_colours_of_the_pictures_in_both_modes():
    script = (files("multicell.report.viewer") / "viewer.js").read_text()
    assert "prefers-color-scheme" not in script
    assert "--stage" not in STYLE
    assert f"background:{STAGE}" in STYLE
    assert "filter:" not in STYLE


@styled
def mixed():
    """Draw cells, dead ones among them, beside a curve, bars and letters."""
    figure = blank("A title", "what is shown", (6.0, 4.0))
    ground, chart = figure.subplots(1, 2)
    frame_window(ground, np.zeros(3), 10.0)
    rgb = np.array([to_rgb(colour) for colour in STATE_COLOURS.values()])
    place = np.array([[-5.0, 5.0], [5.0, 5.0], [-5.0, -5.0], [5.0, -5.0]])
    draw_discs(ground, place, np.full(4, 4.0), rgb)
    ground.set_title("cells")
    chart.bar([1, 2], [1, 2], color=[STATE_COLOURS["necrotic"], STATE_COLOURS["quiescent"]])
    chart.plot([1, 2], [1, 2], color=INK)
    chart.set_xlabel("time")
    return figure


def test_dark_mode_keeps_cells_on_a_light_ground_and_edges_what_would_be_lost():
    figure = mixed()
    ground, chart = figure.axes
    before = ground.collections[0].get_facecolor().copy()
    darken(figure)
    assert to_hex(figure.get_facecolor()) == CARD
    assert to_hex(ground.get_facecolor()) == STAGE
    np.testing.assert_array_equal(ground.collections[0].get_facecolor(), before)
    assert contrast(ground._left_title.get_color()) > 4.5
    assert to_hex(chart.get_facecolor()) == CARD
    dead, alive = chart.patches
    assert [to_hex(bar.get_facecolor()) for bar in (dead, alive)] == [
        STATE_COLOURS["necrotic"],
        STATE_COLOURS["quiescent"],
    ]
    assert contrast(dead.get_edgecolor()) > 4.5
    assert contrast(chart.lines[0].get_color()) > 4.5
    assert contrast(chart.xaxis.label.get_color()) > 4.5


def test_letters_on_tiles_stay():
    figure = mixed()
    chart = figure.axes[1]
    chart.pcolormesh(np.arange(4.0).reshape(2, 2))
    on_tile = chart.text(0.5, 0.5, "3.2", color=INK)
    darken(figure)
    assert on_tile.get_color() == INK
    assert contrast(chart.xaxis.label.get_color()) > 4.5


def test_small_letters_are_noticed():
    figure = mixed()
    figure.text(0.5, 0.5, "tiny", fontsize=3.0)
    size, text = smallest_letters(figure)
    assert text == "tiny"
    assert size == pytest.approx(3.0 * 1004 / 96 / 6.0)
    with pytest.raises(AssertionError, match="tiny"):
        style.inline_picture(figure)


@styled
def titled():
    figure = blank("A title that the page has", "what is shown", (6.0, 4.0))
    axes = figure.add_axes((0.2, 0.2, 0.7, 0.6))
    axes.plot([1.0, 2.0], [1.0, 2.0], "o", color="#f04040", ms=12)
    axes.set(xlim=(0, 3), ylim=(0, 3))
    return figure


def pixels(text):
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB")).astype(int)


def test_a_page_holds_a_picture_without_its_title():
    shown = inline_picture(titled())
    drawn = pixels(shown.png)
    assert drawn.shape == (shown.high, shown.wide, 3)
    assert (shown.wide, shown.high) == (960, 576)
    night = pixels(shown.dark)
    assert night.shape == drawn.shape
    assert night[0, 0].tolist() == [0x18, 0x23, 0x2A]
    assert shown.subtitle == "what is shown"
    assert drawn[0, 0].tolist() == [255, 255, 255]


def test_the_file_beside_a_page_is_the_picture_with_its_title(tmp_path):
    path = tmp_path / "picture.png"
    inline_picture(titled(), path)
    assert path.read_bytes() == style.render(titled(), "png")
