"""Constraints between two free parameters of a fit: ``necrosis < quiescence``."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Self, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.measured.noise import Array
from multicell.schema import near_miss
from multicell.studies.axes import Range
from multicell.units import shown

_ORDER: Final = re.compile(r"\s*([^<>=\s]+)\s*([<>])\s*([^<>=\s]+)\s*")
_HINT: Final = "Write 'necrosis < quiescence', with names or keys of free parameters."
LEAST_SHARE_LEFT: Final = 0.01
"""Part of the ranges that constraints must leave: draws outside of it are drawn again."""
_TRIALS: Final = 4096  # points that the part is counted with
_APART: Final = 1e-3  # of both ranges, between the ends at which scenes are tried


@final
@dataclass(frozen=True)
class Constraints:
    """Pairs of parameters of which the first is the smaller one.

    - ``ranges``: of all free parameters; may be empty where there is no pair
    - ``pairs``: their numbers, the smaller parameter first
    """

    ranges: tuple[Range, ...] = ()
    pairs: tuple[tuple[int, int], ...] = ()

    @classmethod
    def of(cls, texts: str | Sequence[str], ranges: Sequence[Range]) -> Self:
        """Return the constraints that texts describe.

        Raises SceneError for what is no ``A < B``, for parameters that are not free, whole numbers,
        and units of two kinds.
        """
        pairs = []
        for text in [texts] if isinstance(texts, str) else texts:
            match = _ORDER.fullmatch(text) if isinstance(text, str) else None
            if match is None:
                raise SceneError("constraints", f"have {shown(text)}, which is no order", _HINT)
            pair = _number(match[1], ranges), _number(match[3], ranges)
            if pair[0] == pair[1]:
                raise SceneError("constraints", f"compare {match[1]} with itself", _HINT)
            one, other = (ranges[k] for k in pair)
            if one.unit != other.unit:
                problem = f"compare {one.name} ({one.unit}) with {other.name} ({other.unit})"
                raise SceneError("constraints", problem, "Both must have one kind of unit.")
            pairs.append(pair if match[2] == "<" else pair[::-1])
        found = cls(tuple(ranges), tuple(dict.fromkeys(pairs)))
        trial = np.random.default_rng(0).random((_TRIALS, len(ranges)))
        if found.hold(trial).mean() < LEAST_SHARE_LEFT:
            problem = f"leave less than {100.0 * LEAST_SHARE_LEFT:g} % of the ranges"
            raise SceneError("constraints", problem, "Search ranges that overlap more.")
        return found

    def texts(self) -> list[str]:
        """Return the constraints in words, by keys."""
        return [f"{self.ranges[i].key} < {self.ranges[j].key}" for i, j in self.pairs]

    def hold(self, shares: Array) -> NDArray[np.bool_]:
        """Return whether places in the ranges (k, d) satisfy all of them: (k,)."""
        return np.asarray((self.gaps(shares) > 0.0).all(axis=1))

    def gaps(self, shares: Array) -> Array:
        """Return how far the larger parameter is above the smaller one: (k, pairs).

        In parts of both ranges, on logarithmic ones of their logarithms.
        """
        gaps = np.empty((len(shares), len(self.pairs)))
        for column, (i, j) in enumerate(self.pairs):
            one, other = self.ranges[i], self.ranges[j]
            ends = np.array([one.low, one.high, other.low, other.high])
            low, high = values_at(one, shares[:, i]), values_at(other, shares[:, j])
            if one.log and other.log:
                ends, low, high = np.log(ends), np.log(low), np.log(high)
            gaps[:, column] = (high - low) / (ends.max() - ends.min())
        return gaps

    def mended(self, shares: Array, fixed: int) -> Array:
        """Return places in which other parameters than the fixed one moved to hold all, (k, d).

        Where that cannot be, they do not hold still.
        """
        found = shares.copy()
        for _ in self.pairs:
            for number, (i, j) in enumerate(self.pairs):
                # the larger one moves up, and where that is not enough the smaller one down
                for moved, to, step in ((j, i, _APART), (i, j, -_APART)):
                    wrong = self.gaps(found)[:, number] <= 0.0
                    if moved == fixed or not wrong.any():
                        continue
                    free = self.ranges[moved]
                    values = values_at(self.ranges[to], found[wrong, to])
                    values = np.clip(values, free.low, free.high)
                    places = np.array([free.share(float(value)) for value in values]) + step
                    found[wrong, moved] = np.clip(places, 0.0, 1.0)
        return found

    def apart(self) -> tuple[Range, ...]:
        """Return the ranges cut to the values that some values of the others allow.

        Ends of two of them are apart, so that scenes exist there.
        """
        ranges = list(self.ranges)
        for _ in self.pairs:
            for i, j in self.pairs:
                one, other = ranges[i], ranges[j]
                gap = _APART * (max(one.high, other.high) - min(one.low, other.low))
                ranges[i] = replace(one, high=min(one.high, other.high - gap))
                ranges[j] = replace(other, low=max(other.low, one.low + gap))
        return tuple(ranges)

    def descend(
        self,
        value_and_slope: Callable[..., tuple[float, Array]],
        start: Array,
        moving: Sequence[int],
        arguments: tuple[Any, ...] = (),
    ) -> Array:
        """Return where a function of some parameters is least, from a start (d,): (d,).

        - ``value_and_slope``: of the moving parameters, (m,), and of further ``arguments``
        """
        from scipy.optimize import minimize

        def gaps(x: Array, *more: Any) -> Array:
            place = start.copy()
            place[list(moving)] = x
            return np.asarray(self.gaps(place[None])[0] - 1e-9)

        more: dict[str, Any] = {"method": "L-BFGS-B"}
        if self.pairs:
            more = {"method": "SLSQP", "constraints": {"type": "ineq", "fun": gaps}}
            more["options"] = {"ftol": 1e-10, "maxiter": 200}
        down = minimize(
            value_and_slope,
            start[list(moving)],
            args=arguments,
            jac=True,
            bounds=[(0.0, 1.0)] * len(moving),
            **more,
        )
        end = start.copy()
        end[list(moving)] = np.clip(down.x, 0.0, 1.0)
        return end if not self.pairs or self.hold(end[None])[0] else start


NO_CONSTRAINTS: Final[Constraints] = Constraints()


def values_at(free: Range, shares: Array) -> Array:
    """Return the values at places in a range, (k,), in base units; whole ones as if they were not.

    A whole number k has the places of the values from k to k + 1.
    """
    high = free.high + 1.0 if free.whole else free.high
    if free.log:
        return np.asarray(free.low * (high / free.low) ** shares)
    return np.asarray(free.low + (high - free.low) * shares)


def _number(name: str, ranges: Sequence[Range]) -> int:
    """Return the number of a free parameter by its name or key."""
    for k, free in enumerate(ranges):
        if name in (free.name, free.key):
            if free.whole:
                raise SceneError("constraints", f"name {name}, which is a whole number")
            return k
    hint = near_miss(name, [free.name for free in ranges]) or _HINT
    if re.match(r"[+-]?\.?\d", name):
        hint = "A limit is an end of a range: --free KEY=LOW:HIGH."
    raise SceneError("constraints", f"name {shown(name)}, which is not free", hint)
