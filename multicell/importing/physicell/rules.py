"""Rules of PhysiCell's grammar as responses of a scene.

A line of version 2 or 3 is: type, signal, increases or decreases, behaviour, its value at
saturation, signal of half the effect, Hill power, and whether it holds for the dead; version 1 has
the type's own value before that at saturation. All rules of one behaviour combine by the rule
``physicell`` of :mod:`multicell.biology.responding`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

from multicell.behaviours.catalogue import CONTACTS, behaviour_named
from multicell.errors import SceneError
from multicell.importing.files import found_file, read_rows
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, Kind, Model

if TYPE_CHECKING:
    from pathlib import Path

    from multicell.importing.files import Element

_STEEPEST = 32.0
"""Largest Hill power of a scene."""
_COLUMNS: Final = {0: 10, 1: 9, 2: 8, 3: 8}
"""Of each version of the grammar."""
_TOUCHING = "neighbours that touch and live; PhysiCell counts all within the range of adhesion"
_EATEN = "cells do not eat, attack or fuse with each other"
_HURT = "cells have no damage"
_DEAD = "what has died responds to nothing"
_CODE = "read by C++ code of a model only"

_SIGNALS: Final = {
    "pressure": ("crowding", 1.0, ""),
    "volume": ("volume", 1.0, ""),
    "time": ("time", MINUTE, ""),
    "contact with live cell": ("neighbours", 1.0, _TOUCHING),
    "contact with dead cell": ("dead neighbours", 1.0, _TOUCHING.replace(" and live", "")),
}
"""Signal here, how much of its unit one of PhysiCell's is, and how it differs."""
_NO_SIGNAL: Final = {
    r"intracellular |internalized ": "what a cell has taken up is not kept",
    r".* gradient$|grad\(|gradient of ": "the steepness of a field is no signal",
    r"contact with (apoptotic|necrotic|other dead)": "dead neighbours are counted as one",
    r"contact with (basement membrane|BM)": "there is no basement membrane",
    r"damage|.*attack": _HURT,
    r"(is[ _])?(dead|apoptotic|necrotic)$": _DEAD,
    r"custom": _CODE,
}
_NO_BEHAVIOUR: Final = {
    r"attack|phagocyto|fuse": _EATEN,
    r"damage|immunogenicity": _HURT,
    r"migration persistence time": "types share one persistence time, which does not respond",
    r"chemotactic ": "the share of each gradient does not respond, only the bias along one",
    r"migration|exit from|cycle entry": "cells of this type have none",
    r"cell-(cell|BM|membrane)|adhesive|relative maximum": "adhesion does not respond",
    r"custom": _CODE,
    r"is_movable|cell (at|de)tachment|maximum number": "cells are not joined or held",
}
_SYNONYMS: Final = {
    r"exit from cycle phase 0": "cycle entry",
    r"(transition|transform) to ": "transform to ",
    r"(.*) secretion saturation density": r"\1 secretion target",
    r"(current|global) time": "time",
    r"(contact with .*\bcell)s": r"\1",
}


@final
@dataclass(eq=False)
class Rule:
    """A line of a file of rules, and what became of it; names are the grammar's first ones."""

    place: str
    text: str
    kind: Kind | None
    signal: str
    behaviour: str
    end: float
    half: float
    power: float
    dead: bool
    level: tuple[str, float] | None = None  # signal of the scene, its units for one of PhysiCell's
    fate: Fate = Fate.LEFT_OUT
    key: str = ""
    note: str = ""


def read_rules(model: Model, folder: Path) -> None:
    """Read ``cell_rules``; to be called when substances are known, before what they change."""
    for ruleset in model.root.all("cell_rules/rulesets/ruleset"):
        if not ruleset.says("enabled"):
            model.account.take_all([ruleset], Fate.OFF)
        elif ruleset.attributes.get("format", "csv").lower() != "csv":
            model.account.leave_out([ruleset], "rules are read from tables (CSV) only")
        else:
            path = found_file(ruleset, folder)
            note = "its rules have own entries"
            for one in ("folder", "filename"):
                model.account.take_all(ruleset.all(one), Fate.MAPPED, note=note)
            model.rules += _rules(model, path, _version(ruleset))


def _version(ruleset: Element) -> int | None:
    """Return the version of the grammar, or None if it is not said."""
    stated = ruleset.attributes.get("version", "")
    try:
        return min(int(float(stated)), 3) if stated else None
    except ValueError:
        raise ruleset.error(f"has the version {stated!r}, must be a number") from None


def _rules(model: Model, path: Path, version: int | None) -> Iterable[Rule]:
    for number, row in read_rows(path):
        place = f"{path.name}, line {number}"
        if row[0].startswith("//"):
            continue
        if len(row) == 1 and "\t" in row[0]:
            row = [word.strip() for word in row[0].split("\t")]
        columns = _COLUMNS[version] if version is not None else max(8, min(len(row), 9))
        if version == 0:
            note = "rules of the prototype of the grammar (version 0) are not read"
            model.account.add(place, ",".join(row), Fate.LEFT_OUT, note=note)
        elif len(row) != columns or not all(row):
            note = f"{len(row)} columns, not {columns} that all say something: PhysiCell skips it"
            model.account.add(place, ",".join(row), Fate.OFF, note=note)
        else:
            yield _rule(model, place, row)


