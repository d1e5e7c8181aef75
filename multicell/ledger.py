"""What came into the box of a nutrient and what the cells took up, over a whole run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final


@final
@dataclass
class Ledger:
    """Running totals of one nutrient, amol.

    A quasi-steady field stores nothing: inflow and uptake must agree up to the solver's
    tolerance, and the remainder says how well they do.
    """

    inflow: float = 0.0
    uptake: float = 0.0

    def add(self, inflow: float, uptake: float, dt: float) -> None:
        """Add rates (amol/s) that held for a time ``dt`` (s)."""
        self.inflow += inflow * dt
        self.uptake += uptake * dt

    @property
    def remainder(self) -> float:
        """Inflow minus uptake, amol."""
        return self.inflow - self.uptake

    def summary(self) -> dict[str, float]:
        """Return totals in amol, and the remainder relative to the turnover."""
        turnover = max(abs(self.inflow), abs(self.uptake))
        return {
            "inflow": self.inflow,
            "uptake": self.uptake,
            "remainder": self.remainder,
            "relative_remainder": abs(self.remainder) / turnover if turnover else 0.0,
        }
