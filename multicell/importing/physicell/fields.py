"""Substances: diffusion, decay, the start and the sides of the box, uptake and secretion of cells.

A cell of volume V changes the amount of a substance around it by V [S (T - c) - U c] + E: S, T and
U are rate and target of secretion and the rate of uptake, E the net export. Here uptake saturates
(Michaelis–Menten), u V c / (K + c): with K a thousand times the largest concentration it is
(S + U) V c up to a thousandth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, final

from multicell.importing.files import Element
from multicell.importing.imported import Fate
from multicell.importing.physicell import run
from multicell.importing.physicell.model import MINUTE, CellDefinition, Model, keys_of
from multicell.importing.physicell.rules import Rule, rules_of, set_behaviour
from multicell.scene.oxygen import is_oxygen
from multicell.units import oxygen_solubility, to_base, unit_factor

_FAR = 1e3
"""Half saturation over the largest concentration."""
_MAX_HALF = 1e5
"""Largest half saturation of a scene, mM."""
_SLOWEST = 1e-6
"""Least diffusion coefficient of a scene, µm²/s."""
_BODY = 37.0  # °C, at which mmHg of PhysiCell become concentrations


def name_fields(model: Model) -> None:
    """Find the names of substances here, and what one unit of each is."""
    variables = model.root.all("microenvironment_setup/variable")
    for variable in variables:
        if not variable.attributes.get("name"):
            raise variable.error("has no name")
    names = [variable.attributes["name"] for variable in variables]
    model.fields = dict(zip(names, keys_of(names, "field"), strict=True))
    if len(model.fields) < len(variables):
        raise variables[-1].error("has the name of another substance")
    for variable, name in zip(variables, names, strict=True):
        model.unit[name] = _unit(name, variable.attributes.get("units", ""))[0]


def read_microenvironment(model: Model) -> None:
    """Read ``microenvironment_setup``; to be called when the size of cells is known."""
    variables = model.root.all("microenvironment_setup/variable")
    # BioFVM sets no side at all unless one substance has its condition on all of them
    active = any(_on_all(variable) for variable in variables)
    for variable in variables:
        _read_variable(model, variable, active)


def _on_all(variable: Element) -> bool:
    found = variable.find("Dirichlet_boundary_condition")
    return found is not None and found.says("enabled")


def _read_variable(model: Model, variable: Element, active: bool) -> None:
    name = variable.attributes["name"]
    key = model.fields[name]
    unit, fate, note = _unit(name, variable.attributes.get("units", ""))
    called = "" if key == name else f"called {key} here; "
    model.account.take(variable, fate, f"nutrients.{key}", called + note, name)
    made = model.part("nutrients", key)
    # nothing rests here: uptake is that of living cells, whatever they do
    made |= {"uptake": 0.0, "quiescent_uptake": 1.0, "geometry": "box"}
    # that of the voxels, unless cells are too small for them
    made["spacing"] = min(run.voxel_side(model), 4.0 * model.part("cells")["division_radius"])
    thickness = model.root.find("domain/dz")
    if model.scene["dimensions"] == 2 and thickness is not None:
        made["height"] = thickness.number()
    moves = "physical_parameter_set/diffusion_coefficient"
    value = variable.number_at(moves, 0.0, at_least=0.0) / MINUTE
    made["diffusion"] = max(value, _SLOWEST)
    if value < _SLOWEST:
        note = f"{_SLOWEST:g} um^2/s, the least there is: it stays where it is"
        found = variable.find(moves)
        model.account.take(found, Fate.APPROXIMATED, "nutrients.*.diffusion", note)
    if variable.find("physical_parameter_set/decay_rate"):
        decay = variable.number_at("physical_parameter_set/decay_rate", 0.0, at_least=0.0)
        made["decay"] = decay / MINUTE
    level = variable.number_at("initial_condition", 0.0, at_least=0.0)
    made["boundary"] = level * unit
    levels = _read_sides(model, variable, active, made)
    model.top[name] = max([level, *levels])


def _unit(name: str, said: str) -> tuple[float, Fate, str]:
    """Return mM for one unit of a substance, and what that is."""
    known = 1000.0 if said == "M" else unit_factor(said, "mM")
    if known is not None:
        return known, Fate.MAPPED, f"{said} as {said}"
    if is_oxygen(name) and said.lower() in ("mmhg", "dimensionless", "none", ""):
        factor = oxygen_solubility(_BODY) * to_base("1 mmHg", "kPa")
        how = f"1 mmHg as {factor:.4g} mM, the solubility in water at 37 °C (Battino et al. 1983)"
        if said.lower() == "mmhg":
            return factor, Fate.MAPPED, how
        return factor, Fate.APPROXIMATED, f"'{said}' taken as mmHg, PhysiCell's usual unit: {how}"
    note = f"1 {said or 'unit'} stands for 1 mM: no amount is known, and the equations are linear"
    return 1.0, Fate.APPROXIMATED, note


def _read_sides(model: Model, variable: Element, active: bool, made: dict[str, Any]) -> list[float]:
    """Set the sides of a field; return the values that they have, in the substance's unit."""
    name = variable.attributes["name"]
    unit = model.unit[name]
    all_sides = variable.find("Dirichlet_boundary_condition")
    on_all = _on_all(variable)
    value = all_sides.number(at_least=0.0) if all_sides is not None and on_all else 0.0
    axes = "xyz"[: model.scene["dimensions"]]
    levels = {f"{a}{e}": (on_all, value) for a in axes for e in "-+"}
    for one in variable.all("Dirichlet_options/boundary_value"):
        side = one.attributes.get("ID", "")
        face = side[:1] + {"min": "-", "max": "+"}.get(side[1:], "")
        if face not in levels:
            named = side not in ("zmin", "zmax")  # those a plane does not have
            fate, note = (Fate.LEFT_OUT, "no side of this name") if named else (Fate.OFF, "")
            model.account.take(one, fate, note=note)
            continue
        on = one.says("enabled")
        levels[face] = on, one.number(at_least=0.0) if on and active else 0.0
        if not on:
            model.account.take(one, Fate.MAPPED, "nutrients.*.sides", "a wall")
        elif not active:
            note = "PhysiCell sets no side unless a Dirichlet_boundary_condition is enabled"
            model.account.take(one, Fate.OFF, note=note)
    held = {face: level for face, (on, level) in levels.items() if on and active}
    wall: dict[str, Any] = {"type": "derivative", "derivative": 0.0}
    sides = {
        face: {"type": "value", "value": held[face] * unit} if face in held else wall
        for face in levels
    }
    alike = all(side == sides["x-"] for side in sides.values())
    made["sides"] = {"*": sides["x-"]} if alike else sides
    return list(held.values())


