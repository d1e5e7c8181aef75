"""How the volume of one cell grows between birth and division, in closed form.

Each law is dV/dt = f g(V), with f in [0, 1] what nutrient and pressure leave of growth, and g so
that a cell of the birth volume V_b doubles it in its cycle time T where f = 1. With V_d = 2 V_b the
division volume and K the volume that a saturating law goes to:

    linear       g = V_b / T                        V(t) = V + g t
    exponential  g = r V           r T = ln 2       V(t) = V e^{rt}
    relaxation   g = r (K - V)     r T = ln [(K - V_b) / (K - V_d)]
                                                    V(t) = K - (K - V) e^{-rt}
    logistic     g = r V (1 - V/K) r T = ln [(K/V_b - 1) / (K/V_d - 1)]
                                                    V(t) = K / [1 + (K/V - 1) e^{-rt}]
    gompertz     g = r V ln(K/V)   r T = ln [ln(K/V_b) / ln(K/V_d)]
                                                    V(t) = K (V/K)^{exp(-rt)}

A saturating law reaches V_d only if K is above it. f is held fixed in a coupling step, and only
scales time: a step of length t is one of length f t with f = 1.

References
----------
Relaxation is how volumes approach their targets in PhysiCell (A. Ghaffarizadeh et al., PLoS Comput.
Biol. 14 (2018) e1005991, https://doi.org/10.1371/journal.pcbi.1005991).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.scene.parts import Growth


def grown(growth: Growth, birth: float, volume: FloatArray, share: FloatArray) -> FloatArray:
    """Return the volumes after a part of a cycle without limits, (n,) µm³.

    Parameters
    ----------
    growth
        With the law.
    birth : float, µm³
        Volume at birth.
    volume : (n,), µm³
        At the beginning.
    share : (n,)
        Time over the cycle time, times the factor of growth.
    """
    if growth.law == "linear":
        return np.asarray(volume + birth * share)
    fall = np.exp(-_rate(growth) * share)
    if growth.law == "exponential":
        return np.asarray(volume / fall)
    most = _largest(growth, birth)
    if growth.law == "relaxation":
        return np.asarray(most - (most - volume) * fall)
    if growth.law == "logistic":
        return np.asarray(most / (1.0 + (most / volume - 1.0) * fall))
    return np.asarray(most * (volume / most) ** fall)


def share_behind(growth: Growth, ratio: FloatArray) -> FloatArray:
    """Return the part of a cycle without limits that takes cells from birth to a volume, (n,).

    The inverse of :func:`grown`.

    Parameters
    ----------
    growth
        With the law.
    ratio : (n,)
        Volume over that at birth, from 1 to 2.
    """
    if growth.law == "linear":
        return np.asarray(ratio - 1.0)
    rate = _rate(growth)
    if growth.law == "exponential":
        return np.asarray(np.log(ratio) / rate)
    most = _largest(growth, 1.0)
    if growth.law == "relaxation":
        return np.asarray(np.log((most - 1.0) / (most - ratio)) / rate)
    if growth.law == "logistic":
        return np.asarray(np.log((most - 1.0) / (most / ratio - 1.0)) / rate)
    return np.asarray(np.log(math.log(most) / np.log(most / ratio)) / rate)


def unlimited_rate(
    growth: Growth, birth: float, volume: FloatArray, cycle: FloatArray
) -> FloatArray:
    """Return g(V), how fast cells would grow where nothing limits them, (n,) µm³/s.

    ``cycle`` are the cycle times, (n,) s.
    """
    if growth.law == "linear":
        return np.asarray(birth / cycle)
    return np.asarray(slope(growth, birth, volume) / cycle)


def slope(growth: Growth, birth: float, volume: FloatArray) -> FloatArray:
    """Return g(V) T, µm³ in a cycle."""
    if growth.law == "linear":
        return np.full(np.shape(volume), birth)
    rate = _rate(growth)
    if growth.law == "exponential":
        return np.asarray(rate * volume)
    most = _largest(growth, birth)
    if growth.law == "relaxation":
        return np.asarray(rate * (most - volume))
    if growth.law == "logistic":
        return np.asarray(rate * volume * (1.0 - volume / most))
    return np.asarray(rate * volume * np.log(most / volume))


def missing_in_waiting(growth: Growth) -> float:
    """Return what two daughters would gain beyond their mother, over what she gains.

    While a mother beyond the division volume waits for the end of the coupling step: she grows at
    the rate g(V_d), two daughters at 2 g(V_b). One for linear growth, zero for exponential.
    """
    if growth.law == "linear":
        return 1.0
    young, old = (float(slope(growth, 1.0, np.array(v))) for v in (1.0, 2.0))
    return 2.0 * young / old - 1.0


def _largest(growth: Growth, birth: float) -> float:
    """Return K, the volume that a saturating law goes to, µm³."""
    assert growth.target is not None
    return 2.0 * birth * growth.target


def _rate(growth: Growth) -> float:
    """Return r T, without unit."""
    if growth.law == "exponential":
        return math.log(2.0)
    most = _largest(growth, 1.0)
    if growth.law == "relaxation":
        return math.log((most - 1.0) / (most - 2.0))
    if growth.law == "logistic":
        return math.log((most - 1.0) / (0.5 * most - 1.0))
    return math.log(math.log(most) / math.log(0.5 * most))
