"""The concentration of the medium over time: straight pieces, which jumps may separate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError

if TYPE_CHECKING:
    from multicell.scene.nutrient import Nutrient


@final
@dataclass(frozen=True, eq=False)
class Schedule:
    """Pieces of a concentration that is linear in time.

    Attributes
    ----------
    times : (k,), s
        Beginning of each piece, rising.
    start : (k,), mM
        Concentration there.
    slope : (k,), mM/s
    """

    times: FloatArray
    start: FloatArray
    slope: FloatArray

    @classmethod
    def steady(cls, concentration: float) -> Schedule:
        """Return a medium that stays as it is."""
        return cls(np.zeros(1), np.array([float(concentration)]), np.zeros(1))

    @classmethod
    def steps(cls, changes: list[tuple[float, float]]) -> Schedule:
        """Return a medium that is changed at times in s to concentrations in mM.

        Raises
        ------
        SceneError
            If there is no change, or times do not rise.
        """
        times, values = (np.array(x, dtype=float) for x in zip(*changes, strict=True))
        if not len(times) or not (np.diff(times) > 0.0).all():
            raise SceneError("medium", "needs one change or more, at times that rise")
        return cls(times, values, np.zeros(len(times)))

    @classmethod
    def of(cls, nutrient: Nutrient) -> Schedule:
        """Return the medium of a scene's nutrient."""
        ends = nutrient.switches(0.0, np.inf)
        times = np.array([0.0, *ends])
        start = np.array([nutrient.medium(t) for t in times])
        slope = np.zeros(len(times))
        if nutrient.media_change == "linear":
            slope[:-1] = np.diff(start) / np.diff(times)
        return cls(times, start, slope)

    @property
    def constant(self) -> bool:
        """Whether the concentration never changes."""
        return len(self.times) == 1 and self.slope[0] == 0.0

    def at(self, t: float) -> float:
        """Return the concentration at a time in s, mM: that of the last piece that has begun."""
        if len(self.times) == 1 and self.slope[0] == 0.0:
            return float(self.start[0])  # asked for often in each step, of most fields
        piece = max(int(np.searchsorted(self.times, t, side="right")) - 1, 0)
        if self.slope[piece] == 0.0:
            return float(self.start[piece])
        return float(self.start[piece] + self.slope[piece] * (t - self.times[piece]))

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the beginnings of pieces strictly between two times, s."""
        return [float(t) for t in self.times if begin < t < end]
