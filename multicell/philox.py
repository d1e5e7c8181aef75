"""The block function of Philox4x64-10, compiled; what it is for stands in :mod:`multicell.random`.

In arrays of NumPy the hundreds of operations of a block cost more than all else that a division
of few cells does.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_OPTIONS: dict[str, Any] = {"cache": True, "no_cfunc_wrapper": True}
_INNER: dict[str, Any] = {"no_cpython_wrapper": True}
_ROUNDS = 10  # ten rounds: Philox4x64-10 of the paper
_LOW, _HALF = np.uint64(0xFFFFFFFF), np.uint64(32)  # half a word, and its bits
# the multipliers and the key increments of the paper (golden ratio, sqrt(3) - 1)
_FIRST, _SECOND = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_WEYL_0, _WEYL_1 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)


@njit(**_OPTIONS, **_INNER)
def _high(a, b):
    """Return the high word of the 128-bit product of two words."""
    a_high, a_low = a >> _HALF, a & _LOW
    b_high, b_low = b >> _HALF, b & _LOW
    middle = a_high * b_low + ((a_low * b_low) >> _HALF)
    other = a_low * b_high + (middle & _LOW)
    return a_high * b_high + (middle >> _HALF) + (other >> _HALF)


@njit(**_OPTIONS)
def philox_blocks(counter, key_0, key_1, out):
    """Write the random words of each counter to ``out``; both (4, m) uint64."""
    for k in range(counter.shape[1]):
        x0, x1, x2, x3 = counter[0, k], counter[1, k], counter[2, k], counter[3, k]
        k0, k1 = key_0, key_1
        for _ in range(_ROUNDS):
            x0, x1, x2, x3 = (
                _high(_SECOND, x2) ^ x1 ^ k0,
                _SECOND * x2,
                _high(_FIRST, x0) ^ x3 ^ k1,
                _FIRST * x0,
            )
            k0, k1 = k0 + _WEYL_0, k1 + _WEYL_1
        out[0, k], out[1, k], out[2, k], out[3, k] = x0, x1, x2, x3
