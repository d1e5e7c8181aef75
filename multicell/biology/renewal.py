"""Directions of cells that change them at random moments: a Poisson process without a state.

Time is cut into windows of one polarisation time. How many moments fall into a window (a Poisson
number with mean 1) and where (uniformly) are functions of seed, cell and window, and so is the
direction that is taken at each of them. The direction at a time is that of the last moment before:
in the same window, or in an earlier one if there is none, as in one window of e on average.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from multicell import random
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import FloatArray, IntArray

_MOST: Final = 20
"""Moments in a window: the chance of more is below the resolution of a random number."""
_EARLIER: Final = 1 << 20
"""Added to the number of a window, so that those before the start have numbers above zero too."""


def directions_at(plan: BiologyPlan, ids: IntArray, time: float) -> FloatArray:
    """Return the random direction of each cell, (n, 3).

    - ``ids``, (n,): identities
    - ``time``: in polarisation times
    """
    out = np.empty((len(ids), 3))
    window = int(np.floor(time))
    left, before = np.arange(len(ids)), time - window
    while left.size:
        last, found = _last_moment(plan, ids[left], window, before)
        for number in np.unique(last[found]):
            now = left[found & (last == number)]
            out[now] = random.directions(
                plan.seed, Purpose.MOTILITY, (window + _EARLIER) * _MOST + int(number), ids[now],
                plan.dimensions,
            )  # fmt: skip
        left, window, before = left[~found], window - 1, 1.0
    return out


def _last_moment(
    plan: BiologyPlan, ids: IntArray, window: int, before: float
) -> tuple[IntArray, np.ndarray]:
    """Return the number of the last moment of a window before a part of it, and if there is one."""
    u = random.uniform(plan.seed, Purpose.RENEWAL, window + _EARLIER, ids, 1 + _MOST)
    count = np.searchsorted(_cumulated(), u[:, 0], side="right")
    moments = np.where(np.arange(_MOST) < count[:, None], u[:, 1:], np.inf)
    moments[moments >= before] = -np.inf
    return moments.argmax(axis=1), moments.max(axis=1) > -np.inf


def _cumulated() -> FloatArray:
    """Return the chances of at most 0, 1, ... moments in a window."""
    chances = np.exp(-1.0) / np.cumprod(np.concatenate([[1.0], np.arange(1.0, _MOST)]))
    return np.asarray(np.cumsum(chances))
