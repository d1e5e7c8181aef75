"""Motion of cells by themselves, at random and along gradients."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, Kind, Model
from multicell.importing.physicell.rules import Rule, rules_of, set_behaviour

if TYPE_CHECKING:
    from multicell.importing.files import Element

_STEEP = 1e-9
"""Gradient of half the force over the largest concentration, 1/µm: any gradient is followed."""


@final
@dataclass(frozen=True)
class Migration:
    """Motion of a type: µm/min, min, and the signed share of its speed along each gradient.

    ``fastest`` is the largest speed that rules give it.
    """

    speed: float
    fastest: float
    persistence: float
    bias: float
    along: tuple[tuple[str, float], ...]
    summed: bool

    @property
    def field(self) -> str:
        """The one substance that it moves along; empty where there is none, or several."""
        return self.along[0][0] if len(self.along) == 1 else ""

    def pattern(self, lead: Migration) -> bool:
        """Return whether responses can let a type of this migration move in the pattern of one."""
        biased = self.bias if self.along else 0.0
        same = self.persistence == lead.persistence
        if len(lead.along) < 2 and len(self.along) < 2:
            return same and (not biased or self.field == lead.field)
        return same and self.along == lead.along and self.bias == lead.bias


def read_motility(model: Model) -> None:
    """Read ``motility`` of all types; to be called when the substances are known."""
    moving = {kind: _migration(model, kind) for kind in model.kinds if _moves(kind)}
    moving = {kind: how for kind, how in moving.items() if how.fastest > 0.0}
    # the pattern of most cells that follow something, at the largest speed that any of them has
    lead = max(
        moving, key=lambda k: (bool(moving[k].along) and k.count > 0, k.count, moving[k].fastest),
        default=None,
    )  # fmt: skip
    if lead is not None:
        _set_scene(model, lead, moving)
        _set_speeds(model, moving)
    for kind in model.kinds:
        if kind.own("motility") is not None:
            _account_for(model, kind, moving.get(kind), moving[lead] if lead else None)


def _moves(kind: Kind) -> bool:
    found = kind.given("motility/options/enabled")
    return found is not None and found.flag()


def _migration(model: Model, kind: Kind) -> Migration:
    along, summed = _directions(model, kind)
    bias = kind.number_of("motility/migration_bias", 0.0, at_least=0.0, at_most=1.0)
    speed = kind.number_of("motility/speed", 1.0)
    ends = [rule.end for rule in rules_of(model, "migration speed", [kind])]
    return Migration(
        speed, max(speed, *ends, 0.0), kind.number_of("motility/persistence_time", 1.0),
        bias, tuple(along), summed,
    )  # fmt: skip


def _on(kind: Kind, tag: str) -> Element | None:
    """Return the table of a way of chemotaxis that is enabled, or None."""
    found = kind.given(f"motility/options/{tag}")
    enabled = None if found is None else found.find("enabled")
    return found if enabled is not None and enabled.flag() else None


def _directions(model: Model, kind: Kind) -> tuple[list[tuple[str, float]], bool]:
    """Return the substances along which a type moves with their shares, and if they are summed."""
    advanced = _on(kind, "advanced_chemotaxis")
    if advanced is not None:
        found = advanced.all("chemotactic_sensitivities/chemotactic_sensitivity")
        known = {
            one.attributes.get("substrate", ""): one.number()
            for one in found
            if one.attributes.get("substrate") in model.fields and one.number() != 0.0
        }
        total = sum(map(abs, known.values()))
        each = advanced.find("normalize_each_gradient")
        summed = len(known) > 1 and not (each is not None and each.flag())
        return [(name, value / total) for name, value in known.items()], summed
    simple = _on(kind, "chemotaxis")
    if simple is None:
        return [], False
    name, direction = simple.find("substrate"), simple.find("direction")
    if name is None or name.word() not in model.fields:
        raise simple.error("follows no substance of the model")
    sign = 1.0 if direction is None else direction.number()
    return ([(name.word(), 1.0 if sign > 0.0 else -1.0)] if sign else []), False


def _set_scene(model: Model, lead: Kind, moving: dict[Kind, Migration]) -> None:
    how, fastest = moving[lead], max(moving, key=lambda kind: moving[kind].fastest * kind.drag)
    force = moving[fastest].fastest * fastest.drag / MINUTE
    bias = _largest_bias(model, how, moving)
    motility = model.part("motility")
    motility.update(force=force, persistence=max(how.persistence * MINUTE, _step(model)))
    # below the step of mechanics PhysiCell takes a new direction in every step
    motility["renewal"] = "random" if how.persistence * MINUTE >= _step(model) else "regular"
    if bias > 0.0 and how.field:
        bias = math.copysign(bias, how.along[0][1])
        motility.update(bias=bias, towards=model.fields[how.field])
        _set_biases(model, how, moving)
    elif bias > 0.0:
        motility["force"] = force * (1.0 - bias)
        for name, share in how.along:
            level = max(model.top[name], 1e-6) * model.unit[name]
            model.part("chemotaxis")[model.fields[name]] = {
                "force": force * bias * share,
                "half": max(_STEEP * level, 1e-15),
            }
    for kind in model.kinds:
        own = moving[kind].fastest * kind.drag / MINUTE if kind in moving else 0.0
        model.of_type(kind, "motility_scale", own / force)
    # forces are held in a coupling step
    shortest = min(max(moving[kind].persistence * MINUTE, _step(model)) for kind in moving)
    model.scene["coupling_step"] = min(model.scene["coupling_step"], shortest)


def _set_speeds(model: Model, moving: dict[Kind, Migration]) -> None:
    def value(kind: Kind, rule: Rule | None) -> float:
        how = moving[kind]
        return max(how.speed if rule is None else rule.end, 0.0) / how.fastest

    set_behaviour(model, "speed", 1.0, value, moving, rules_of(model, "migration speed", moving))


def _largest_bias(model: Model, lead: Migration, moving: dict[Kind, Migration]) -> float:
    """Return the largest bias of types and rules along one substance, or that along several."""
    if not lead.field:
        return lead.bias if lead.along else 0.0
    along = {kind: how.bias for kind, how in moving.items() if how.field == lead.field}
    ends = [rule.end for rule in rules_of(model, "migration bias", along)]
    return min(max([*along.values(), *ends]), 1.0)


def _set_biases(model: Model, lead: Migration, moving: dict[Kind, Migration]) -> None:
    """Set biases along the gradient of one substance; against it they are negative."""
    signs = {
        kind: how.along[0][1] if how.field == lead.field else 0.0 for kind, how in moving.items()
    }

    def value(kind: Kind, rule: Rule | None) -> float:
        return signs[kind] * (moving[kind].bias if rule is None else min(max(rule.end, 0.0), 1.0))

    turning = [kind for kind in moving if signs[kind]]
    rules = rules_of(model, "migration bias", turning)
    set_behaviour(model, "bias", model.part("motility")["bias"], value, moving, rules)


def _step(model: Model) -> float:
    """Return the step of PhysiCell's mechanics, s: no direction changes sooner."""
    found = model.root.find("overall/dt_mechanics")
    return (0.1 if found is None else found.number(above=0.0)) * MINUTE


