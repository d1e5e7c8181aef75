"""Rules of PhysiCell's grammar as responses of a scene.

A line of version 2 or 3 is: type, signal, increases or decreases, behaviour, its value at
saturation, signal of half the effect, Hill power, and whether it holds for the dead; version 1 has
the type's own value before that at saturation. All rules of one behaviour combine by the rule
``physicell`` of :mod:`multicell.biology.responding`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

from multicell.behaviours.catalogue import CONTACTS, behaviour_named
from multicell.errors import SceneError
from multicell.importing.files import Element, found_file, read_rows
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, CellDefinition, Model
from multicell.units import whole_number

_STEEPEST = 32.0
"""Largest Hill power of a scene."""
_TOUCHING = "neighbours that touch and live; PhysiCell counts all within the range of adhesion"

_SIGNALS: Final = {
    "pressure": ("crowding", 1.0, ""),
    "volume": ("volume", 1.0, ""),
    "time": ("time", MINUTE, ""),
    "contact with live cell": ("neighbours", 1.0, _TOUCHING),
    "contact with dead cell": ("dead neighbours", 1.0, _TOUCHING.replace(" and live", "")),
}
"""Signal here, how much of its unit one of PhysiCell's is, and how it differs."""
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
    """A line of a file of rules, and what became of it; names are the grammar's first ones.

    ``signal`` and ``half`` are those of the scene. An ``element`` that lets a network decide stands
    for a straight line from nothing at zero to ``end`` at a signal of ``end``; its text is empty
    for a type that has it from another one.
    """

    place: str
    text: str
    kind: CellDefinition
    signal: str
    behaviour: str
    end: float
    half: float
    power: float
    note: str
    fate: Fate = Fate.LEFT_OUT
    key: str = ""
    element: Element | None = None


def read_rules(model: Model, folder: Path) -> None:
    """Read ``cell_rules``; to be called when substances are known, before what they change."""
    for ruleset in model.root.all("cell_rules/rulesets/ruleset"):
        version = ruleset.attributes.get("version", "")
        csv = ruleset.attributes.get("format", "csv").lower() == "csv"
        if not ruleset.says("enabled"):
            model.account.take_all([ruleset], Fate.OFF)
        elif not csv or not re.match(r"[1-9]|$", version):
            note = "rules are read from tables (CSV) of versions 1, 2 and 3 only"
            model.account.take_all([ruleset], Fate.LEFT_OUT, note=note)
        else:
            note = "its rules have own entries"
            model.account.take_all([ruleset], Fate.MAPPED, note=note)
            _read_table(model, found_file(ruleset, folder), version)


def _read_table(model: Model, path: Path, version: str) -> None:
    for number, row in read_rows(path):
        place = f"{path.name}, line {number}"
        if row[0].startswith("//"):
            continue
        if len(row) == 1 and "\t" in row[0]:
            row = [word.strip() for word in row[0].split("\t")]
        columns = 9 if version[:1] == "1" or (not version and len(row) > 8) else 8
        if len(row) != columns or not all(row):
            note = f"{len(row)} columns, not {columns} that all say something: PhysiCell skips it"
            model.account.add(place, ",".join(row), Fate.OFF, note=note)
        else:
            _read_row(model, place, row)


def _read_row(model: Model, place: str, row: list[str]) -> None:
    try:
        end, half, power, dead = map(float, row[-4:])
    except ValueError:
        raise SceneError(place, "has a number that is none in its last columns") from None
    if not all(map(math.isfinite, (end, half, power))):
        raise SceneError(place, "has a number that is not finite")
    if row[2] not in ("increase", "increases", "promotes", "decrease", "decreases", "inhibits"):
        raise SceneError(place, f"says {row[2]!r}, must be 'increases' or 'decreases'")
    signal, behaviour = (_first_name(model, word) for word in (row[1], row[3]))
    kind, level, text = model.kind_named(row[0]), _level(model, signal), ",".join(row)
    if kind is None:
        model.account.add(place, text, Fate.OFF, note="of a type that there is not")
    elif level is None:
        note = f"the signal '{signal}' has no counterpart here"
        model.account.add(place, text, Fate.LEFT_OUT, note=note)
    elif not (half > 0.0 and power > 0.0):
        note = "half the effect at no signal, or a power of zero"
        model.account.add(place, text, Fate.LEFT_OUT, note=note)
    else:
        name, unit, note = level
        note = "for living cells only" if dead else note
        if len(row) == 9:
            note += f"; the own value is that of the settings, not {row[4]} of this line"
        rule = Rule(place, text, kind, name, behaviour, end, half * unit, power, note)
        model.rules.append(rule)


