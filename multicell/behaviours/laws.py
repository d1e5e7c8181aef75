"""The laws by which a behaviour responds to a signal: the share of the full effect.

A law gives a share between 0 and 1 that rises with the signal s, or falls with it.

References
----------
A. V. Hill, J. Physiol. 40 (1910) iv; J. Monod, Annu. Rev. Microbiol. 3 (1949) 371.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.plugins.laws import Laws

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.schema.bounds import Curve


class ResponseLaw(ABC):
    """A law of response."""

    @abstractmethod
    def share(self, signal: FloatArray, *, falls: bool) -> Any:
        """Return the share of the full effect at a signal, (n,)."""

    @property
    @abstractmethod
    def middle(self) -> float:
        """Signal in the middle of the response, by which cells are ranked at the start of a run."""

    @property
    def kinks(self) -> tuple[float, ...]:
        """Signals at which the share jumps or changes its slope at once."""
        return ()


@dataclass(frozen=True)
class HalfLaw(ResponseLaw):
    """A law with half of its effect at the signal ``half``, or a threshold there."""

    half: float

    @property
    def middle(self) -> float:
        """The signal ``half``."""
        return self.half


@final
class Monod(HalfLaw):
    """s / (half + s); falling half / (half + s); what is below zero (tension) counts as zero."""

    def share(self, signal: FloatArray, *, falls: bool) -> Any:
        """Return the share."""
        above = np.maximum(signal, 0.0)
        return (self.half if falls else above) / (self.half + above)


@final
@dataclass(frozen=True)
class Hill(HalfLaw):
    """sⁿ / (halfⁿ + sⁿ), n = ``power``; what is below zero (tension) counts as zero."""

    power: float

    def share(self, signal: FloatArray, *, falls: bool) -> Any:
        """Return the share."""
        with np.errstate(over="ignore", divide="ignore"):
            ratio = np.maximum(signal, 0.0) / self.half
            return 1.0 / (1.0 + ratio ** (self.power if falls else -self.power))


@final
@dataclass(frozen=True)
class Threshold(HalfLaw):
    """All from ``half`` on (if ``strict`` only above it), nothing below; falling the other way."""

    strict: bool = False

    def share(self, signal: FloatArray, *, falls: bool) -> Any:
        """Return the share, as booleans."""
        if falls:
            return signal < self.half
        return signal > self.half if self.strict else signal >= self.half

    @property
    def kinks(self) -> tuple[float, ...]:
        """The threshold."""
        return (self.half,)


@final
@dataclass(frozen=True)
class LinearResponse(ResponseLaw):
    """A straight line between ``begin`` and ``end``, constant outside."""

    begin: float
    end: float

    def share(self, signal: FloatArray, *, falls: bool) -> Any:
        """Return the share."""
        above = signal if self.begin == 0.0 else signal - self.begin
        part = above / (self.end - self.begin)
        return np.minimum(1.0, np.maximum(0.0, 1.0 - part if falls else part))

    @property
    def middle(self) -> float:
        """Half way."""
        return 0.5 * (self.begin + self.end)

    @property
    def kinks(self) -> tuple[float, ...]:
        """The ends of the line."""
        return self.begin, self.end


@final
@dataclass(frozen=True)
class TableResponse(ResponseLaw):
    """Straight lines between points (signal, value), constant outside; the values themselves."""

    points: Curve

    def share(self, signal: FloatArray, *, falls: bool) -> Any:
        """Return the value."""
        assert not falls
        x, y = np.array(self.points).T
        return np.interp(signal, x, y)

    @property
    def middle(self) -> float:
        """The signal half way between the first and the last point."""
        return 0.5 * (self.points[0][0] + self.points[-1][0])

    @property
    def kinks(self) -> tuple[float, ...]:
        """The signals of all points."""
        return tuple(signal for signal, _ in self.points)


@final
@dataclass(frozen=True)
class Constant(ResponseLaw):
    """All, whatever the signal."""

    def share(self, signal: FloatArray, *, falls: bool) -> Any:
        """Return ones."""
        return np.ones(np.shape(signal))

    @property
    def middle(self) -> float:
        """There is none."""
        return 0.0


KEYS: Final = {
    "hill": (("signal", "half"), ("power", "falls", "base", "largest")),
    "monod": (("signal", "half"), ("falls", "base", "largest")),
    "threshold": (("signal", "half"), ("falls", "base", "largest")),
    "linear": (("signal", "begin", "end"), ("falls", "base", "largest")),
    "table": (("signal", "points"), ()),
    "constant": (("largest",), ("base",)),
}
"""Laws by their names in a scene -> the keys that they need, and those that they may have."""

OWN_RESPONSES: Final[Laws[Any]] = Laws({})
"""Laws of the user's own, made by :func:`multicell.response`."""
