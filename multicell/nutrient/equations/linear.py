"""Fields that no cell takes up, exactly: linear equations with one coefficient of diffusion.

On the nodes of a box such a field obeys dc/dt = -A c + g(t), and a fast transform makes A diagonal.
Where g, what cells secrete and sides bring, goes linearly from g0 to g0 + d within a time T, each
mode of the rate λ is, with z = λ T,

    c(T) = e^(-z) c(0) + T [φ1(z) g0 + φ2(z) d],    φ1 = (1 - e^(-z)) / z,  φk+1 = (1/k! - φk) / z

(Hochbruck & Ostermann 2010, Acta Numerica 19, 209, §2.1), and its integral, of which the account is
made, ends in φ2 and φ3. Nothing but rounding separates it from the solution of the nodes' equation
at any time. On shells, where few nodes make other solvers cheap, there is no such transform.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final, NamedTuple, final

import numpy as np

from multicell.cells import FloatArray
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.equations.placed import PlacedSubstance

_SERIES: Final = 0.5  # argument below which φ is a power series: differences would lose digits
_TOGETHER: Final = 8192  # modes
_TERMS: Final = 14  # of it: 0.5^14/17! is below the rounding of φ3 = 1/6


class _Modes(NamedTuple):
    """Modes of a field at a beginning, and of its gain there and of what that changes by."""

    start: FloatArray
    gain: FloatArray
    change: FloatArray | None


@final
class LinearCourse:
    """A field from one time to another, s, between which no medium jumps.

    - ``each``: the substance; :func:`is_linear` holds of it
    - ``c``: its nodes at the beginning, mM
    - ``last``: the time just before the end, when the medium is still that of the course
    """

    def __init__(
        self, each: PlacedSubstance, c: FloatArray, begin: float, last: float, end: float
    ) -> None:
        self.each, self.begin, self.last, self.length = each, begin, last, end - begin
        assert isinstance(each.operator, Diffusion)
        before, after = each.gain(begin), each.gain(last)
        self.operator = each.operator
        transformed = self.operator.to_modes
        change = None if np.array_equal(before, after) else transformed(after - before)
        self._modes = _Modes(
            transformed(np.array(c.reshape(each.shape))), transformed(before), change
        )
        self._along, ay, az = self.operator.eigenvalues
        self._across = ay[:, None] + (az + each.linear)

    def at(self, share: float) -> FloatArray:
        """Return the nodes when a share of the time has gone; rounding may leave them below 0."""
        start, gain, change = self._modes
        length, found = share * self.length, np.empty_like(start)
        for part, decay, one, two, _ in self._layers(length):
            found[part] = decay * start[part] + length * one * gain[part]
            if change is not None:
                found[part] += share * length * two * change[part]
        return self.operator.from_modes(found)

    def end(self) -> tuple[FloatArray, list[float]]:
        """Return the nodes at the end, and all that has happened to them, amol.

        The columns are those of :data:`multicell.nutrient.balance.BALANCE_COLUMNS`.
        """
        start, gain, change = self._modes
        length, mean = self.length, np.empty_like(start)
        for part, _, one, two, three in self._layers(length):
            mean[part] = one * start[part] + length * two * gain[part]
            if change is not None:
                mean[part] += length * three * change[part]
        middle = self.begin + 0.5 * (self.last - self.begin)
        self.each.set_time(middle)
        level, mean = self.each.schedule.at(middle), self.operator.from_modes(mean)
        row = self.each.account(mean, level, self.each.flows(mean, level))
        self.each.set_time(self.last)
        return self.at(1.0), [length * rate for rate in row]

    def _layers(self, length: float) -> Iterator[tuple[Any, ...]]:
        """Yield some layers of modes at a time with e^(-z) and φ1 to φ3: they stay in the cache."""
        many = max(1, _TOGETHER // self._across.size)
        for first in range(0, len(self._along), many):
            part = slice(first, first + many)
            yield part, *_phi((self._along[part, None, None] + self._across) * length)


def is_linear(each: PlacedSubstance) -> bool:
    """Whether a substance on a box has one coefficient of diffusion, and gains linearly in time.

    Where a layer of medium ends inside of the box, no transform makes A diagonal.
    """
    op = each.operator
    uniform = isinstance(op, Diffusion) and op.varied is None and op.exchange is None
    return uniform and each.gains_linearly


def _phi(z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return e^(-z) and φ1 to φ3 of arguments that are not negative."""
    small = z < _SERIES
    safe = np.where(small, 1.0, z)
    decay = np.exp(-z)
    one = (1.0 - decay) / safe
    two = (1.0 - one) / safe
    three = (0.5 - two) / safe
    y = z[small]
    series = np.zeros_like(y)
    for k in range(_TERMS - 1, -1, -1):
        series = 1.0 / math.factorial(k + 3) - y * series
    # upwards the recurrence adds errors of rounding that the argument, small here, makes smaller
    three[small], two[small] = series, 0.5 - y * series
    one[small] = 1.0 - y * two[small]
    return decay, one, two, three