def _first_name(model: Model, word: str) -> str:
    """Return the grammar's first name for a signal or behaviour."""
    for pattern, name in _SYNONYMS.items():
        found = re.match(pattern, word)
        if found:
            word = found.expand(name) + word[found.end() :]
    found = re.fullmatch(r"(.*) cell type (\d+)", word)
    kind = next((k for k in model.kinds if found and k.number == whole_number(found[2])), None)
    return f"{found[1]} {kind.name}" if found and kind else word


def _level(model: Model, signal: str) -> tuple[str, float, str] | None:
    """Return the signal of the scene, its units for one of PhysiCell's, and how it differs."""
    touching = model.kind_named(signal.removeprefix("contact with "))
    if signal in model.fields:
        return model.fields[signal], model.unit[signal], ""
    if signal.startswith("contact with ") and touching is not None:
        counted = "neighbours" if len(model.kinds) == 1 else f"{CONTACTS}{touching.key}"
        return counted, 1.0, _TOUCHING
    return _SIGNALS.get(signal)


def rules_of(model: Model, behaviour: str, kinds: Iterable[CellDefinition]) -> list[Rule]:
    """Return the rules of a behaviour of some types."""
    who = set(kinds)
    return [rule for rule in model.rules if rule.behaviour == behaviour and rule.kind in who]


def set_behaviour(
    model: Model,
    behaviour: str,
    usual: float,
    own: Mapping[CellDefinition, float],
    rules: Iterable[Rule],
    end: Callable[[Rule], float],
    note: str = "",
) -> None:
    """Set behaviours of types: their own values where these are not the scene's, and rules.

    - ``behaviour``, ``usual``: of the scene, and what it gives for all types
    - ``own``, ``end``: values of types by themselves, and at saturation of a rule, in its unit
      there
    - ``note``: how the behaviour here differs from that of the rules
    """
    known, most = list(rules), behaviour_named(behaviour, "")[0].at_most
    combine = {"combine": "physicell"} if known else {}
    ruled = {rule.kind: _at_nothing(rule, end) for rule in known if rule.element is not None}
    own = {**own, **ruled}
    for kind, number in own.items():
        if not math.isclose(min(number, most), usual, rel_tol=1e-12):
            said = {"law": "constant", "largest": min(number, most), **combine}
            _respond(model, kind, behaviour, "", said)
    for rule in known:
        wanted, base = end(rule), min(own[rule.kind], most)
        if math.isclose(wanted, base, rel_tol=1e-12):
            if not rule.key:
                rule.fate, rule.note = Fate.OFF, "ends at the type's own value"
            continue
        law = {"law": "hill", "half": rule.half, "power": min(rule.power, _STEEPEST)}
        if rule.element is not None:
            law = {"law": "linear", "begin": 0.0, "end": rule.end * min(1.0, most / wanted)}
        rule.key = _respond(
            model,
            rule.kind,
            behaviour,
            rule.signal,
            {
                "signal": rule.signal,
                **law,
                "base": base,
                "largest": min(wanted, most),
                **combine,
            },
        )
        notes = [*rule.note.split("; "), note]
        if rule.power > _STEEPEST:
            notes.append(f"with the power {_STEEPEST:g}, the largest here")
        if wanted > most:
            notes.append(f"at most {most:g} {behaviour_named(behaviour, '')[0].unit}".rstrip())
        rule.note = "; ".join(dict.fromkeys(filter(None, notes)))
        rule.fate = Fate.APPROXIMATED if rule.note else Fate.MAPPED


def _at_nothing(rule: Rule, end: Callable[[Rule], float]) -> float:
    """Return the value of a rule's behaviour where its network makes nothing."""
    top, rule.end = rule.end, 0.0
    try:
        return end(rule)
    finally:
        rule.end = top


def _respond(
    model: Model, kind: CellDefinition, behaviour: str, signal: str, said: dict[str, Any]
) -> str:
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
        if rule.fate is Fate.LEFT_OUT and not rule.note.startswith("fields"):
            rule.note = f"'{rule.behaviour}' of this type has no counterpart here"
        if rule.element is not None and rule.text:
            model.account.take(rule.element, rule.fate, rule.key, rule.note, rule.text)
        elif rule.element is None:
            model.account.add(rule.place, rule.text, rule.fate, rule.key, rule.note)