def _rule(model: Model, place: str, row: list[str]) -> Rule:
    try:
        end, half, power, dead = map(float, row[-4:])
        own = float(row[4]) if len(row) == 9 else None
    except ValueError:
        raise SceneError(place, "has a number that is none in its last columns") from None
    if not all(map(math.isfinite, (end, half, power))):
        raise SceneError(place, "has a number that is not finite")
    if row[2] not in ("increase", "increases", "promotes", "decrease", "decreases", "inhibits"):
        raise SceneError(place, f"says {row[2]!r}, must be 'increases' or 'decreases'")
    signal, behaviour = (_first_name(model, word) for word in (row[1], row[3]))
    rule = Rule(
        place, ",".join(row), model.kind_named(row[0]), signal, behaviour, end, half, power,
        bool(dead),
    )  # fmt: skip
    if rule.kind is None:
        rule.fate, rule.note = Fate.OFF, "of a type that there is not"
    elif not (half > 0.0 and power > 0.0):
        rule.note = "half the effect at no signal, or a power of zero"
    else:
        _find_signal(model, rule)
        if own is not None:
            rule.note += f"; the own value is that of the settings, not {own:g} of this line"
    return rule


def _first_name(model: Model, word: str) -> str:
    """Return the grammar's first name for a signal or behaviour."""
    for pattern, name in _SYNONYMS.items():
        found = re.match(pattern, word)
        if found:
            word = found.expand(name) + word[found.end() :]
    found = re.fullmatch(r"(.*) cell type (\d+)", word)
    kind = next((k for k in model.kinds if found and k.number == int(found[2])), None)
    return f"{found[1]} {kind.name}" if found and kind else word


def _find_signal(model: Model, rule: Rule) -> None:
    """Set the signal of the scene that a rule means, or say why there is none."""
    rule.note = "for living cells only" if rule.dead else ""
    touching = model.kind_named(rule.signal.removeprefix("contact with "))
    if rule.signal in model.fields:
        rule.level = model.fields[rule.signal], model.unit[rule.signal]
    elif rule.signal in _SIGNALS:
        name, factor, note = _SIGNALS[rule.signal]
        rule.level, rule.note = (name, factor), rule.note or note
    elif rule.signal.startswith("contact with ") and touching is not None:
        counted = "neighbours" if len(model.kinds) == 1 else f"{CONTACTS}{touching.key}"
        rule.level, rule.note = (counted, 1.0), rule.note or _TOUCHING
    else:
        rule.note = _reason(rule.signal, _NO_SIGNAL) or "is no signal of PhysiCell's grammar"


def _reason(word: str, known: dict[str, str]) -> str:
    return next((why for pattern, why in known.items() if re.match(pattern, word)), "")


def rules_of(model: Model, behaviour: str, kinds: Iterable[Kind]) -> list[Rule]:
    """Return the rules of a behaviour of some types whose signals a scene has."""
    who = set(kinds)
    return [
        rule
        for rule in model.rules
        if rule.behaviour == behaviour and rule.kind in who and rule.level is not None
    ]


def set_behaviour(
    model: Model,
    behaviour: str,
    usual: float,
    value: Callable[[Kind, Rule | None], float],
    kinds: Iterable[Kind],
    rules: Iterable[Rule],
    note: str = "",
) -> None:
    """Set what types do: their own values where these are not the scene's, and what rules say.

    - ``behaviour``, ``usual``: of the scene, and what it gives for all types
    - ``value``: returns what a type does by itself, or at saturation of a rule, in its unit there
    - ``note``: how the behaviour here differs from that of the rules
    """
    known, most = list(rules), behaviour_named(behaviour, "")[0].at_most
    own = {kind: min(value(kind, None), most) for kind in kinds}
    combine = {"combine": "physicell"} if known else {}
    for kind, number in own.items():
        if not math.isclose(number, usual, rel_tol=1e-12):
            _respond(model, kind, behaviour, "", {"law": "constant", "largest": number, **combine})
    for rule in known:
        assert rule.kind is not None
        assert rule.level is not None
        wanted, base = value(rule.kind, rule), own[rule.kind]
        if math.isclose(wanted, base, rel_tol=1e-12):
            if not rule.key:
                rule.fate, rule.note = Fate.OFF, "ends at the type's own value"
            continue
        rule.key = _respond(model, rule.kind, behaviour, rule.level[0], {
            "signal": rule.level[0], "law": "hill", "half": rule.half * rule.level[1],
            "power": min(rule.power, _STEEPEST), "base": base, "largest": min(wanted, most),
            **combine,
        })  # fmt: skip
        notes = [*rule.note.split("; "), note]
        if rule.power > _STEEPEST:
            notes.append(f"with the power {_STEEPEST:g}, the largest here")
        if wanted > most:
            notes.append(f"at most {most:g} {behaviour_named(behaviour, '')[0].unit}".rstrip())
        rule.note = "; ".join(dict.fromkeys(filter(None, notes)))
        rule.fate = Fate.APPROXIMATED if rule.note else Fate.MAPPED


def _respond(model: Model, kind: Kind, behaviour: str, signal: str, said: dict[str, Any]) -> str:
    """Add a response of a type; return its key."""
    by = f"_by_{signal}" if signal else ""
    who = {"cells": kind.key} if len(model.kinds) > 1 else {}
    name = re.sub(r"\W+", "_", f"{behaviour}_of_{kind.key}{by}", flags=re.ASCII)
    known = model.part("responses")
    while name in known:
        name += "_too"
    known[name] = {"behaviour": behaviour, **who, **said}
    return f"responses.{name}"


def account_for_rules(model: Model) -> None:
    """Account for all rules, those that nothing has read included."""
    for rule in model.rules:
        if not rule.key and rule.fate is Fate.LEFT_OUT and rule.level is not None:
            known = _reason(rule.behaviour, _NO_BEHAVIOUR)
            rule.note = known or (rule.note if rule.note.startswith("fields") else
                                  "this behaviour has no counterpart")  # fmt: skip
        model.account.add(rule.place, rule.text, rule.fate, rule.key, rule.note.strip("; "))