def _account_for(model: Model, kind: Kind, how: Migration | None, lead: Migration | None) -> None:
    table = kind.own("motility")
    assert table is not None
    solid = model.scene["dimensions"] == 3 and how is not None
    flat, why = table.all("options/use_2D"), "motion in a plane within three dimensions"
    model.account.leave_out(flat, why, acts=lambda one: solid and one.flag())
    if how is None or lead is None:
        model.account.take_all([table], Fate.OFF)
        return
    same = how.pattern(lead)
    other = "" if same else "types share one persistence and one gradient, those of the most cells"
    size = f"a force that gives a cell of {kind.volume:g} um^3 this speed"
    fate = Fate.MAPPED if same else Fate.APPROXIMATED
    take, bias = model.account.take, table.find("migration_bias")
    take(table.find("speed"), Fate.APPROXIMATED, "motility.force", size)
    take(table.find("persistence_time"), fate, "motility.persistence", other)
    take(table.find("options/enabled"), Fate.MAPPED, "motility")
    if not how.along:
        take(bias, Fate.OFF, "", "no gradient is followed")
    else:
        note = "along the gradient of the moment, not that of the last change of direction"
        key = "motility.bias"
        if len(how.along) > 1:
            note = "random and directed part are added; in PhysiCell their sum has the full speed"
            key = "chemotaxis"
        take(bias, Fate.APPROXIMATED, key, "; ".join(filter(None, (note, other))))
    _account_for_taxis(model, kind, how, table, other)


def _account_for_taxis(
    model: Model, kind: Kind, how: Migration, table: Element, other: str
) -> None:
    used = _on(kind, "advanced_chemotaxis") or _on(kind, "chemotaxis")
    key = "motility.towards" if len(how.along) == 1 else "chemotaxis"
    for tag in ("chemotaxis", "advanced_chemotaxis"):
        for one in table.all(f"options/{tag}"):
            if one is not used:
                model.account.take_all([one], Fate.OFF)
                continue
            summed = "gradients are followed each by itself, not their sum" if how.summed else ""
            note = "; ".join(filter(None, (summed, other)))
            model.account.take_all([one], Fate.APPROXIMATED if note else Fate.MAPPED, key, note)