@final
@dataclass(frozen=True)
class SubstanceExchange:
    """Exchange of a substance by a type: per minute, in the substance's own unit."""

    secretion: float
    target: float
    uptake: float
    export: float

    def under(self, name: str, rule: Rule | None) -> SubstanceExchange:
        """Return the exchange of a substance at the saturation of a rule."""
        if rule is None:
            return self
        what = rule.behaviour.removeprefix(f"{name} ")
        return replace(self, **{what.removeprefix("secretion "): max(rule.end, 0.0)})


def read_secretion(model: Model) -> None:
    """Read ``secretion`` of all types; to be called when the substances are known."""
    for kind in model.kinds:
        for one in kind.listed("secretion", "substrate", own=True):
            if one.attributes.get("name") not in model.fields:
                note = f"no substance '{one.attributes.get('name', '')[:60]}' is declared"
                model.account.take_all([one], Fate.LEFT_OUT, note=note)
    for name in model.fields:
        known = {kind: _exchange(kind, name) for kind in model.kinds}
        _set_field(model, name, known)
        for kind, does in known.items():
            for one in kind.listed("secretion", "substrate", own=True):
                if one.attributes["name"] == name and does.export < 0.0:
                    note = "uptake at a rate that does not depend on the concentration"
                    model.account.take(one.find("net_export_rate"), Fate.LEFT_OUT, note=note)
                if one.attributes["name"] == name and does.secretion == 0.0:
                    model.account.take(one.find("secretion_target"), Fate.OFF)


