"""What ``multicell explain`` tells: the parts of a scene, and numbers that follow from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Final, final

from multicell.units import time_text

_ABSENT: Final = {
    "types": "all cells are alike",
    "adhesion": "no receptors",
    "friction": "only the medium resists",
    "compression": "contacts of pairs alone resist compression",
    "motility": "no active motion",
    "pull": "no external force",
    "motions": "no cell is held or moved from outside",
    "growth": "the number of cells stays, no growth and no division is computed",
    "radiation": "no cell is irradiated",
    "death": "dead cells keep their place and volume",
    "energy": "every field acts by itself, none makes up for another",
    "nutrients": "no field is solved, no cell starves",
}
"""What the absence of a part means."""


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


def part(name: str, what: object) -> Part:
    """Return a part that is used if there is anything to say of it, and absent if not."""
    return Part(name, bool(what), str(what or "") or f"absent: {_ABSENT[name]}")


def pair_label(text: str, label: str) -> str:
    """Return the name of a number, with the pair of types that it is of."""
    return f"{text}, {label}" if label else text


hours = partial(time_text, least_days=3.0)
"""Return a simulated time in a unit that is easy to read."""
