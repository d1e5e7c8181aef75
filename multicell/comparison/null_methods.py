"""Methods that know no mechanics, and the motion that is left when they have done what they can.

A method that is asked for an error larger than what these leave is asked for nothing. They are
compared by name like any other method, but no scene can run with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, final

import numpy as np

from multicell.cells import FloatArray
from multicell.integrators.base import MethodInfo, Outcome, info_of
from multicell.mechanics.system import Mechanics

RESOLUTION: Final = 0.01
"""Motion over a coupling step below which errors are no longer relative to it, mean radii."""


@final
@dataclass(frozen=True)
class StandStill:
    """Leave every cell where it is."""

    info: ClassVar = MethodInfo("stand-still", "no cell moves", colour="#8a8f94", marker="X")

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Return the positions at the beginning."""
        return Outcome(system.motion.end, np.array(position))


@final
@dataclass(frozen=True)
class Dilation:
    """Scale all positions about the centroid as the total volume of the cells grows."""

    info: ClassVar = MethodInfo(
        "dilation", "positions scale with the volume of the tissue", colour="#5d6b75", marker="P"
    )

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Return the scaled positions."""
        motion = system.motion
        growth = np.sum(motion.end_radius**3) / np.sum(motion.radius**3)
        centre = position.mean(axis=0)
        return Outcome(motion.end, centre + np.cbrt(growth) * (position - centre))


NULL_METHODS: Final = {info.name: info for info in map(info_of, (StandStill, Dilation))}
"""Name of each null method -> what is known of it."""


def residual_motion(start: FloatArray, end: FloatArray) -> FloatArray:
    """Subtract the best translation and dilation from a motion, (n, 3) µm.

    - ``start``, ``end``: positions of the same cells, (n, 3) µm
    """
    before, after = start - start.mean(axis=0), end - end.mean(axis=0)
    extent = float(np.sum(before**2))
    scale = float(np.sum(before * after)) / extent if extent > 0.0 else 1.0
    return np.asarray(after - scale * before)


@final
@dataclass(frozen=True)
class MotionScale:
    """The motion of a coupling step, to which errors of that step are relative.

    Attributes
    ----------
    rms, largest : float, µm
        What the best dilation leaves of the motion: root mean square over the cells, and of the
        cell that moves most; at least :data:`RESOLUTION` of a mean radius, since nothing hangs on
        motions that small.
    residual, moved : float, µm
        Root mean square of what dilation leaves, however small, and of the whole motion.
    """

    rms: float
    largest: float
    residual: float
    moved: float

    @classmethod
    def of(cls, start: FloatArray, end: FloatArray, radius: float) -> MotionScale:
        """Return the scale of a motion between positions, (n, 3) µm, of cells of a mean radius."""
        left = np.linalg.norm(residual_motion(start, end), axis=1)
        least = RESOLUTION * radius
        moved = np.linalg.norm(end - start, axis=1)
        rms = root_mean_square(left)
        return cls(max(rms, least), max(float(left.max()), least), rms, root_mean_square(moved))

    def errors(self, found: FloatArray, exact: FloatArray) -> tuple[float, float]:
        """Return how far an end is off, dimensionless: all cells, and the worst cell.

        Of all cells the root mean square of their distances counts, over :attr:`rms`; of the
        worst one its distance, over :attr:`largest`.
        """
        off = np.linalg.norm(found - exact, axis=1)
        return root_mean_square(off) / self.rms, float(off.max()) / self.largest


def root_mean_square(values: FloatArray) -> float:
    """Return the root of the mean of all squares."""
    return float(np.sqrt(np.mean(values**2)))
