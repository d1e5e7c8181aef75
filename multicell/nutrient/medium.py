"""What a finite medium holds, and its account."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, final

from multicell.errors import NutrientFailed

if TYPE_CHECKING:
    from multicell.scene.nutrient import Nutrient


@final
@dataclass(frozen=True)
class WellMixed:
    """The stirred part of a medium, with its account from the start on.

    - ``amount``, float, amol
    - ``volume``, float, µm³
    - ``fresh``, ``discarded``, float, amol: what fresh medium brought, at the start and at changes,
      and what went with the old
    - ``decayed``, float, amol
    - ``changes``, int: how many entries of the schedule have been done
    """

    amount: float
    volume: float
    fresh: float
    discarded: float = 0.0
    decayed: float = 0.0
    changes: int = 0

    @property
    def concentration(self) -> float:
        """Concentration, mM."""
        return self.amount / self.volume

    def changed(self, concentration: float, part: float) -> WellMixed:
        """Return it with a part replaced by fresh medium of a concentration in mM."""
        gone, brought = part * self.amount, part * self.volume * concentration
        return replace(
            self, amount=self.amount - gone + brought, fresh=self.fresh + brought,
            discarded=self.discarded + gone, changes=self.changes + 1,
        )  # fmt: skip


def attach(name: str, nutrient: Nutrient, covered: float) -> WellMixed:
    """Return the medium at the start, round a grid that covers ``covered`` µm³."""
    volume, level = beyond(name, nutrient, covered), nutrient.medium(0.0)
    done = sum(time <= 0.0 for time, _ in nutrient.media or ())
    return WellMixed(level * volume, volume, level * volume, changes=done)


def beyond(name: str, nutrient: Nutrient, covered: float) -> float:
    """Return the volume of the medium beyond the grid, µm³."""
    assert nutrient.finite_medium is not None
    volume = nutrient.finite_medium.volume
    if not volume > covered:
        raise NutrientFailed(
            f"the finite medium of {name} is {volume:.4g} um^3 in all, but its grid covers "
            f"{covered:.4g} um^3: nothing is left that could be stirred",
            "Give finite_medium a larger volume, or the field a smaller margin",
        )
    return volume - covered
