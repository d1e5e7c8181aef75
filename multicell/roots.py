"""Roots of functions of one number by Brent's method, step for step that of SciPy."""

from __future__ import annotations

import math
from collections.abc import Callable


def brent_root(
    f: Callable[[float], float], low: float, high: float, *, rtol: float, xtol: float
) -> float:
    """Return a root between two places at which a function has opposite signs.

    R. P. Brent, Algorithms for Minimization without Derivatives (1973), chapter 4. It has the bits
    of ``scipy.optimize.brentq``, and needs none of ``scipy.optimize``, which takes longer to load
    than all that a run says before it starts.

    - ``rtol``, ``xtol``: the root is off by less than ``xtol + rtol * abs(root)``

    Raises ValueError if both signs are the same.
    """
    last, here = low, high
    f_last, f_here = f(last), f(here)
    if f_last == 0.0 or f_here == 0.0:
        return last if f_last == 0.0 else here
    if (f_last > 0.0) == (f_here > 0.0):
        raise ValueError("f(low) and f(high) must have different signs")
    other, f_other, before, move = last, f_last, here - last, here - last
    while True:
        if (f_last > 0.0) != (f_here > 0.0):
            other, f_other, before, move = last, f_last, here - last, here - last
        if abs(f_other) < abs(f_here):
            last, here, other = here, other, here
            f_last, f_here, f_other = f_here, f_other, f_here
        delta, middle = 0.5 * (xtol + rtol * abs(here)), 0.5 * (other - here)
        if f_here == 0.0 or abs(middle) < delta:
            return here
        tried = math.inf
        if abs(before) > delta and abs(f_here) < abs(f_last):
            if last == other:
                tried = -f_here * (here - last) / (f_here - f_last)
            else:
                one = (f_last - f_here) / (last - here)
                two = (f_other - f_here) / (other - here)
                tried = -f_here * (f_other * two - f_last * one) / (two * one * (f_other - f_last))
        short = 2.0 * abs(tried) < min(abs(before), 3.0 * abs(middle) - delta)
        before, move = (move, tried) if short else (middle, middle)
        last, f_last = here, f_here
        here += move if abs(move) > delta else math.copysign(delta, middle)
        f_here = f(here)
