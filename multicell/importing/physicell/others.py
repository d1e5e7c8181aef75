"""Elements without a counterpart in a scene, or used by C++ code of a model only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from multicell.importing.account import Fate
from multicell.importing.physicell.model import MINUTE, Kind, Model
from multicell.importing.physicell.rules import Rule, rules_of, set_behaviour

if TYPE_CHECKING:
    from multicell.importing.xml import Element

_CODE = "read by C++ code of the model only"
_ATTACKS: Final = ("attack_damage_rate", "attack_duration", "damage_rate")
_PARTS: Final = {
    "cell_interactions": "cells do not eat, attack or fuse with each other",
    "cell_integrity": "cells have no damage",
    "molecular": _CODE,
}


def read_others(model: Model) -> None:
    """Account for what has no counterpart here."""
    account = model.account
    _read_changes(model)
    for kind in model.kinds:
        for part, why in _PARTS.items():
            found = kind.own(part)
            if found is not None:
                _leave(model, found, why)
        _account_for_changes(model, kind)
        inside = kind.element.all("phenotype/intracellular")
        account.leave_out(inside, "there are no models inside cells")
        account.leave_out(kind.element.all("custom_data"), _CODE)
        for one in kind.element.all("initial_parameter_distributions"):
            _read_distributions(model, one)
    account.take_all(model.root.all("cell_rules/settings"), Fate.OFF)
    account.leave_out(model.root.all("user_parameters"), _CODE)


def _changes(kind: Kind) -> dict[str, float]:
    """Return the rates at which cells of a type become others, 1/min by their names."""
    table = kind.given("cell_transformations")
    found = [] if table is None else table.all("transformation_rates/transformation_rate")
    return {one.attributes.get("name", ""): one.number(at_least=0.0) for one in found}


def _read_changes(model: Model) -> None:
    """Read ``transformation_rates`` of all types, and rules that change them."""
    for to in model.kinds:
        rates = {kind: _changes(kind).get(to.name, 0.0) for kind in model.kinds if kind is not to}

        def value(kind: Kind, rule: Rule | None, rates: dict[Kind, float] = rates) -> float:
            return (rates[kind] if rule is None else rule.end) / MINUTE

        rules = rules_of(model, f"transform to {to.name}", rates)
        set_behaviour(model, f"change to {to.key}", 0.0, value, rates, rules)


def _account_for_changes(model: Model, kind: Kind) -> None:
    table = kind.own("cell_transformations")
    for one in [] if table is None else table.all("transformation_rates/transformation_rate"):
        to = model.kind_named(one.attributes.get("name", ""))
        if to is None or to is kind or one.number() == 0.0:
            model.account.take(one, Fate.OFF)
        else:
            model.account.take(one, Fate.MAPPED, f"responses.change_to_{to.key}_of_{kind.key}")


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
