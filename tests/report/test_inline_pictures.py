"""Pictures in pages: without their titles, and to be seen in dark mode too."""

import base64
import io
import json
import re
from importlib.resources import files

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from multicell.report.plots.colour_vision import PALE, luminance
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
CARD = np.array(to_rgb(re.search(r"--card:(#\w+)", DARK)[1]))
BRIGHTNESS = float(re.search(r"invert\(1\) hue-rotate\(180deg\) brightness\((.*?)\)", DARK)[1])
# hue-rotate by half a turn, as the specification of filters has it
HUE = np.array([[-0.574, 1.43, 0.144], [0.426, 0.43, 0.144], [0.426, 1.43, -0.856]])


def in_dark_mode(colour):
    """Return what the style sheet makes of a picture's colour on a card: filter, then screen."""
    filtered = np.clip(BRIGHTNESS * np.clip(HUE @ (1.0 - np.array(to_rgb(colour))), 0, 1), 0, 1)
    return 1.0 - (1.0 - filtered) * (1.0 - CARD)


def contrast(colour):
    light, dark = sorted((luminance(in_dark_mode(colour)), luminance(CARD)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def test_white_becomes_the_card_and_pale_marks_stay_pale():
    assert "mix-blend-mode:screen" in DARK
    np.testing.assert_allclose(in_dark_mode("white"), CARD, atol=1e-12)
    assert contrast(PALE) < 3.0


@pytest.mark.parametrize("colour", [INK, QUIET, RED, "#000000", "#333333"])
def test_what_is_written_can_be_read_in_dark_mode(colour):
    assert contrast(colour) >= 4.5


@pytest.mark.parametrize(
    "colour", [BLUE, *STATE_COLOURS.values(), *type_colours(map(str, range(7))).values()]
)
def test_what_is_drawn_can_be_seen_in_dark_mode(colour):
    assert contrast(colour) >= 2.9


def test_the_view_turns_its_colours_as_the_style_sheet_turns_pictures():
    script = (files("multicell.report.viewer") / "viewer.js").read_text()
    matrix = json.loads(re.search(r"TURN = (\[\[.*?\]\])", script)[1])
    np.testing.assert_array_equal(matrix, HUE)
    assert float(re.search(r"const value = ([\d.]+) \*", script)[1]) == BRIGHTNESS


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
    assert shown.subtitle == "what is shown"
    assert drawn[0, 0].tolist() == [255, 255, 255]
