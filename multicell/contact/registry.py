"""The contact laws by their names in a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.contact.springs import Cubic, GeneralisedLinear, Linear

if TYPE_CHECKING:
    from multicell.contact.law import PairLaw


LAWS: dict[str, type[PairLaw]] = {
    "hertz": Hertz,
    "jkr": JKR,
    "exact-jkr": ExactJKR,
    "linear": Linear,
    "cubic": Cubic,
    "generalised-linear": GeneralisedLinear,
}
"""Pair laws by the name that a scene gives."""
