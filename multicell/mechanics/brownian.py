"""Paths of Brownian motion: one for each cell, a function of seed, identity and time alone.

Time is cut into spans, and each span into halves again and again. The displacement over a span is
drawn for the span and the cell, that at the middle of an interval for the interval and the cell, as
a Brownian bridge has it. So the path is the same however a run is cut into steps: those of half
the length visit the same places, and the ones between.

References
----------
P. Lévy, *Processus stochastiques et mouvement brownien* (1948): the construction by midpoints.
E. Wong & M. Zakai, Ann. Math. Stat. 36 (1965) 1560: equations driven by a path made of straight
pieces.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell import random

if TYPE_CHECKING:
    from collections.abc import Iterator

    from multicell.cells import FloatArray, IntArray

_SPAN: Final = 15
"""Spans last 2**14 to 2**15 s: as coupling steps that are halves of each other have them alike."""
_DEEPEST: Final = 40
"""Halvings of a span that keep times apart, 3e-8 s: a cell hardly moves in so short a time."""
_ROUNDING: Final = 1e-9
"""Part of an internal step within which two times are one."""


@final
class BrownianPaths:
    """The paths of all cells of a run, with variance t along each axis.

    - ``seed``, ``dimensions``: of the scene
    - ``coupling_step``, s: of the scene; scenes whose steps differ by powers of two have one path
    - ``longest``, s: internal steps, over which a path is straight, are no longer
    """

    def __init__(self, seed: int, dimensions: int, coupling_step: float, longest: float) -> None:
        self._seed, self._dimensions = seed, dimensions
        self._span = math.ldexp(math.frexp(coupling_step)[0], _SPAN)
        halvings = math.ceil(math.log2(self._span / longest) - _ROUNDING)
        self.dt = math.ldexp(self._span, -min(max(halvings, 0), _DEEPEST))

    def times(self, begin: float, end: float) -> list[float]:
        """Return the ends of the internal steps between two times, s, these included."""
        near = _ROUNDING * self.dt
        first = math.floor((begin + near) / self.dt) + 1
        last = math.ceil((end - near) / self.dt)
        return [begin, *(k * self.dt for k in range(first, last)), end]

    def moves(self, times: list[float], ids: IntArray) -> Iterator[FloatArray]:
        """Yield how cells move between one time and the next, (n, 3) µm for 1 µm²/s = 2 D."""
        known: dict[tuple[int, int], FloatArray] = {}
        for begin, end in pairwise(self._place(time) for time in times):
            move = self._at(*end, ids, known) - self._at(*begin, ids, known)
            for whole in range(begin[0], end[0]):
                move = move + self._at(whole, 1 << _DEEPEST, ids, known)
            # no later place lies between two of which one is before the end
            known = {place: way for place, way in known.items() if place >= end}
            yield move

    def _place(self, time: float) -> tuple[int, int]:
        """Return the span of a time, and how many of its shortest intervals have passed."""
        span = math.floor(time / self._span)
        node = round((time / self._span - span) * 2.0**_DEEPEST)
        return span + (node >> _DEEPEST), node & ((1 << _DEEPEST) - 1)

    def _at(
        self, span: int, node: int, ids: IntArray, known: dict[tuple[int, int], FloatArray]
    ) -> FloatArray:
        """Return the way from the beginning of a span to one of its nodes, (n, 3)."""
        if node == 0:
            return np.zeros((len(ids), 3))
        if (span, node) not in known:
            if node == 1 << _DEEPEST:
                known[span, node] = math.sqrt(self._span) * self._drawn(span, 0, ids)
            else:
                # the interval whose middle the node is, half of it wide
                half = node & -node
                ends = [self._at(span, node + way, ids, known) for way in (-half, half)]
                depth = _DEEPEST - half.bit_length()
                interval = (1 << depth) + (node >> half.bit_length())
                spread = 0.5 * math.sqrt(math.ldexp(self._span, -depth))
                noise = spread * self._drawn(span, interval, ids)
                known[span, node] = 0.5 * (ends[0] + ends[1]) + noise
        return known[span, node]

    def _drawn(self, span: int, interval: int, ids: IntArray) -> FloatArray:
        out = np.zeros((len(ids), 3))
        out[:, : self._dimensions] = random.normal(
            self._seed, random.Purpose.BROWNIAN, interval, ids, self._dimensions, attempt=span
        )
        return out
