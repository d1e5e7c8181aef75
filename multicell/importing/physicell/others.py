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
    account = model.account
    for kind in model.kinds:
        for part, why in _PARTS.items():
            found = kind.own(part)
            if found is not None:
                _leave(model, found, why)
        inside = kind.element.all("phenotype/intracellular")
        account.leave_out(inside, "there are no models inside cells")
        account.leave_out(kind.element.all("custom_data"), _CODE)
        for one in kind.element.all("initial_parameter_distributions"):
            _read_distributions(model, one)
    account.take_all(model.root.all("cell_rules/settings"), Fate.OFF)
    account.leave_out(model.root.all("user_parameters"), _CODE)


def _leave(model: Model, part: Element, why: str) -> None:
    """Account for the numbers of a part: those that are zero do nothing in the model either."""
    peaceful = not any(_acts(one) for one in part.all("attack_rates/attack_rate"))
    for leaf in part.leaves():
        idle = peaceful and leaf.tag in _ATTACKS and part.tag == "cell_interactions"
        model.account.leave_out([leaf], why, acts=_acts(leaf) and not idle)


def _acts(element: Element) -> bool:
    return bool(element.word()) and element.number() != 0.0


def _read_distributions(model: Model, table: Element) -> None:
    off = "enabled" in table.attributes and not table.says("enabled")
    for one in table.all("distribution"):
        quiet = off or ("enabled" in one.attributes and not one.says("enabled"))
        note = "cells of one type are alike at the start, but for cells.csv"
        model.account.leave_out([one], note, acts=not quiet)
    model.account.take_all([table], Fate.OFF)
