"""Rules of PhysiCell's grammar: which of them a scene can say.

A line is: type, signal, increases or decreases, behaviour, its value at saturation, signal of half
the effect, Hill power, and whether it holds for the dead. Behaviour goes from the type's own value
to that at saturation by c^n / (K^n + c^n). Here growth goes by c / (K + c) or I / (I + c), and
cells become necrotic below a threshold.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from multicell.errors import SceneError
from multicell.importing.account import Fate
from multicell.importing.files import read_rows
from multicell.importing.physicell.files import found_file
from multicell.importing.physicell.model import MINUTE, Kind, Model

if TYPE_CHECKING:
    from pathlib import Path

_WORDS = 4


@final
@dataclass(frozen=True)
class Rule:
    """A line of a file of rules."""

    place: str
    text: str
    kind: Kind | None
    signal: str
    rises: bool
    behaviour: str
    end: float
    half: float
    power: float


def read_rules(model: Model, folder: Path) -> None:
    """Read ``cell_rules``; to be called when substances are known, before the cycle is read."""
    for ruleset in model.root.all("cell_rules/rulesets/ruleset"):
        if not ruleset.says("enabled"):
            model.account.take_all([ruleset], Fate.OFF)
            continue
        path = found_file(ruleset, folder)
        for one in ("folder", "filename"):
            model.account.take_all(ruleset.all(one), Fate.MAPPED, note="its rules have own entries")
        for rule in _rules(model, path):
            fate, key, note = _read_rule(model, rule)
            model.account.add(rule.place, rule.text, fate, key, note)


def _rules(model: Model, path: Path) -> list[Rule]:
    made = []
    for number, row in read_rows(path):
        if row[0].startswith("//"):
            continue
        place = f"{path.name}, line {number}"
        # the first form of the grammar gives the value without signal as well
        if len(row) not in (8, 9):
            raise SceneError(place, f"has {len(row)} columns, must have 8", "Remove the line.")
        try:
            end, half, power = map(float, row[len(row) - 4 : len(row) - 1])
        except ValueError:
            raise SceneError(place, "has a number that is none in its last four columns") from None
        made.append(Rule(
            place, ",".join(row), model.kind_named(row[0]), row[1], row[2] == "increases", row[3],
            end, half, power,
        ))  # fmt: skip
    return made


def _read_rule(model: Model, rule: Rule) -> tuple[Fate, str, str]:
    """Do what a rule says, where a scene can say it; return what became of it."""
    if rule.kind is None:
        return Fate.OFF, "", "of a type that there is not"
    known = rule.signal in model.fields
    if known and rule.kind is model.leader and rule.half > 0.0:
        field = model.fields[rule.signal]
        level, made = rule.half * model.unit[rule.signal], model.part("nutrients", field)
        steep = "" if rule.power == 1.0 else f" (of the power 1, not {rule.power:g})"
        shared = "for all types" if len(model.kinds) > 1 else ""
        if rule.behaviour == "cycle entry" and rule.rises and "growth_half_saturation" not in made:
            made["growth_half_saturation"] = level
            rule.kind.entry = rule.end
            note = f"all growth by c / (K + c){steep} {shared}".strip()
            return Fate.APPROXIMATED, f"nutrients.{field}.growth_half_saturation", note
        falls = rule.behaviour == "cycle entry" and not rule.rises and rule.end == 0.0
        if falls and "growth_inhibition" not in made:
            made["growth_inhibition"] = level
            rule.kind.limited = True
            note = f"all growth by I / (I + c){steep} {shared}".strip()
            return Fate.APPROXIMATED, f"nutrients.{field}.growth_inhibition", note
        if rule.behaviour == "necrosis" and not rule.rises and _necrosis(model, rule, level, field):
            note = f"at the type's own rate below the signal of half the effect {shared}".strip()
            return Fate.APPROXIMATED, f"nutrients.{field}.necrosis", note
    return Fate.LEFT_OUT, "", "rules of this kind have no counterpart"


def _necrosis(model: Model, rule: Rule, level: float, field: str) -> bool:
    """Let cells become necrotic below a level at their type's rate, if it has one."""
    assert rule.kind is not None
    table = rule.kind.given("death")
    for one in [] if table is None else table.all("model"):
        rate = one.find("death_rate")
        if one.attributes.get("code") == "101" and rate is not None and rate.number() > 0.0:
            made = model.part("nutrients", field)
            if "necrosis" in made:
                return False
            made["necrosis"] = level
            model.part("death")["necrosis_rate"] = rate.number() / MINUTE
            return True
    return False