def _exchange(kind: CellDefinition, name: str) -> SubstanceExchange:
    listed = kind.listed("secretion", "substrate")
    found = next((one for one in listed if one.attributes.get("name") == name), None)
    if found is None:
        return SubstanceExchange(0.0, 0.0, 0.0, 0.0)
    tags = ("secretion_rate", "secretion_target", "uptake_rate")
    secretion, target, uptake = (found.number_at(tag, 0.0, at_least=0.0) for tag in tags)
    return SubstanceExchange(secretion, target, uptake, found.number_at("net_export_rate", 0.0))


def _set_field(model: Model, name: str, known: dict[CellDefinition, SubstanceExchange]) -> None:
    key, unit = model.fields[name], model.unit[name]
    made = model.part("nutrients", key)
    top = max([model.top[name], *(x.target for x in known.values() if x.secretion > 0.0)])
    rules = _rules(model, name)

    def takes(kind: CellDefinition, rule: Rule | None) -> float:
        """Return first-order uptake per volume, 1/min."""
        does = known[kind].under(name, rule)
        return does.uptake + does.secretion

    def gives(kind: CellDefinition, rule: Rule | None) -> float:
        """Return secretion that does not depend on the concentration, unit µm³ / min."""
        does = known[kind].under(name, rule)
        return does.secretion * does.target * kind.volume + max(does.export, 0.0)

    def largest(kind: CellDefinition, of: Callable[[CellDefinition, Rule | None], float]) -> float:
        return max(of(kind, rule) for rule in (None, *rules) if rule is None or rule.kind is kind)

    limits = {kind: largest(kind, takes) for kind in known}
    fastest = max(limits.values())
    if fastest > 0.0:
        half = min(max(_FAR * top * unit, _FAR * 1e-6), _MAX_HALF)
        del made["uptake"]
        made["half_saturation"] = half
        made["uptake_per_volume"] = fastest / MINUTE * half
        own = [rule for rule in rules if rule.behaviour == f"{name} uptake"]
        for rule in rules:
            if rule.behaviour == f"{name} secretion":
                if any(rule.kind is other.kind for other in own):
                    rule.note += "; what is given off only, beside rules of uptake"
                else:
                    own.append(rule)
        _respond(model, "uptake", key, takes, limits, own)
    given = {kind: largest(kind, gives) for kind in known}
    most = max(given.values())
    if most > 0.0:
        made["secretion"] = most * unit / MINUTE
        others = [rule for rule in rules if rule.behaviour != f"{name} uptake"]
        _respond(model, "secretion", key, gives, given, others)


def _respond(
    model: Model,
    what: str,
    key: str,
    of: Callable[[CellDefinition, Rule | None], float],
    limits: dict[CellDefinition, float],
    rules: list[Rule],
) -> None:
    """Let types do a part of what any of them does at most with a field."""
    most = max(limits.values())
    for kind, limit in limits.items():
        if limit / most != 1.0 and len(model.kinds) > 1:
            model.part("types", kind.key, f"{what}_of")[key] = limit / most
    own = {kind: of(kind, None) / limit for kind, limit in limits.items() if limit > 0.0}
    rules = [rule for rule in rules if rule.kind in own]
    behaviour = f"{what} of {key}"
    set_behaviour(model, behaviour, 1.0, own, rules, lambda r: of(r.kind, r) / limits[r.kind])


def _rules(model: Model, name: str) -> list[Rule]:
    """Return the rules of a substance that fields, which are solved one by one, can follow."""
    found, key = [], model.fields[name]
    for what in ("uptake", "secretion", "secretion target", "export"):
        for rule in rules_of(model, f"{name} {what}", model.kinds):
            field = rule.signal in model.fields.values()
            if field and not _leads(model, rule.signal, key):
                model.needs.setdefault(key, set()).add(rule.signal)
                found.append(rule)
            elif rule.signal == "volume" or rule.element is not None:
                found.append(rule)
            else:
                rule.note = (
                    "fields respond to volumes, networks, and others that do not depend on them"
                )
    return found


def _leads(model: Model, field: str, to: str) -> bool:
    """Return whether a field is another one, or depends on it by rules."""
    return field == to or any(_leads(model, one, to) for one in model.needs.get(field, ()))
