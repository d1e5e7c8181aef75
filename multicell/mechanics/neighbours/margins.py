"""Margins: how far each cell may drift from where it was when the list was built."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from multicell.compiling import INLINED, arithmetic

WIDEST = 8.0  # largest margin of a cell over the least
_FORESIGHT = 6.0  # how many times as far as since the last list a cell may move until the next one


@njit(**INLINED)
def next_margin(square, least, margin):
    """Return a cell's margin after it has drifted by the root of ``square``, µm."""
    return max(least, min(max(_FORESIGHT * math.sqrt(square), 0.5 * margin), WIDEST * least))


@arithmetic
def widened(position, reference, reach, least, margin):
    """Adapt the margins of the cells to how they move, and note where they are.

    Return the radii to build a list with.

    A list lasts until some cell has drifted by its margin. Where few cells move it is they for
    whom it is built again and again, and room round them costs little: each cell's margin is a
    multiple of its drift since the last list, but not below half of what it was.

    - ``position``, (n, 3), µm: now
    - ``reference``, (n, 3), µm: at the last list, not a number where there was none; changed to
      ``position``
    - ``reach``, (n,), µm: half of the distance within which a pair matters
    - ``least``, float, µm: smallest margin
    - ``margin``, (n,), µm: how far each cell may drift; changed in place

    Returns (n,), µm: ``reach`` + ``margin``.
    """
    wide = np.empty_like(reach)
    for i in range(reach.size):
        square = 0.0
        for a in range(3):
            square += (position[i, a] - reference[i, a]) ** 2
            reference[i, a] = position[i, a]
        # not a number where there was no list: the margin stays
        if square == square:
            margin[i] = next_margin(square, least, margin[i])
        wide[i] = reach[i] + margin[i]
    return wide
