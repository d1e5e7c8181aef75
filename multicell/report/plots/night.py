"""Figures for pages in dark mode: what is paper becomes dark, what is ink light, data keep theirs.

A figure is drawn once, for white paper, and turned afterwards: neutral colours change places
between light and dark, those of the pictures' own palette have a counterpart, and of other colours
only those too dark for a dark page are made lighter. Colours that stand for numbers (images, maps)
stay, and so does what lies on them.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from functools import cache
from typing import TYPE_CHECKING, Any, Final
from weakref import WeakKeyDictionary

import numpy as np
from matplotlib.collections import Collection
from matplotlib.colors import ListedColormap, to_hex, to_rgb, to_rgba
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from multicell.cells import FloatArray

ON_COLOUR: Final = "on colour"
"""The ``gid`` of what lies on colours that stand for numbers, and keeps its own."""
CARD: Final = "#18232a"
"""What white becomes: the colour of a page's cards in dark mode."""
WATER: Final = ListedColormap(np.linspace(to_rgb("#ffffff"), to_rgb("#8fbce0"), 256), "water")
"""Shades of a field behind cells: white to a light blue, against which cells stand out."""

_NIGHT_WATER: Final = ListedColormap(
    np.linspace(to_rgb(CARD), to_rgb("#2f5f8a"), 256), "water at night"
)
_LIGHT: Final = "#e3eaee"
_COUNTERPARTS: Final = {
    "#ffffff": CARD, "#22303c": _LIGHT, "#6b7a86": "#9fb0ba", "#e4e9ed": "#2c3a44",
    "#9aa7b1": "#5f717d", "#b5432f": "#f08f79", "#2f6fb0": "#5b9bd8", "#4b3a5e": "#8f7bad",
    "#200008": "#c0566a", "#fbf1d9": "#38321f", "#f6dfd9": "#43302c", "#faf3f1": "#262425",
}  # fmt: skip
_NEUTRAL: Final = 0.075  # spread of red, green and blue below which a colour is a grey
_CONTRAST: Final = 3.6  # to the card, that marks and letters need at least

_FADED: MutableMapping[Collection, FloatArray] = WeakKeyDictionary()


def fades(drawn: Collection, rgb: FloatArray, share: FloatArray) -> None:
    """Say that the faces of a collection are colours that fade into the paper by these shares."""
    _FADED[drawn] = rgb * (1.0 - share) + share * np.array(to_rgb(CARD))


def luminance(colour: Any) -> float:
    """Return the relative luminance of a colour (WCAG 2)."""
    value = np.array(to_rgb(colour))
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


@cache
def at_night(colour: str) -> str:
    """Return what a colour, as ``#rrggbb``, becomes on a dark page."""
    if colour in _COUNTERPARTS:
        return _COUNTERPARTS[colour]
    value, card = np.array(to_rgb(colour)), np.array(to_rgb(CARD))
    if np.ptp(value) < _NEUTRAL:
        return _hex(card + (1.0 - value.mean()) * (np.array(to_rgb(_LIGHT)) - card))
    paper = luminance(CARD) + 0.05
    share = 0.0
    while (luminance(value + share * (1.0 - value)) + 0.05) / paper < _CONTRAST:
        share += 0.05
    return _hex(value + share * (1.0 - value))


def _hex(rgb: FloatArray) -> str:
    red, green, blue = map(float, rgb)
    return to_hex((red, green, blue))


def darken(figure: Figure) -> None:
    """Turn a figure that was drawn on white into one for a dark page."""
    for image in figure.findobj(AxesImage):
        _darken_image(image)
    for drawn in figure.findobj(_turned):
        if drawn.get_gid() != ON_COLOUR:
            _darken(drawn)


def _turned(drawn: Any) -> bool:
    return isinstance(drawn, Text | Line2D | Patch | Collection)


def _darken_image(image: Any) -> None:
    if image.get_cmap().name == WATER.name:
        image.set_cmap(_NIGHT_WATER)
        face = image.axes.get_facecolor()
        share = (1.0 - face[0]) / (1.0 - to_rgb("#8fbce0")[0])
        image.axes.set_facecolor(_NIGHT_WATER(min(1.0, share)))
        image.axes.patch.set_gid(ON_COLOUR)


def _darken(drawn: Any) -> None:
    """Change the colours of one artist."""
    if isinstance(drawn, Text):
        drawn.set_color(_rgba(drawn.get_color()))
        box = drawn.get_bbox_patch()
        if box is not None:
            _darken(box)
    elif isinstance(drawn, Line2D):
        faces = drawn.get_markerfacecolor(), drawn.get_markeredgecolor()
        drawn.set_color(_rgba(drawn.get_color()))
        drawn.set_markerfacecolor(_rgba(faces[0]))
        drawn.set_markeredgecolor(_rgba(faces[1]))
    elif isinstance(drawn, Patch):
        faces = drawn.get_facecolor(), drawn.get_edgecolor()
        drawn.set_facecolor(_rgba(faces[0]))
        drawn.set_edgecolor(_rgba(faces[1]))
    else:
        edges = [_rgba(colour) for colour in drawn.get_edgecolor()]
        if drawn in _FADED:
            drawn.set_facecolor(_FADED[drawn])
        elif drawn.get_array() is None:
            drawn.set_facecolor([_rgba(colour) for colour in drawn.get_facecolor()])
        drawn.set_edgecolor(edges)


def _rgba(colour: Any) -> Any:
    """Return a colour by night, as opaque as it was."""
    if isinstance(colour, str) and colour == "none":
        return colour
    red, green, blue, opaque = to_rgba(colour)
    return (*to_rgb(at_night(to_hex((red, green, blue)))), opaque)
