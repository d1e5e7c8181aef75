"""Michaelis-Menten uptake: every formula of it, for numbers, for arrays, and inside kernels.

With the largest uptake V and the half saturation K (mM), uptake at the concentration c (mM) is
V c / (K + c), in the unit of V: amol/s of a cell or a shell, mM/s of a node (Michaelis & Menten
1913).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable


@register_jitable
def uptake(most: Any, c: Any, half: Any) -> Any:
    """Return V c / (K + c) for ``c`` not below zero."""
    return most * c / (half + c)


@register_jitable
def rate(most: Any, c: Any, half: Any) -> Any:
    """Return V / (K + c), the uptake over c, for ``c`` not below zero: in the unit of V over mM."""
    return most / (half + c)


@register_jitable
def uptake_and_slope(most: Any, c: Any, half: Any) -> Any:
    """Return the uptake and its derivative V K / (K + c)², for any ``c``.

    Below zero, where only intermediate iterates can be, uptake continues along its tangent at zero.
    """
    kept = 0.5 * (c + abs(c))  # the larger of c and 0, of numbers and of arrays
    share = half / (half + kept)
    slope = most / (half + kept) * share
    return most * kept / (half + kept) + slope * (c - kept), slope


@register_jitable
def balanced(gain: Any, loss: Any, most: Any, half: Any) -> Any:
    """Return the c at which ``loss`` c + V c / (K + c) is ``gain``.

    - ``gain``, float: in the unit of V; below zero uptake continues along its tangent
    - ``loss``, float: in the unit of V over mM, above zero
    - ``most``, ``half``, float: V and K
    """
    if gain < 0.0:
        return gain / (loss + most / half)
    middle = loss * half + most - gain
    root = np.sqrt(middle * middle + 4.0 * loss * gain * half)
    # of the two forms of the root, the one whose sum does not cancel
    return 2.0 * gain * half / (middle + root) if middle > 0.0 else 0.5 * (root - middle) / loss
