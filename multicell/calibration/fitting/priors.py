"""Priors of the parameters: ranges and distributions.

A parameter has a range in which all values are equally likely (on a logarithmic one: all ratios),
or a normal or log-normal distribution with units::

    8:25 h                                 log 1e-3:1 1/s
    norm(18 h, 2 h)                        lognorm(median=0.02 mM/s, sigma=0.3)
    norm(18 h, 2 h) in 10:30 h

``norm`` takes mean and standard deviation, ``lognorm`` the median and the standard deviation of the
logarithm. Behind ``in`` stand the ends of the range that is searched, to which the distribution is
cut; without it these are the quantiles that leave a thousandth out. Searches, emulators and
samplers work in places in the ranges (0 to 1; of a log-normal distribution on a logarithmic scale);
here is their density there.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Self, final

import numpy as np

from multicell.calibration.fitting.constraints import NO_CONSTRAINTS, Constraints, values_at
from multicell.errors import SceneError
from multicell.measured.noise import Array
from multicell.scene.oxygen import is_oxygen
from multicell.scene.scene import Scene
from multicell.studies.axes import QUANTITY, Range, is_numeric
from multicell.studies.keys import Key, key_of
from multicell.units import shown, to_base

_CALL: Final = re.compile(r"\s*([A-Za-z]\w*)\s*\((.*)\)\s*(?:in\s+(.+?))?\s*", re.DOTALL)
_ARGUMENTS: Final = {
    "norm": re.compile(r"([^,=]+),([^,=]+)"),
    "lognorm": re.compile(r"\s*median\s*=([^,=]+),\s*sigma\s*=([^,=]+)"),
}
_TAIL: Final = 0.0005  # of a distribution, beyond each end of a range that nobody stated
_DRAWS: Final = 20_000  # of which the share that constraints leave is counted
_HINT: Final = "For example 'norm(18 h, 2 h)' or 'lognorm(median=0.02 mM/s, sigma=0.3)'."


@final
@dataclass(frozen=True)
class Density:
    """The distribution of a parameter, cut to its range.

    - ``name``: in :mod:`scipy.stats`
    - ``shapes``: its shape parameters
    - ``loc``, ``scale``: in base units
    """

    name: str
    shapes: tuple[float, ...]
    loc: float
    scale: float

    @classmethod
    def of(cls, name: str, *numbers: float) -> Self:
        """Return a density from its shapes, location and scale."""
        *shapes, loc, scale = map(float, numbers)
        return cls(name, tuple(shapes), loc, scale)

    @cached_property
    def frozen(self) -> Any:
        """SciPy's frozen distribution, base units."""
        from scipy import stats

        return getattr(stats, self.name)(*self.shapes, loc=self.loc, scale=self.scale)


@final
@dataclass(frozen=True)
class Prior:
    """Prior of the parameters; by default uniform over their ranges.

    - ``dimensions``: number of parameters
    - ``ranges``, ``densities``: one for each where one has a density, else empty; a density of None
      is uniform
    - ``constraints``: between two of them, beyond which there is nothing
    """

    dimensions: int
    ranges: tuple[Range, ...] = ()
    densities: tuple[Density | None, ...] = ()
    constraints: Constraints = NO_CONSTRAINTS

    def density_loss(self, shares: Array) -> Array:
        """Return -2 ln of the density of places in the ranges (k, d): (k,)."""
        total = np.zeros(len(shares))
        for k, density in enumerate(self.densities):
            if density is not None:
                total -= 2.0 * self._log_density(k, density, shares[:, k])
        return total

    def loss(self, shares: Array) -> Array:
        """Return -2 ln of the density of places in the ranges (k, d): (k,), inf beyond them."""
        inside = ((shares >= 0.0) & (shares <= 1.0)).all(axis=1)
        places = np.clip(shares, 0.0, 1.0)
        return np.where(inside & self.constraints.hold(places), self.density_loss(places), np.inf)

    def places(self, even: Array) -> Array:
        """Return places in the ranges for points of the unit cube (k, d) that fill it evenly."""
        found = even.copy()
        for k, density in enumerate(self.densities):
            if density is not None:
                free, frozen = self.ranges[k], density.frozen
                low, high = frozen.cdf([free.low, free.high])
                values = np.clip(frozen.ppf(low + even[:, k] * (high - low)), free.low, free.high)
                found[:, k] = [free.share(float(value)) for value in values]
        return found

    def draw(self, random: np.random.Generator, count: int) -> Array:
        """Return independent draws, (count, d)."""
        found = self.places(random.random((count, self.dimensions)))
        while not (kept := self.constraints.hold(found)).all():
            found[~kept] = self.places(random.random((int((~kept).sum()), self.dimensions)))
        return found

    def part(self, k: int, level: float) -> float:
        """Return the part of a range that a central interval of its density covers."""
        if self.constraints.pairs:
            drawn = self.draw(np.random.default_rng(0), _DRAWS)[:, k]
            return float(np.diff(np.quantile(drawn, [0.5 - 0.5 * level, 0.5 + 0.5 * level]))[0])
        density = self.densities[k] if self.densities else None
        if density is None:
            return level
        tails = np.full((2, self.dimensions), 0.5)
        tails[:, k] = 0.5 - 0.5 * level, 0.5 + 0.5 * level
        ends = self.places(tails)[:, k]
        return float(ends[1] - ends[0])

    def marginal(self, k: int, shares: Array) -> Array:
        """Return the density of one parameter at places in its range."""
        density = self.densities[k] if self.densities else None
        alone = np.ones(len(shares))
        if density is not None:
            alone = np.exp(self._log_density(k, density, shares))
        if not self.constraints.pairs:
            return alone
        others = self.places(np.random.default_rng(0).random((_DRAWS, self.dimensions)))
        left = self.constraints.hold(others).mean()
        parts = []
        for share in shares:
            others[:, k] = share
            parts.append(self.constraints.hold(others).mean())
        return np.asarray(alone * parts / left)

    def _log_density(self, k: int, density: Density, shares: Array) -> Array:
        """Return the logarithm of the density of places in a range, up to no constant."""
        free, frozen = self.ranges[k], density.frozen
        low, high = frozen.cdf([free.low, free.high])
        values = values_at(free, shares)
        slope = values * math.log(free.high / free.low) if free.log else free.high - free.low
        return np.asarray(frozen.logpdf(values) + np.log(slope) - math.log(high - low))

    def describe(self) -> dict[str, Any]:
        """Return the numbers that decide it; empty where it is uniform."""
        densities = {
            free.key: [density.name, *density.shapes, density.loc, density.scale]
            for free, density in zip(self.ranges, self.densities, strict=False)
            if density is not None
        }
        found: dict[str, Any] = {"densities": densities} if densities else {}
        orders = self.constraints.texts()
        return found | ({"constraints": orders} if orders else {})


