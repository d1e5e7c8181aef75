"""Uptake and secretion of cells.

A cell of volume V changes the amount of a substance around it by V [S (T - c) - U c] + E: S, T and
U are rate and target of secretion and the rate of uptake, E the net export. Here uptake saturates
(Michaelis–Menten), u V c / (K + c): with K a thousand times the largest concentration it is
(S + U) V c up to a thousandth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, final

from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, Kind, Model
from multicell.importing.physicell.rules import Rule, rules_of, set_behaviour

if TYPE_CHECKING:
    from multicell.importing.files import Element

_FAR = 1e3
"""Half saturation over the largest concentration."""
_MAX_HALF = 1e5
"""Largest half saturation of a scene, mM."""


@final
@dataclass(frozen=True)
class Exchange:
    """Exchange of a substance by a type: per minute, in the substance's own unit."""

    secretion: float
    target: float
    uptake: float
    export: float

    def under(self, name: str, rule: Rule | None) -> Exchange:
        """Return the exchange of a substance at the saturation of a rule."""
        if rule is None:
            return self
        what = rule.behaviour.removeprefix(f"{name} ")
        return replace(self, **{what.removeprefix("secretion "): max(rule.end, 0.0)})

    def given_off(self, volume: float) -> float:
        """Return what it gives off whatever there is, unit µm³ / min."""
        return self.secretion * self.target * volume + max(self.export, 0.0)

    @property
    def taken_up(self) -> float:
        """First-order uptake per volume, 1/min."""
        return self.uptake + self.secretion


def read_secretion(model: Model) -> None:
    """Read ``secretion`` of all types; to be called when the substances are known."""
    for kind in model.kinds:
        for one in kind.listed("secretion", "substrate", own=True):
            if one.attributes.get("name") not in model.fields:
                problem = f"is of '{one.attributes.get('name')}', which is no substance"
                raise one.error(problem)
    for name in model.fields:
        known = {kind: _exchange(kind, name) for kind in model.kinds}
        _set_field(model, name, known)
        for kind in model.kinds:
            found = _substrate(kind, name, own=True)
            if found is not None:
                _account_for(model, kind, name, found, known[kind])


def _substrate(kind: Kind, name: str, *, own: bool = False) -> Element | None:
    found = kind.listed("secretion", "substrate", own=own)
    return next((one for one in found if one.attributes.get("name") == name), None)


def _exchange(kind: Kind, name: str) -> Exchange:
    found = _substrate(kind, name)

    def number(tag: str) -> float:
        one = None if found is None else found.find(tag)
        least = None if tag == "net_export_rate" else 0.0
        return 0.0 if one is None or not one.word() else one.number(at_least=least)

    return Exchange(
        number("secretion_rate"), number("secretion_target"), number("uptake_rate"),
        number("net_export_rate"),
    )  # fmt: skip


def _set_field(model: Model, name: str, known: dict[Kind, Exchange]) -> None:
    key, unit = model.fields[name], model.unit[name]
    made = model.part("nutrients", key)
    top = max([model.top[name], *(x.target for x in known.values() if x.secretion > 0.0)])
    rules = _rules(model, name)

    def takes(kind: Kind, rule: Rule | None) -> float:
        return known[kind].under(name, rule).taken_up

    def gives(kind: Kind, rule: Rule | None) -> float:
        return known[kind].under(name, rule).given_off(kind.volume)

    def largest(kind: Kind, of: Callable[[Kind, Rule | None], float]) -> float:
        return max(of(kind, rule) for rule in (None, *rules) if rule is None or rule.kind is kind)

    limits = {kind: largest(kind, takes) for kind in known}
    fastest = max(limits.values())
    if fastest > 0.0:
        half = min(max(_FAR * top * unit, _FAR * 1e-6), _MAX_HALF)
        del made["uptake"]
        made["half_saturation"] = half
        made["uptake_per_volume"] = fastest / MINUTE * half
        _by_type(model, "uptake_of", key, {k: x / fastest for k, x in limits.items()})
        own = [rule for rule in rules if rule.behaviour == f"{name} uptake"]
        for rule in rules:
            if rule.behaviour == f"{name} secretion":
                if any(rule.kind is other.kind for other in own):
                    rule.note += "; what is given off only, beside rules of uptake"
                else:
                    own.append(rule)
        _respond(model, f"uptake of {key}", takes, limits, own)
    given = {kind: largest(kind, gives) for kind in known}
    most = max(given.values())
    if most > 0.0:
        made["secretion"] = most * unit / MINUTE
        _by_type(model, "secretion_of", key, {kind: x / most for kind, x in given.items()})
        others = [rule for rule in rules if rule.behaviour != f"{name} uptake"]
        _respond(model, f"secretion of {key}", gives, given, others)


def _respond(
    model: Model,
    behaviour: str,
    of: Callable[[Kind, Rule | None], float],
    limits: dict[Kind, float],
    rules: list[Rule],
) -> None:
    """Let types do a part of what they do at most."""

    def value(kind: Kind, rule: Rule | None) -> float:
        return of(kind, rule) / limits[kind]

    set_behaviour(model, behaviour, 1.0, value, [k for k in limits if limits[k] > 0.0],
                  [rule for rule in rules if rule.kind and limits[rule.kind] > 0.0])  # fmt: skip


def _rules(model: Model, name: str) -> list[Rule]:
    """Return the rules of a substance that fields, which are solved one by one, can follow."""
    found, key = [], model.fields[name]
    for what in ("uptake", "secretion", "secretion target", "export"):
        for rule in rules_of(model, f"{name} {what}", model.kinds):
            assert rule.level is not None
            signal = rule.level[0]
            if signal in model.fields.values() and not _leads(model, signal, key):
                model.needs.setdefault(key, set()).add(signal)
                found.append(rule)
            elif signal == "volume":
                found.append(rule)
            else:
                rule.note = "fields respond to volumes, and to others that do not depend on them"
    return found


def _leads(model: Model, field: str, to: str) -> bool:
    """Return whether a field is another one, or depends on it by rules."""
    return field == to or any(_leads(model, one, to) for one in model.needs.get(field, ()))


def _by_type(model: Model, table: str, key: str, factors: dict[Kind, float]) -> None:
    """Set factors of types on what they do with a field."""
    for kind, factor in factors.items():
        if factor != 1.0 and len(model.kinds) > 1:
            model.part("types", kind.key, table)[key] = factor


def _account_for(model: Model, kind: Kind, name: str, found: Element, does: Exchange) -> None:
    key = f"nutrients.{model.fields[name]}"
    takes, gives = f"{key}.uptake_per_volume", f"{key}.secretion"
    near = "uptake saturates, a thousand times above the largest concentration that is named"
    size = f"of a cell of {kind.volume:g} um^3 whatever its size"
    entries = {
        "uptake_rate": (does.uptake != 0.0, Fate.APPROXIMATED, takes, near),
        "secretion_rate": (does.secretion != 0.0, Fate.APPROXIMATED, gives,
                           f"S T given off, {size}, and S c taken up"),
        "secretion_target": (does.secretion * does.target != 0.0, Fate.MAPPED, gives, ""),
        "net_export_rate": (does.export != 0.0, Fate.MAPPED, gives, ""),
    }  # fmt: skip
    if does.export < 0.0:
        note = "uptake at a rate that does not depend on the concentration"
        entries["net_export_rate"] = True, Fate.LEFT_OUT, "", note
    for tag, (acts, fate, to, note) in entries.items():
        said = (fate, to, note) if acts else (Fate.OFF,)
        model.account.take(found.find(tag), *said)
