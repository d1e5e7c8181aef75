"""Motion of cells by themselves, at random and along gradients."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

from multicell.importing.files import Element
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, CellDefinition, Model
from multicell.importing.physicell.rules import rules_of, set_behaviour

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
    enabled = {kind: kind.given("motility/options/enabled") for kind in model.kinds}
    moving = {kind: _migration(model, kind) for kind, on in enabled.items() if on and on.flag()}
    moving = {kind: how for kind, how in moving.items() if how.fastest > 0.0}
    # the pattern of most cells that follow something, at the largest speed that any of them has
    lead = max(
        moving,
        key=lambda k: (bool(moving[k].along) and k.count > 0, k.count, moving[k].fastest),
        default=None,
    )
    if lead is not None:
        _set_scene(model, lead, moving)
        speeds = {kind: max(how.speed, 0.0) / how.fastest for kind, how in moving.items()}
        set_behaviour(
            model,
            "speed",
            1.0,
            speeds,
            rules_of(model, "migration speed", moving),
            lambda rule: max(rule.end, 0.0) / moving[rule.kind].fastest,
        )
    for kind in model.kinds:
        _account_for(model, kind, moving.get(kind), moving[lead] if lead else None)


def _migration(model: Model, kind: CellDefinition) -> Migration:
    along = _directions(model, kind)
    bias = kind.number_of("motility/migration_bias", 0.0, at_least=0.0, at_most=1.0)
    speed = kind.number_of("motility/speed", 1.0)
    ends = [rule.end for rule in rules_of(model, "migration speed", [kind])]
    return Migration(
        speed,
        max(speed, *ends, 0.0),
        kind.number_of("motility/persistence_time", 1.0),
        bias,
        tuple(along),
    )


def _on(kind: CellDefinition, tag: str) -> Element | None:
    """Return the table of a way of chemotaxis that is enabled, or None."""
    found = kind.given(f"motility/options/{tag}")
    enabled = None if found is None else found.find("enabled")
    return found if enabled is not None and enabled.flag() else None


def _directions(model: Model, kind: CellDefinition) -> list[tuple[str, float]]:
    """Return the substances along which a type moves with their shares."""
    advanced = _on(kind, "advanced_chemotaxis")
    if advanced is not None:
        found = advanced.all("chemotactic_sensitivities/chemotactic_sensitivity")
        known = {
            one.attributes.get("substrate", ""): one.number()
            for one in found
            if one.attributes.get("substrate") in model.fields and one.number() != 0.0
        }
        total = sum(map(abs, known.values()))
        return [(name, value / total) for name, value in known.items()]
    simple = _on(kind, "chemotaxis")
    if simple is None:
        return []
    name, sign = simple.find("substrate"), simple.number_at("direction", 1.0)
    if name is None or name.word() not in model.fields:
        return []
    return [(name.word(), math.copysign(1.0, sign))] if sign else []


def _set_scene(model: Model, lead: CellDefinition, moving: dict[CellDefinition, Migration]) -> None:
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


def _largest_bias(model: Model, lead: Migration, moving: dict[CellDefinition, Migration]) -> float:
    """Return the largest bias of types and rules along one substance, or that along several."""
    if not lead.field:
        return lead.bias if lead.along else 0.0
    along = {kind: how.bias for kind, how in moving.items() if how.field == lead.field}
    ends = [rule.end for rule in rules_of(model, "migration bias", along)]
    return min(max([*along.values(), *ends]), 1.0)


def _set_biases(model: Model, lead: Migration, moving: dict[CellDefinition, Migration]) -> None:
    """Set biases along the gradient of one substance; against it they are negative."""
    signs = {
        kind: how.along[0][1] if how.field == lead.field else 0.0 for kind, how in moving.items()
    }
    own = {kind: signs[kind] * how.bias for kind, how in moving.items()}
    rules = rules_of(model, "migration bias", [kind for kind in moving if signs[kind]])
    set_behaviour(
        model,
        "bias",
        model.part("motility")["bias"],
        own,
        rules,
        lambda rule: signs[rule.kind] * min(max(rule.end, 0.0), 1.0),
    )


def _step(model: Model) -> float:
    """Return the step of PhysiCell's mechanics, s: no direction changes sooner."""
    return model.root.number_at("overall/dt_mechanics", 0.1, above=0.0) * MINUTE


def _account_for(
    model: Model, kind: CellDefinition, how: Migration | None, lead: Migration | None
) -> None:
    """Account for what differs from the pattern of motion of all types, or is without effect."""
    table, account = kind.own("motility"), model.account
    if table is None:
        return
    if how is None or lead is None:
        account.take_all([table], Fate.OFF)
        return
    if model.scene["dimensions"] == 2:
        account.take_all(table.all("options/use_2D"), Fate.OFF)
    used = _on(kind, "advanced_chemotaxis") or _on(kind, "chemotaxis")
    ways = [*table.all("options/chemotaxis"), *table.all("options/advanced_chemotaxis")]
    account.take_all([way for way in ways if way is not used], Fate.OFF)
    bias = table.all("migration_bias")
    named = table.find("options/chemotaxis/substrate")
    lost = named is None or named.word() not in model.fields
    if used is not None and used.tag == "chemotaxis" and lost:
        note = "follows no substance of the model: PhysiCell ends here, these cells do not turn"
        account.take_all([used], Fate.LEFT_OUT, note=note)
    if not how.along:
        account.take_all(bias, Fate.OFF, note="no gradient is followed")
    if len(how.along) > 1:
        note = "gradients are followed each by itself, and random motion is added at full length"
        account.take_all([*bias, *ways], Fate.APPROXIMATED, "chemotaxis", note)
    if not how.pattern(lead):
        note = "types share one persistence and one gradient, those of the most cells"
        shared = [*table.all("persistence_time"), *bias, *ways]
        account.take_all(shared, Fate.APPROXIMATED, "motility", note)
