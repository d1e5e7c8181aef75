"""Items of ``multicell explain``: the parts of a scene, and numbers that follow from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import final

from multicell.units import time_text


@final
@dataclass(frozen=True)
class ExplainedPart:
    """A part of a scene: whether it is used, and its effect."""

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


def part(name: str, what: object) -> ExplainedPart:
    """Return a part that is used if there is anything to say of it, and absent if not."""
    return ExplainedPart(name, bool(what), str(what or "absent"))


def pair_label(text: str, label: str) -> str:
    """Return the name of a number, with the pair of types that it is of."""
    return f"{text}, {label}" if label else text


hours = partial(time_text, least_days=3.0)
"""Return a simulated time in a unit that is easy to read."""
