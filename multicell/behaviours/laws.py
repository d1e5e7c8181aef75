"""The laws by which a behaviour responds to a signal: the share of the full effect.

A law gives a share between 0 and 1 that rises with the signal s, or falls with it.

References
----------
A. V. Hill, J. Physiol. 40 (1910) iv; J. Monod, Annu. Rev. Microbiol. 3 (1949) 371.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, Final, final

import numpy as np

from multicell.plugins.laws import Laws

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.schema.bounds import Curve


_REACH: Final = 4.0
"""Signals that are drawn, up to so many times the middle of the response."""
_EFFECT: Final = ("falls", "base", "largest")  # keys of laws that give a share


class ResponseLaw(ABC):
    """A law of response, with the properties that other rooms ask for.

    - ``needs``, ``may_have``: keys of a response in a scene; its fields are filled from those of
      the same names
    - ``gives_values``: whether it gives values of the behaviour in place of shares
    - ``has_signal``: whether it depends on a signal
    - ``jumps``: whether its share is all or nothing
    """

    needs: ClassVar[tuple[str, ...]] = ("signal",)
    may_have: ClassVar[tuple[str, ...]] = ("parameters", *_EFFECT)
    gives_values: ClassVar[bool] = False
    has_signal: ClassVar[bool] = True
    jumps: ClassVar[bool] = False

    @classmethod
    def from_keys(cls, part: Any) -> ResponseLaw:
        """Return the law with its fields from the keys of a response."""
        keys = {*cls.needs, *cls.may_have}
        own: Any = cls
        names = [field.name for field in fields(own) if field.name in keys]
        return cls(**{name: getattr(part, name) for name in names})

    def words(self, amount: Callable[[float], str]) -> str:
        """Return the law in words; ``amount`` writes a signal with its unit."""
        return f"by {type(self).__name__}"

    def least(self, low: float, high: float) -> float:
        """Return the smallest value of a behaviour that is ``low`` without the effect."""
        return min(low, high)

    def most(self, low: float, high: float) -> float:
        """Return the largest value of such a behaviour."""
        return max(low, high)

    @property
    def reach(self) -> float:
        """Signal up to which a curve of the law is drawn."""
        return _REACH * self.middle or 1.0

    @abstractmethod
    def share(self, signal: FloatArray, *, falls: bool) -> Any:
        """Return the share of the full effect at a signal, (n,)."""

    @property
    def middle(self) -> float:
        """Signal in the middle of the response, by which cells are ranked at the start of a run.

        0 where none is known: they are not ranked by it.
        """
        return 0.0

    @property
    def kinks(self) -> tuple[float, ...]:
        """Signals at which the share jumps or changes its slope at once."""
        return ()


@dataclass(frozen=True)
class HalfLaw(ResponseLaw):
    """A law with half of its effect at the signal ``half``, or a threshold there."""

    half: float

    needs: ClassVar[tuple[str, ...]] = ("signal", "half")
    may_have: ClassVar[tuple[str, ...]] = _EFFECT

    def words(self, amount: Callable[[float], str]) -> str:
        """Return the law in words."""
        return f"half way at {amount(self.half)}"

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

    may_have: ClassVar[tuple[str, ...]] = ("power", *_EFFECT)

    def words(self, amount: Callable[[float], str]) -> str:
        """Return the law in words."""
        return f"{super().words(amount)}, Hill's exponent {self.power:g}"

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

    jumps: ClassVar[bool] = True

    def words(self, amount: Callable[[float], str]) -> str:
        """Return the law in words."""
        return f"at once at {amount(self.half)}"

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

    needs: ClassVar[tuple[str, ...]] = ("signal", "begin", "end")
    may_have: ClassVar[tuple[str, ...]] = _EFFECT

    def words(self, amount: Callable[[float], str]) -> str:
        """Return the law in words."""
        return f"in a line from {amount(self.begin)} to {amount(self.end)}"

    @property
    def reach(self) -> float:
        """A little beyond the end."""
        return 1.3 * self.end

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

    needs: ClassVar[tuple[str, ...]] = ("signal", "points")
    may_have: ClassVar[tuple[str, ...]] = ()
    gives_values: ClassVar[bool] = True

    def words(self, amount: Callable[[float], str]) -> str:
        """Return the points."""
        return ", ".join(f"{y:.4g} at {amount(x)}" for x, y in self.points)

    def least(self, low: float, high: float) -> float:
        """Return the smallest value of the points."""
        return min(value for _, value in self.points)

    def most(self, low: float, high: float) -> float:
        """Return the largest value of the points."""
        return max(value for _, value in self.points)

    @property
    def reach(self) -> float:
        """The last point."""
        return self.points[-1][0]

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

    needs: ClassVar[tuple[str, ...]] = ("largest",)
    may_have: ClassVar[tuple[str, ...]] = ("base",)
    has_signal: ClassVar[bool] = False

    def least(self, low: float, high: float) -> float:
        """Return the only value."""
        return high

    def share(self, signal: FloatArray, *, falls: bool) -> Any:
        """Return ones."""
        return np.ones(np.shape(signal))


RESPONSE_LAWS: Final[Mapping[str, type[ResponseLaw]]] = {
    "hill": Hill,
    "monod": Monod,
    "threshold": Threshold,
    "linear": LinearResponse,
    "table": TableResponse,
    "constant": Constant,
}
"""Laws by their names in a scene."""

OWN_RESPONSES: Final[Laws[Any]] = Laws({})
"""Laws of the user's own, made by :func:`multicell.response`."""
