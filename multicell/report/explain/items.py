"""The two kinds of facts that ``multicell explain`` gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class Part:
    """A part of a scene: whether it is used, and what that means."""

    part: str
    used: bool
    what: str


@final
@dataclass(frozen=True)
class Number:
    """A derived number with its unit and its meaning."""

    name: str
    value: float
    unit: str
    meaning: str


def hours(seconds: float) -> str:
    """Return a simulated time in a unit that is easy to read."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= (3.0 if unit == "d" else 1.0) * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"
