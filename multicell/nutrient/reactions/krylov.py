"""GMRES with a preconditioner on the right, on one thread: no sum depends on how many there are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from multicell.cells import FloatArray
from multicell.compiling import KERNEL, typed
from multicell.nutrient.stencil import dot

_jit = typed(**KERNEL)

Map = Callable[[FloatArray], FloatArray]

_DIMENSION, _CYCLES = 20, 6


def gmres(product: Map, near: Map, right: FloatArray, goal: float) -> tuple[FloatArray, int]:
    """Return x of A x = right, and how many products that took (Saad & Schultz 1986).

    - ``near``: v -> about the inverse of A
    - ``goal``: part of the right-hand side's norm that may be left over; as little as was reached
      is returned where it is not
    """
    x, taken = np.zeros_like(right), 0
    r = right.copy()
    first = float(np.sqrt(dot(r, r)))
    for _ in range(_CYCLES):
        size = float(np.sqrt(dot(r, r)))
        if not size > goal * first:
            break
        basis = np.empty((_DIMENSION + 1, right.size))
        basis[0] = r / size
        h = np.zeros((_DIMENSION + 1, _DIMENSION))
        for k in range(_DIMENSION):
            w = np.ascontiguousarray(product(near(basis[k])))
            taken += 1
            orthogonalise(basis, k, w, h)
            y, left = _least(h[: k + 2, : k + 1], size)
            if not left > goal * first or h[k + 1, k] == 0.0:
                break
        x += near(combined(basis, y))
        r = right - product(x)
    return x, taken


def _least(h: FloatArray, size: float) -> tuple[FloatArray, float]:
    """Return y with the least norm of (size, 0, ...) - h y, and that norm."""
    right = np.zeros(len(h))
    right[0] = size
    y = np.linalg.lstsq(h, right, rcond=None)[0]
    return np.asarray(y, dtype=np.float64), float(np.linalg.norm(right - h @ y))


@_jit
def orthogonalise(basis: FloatArray, k: int, w: FloatArray, h: FloatArray) -> None:
    """Write ``w`` made orthogonal to ``basis[:k + 1]``, of norm 1, to ``basis[k + 1]``.

    ``h[:, k]`` gets its parts. ``w`` (n,) is used up.
    """
    for j in range(k + 1):
        part = dot(basis[j], w)
        h[j, k] = part
        for i in range(w.size):
            w[i] -= part * basis[j, i]
    norm = np.sqrt(dot(w, w))
    h[k + 1, k] = norm
    scale = 1.0 / norm if norm > 0.0 else 0.0
    for i in range(w.size):
        basis[k + 1, i] = scale * w[i]


@_jit
def combined(basis: FloatArray, y: FloatArray) -> FloatArray:
    """Return Σ_j y[j] basis[j], (n,)."""
    out = np.zeros(basis.shape[1])
    for j in range(y.size):
        for i in range(out.size):
            out[i] += y[j] * basis[j, i]
    return out
