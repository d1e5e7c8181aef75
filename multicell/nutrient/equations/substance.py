"""What a substance is made of for the solvers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.nutrient.equations.schedule import Schedule

Conditions = Mapping[str, Any]


@final
@dataclass(frozen=True, eq=False)
class Substance:
    """What diffuses, decays, and is taken up and secreted by cells.

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
