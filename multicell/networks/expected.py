"""Expected work of solving a network, before anything of it is compiled."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

import numpy as np

from multicell.cells import FloatArray
from multicell.networks.network import Network

_LEARNT: Final = 3  # intervals, of which the last counts: a start from elsewhere takes more
_ENOUGH: Final = 3000  # evaluations in Python, 0.1 s: then the rest is expected to be like it
_SMALL: Final = 1e-3  # absolute tolerance over the relative one, of states near one


class _EnoughError(Exception):
    """Enough evaluations to know how many the rest takes."""


@lru_cache(maxsize=32)
def network_evaluations(network: Network, length: float, tolerance: float) -> float:
    """Return how many evaluations of its rates an interval takes once the start has passed.

    SciPy's LSODA counts them in Python, which changes between methods for stiff and other equations
    as the network's own solver does. Not a number where it fails.

    - ``length``: of an interval, in the network's unit of time
    - ``tolerance``: relative
    """
    from scipy.integrate import solve_ivp

    rates: Callable[..., None] = getattr(network.rates, "py_func", network.rates)
    u, p = np.array(network.defaults, dtype=float), np.array(network.values, dtype=float)
    y: FloatArray = np.array(network.start, dtype=float)
    counted, reached, begin = 0, 0.0, 0.0

    def called(t: float, y: FloatArray) -> Any:
        nonlocal counted, reached
        counted, reached = counted + 1, max(reached, t)
        if counted > _ENOUGH:
            raise _EnoughError
        out = np.empty_like(y)
        rates(t, y, u, p, out)
        return out

    try:
        for k in range(_LEARNT):
            counted, begin = 0, k * length
            span = begin, begin + length
            with np.errstate(all="ignore"):
                found = solve_ivp(
                    called, span, y, method="LSODA", rtol=tolerance, atol=_SMALL * tolerance
                )
            if not found.success:
                return float("nan")
            y = found.y[:, -1]
    except _EnoughError:
        return counted * length / max(reached - begin, length / _ENOUGH)
    except (ArithmeticError, ValueError):  # rates that Python refuses and compiled code does not
        return float("nan")
    return float(counted)
