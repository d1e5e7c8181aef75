"""What a substance is made of for the solvers, and the terms that are linear in it.

A term of the equation that is linear in the concentration and the same all over the grid is a class
here with its line in :data:`LINEAR_TERMS`, a rate of :class:`Substance` and a key of
:class:`multicell.scene.nutrient.Nutrient`, all of one name. Solvers, derivatives and accounts read
it there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple, Protocol, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.nutrient.equations.schedule import Schedule

Conditions = Mapping[str, Any]


class LinearTerm(Protocol):
    """A term that takes in proportion to the concentration, and may bring what the medium has."""

    @property
    def rate(self) -> float:
        """What it takes over the concentration, 1/s."""

    def gain(self, level: float) -> float:
        """Return what it brings to each node with a concentration of the medium in mM, mM/s."""

    def entries(self, content: float, medium: float) -> dict[str, float]:
        """Return its entries in the account, amol/s; see :data:`multicell.nutrient.balance.SIGNS`.

        ``content`` is what the field holds, ``medium`` what it would hold were it all medium, amol.
        """


@final
class Decay(NamedTuple):
    """First-order decay."""

    rate: float

    def gain(self, level: float) -> float:
        """Return zero: nothing comes back."""
        return 0.0

    def entries(self, content: float, medium: float) -> dict[str, float]:
        """Return what decays."""
        return {"decayed": self.rate * content}


@final
class Perfusion(NamedTuple):
    """A flow through the tissue, which brings medium and takes the same volume with it."""

    rate: float

    def gain(self, level: float) -> float:
        """Return what the flow brings."""
        return self.rate * level

    def entries(self, content: float, medium: float) -> dict[str, float]:
        """Return what comes in, net, and what is washed out."""
        return {"inflow": self.rate * (medium - content), "washed": self.rate * content}


LINEAR_TERMS: Final[Mapping[str, Callable[[float], LinearTerm]]] = {
    "decay": Decay,
    "perfusion": Perfusion,
}


@final
@dataclass(frozen=True, eq=False)
class Substance:
    """What diffuses, decays, and is taken up and secreted by cells.

    Parameters
    ----------
    diffusion : float, µm²/s
    conditions
        On the sides of the grid, in py-pde's terms (``{"x-": {"value": 0.1}, "*":
        {"derivative": 0}}``; of shells ``"r+"`` or one condition), a concentration in mM on all
        sides, or a function of the medium's concentration (mM) that returns them. Values, slopes
        and mixed conditions are known, of numbers; a value, slope or ``const`` may be an array of
        the nodes of a side.
    half_saturation : float, mM
    decay, perfusion : float, 1/s
        Rates of the linear terms: see :data:`LINEAR_TERMS`.
    medium
        What a perfusion brings and ``conditions`` is called with: mM, or a :class:`Schedule`.
    capacity, production : (n,), amol/s, optional
        Largest uptake and secretion of each cell.
    varied : shape of the grid, optional
        Coefficient of diffusion at the nodes over ``diffusion``.
    supply : shape of the grid, mM/s, optional
        What nodes gain besides, whatever the cells do: from points and planes that stand still.

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
    supply: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("diffusion", "half_saturation", *LINEAR_TERMS):
            value = getattr(self, name)
            positive = name in ("diffusion", "half_saturation")
            if not (np.isfinite(value) and (value > 0.0 or (value == 0.0 and not positive))):
                bound = "above zero" if positive else "zero or more"
                raise SceneError(name, f"is {value!r}, must be a finite number, {bound}")
        for name in ("capacity", "production"):
            amounts = getattr(self, name)
            if (
                amounts is not None
                and not (np.isfinite(amounts) & (np.asarray(amounts) >= 0)).all()
            ):
                raise SceneError(name, "of some cell is negative or not finite")
        if self.supply is not None and not np.isfinite(self.supply).all():
            raise SceneError("supply", "of some node is not finite")

    @property
    def schedule(self) -> Schedule:
        """The medium over time."""
        return self.medium if isinstance(self.medium, Schedule) else Schedule.steady(self.medium)

    @cached_property
    def linear_terms(self) -> tuple[LinearTerm, ...]:
        """Those whose rate is not zero."""
        rates = {name: float(getattr(self, name)) for name in LINEAR_TERMS}
        return tuple(LINEAR_TERMS[name](rate) for name, rate in rates.items() if rate > 0.0)
