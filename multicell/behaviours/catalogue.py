"""The behaviours of cells that respond to signals, and the signals, by their names in a scene."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, final

from multicell.errors import SceneError
from multicell.schema import near_miss


@final
@dataclass(frozen=True)
class Behaviour:
    """A behaviour of cells, which responses may change.

    Attributes
    ----------
    name
        In a scene; of those that concern a field, a type or a phase up to its name.
    of
        ``"field"``, ``"type"`` or ``"phase"`` if the name ends in that of one, else empty.
    unit
        Base unit of its values. Those without are factors on what the scene gives, or chances.
    combine
        How several responses are combined, unless they state it.
    at_most
        The largest value.
    doc
        What it is.
    """

    name: str
    doc: str
    of: str = ""
    unit: str = ""
    combine: str = "product"
    at_most: float = 1e3

    @property
    def is_factor(self) -> bool:
        """Whether its values multiply what the scene gives, so that one changes nothing."""
        return self.combine == "product"


def _rate(name: str, doc: str, of: str = "") -> Behaviour:
    return Behaviour(name, doc, of, "1/s", "sum", 1.0)


def _chance(name: str, doc: str) -> Behaviour:
    return Behaviour(name, doc, "type", "", "sum", 1.0)


SURFACE_ENERGY: Final = "surface energy"

BEHAVIOURS: Final = (
    Behaviour("growth rate", "factor on growth, and on the cycle in the phases in which it grows"),
    Behaviour("entry into", "factor on the pace of the phase before", "phase"),
    Behaviour("rest", "chance that a cell rests", combine="maximum", at_most=1.0),
    _rate("apoptosis rate", "rate of death by apoptosis"),
    _rate("necrosis rate", "rate of death by necrosis"),
    _rate("damage rate", "rate of taking damage, of which 1 kills a mean cell by necrosis"),
    _rate("change to", "rate of becoming another type", "type"),
    _chance("mutation to", "chance of each daughter to be of another type"),
    _chance("asymmetric division to", "chance that exactly one daughter is of another type"),
    Behaviour("speed", "factor on the active forces"),
    Behaviour("bias", "bias of random motion, from -1 to 1", combine="sum", at_most=1.0),
    Behaviour("uptake of", "factor on the uptake of a field", "field"),
    Behaviour("secretion of", "factor on the secretion of a field", "field"),
    Behaviour("receptors", "factor on the receptors"),
    Behaviour("ligands", "factor on the ligands"),
    Behaviour("Young's modulus", "factor on Young's modulus"),
    Behaviour(SURFACE_ENERGY, "factor on the surface energy of a cell's contacts"),
)
"""All behaviours."""

_ALSO: Final = {"death rate": "apoptosis rate", "growth": "growth rate"}
"""Other names -> the behaviour that is meant."""

COMBINE: Final = ("product", "minimum", "maximum", "sum", "physicell")
"""How several responses of one behaviour are combined; see :mod:`multicell.biology.responding`."""

SIGNALS: Final = {
    "pressure": "kPa",
    "ATP": "mM/s",
    "age": "s",
    "volume": "um^3",
    "radius": "um",
    "time": "s",
    "neighbours": "",
    "dead neighbours": "",
    "crowding": "",
}
"""Signals besides fields -> base unit.

``crowding`` is the sum over the neighbours of (1 - d/s)², d the distance and s the sum of the
radii, over that of :data:`FULL_CROWDING`: 1 for a cell among twelve at the distance
of close packing.
"""

FULL_CROWDING: Final = 12.0 * (1.0 - math.sqrt(math.pi / (2.0 * math.sqrt(3.0)))) ** 2
"""Twelve neighbours in a plane's closest packing of one density: PhysiCell's unit of pressure.

A. Ghaffarizadeh et al., PLoS Comput. Biol. 14 (2018) e1005991.
"""

CONTACTS: Final = "contacts with "
"""Signals that begin so count the neighbours of a type."""


PHASE: Final = "phase "
"""Signals that begin so are 1 for cells in a phase of the cycle, and 0 for others."""
OF_NEIGHBOURS: Final = "neighbours."
"""Signals that begin so are the mean of a network's value over the neighbours that touch."""
SUM_OF: Final = "sum of "
"""Before such a signal: the sum in place of the mean."""
WEIGHTED: Final = "weighted "
"""Before such signals: each neighbour counts in proportion to the area of the contact."""


def behaviour_named(name: str, path: str) -> tuple[Behaviour, str]:
    """Return a behaviour and the name of the field, type or phase that it concerns, if any."""
    name = _ALSO.get(name, name)
    for known in BEHAVIOURS:
        if known.of and name.startswith(known.name + " "):
            return known, name[len(known.name) + 1 :]
        if not known.of and name == known.name:
            return known, ""
    names = [f"{b.name} {b.of.upper()}" if b.of else b.name for b in BEHAVIOURS]
    raise SceneError(path, f"is {name!r}, which is no behaviour", near_miss(name, names))


def signal_unit(name: str, fields: Iterable[str], path: str) -> str:
    """Return the base unit of a signal; its caller checks types of contacts, and networks.

    Values of networks have no base unit: they are in the network's own.
    """
    if "." in name:
        return ""
    if name in SIGNALS:
        return SIGNALS[name]
    if name.startswith((CONTACTS, PHASE)):
        return ""
    if name in fields:
        return "mM"
    known = [*fields, *SIGNALS, f"{CONTACTS}TYPE", f"{PHASE}NAME"]
    raise SceneError(path, f"is {name!r}, which is no signal here", near_miss(name, known))


def value_around(signal: str) -> str:
    """Return the ``NETWORK.NAME`` of which a signal is the value, also in neighbours."""
    return signal.removeprefix(WEIGHTED).removeprefix(SUM_OF).removeprefix(OF_NEIGHBOURS)


def needs_contacts(signal: str) -> bool:
    """Return whether a signal is made from the neighbours."""
    counted = signal in ("neighbours", "dead neighbours", "crowding")
    return counted or signal.startswith(CONTACTS) or OF_NEIGHBOURS in signal
