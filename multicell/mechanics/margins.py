"""How much room the neighbour list leaves round each cell.

A list lasts until some cell has drifted by its margin. Where few cells move it is they for whom it
must be mended again and again, and room round them costs little: each cell's margin is a multiple
of its drift since the last list, but not below half of what it was.
"""

from __future__ import annotations

import math

from numba import njit

from multicell.compiling import INLINED

_WIDEST = 8.0  # largest margin of a cell over the least
FORESIGHT, REPAIR_FORESIGHT = 6.0, 3.0
"""How many times as far as since the last list a cell may move until the next one: where that is
built, and where it is repaired, which costs less."""


@njit(**INLINED)
def square_drift(position, reference, i):
    """Return the square of how far cell i is from where it was at the last list, µm²."""
    x = position[i, 0] - reference[i, 0]
    y = position[i, 1] - reference[i, 1]
    z = position[i, 2] - reference[i, 2]
    return x * x + y * y + z * z


@njit(**INLINED)
def widened(margin, foresight, square, least):
    """Return the margin of a cell for the next list, µm.

    ``least`` is the smallest one, ``square`` that of :func:`square_drift`, not a number where there
    was no list.
    """
    wanted = foresight * math.sqrt(square)
    if wanted == wanted:
        return max(least, min(max(wanted, 0.5 * margin), _WIDEST * least))
    return margin
