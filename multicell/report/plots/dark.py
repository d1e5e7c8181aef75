"""Dark mode of pictures: light letters on a dark card, and states in the colours that they have.

Necrotic and apoptotic cells are nearly black. Where cells are drawn themselves, the ground under
them stays light; elsewhere such an area gets a light edge.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import Collection, QuadMesh
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.text import Text

from multicell.report.colours import STATE_COLOURS, TYPE_COLOURS
from multicell.report.plots.colour_vision import luminance

Rgba = tuple[float, float, float, float]

CARD: Final = "#18232a"
"""Ground of a card in dark mode, as in ``style.css``."""
GROUND: Final = "ground"
"""The ``gid`` of axes whose ground stays light: cells themselves are drawn on it."""
STAGE: Final = "#eef3f7"
"""The same ground where no field is drawn, as that of the 3D view."""
_EDGE: Final = "#9fb0ba"  # of what would be lost on the card
_INK: Final = "#e3eaee"
_LEAST: Final = 3.0  # contrast with the card that WCAG 2 asks of graphics
_READ: Final = 4.5  # and of letters
_PALE: Final = 0.8  # mean of red, green and blue above which a colour is of what stands behind
_GREY: Final = 0.12  # range of red, green and blue below which a colour is one of ink and paper
_SEEN: Final = 0.4  # opacity from which on a mark is judged as it looks on the card
_SAME: Final = frozenset(to_hex(colour) for colour in (*STATE_COLOURS.values(), *TYPE_COLOURS))
_LOST: Final = frozenset(to_hex(STATE_COLOURS[name]) for name in ("necrotic", "apoptotic"))


def contrast(colour: Any) -> float:
    """Return the contrast of a colour with the card after WCAG 2, 1 to 21."""
    low, high = sorted((luminance(colour), luminance(CARD)))
    return (high + 0.05) / (low + 0.05)


def in_dark(colour: Any, least: float = _LEAST) -> Rgba:
    """Return the red, green, blue and opacity of a colour on a dark card.

    States and types stay. Ink and paper change places, and so do the greys between them. What is
    too dark to be seen then is mixed with white until it is not.
    """
    return _in_dark(to_rgba(colour), least)


@cache
def _in_dark(rgba: Rgba, least: float) -> Rgba:
    rgb, opacity = np.array(rgba[:3]), rgba[3]
    if to_hex(rgba) in _SAME:
        return rgba
    pale = rgb.mean() > _PALE
    if np.ptp(rgb) < _GREY:
        card, ink = (np.array(to_rgba(name)[:3]) for name in (CARD, _INK))
        share = min(1.0, 1.15 * (1.0 - rgb.mean()))  # what is nearly black is ink
        rgb = card + share * (ink - card)
    ground, seen = np.array(to_rgba(CARD)[:3]), opacity if opacity >= _SEEN else 1.0
    while not pale and contrast(ground + seen * (rgb - ground)) < least and rgb.min() < 0.99:
        rgb = rgb + 0.05 * (1.0 - rgb)
    red, green, blue = rgb.tolist()
    return red, green, blue, opacity


def darken(figure: Figure) -> None:
    """Give a figure the colours of dark mode."""
    for artist in list(_artists(figure, None)):
        _recolour(artist)
    for axes in figure.axes:
        if axes.get_gid() == GROUND and to_hex(axes.get_facecolor()) == "#ffffff":
            axes.set_facecolor(STAGE)


def _artists(artist: Artist, home: Axes | None) -> Iterator[Artist]:
    """Yield all artists below one but what is drawn in axes that keep their colours."""
    for child in artist.get_children():
        if artist is home and _stays(home, child):
            continue
        if not isinstance(child, Axes):
            yield child
        yield from _artists(child, child if isinstance(child, Axes) else home)


def _stays(axes: Axes, child: Artist) -> bool:
    """Return whether axes keep what is drawn in them: cells, or letters on tiles of a map."""
    kept = axes.get_gid() == GROUND or any(isinstance(c, QuadMesh) for c in axes.collections)
    title = isinstance(child, Text) and child.get_text() == axes.get_title(loc="left")
    return kept and not title and not isinstance(child, (Axes, Axis))  # these stand on the card


def _recolour(artist: Artist) -> None:
    if isinstance(artist, Text):
        artist.set_color(in_dark(artist.get_color(), _READ))
    elif isinstance(artist, Line2D):
        lost = to_hex(artist.get_color()) in _LOST
        marker, edge = (
            in_dark(to_rgba(colour, artist.get_alpha()))
            for colour in (artist.get_markerfacecolor(), artist.get_markeredgecolor())
        )
        artist.set_color(in_dark(to_rgba(artist.get_color(), artist.get_alpha())))
        artist.set_markerfacecolor(marker)
        artist.set_markeredgecolor(edge)
        if lost:
            wide = artist.get_linewidth() + 1.6
            artist.set_path_effects([withStroke(linewidth=wide, foreground=_EDGE)])
    elif isinstance(artist, Patch):
        lost = to_hex(artist.get_facecolor()) in _LOST
        border: Any = _EDGE if lost else in_dark(artist.get_edgecolor())
        artist.set_facecolor(in_dark(artist.get_facecolor()))
        artist.set_edgecolor(border)
        if lost:
            artist.set_linewidth(0.8)
    elif isinstance(artist, Collection) and artist.get_array() is None:
        faces, edges = artist.get_facecolor(), artist.get_edgecolor()
        lost = any(to_hex(face) in _LOST for face in np.atleast_2d(faces))
        artist.set_facecolor(_all(faces))
        artist.set_edgecolor(_EDGE if lost else _all(edges))
        if lost:
            artist.set_linewidth(0.8)


def _all(colours: Any) -> list[Rgba] | str:
    """Return many colours on a dark card; ``"none"`` of none."""
    return [in_dark(one) for one in np.atleast_2d(colours)] if len(colours) else "none"
