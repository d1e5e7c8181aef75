"""How far a population is from a ball."""

from __future__ import annotations

import numpy as np

from multicell.cells import FloatArray

_FEW = 20
"""Cells up to which a cluster is never taken as round: its field costs nothing anyway."""

_BACK = 0.7
"""Part of the limit below which a field in a box goes back to shells."""


def departure(position: FloatArray, radius: FloatArray) -> float:
    """Return the departure of a population from a ball: 0 for a ball, towards 1 for a thread.

    The tensor of gyration of the cells, weighted by volume and with the cells' own extent, has
    the principal radii a >= b >= c, those of the ellipsoid with the same tensor. The departure
    is (a - c) / a.

    Parameters
    ----------
    position : (n, 3), µm
    radius : (n,), µm
    """
    if len(position) == 0:
        return 0.0
    weight = radius**3
    away = position - np.average(position, axis=0, weights=weight)
    tensor = (away * weight[:, None]).T @ away / weight.sum()
    own = 0.2 * float(np.average(radius**2, weights=weight))
    squares = np.linalg.eigvalsh(tensor) + own
    return float(1.0 - np.sqrt(squares[0] / squares[-1]))


def round_enough(
    position: FloatArray, radius: FloatArray, limit: float, *, now_radial: bool
) -> bool:
    """Return whether shells do for a population.

    It depends on the state and on the present geometry only: what is radial stays so up to the
    limit, and what is not goes back well below it, so that it does not change all the time.
    """
    if len(position) <= _FEW:
        return False
    return departure(position, radius) <= (limit if now_radial else _BACK * limit)
