"""Values of parameters in words."""

from __future__ import annotations

from multicell.report.wording import time_unit, written


def value_in_words(value: float, unit: str) -> str:
    """Return a value in base units in words, times in a unit that suits them."""
    if unit == "s" and value:
        return time_unit(abs(value)).text(value)
    return f"{value:.4g} {written(unit)}".strip()
