"""Colour vision: contrast of colours, also without the pigment for green (deuteranopia)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from multicell.cells import FloatArray

PALE: Final = "#d3d9de"
"""Grey of what stands behind the series in colour."""

APART: Final = 12.0
"""Least distance in CIELAB of two colours of one chart, as a deuteranope sees them."""

SPARE: Final = (
    "#ea76e4",
    "#117fff",
    "#ff9500",
    "#adb196",
    "#0000ff",
    "#004a34",
    "#223979",
    "#9d3204",
)
"""Colours for series without one of their own, more than twice `APART` from each other: each
series that is there rules out one of them at most, so that the eighth still finds one."""

# linear sRGB of a deuteranope: Machado, Oliveira & Fernandes 2009, doi:10.1109/TVCG.2009.113
_DEUTERANOPE: Final = np.array(
    [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]
)
# linear sRGB -> CIE XYZ, white D65 (IEC 61966-2-1)
_XYZ: Final = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


def luminance(colour: Any) -> float:
    """Return the relative luminance of a colour (WCAG 2)."""
    return float(_linear(colour) @ (0.2126, 0.7152, 0.0722))


def _linear(colour: Any) -> FloatArray:
    """Return red, green and blue without sRGB's gamma, (3,)."""
    from matplotlib.colors import to_rgb

    value = np.array(to_rgb(colour))
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def cielab(colour: str, *, deuteranope: bool = False) -> FloatArray:
    """Return L*, a*, b* (CIE 1976, white D65), (3,), of a colour as matplotlib names it."""
    linear = _linear(colour)
    if deuteranope:
        linear = np.clip(_DEUTERANOPE @ linear, 0.0, 1.0)
    ratio = _XYZ @ linear / _XYZ.sum(axis=1)
    delta = 6.0 / 29.0
    x, y, z = np.where(ratio > delta**3, np.cbrt(ratio), ratio / (3.0 * delta**2) + 4.0 / 29.0)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def distance(first: str, second: str) -> float:
    """Return the smaller distance in CIELAB: to common eyes, or to those of a deuteranope."""
    return min(
        float(np.linalg.norm(cielab(first, deuteranope=blind) - cielab(second, deuteranope=blind)))
        for blind in (False, True)
    )


def distinguishable_colours(wanted: Mapping[str, str]) -> dict[str, str]:
    """Return a colour for each name: its own, or a spare one where that is like another's.

    - ``wanted``: name -> colour, which may be empty; the first ones keep theirs. Up to eight
      colours, and `PALE`, are at least `APART` from each other; of more, some may be closer.
    """
    given: dict[str, str] = {}
    for name, own in wanted.items():
        taken, choice = [PALE, *given.values()], [own, *SPARE] if own else SPARE
        nearest = {c: min(distance(c, other) for other in taken) for c in choice}
        apart = (colour for colour, least in nearest.items() if least >= APART)
        given[name] = next(apart, max(nearest, key=nearest.__getitem__))
    return given
