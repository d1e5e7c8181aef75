"""Substances as the solvers see them, and the concentration of their medium over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError

if TYPE_CHECKING:
    from multicell.scene.nutrient import Nutrient

Conditions = Mapping[str, Any]


@final
@dataclass(frozen=True, eq=False)
class Schedule:
    """Pieces of a concentration of the medium that is linear in time, which jumps may separate.

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


@final
@dataclass(frozen=True, eq=False)
class Substance:
    """A substance that diffuses, decays, and is taken up and secreted by cells.

    Parameters
    ----------
    diffusion : float, µm²/s
    conditions
        Values and derivatives on the sides of the grid, in py-pde's terms (``{"x-": {"value": 0.1},
        "*": {"derivative": 0}}``; of shells ``"r+"`` or one condition), a concentration in mM on
        all sides, or a function of the medium's concentration (mM) that returns them.
    half_saturation : float, mM
    decay, perfusion : float, 1/s
        Rates of first-order decay, and of exchange with a flow of medium through the tissue.
    medium
        What a perfusion brings and ``conditions`` is called with: mM, or a :class:`Schedule`.
    capacity, production : (n,), amol/s, optional
        Largest uptake and secretion of each cell.
    varied : shape of the grid, optional
        Coefficient of diffusion at the nodes over ``diffusion``.
    exchange : shape of the grid, optional
        Rate of exchange with the medium at the nodes of a ``CartesianGrid``, over D/h², by which
        the layer of medium round a tissue ends inside of the grid and not at its faces.

    Raises
    ------
    SceneError
        For a number that makes no sense.
    """

    diffusion: float
    conditions: float | Conditions | Callable[[float], Conditions]
    half_saturation: float = 1.0
    decay: float = 0.0
    perfusion: float = 0.0
    medium: float | Schedule = 0.0
    capacity: FloatArray | None = None
    production: FloatArray | None = None
    varied: FloatArray | None = None
    exchange: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("diffusion", "half_saturation", "decay", "perfusion"):
            value = getattr(self, name)
            positive = name in ("diffusion", "half_saturation")
            if not (np.isfinite(value) and (value > 0.0 or (value == 0.0 and not positive))):
                bound = "above zero" if positive else "zero or more"
                raise SceneError(name, f"is {value!r}, must be a finite number, {bound}")

    @property
    def schedule(self) -> Schedule:
        """The medium over time."""
        return self.medium if isinstance(self.medium, Schedule) else Schedule.steady(self.medium)