def split_free(
    free: Mapping[str, Any], scene: Scene
) -> tuple[dict[str, Any], dict[str, Density | None]]:
    """Return free parameters with ranges alone, and their densities; None: uniform."""
    ranges: dict[str, Any] = {}
    densities: dict[str, Density | None] = {}
    for name, given in free.items():
        ranges[name], densities[name] = given, None
        if isinstance(given, tuple) and isinstance(given[-1], Density):  # of a stored fit
            ranges[name], densities[name] = given[:-1], given[-1]
        call = _CALL.fullmatch(given) if isinstance(given, str) else None
        if call is None:
            continue
        key = key_of(scene, name)
        if not is_numeric(key) or key.spec.kind == "count":
            problem = "is no real number, so it cannot have a distribution"
            raise SceneError(key.name, problem, "Give whole numbers a range, such as '2:9'.")
        density = _from_call(key, call[1], call[2])
        ranges[name], densities[name] = _range(key, density, call[3]), density
    return ranges, densities


def prior_of(
    ranges: Sequence[Range], densities: Sequence[Density | None], constraints: Constraints
) -> Prior:
    """Return the prior of free parameters."""
    if not any(densities):
        return Prior(len(ranges), constraints=constraints)
    for free, density in zip(ranges, densities, strict=True):
        if density is not None:
            low, high = density.frozen.cdf([free.low, free.high])
            if not high - low > 1e-6:
                ends = f"{free.low:g} to {free.high:g} {free.unit}".strip()
                raise SceneError(free.key, f"has a distribution with next to nothing in {ends}")
    return Prior(len(ranges), tuple(ranges), tuple(densities), constraints)


def _from_call(key: Key, name: str, text: str) -> Density:
    """Return the density that a call in words describes."""
    match = _ARGUMENTS[name].fullmatch(text) if name in _ARGUMENTS else None
    if match is None:
        problem = f"has {shown(f'{name}({text})')}, must be norm or lognorm with two arguments"
        hint = "A uniform one is the range alone, as '8:25 h'." if "unif" in name.lower() else _HINT
        raise SceneError(key.name, problem, hint)
    middle = _number(key, match[1].strip(), bare=False)
    spread = _number(key, match[2].strip(), bare=name == "lognorm")
    if not spread > 0.0 or (name == "lognorm" and not middle > 0.0):
        problem = f"has '{name}({text})', whose deviation or median is not above 0"
        raise SceneError(key.name, problem)
    if name == "norm":
        return Density(name, (), middle, spread)
    return Density(name, (spread,), 0.0, middle)


def _number(key: Key, text: str, bare: bool) -> float:
    """Return an argument: a shape, which has no unit, or one with the unit of the key."""
    match = QUANTITY.fullmatch(text)
    if match is None:
        raise SceneError(key.name, f"has {shown(text)} in its distribution, must be a number")
    if bare or not key.unit:
        if match[2]:
            problem = f"has {shown(text)} in its distribution, must have no unit"
            raise SceneError(key.name, problem)
        return float(match[1])
    try:
        return to_base(text, key.unit, key.name)
    except SceneError:
        if not any(map(is_oxygen, key.name.split("."))):
            raise
        return float(key.plain(text))  # a pressure, or a part of air


def _range(key: Key, density: Density, ends: str | None) -> Any:
    """Return the range that a distribution is cut to, as :func:`parse_range` takes it."""
    if ends is not None:
        return f"log {ends}" if density.name == "lognorm" and not ends.startswith("log") else ends
    low, high = map(float, density.frozen.ppf([_TAIL, 1.0 - _TAIL]))
    try:
        low, high = float(key.plain(low)), float(key.plain(high))
    except SceneError as error:
        hint = "Cut the distribution: 'norm(18 h, 2 h) in 10:30 h'."
        raise SceneError(key.name, f"{error.problem} (a thousandth beyond)", hint) from None
    return (low, high, "log") if density.name == "lognorm" and low > 0.0 else (low, high)
