"""Elements without a counterpart in a scene, or used by C++ code of a model only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from multicell.importing.account import Fate

if TYPE_CHECKING:
    from multicell.importing.physicell.model import Model
    from multicell.importing.xml import Element

_CODE = "read by C++ code of the model only"
_ATTACKS: Final = ("attack_damage_rate", "attack_duration", "damage_rate")
_PARTS: Final = {
    "cell_interactions": "cells do not eat, attack or fuse with each other",
    "cell_transformations": "cells do not change their type",
    "cell_integrity": "cells have no damage",
    "molecular": _CODE,
}


def read_others(model: Model) -> None:
    """Account for what has no counterpart here."""
    take_all = model.account.take_all
    for kind in model.kinds:
        for part, why in _PARTS.items():
            found = kind.own(part)
            if found is not None:
                _leave(model, found, why)
        inside = kind.own("intracellular")
        if inside is not None:
            take_all([inside], Fate.LEFT_OUT, note="there are no models inside cells")
        take_all(kind.element.all("custom_data"), Fate.LEFT_OUT, note=_CODE)
        for one in kind.element.all("initial_parameter_distributions"):
            _read_distributions(model, one)
    for one in model.root.all("cell_rules/settings"):
        take_all([one], Fate.OFF)
    take_all(model.root.all("user_parameters"), Fate.LEFT_OUT, note=_CODE)


def _leave(model: Model, part: Element, why: str) -> None:
    """Account for the numbers of a part: those that are zero do nothing in the model either."""
    peaceful = not any(_acts(one) for one in part.all("attack_rates/attack_rate"))
    for leaf in part.leaves():
        idle = peaceful and leaf.tag in _ATTACKS and part.tag == "cell_interactions"
        on = _acts(leaf) and not idle
        model.account.take(leaf, Fate.LEFT_OUT if on else Fate.OFF, note=why if on else "")


def _acts(element: Element) -> bool:
    return bool(element.word()) and element.number() != 0.0


def _read_distributions(model: Model, table: Element) -> None:
    off = "enabled" in table.attributes and not table.says("enabled")
    for one in table.all("distribution"):
        quiet = off or ("enabled" in one.attributes and not one.says("enabled"))
        note = "" if quiet else "cells of one type are alike at the start, but for cells.csv"
        model.account.take_all([one], Fate.OFF if quiet else Fate.LEFT_OUT, note=note)
    model.account.take_all([table], Fate.OFF)
