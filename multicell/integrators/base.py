"""The protocol of all integrators and what they hand back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, final

import numpy as np

from multicell.mechanics.system import Mechanics

if TYPE_CHECKING:
    from multicell.cells import FloatArray


@final
@dataclass(frozen=True)
class Outcome:
    """Where an integration ended.

    Attributes
    ----------
    time : float
        Time reached, s.
    position : (n, 3)
        Positions at that time, µm.
    problem : str
        Why it stopped early, in words; empty if it reached the end.
    hint : str
        What to try then.
    cell : int or None
        Index of the cell that shows the problem most.
    local_error : float
        The largest error that the method expects to have made with any cell in one of its steps,
        µm; NaN for a method that makes no estimate.
    """

    time: float
    position: FloatArray
    problem: str = ""
    hint: str = ""
    cell: int | None = None
    local_error: float = math.nan

    @property
    def done(self) -> bool:
        """Whether the end of the interval was reached."""
        return not self.problem


class Integrator(Protocol):
    """A method that carries positions over one coupling step.

    Implementations are frozen dataclasses; their work is counted in ``system.work``.
    """

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate from ``system.motion.begin`` to its ``end``, starting at ``position``."""


def furthest(before: FloatArray, after: FloatArray, radius: FloatArray) -> tuple[int, float]:
    """Return the cell that moved furthest, measured in its radius, and that distance.

    A displacement that is not a number counts as infinite.
    """
    moved = np.sqrt(np.square(after - before).sum(axis=1)) / radius
    moved = np.where(np.isnan(moved), np.inf, moved)
    cell = int(moved.argmax())
    return cell, float(moved[cell])
