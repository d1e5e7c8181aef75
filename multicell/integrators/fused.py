"""Arithmetic of a step on whole populations, each in one pass that threads share.

Memory is what takes the time of many cells, so that a step is made of few passes over it. Each
works through chunks of cells and notes a result for each of them. The caller combines these in the
order of the chunks, so that any number of threads gives the same bits.

Like the kernels of forces the passes are compiled once, and called by loops at an address. Python
calls them for one thread.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import prange, types
from numba.extending import overload

from multicell.cells import FloatArray
from multicell.compiling import arithmetic, called_at
from multicell.compiling.threads import two_drivers

_CHUNK = 4096  # cells in a chunk
_BLOCK = 64  # cells whose divisions the vector units do together
_AMOUNT, _CELL = range(2)  # columns of what is found for a chunk


@arithmetic
def chunks(position):
    """Return room for what is found for each chunk of cells, (chunks, 2)."""
    return np.empty((-(-position.shape[0] // _CHUNK), 2))


def _foresee(a, u, b, v, position, radius, out, found):
    """Write position + a u + b v; note of each chunk of cells how far one moves in its radius.

    ``found`` is (chunks, 2): the largest square, not a number counting as infinite, and its cell.
    """
    for c in prange(found.shape[0]):
        most, cell = -1.0, c * _CHUNK
        for i in range(c * _CHUNK, min((c + 1) * _CHUNK, position.shape[0])):
            x = a * u[i, 0] + b * v[i, 0]
            y = a * u[i, 1] + b * v[i, 1]
            z = a * u[i, 2] + b * v[i, 2]
            out[i, 0] = position[i, 0] + x
            out[i, 1] = position[i, 1] + y
            out[i, 2] = position[i, 2] + z
            square = (x * x + y * y + z * z) / (radius[i] * radius[i])
            if not square <= most:
                most, cell = square if square == square else math.inf, i
        found[c, _AMOUNT], found[c, _CELL] = most, cell
    return found.shape[0]


def _assess(a, new, b, now, c, old, position, trial, rtol, atol, found):
    """Weigh the error a new + b now + c old of a step, slopes; note the part of each chunk.

    ``found`` is (chunks, 2): its first column is given the sums of squares over the tolerance.
    """
    u, v, w = new.reshape(-1), now.reshape(-1), old.reshape(-1)
    before, after = position.reshape(-1), trial.reshape(-1)
    for k in prange(found.shape[0]):
        part = np.empty(3 * _BLOCK)
        # three sums, so that none waits for the other
        x, y, z = 0.0, 0.0, 0.0
        end = np.uint64(3 * min((k + 1) * _CHUNK, position.shape[0]))
        for first in range(np.uint64(3 * k * _CHUNK), end, np.uint64(3 * _BLOCK)):
            size = min(np.uint64(3 * _BLOCK), end - first)
            for i in range(size):  # by the vector units, which sums in their order are not for
                p = first + i
                share = atol + rtol * max(abs(before[p]), abs(after[p]))
                part[i] = (a * u[p] + b * v[p] + c * w[p]) / share
            for i in range(np.uint64(0), size, np.uint64(3)):
                p, q, r = part[i], part[i + np.uint64(1)], part[i + np.uint64(2)]
                x, y, z = x + p * p, y + q * q, z + r * r
        found[k, _AMOUNT] = x + y + z
    return found.shape[0]


_FORESEE, _ASSESS = two_drivers(_foresee), two_drivers(_assess)


def fused_kernels(radius: FloatArray, *, shared: bool) -> dict[str, tuple[Any, ...]]:
    """Return the passes, for one thread or for all, as ``compiling.address_of`` takes them."""
    place, found = np.empty((0, 3)), np.empty((0, 2))
    return {
        "foresee_at": (_FORESEE[shared], 0, 0.0, place, 0.0, place, place, radius, place, found),
        "assess_at": (
            _ASSESS[shared],
            0,
            0.0,
            place,
            0.0,
            place,
            0.0,
            place,
            place,
            place,
            0.0,
            0.0,
            found,
        ),
    }


def foresee(source, a, u, b, v, position, radius, out, found):
    """Write position + a u + b v, (n, 3); return who moves furthest, and how far in its radius.

    ``found`` is that of :func:`chunks`. Not a number counts as infinite.
    """
    _FORESEE[0](a, u, b, v, position, radius, out, found)
    return _furthest(found)


def assess(source, a, new, b, now, c, old, position, trial, control, found):
    """Return the root mean square over the tolerances of a step's error a new + b now + c old."""
    _ASSESS[0](a, new, b, now, c, old, position, trial, control.rtol, control.atol, found)
    return _overall(found, position.size)


@overload(foresee)
def _compiled_foresee(source, a, u, b, v, position, radius, out, found):
    def run(source, a, u, b, v, position, radius, out, found):
        _foresee_at(source.foresee_at, a, u, b, v, position, radius, out, found)
        return _furthest(found)

    return run


@overload(assess)
def _compiled_assess(source, a, new, b, now, c, old, position, trial, control, found):
    def run(source, a, new, b, now, c, old, position, trial, control, found):
        _assess_at(
            source.assess_at,
            a,
            new,
            b,
            now,
            c,
            old,
            position,
            trial,
            control.rtol,
            control.atol,
            found,
        )
        return _overall(found, position.size)

    return run


_foresee_at, _assess_at = (called_at(count, lambda *_: types.int64) for count in (8, 11))


@arithmetic
def _furthest(found):
    """Return the cell that moves furthest, in its radius, and how far."""
    k = 0
    for c in range(found.shape[0]):
        if found[c, _AMOUNT] > found[k, _AMOUNT]:
            k = c
    return np.int64(found[k, _CELL]), math.sqrt(found[k, _AMOUNT])


@arithmetic
def _overall(found, numbers):
    """Return the weighted root mean square of an error."""
    total = 0.0
    for c in range(found.shape[0]):
        total += found[c, _AMOUNT]
    return math.sqrt(total / numbers)
