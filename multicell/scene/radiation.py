"""Irradiation in a scene: when which dose is given, and what of it cells survive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.errors import SceneError
from multicell.scene.checks import FIELD_HINT, check_kinds, check_phases
from multicell.schema import (
    count,
    moments,
    near_miss,
    number,
    parameters,
    quantities,
    quantity,
    separated,
    text,
)

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

_LARGE = "The linear-quadratic model is used up to about 20 Gy in a fraction."


@final
@parameters
class Radiation:
    """Fractions of one dose at given times, which cells survive by the linear-quadratic model.

    Of the cells ``S = exp(-f (alpha D + beta D²))`` survive each fraction, with the factor f of
    their phase. Where they lack oxygen D is smaller than ``dose``, by the ratio OER(p) / ``oer``
    with ``OER(p) = (oer p + half_oxygen) / (p + half_oxygen)`` at the partial pressure p.
    """

    dose: float = quantity("Gy", at_least=0, at_most=50, hint=_LARGE, doc="of each fraction")
    times: tuple[float, ...] | None = moments(doc="of the fractions; absent: start says when")
    start: float | None = quantity("s", default=None, at_least=0, doc="time of the first fraction")
    every: float = quantity("s", default=86400.0, above=0, doc="from fraction to fraction")
    fractions: int = count(default=1, at_least=1, at_most=1000, doc="their number, from start on")
    alpha: float = quantity("1/Gy", at_least=0, at_most=10, doc="linear part of -ln S")
    beta: float = quantity("1/Gy^2", default=0.0, at_least=0, at_most=10, doc="quadratic part")
    cells: str | None = text(default=None, doc="types, separated by commas; absent: all cells")
    oxygen: str = text(default="", doc="field that is oxygen; absent: its lack protects no cell")
    oer: float = number(default=3.0, at_least=1, at_most=10, doc="OER with plenty of oxygen")
    half_oxygen: float = quantity(
        "kPa", default=0.4, above=0, doc="partial pressure at which OER is half-way; 3 mmHg"
    )
    phase_factor: Mapping[str, float] | None = quantities(
        "", at_least=0, at_most=10, doc="f by phase of the cycle; absent phases: 1"
    )
    mitotic_divisions: int = count(
        default=0,
        at_least=0,
        at_most=100,
        doc="a cell that does not survive dies in place of this division; 0: at once",
    )

    def check(self) -> None:
        """Raise ``SceneError`` for a course without times, with two, or without any effect."""
        if (self.times is None) == (self.start is None):
            problem = "is missing" if self.times is None else "has no effect: times say when"
            raise SceneError("start", problem, "Give times = ['1 d', '2 d'], or start = '1 d'.")
        if self.times is not None and self.fractions > 1:
            raise SceneError("fractions", "has no effect: times say when")
        if self.alpha == self.beta == 0.0:
            raise SceneError("alpha", "is 0, as is beta: no cell would die", "Such as '0.3 1/Gy'.")

    @property
    def schedule(self) -> tuple[float, ...]:
        """Times of the fractions, s."""
        if self.times is not None:
            return self.times
        return tuple((self.start or 0.0) + k * self.every for k in range(self.fractions))

    @property
    def types(self) -> tuple[str, ...]:
        """The types that are hit; empty for all cells."""
        return separated(self.cells)

    def survival(self, pressure: Any = np.inf, factor: Any = 1.0) -> Any:
        """Return the part of cells that survives a fraction.

        - ``pressure``, (n,) or a number, kPa: partial pressure of oxygen; infinite where there is
          plenty
        - ``factor``, (n,) or a number: that of their phases

        Alper & Howard-Flanders (1956) for the effect of oxygen; with OER = 1 + (oer - 1) q of the
        saturation q = p / (p + half_oxygen).
        """
        with np.errstate(divide="ignore"):
            saturation = 1.0 / (1.0 + self.half_oxygen / np.asarray(pressure, dtype=float))
        dose = self.dose * (1.0 + (self.oer - 1.0) * saturation) / self.oer
        return np.exp(-factor * (self.alpha + self.beta * dose) * dose)


def check_radiation(scene: Scene) -> None:
    """Raise ``SceneError`` for irradiation that does not fit to the rest of the scene."""
    for name, part in scene.radiation.items():
        path = f"radiation.{name}"
        check_kinds(scene, f"{path}.cells", part.cells)
        if part.oxygen and part.oxygen not in scene.nutrients:
            problem = f"is {part.oxygen!r}, which is not {FIELD_HINT}"
            hint = near_miss(part.oxygen, scene.nutrients)
            raise SceneError(f"{path}.oxygen", problem, hint)
        check_phases(scene, f"{path}.phase_factor", part.phase_factor)
        if part.mitotic_divisions and scene.growth is None:
            problem = f"is {part.mitotic_divisions}, but without [growth] no cell divides"
            raise SceneError(f"{path}.mitotic_divisions", problem, "0 lets cells die at once.")
