"""The contact laws by their names in a scene: ours, and those that were made in this process."""

from __future__ import annotations

from typing import TYPE_CHECKING

from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.contact.none import NoContact
from multicell.contact.physicell import PhysiCell
from multicell.contact.springs import CubicSpring, GeneralisedLinearSpring, LinearSpring
from multicell.plugins.laws import Laws

if TYPE_CHECKING:
    from multicell.contact.law import PairLaw


CONTACT_LAWS: Laws[PairLaw] = Laws(
    {
        "hertz": Hertz,
        "jkr": JKR,
        "exact-jkr": ExactJKR,
        "linear": LinearSpring,
        "cubic": CubicSpring,
        "generalised-linear": GeneralisedLinearSpring,
        "physicell": PhysiCell,
        "none": NoContact,
    }
)
"""All pair laws; those of the user's own are entered by :func:`multicell.pair_law`."""
