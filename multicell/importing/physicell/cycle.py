"""Cycle and growth: PhysiCell's models of the cycle as G1, S, G2 and M."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, final

from multicell.cells import SPHERE
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, Kind, Model
from multicell.importing.physicell.rules import Rule, rules_of, set_behaviour

if TYPE_CHECKING:
    from multicell.importing.files import Element

_INSTANT = 1.0
"""Length of a phase that a model does not have, s."""
_NEVER = 1e6
"""Mean cycle over the duration of the run, for types whose cells do not divide."""
_RATE = "cytoplasmic_biomass_change_rate"
_SLOWEST, _FASTEST = 0.7, 12.0
"""Bounds of rate times growing time: beyond, cells become ever smaller, or grow at once."""
_NAMES = ("G1", "S", "G2", "M")
_HALVED = "each of two daughters has half the chance; in PhysiCell one of them has all of it"


@final
@dataclass(frozen=True)
class Stage:
    """A phase of PhysiCell: minutes (infinite: never left), and whether all take that long."""

    minutes: float
    fixed: bool


@final
@dataclass(frozen=True)
class CycleModel:
    """A model of the cycle."""

    name: str
    usual: tuple[Stage, ...]  # its phases with what PhysiCell has for them
    homes: tuple[str, ...]  # the phase of ours in which each of them is
    doubles_before: bool = True  # whether volume doubles before division, not after it


def _stages(*phases: tuple[float, bool]) -> tuple[Stage, ...]:
    return tuple(Stage(*phase) for phase in phases)


_LIVE = CycleModel("live", _stages((60.0 / 0.0432, False)), ("G1",), doubles_before=False)
MODELS: Final[Mapping[int, CycleModel]] = {
    0: CycleModel(
        "Ki67 (advanced)", _stages((3.62 * 60, False), (13.0 * 60, True), (2.5 * 60, True)),
        ("G1", "S", "G1"),
    ),
    1: CycleModel("Ki67 (basic)", _stages((4.59 * 60, False), (15.5 * 60, True)), ("G1", "S")),
    2: CycleModel(
        "flow cytometry (basic)", _stages((1 / 0.00324, False), (1 / 0.00208, False),
                                          (1 / 0.00333, False)), ("G1", "S", "M"),
    ),
    3: _LIVE,
    4: _LIVE,
    5: _LIVE,
    6: CycleModel(
        "flow cytometry (separated)",
        _stages((1 / 0.00335, False), (1 / 0.00208, False), (1 / 0.00417, False),
                (1 / 0.0167, False)), _NAMES,
    ),
    7: CycleModel("cycling-quiescent", _stages((4.59 * 60, False), (15.5 * 60, True)),
                  ("G1", "S")),
}  # fmt: skip
"""By their codes."""


@final
@dataclass(frozen=True)
class Cycle:
    """The cycle of a type: its model, and its phases with their durations.

    Where a phase is left by rules only its duration is that at their saturation. ``rates`` are
    those of leaving the phases without rules, 1/min.
    """

    model: CycleModel
    stages: tuple[Stage, ...]
    rates: tuple[float, ...]

    @property
    def minutes(self) -> float:
        """Mean time of a cycle, infinite for cells that never divide."""
        return sum(stage.minutes for stage in self.stages)

    def phases(self) -> dict[str, dict[str, Any]]:
        """Return G1, S, G2 and M as a scene says them."""
        made = {}
        for name in _NAMES:
            parts = [
                s for s, home in zip(self.stages, self.model.homes, strict=True) if home == name
            ]
            grows = name != "G1" or not self.model.doubles_before
            made[name] = {**_length([s for s in parts if s.minutes > 0.0]), "grows": grows}
        return made


def _length(parts: list[Stage]) -> dict[str, Any]:
    """Return the distribution of the sum of fixed times and of at most one exponential one."""
    mean = sum(stage.minutes for stage in parts) * MINUTE
    random = sum(stage.minutes for stage in parts if not stage.fixed) * MINUTE
    if mean < _INSTANT:
        return {"duration": _INSTANT}
    if random == 0.0:
        return {"duration": mean}
    # a gamma distribution whose variation is its mean is an exponential one
    if random == mean:
        return {"duration": mean, "distribution": "gamma", "variation": 1.0}
    return {
        "duration": mean, "distribution": "shifted-gamma", "shift": 1.0 - random / mean,
        "variation": random / mean,
    }  # fmt: skip


def read_cycle(model: Model) -> None:
    """Read ``cycle`` and ``volume/total`` of all types; set how large cells become."""
    known = {kind: _with_rules(model, kind, _cycle(kind)) for kind in model.kinds}
    dividing = [kind for kind, cycle in known.items() if math.isfinite(cycle.minutes)]
    lead = max(dividing, key=lambda kind: kind.count, default=None)
    sizes = 2.0 * model.leader.volume, 0.0
    if lead is not None:
        growth = model.part("growth")
        growth.update(phases=known[lead].phases(), restriction=False, law="relaxation")
        sizes = _sizes(model, lead, known[lead])
        for kind, cycle in known.items():
            model.of_type(kind, "cycle_scale", _scale(model, cycle, known[lead]))
        _set_paces(model, known, lead)
        _set_daughters(model)
        quickest = min(cycle.minutes for cycle in known.values()) * MINUTE
        model.scene["coupling_step"] = min(model.scene["coupling_step"], quickest)
    # with phases cells divide by their clock, at up to twice the volume of division
    assert model.cells is not None
    most = float(model.cells.volumes().max()) * (1.0 if lead is None else 0.5)
    model.part("cells")["division_radius"] = math.cbrt(max(sizes[0], most) / SPHERE)
    if lead is not None:
        model.part("growth")["target"] = sizes[1]
    for kind in model.kinds:
        _account_for_cycle(model, kind, known, lead)
        _account_for_volume(model, kind, known[kind], lead)


def _sizes(model: Model, lead: Kind, cycle: Cycle) -> tuple[float, float]:
    """Return the volume at division, µm³, and over it the volume K to which cells grow.

    PhysiCell's volumes go to a target at the rate r of the cytoplasm, V' = r (K - V), for the time
    T in which they grow, and need not reach it. Where the target is doubled before division, cells
    of the volume V₀ divide at V₀ (2 - exp(-r T)), with K V_d = 2 V₀. Where it is after division,
    they grow from half the volume V_d at division: with K V_d = V₀,
    V_d = V₀ (1 - exp(-r T)) / (1 - exp(-r T) / 2).
    """
    phases = model.part("growth")["phases"].values()
    length = sum(phase["duration"] for phase in phases if phase["grows"]) / MINUTE
    span = min(max(lead.number_of(f"volume/{_RATE}", 0.0045) * length, _SLOWEST), _FASTEST)
    if cycle.model.doubles_before:
        share = 1.0 - 0.5 * math.exp(-span)
        return 2.0 * lead.volume * share, 1.0 / share
    share = -math.expm1(-span) / (1.0 - 0.5 * math.exp(-span))
    return lead.volume * share, 1.0 / share


def _scale(model: Model, cycle: Cycle, lead: Cycle) -> float:
    if not math.isfinite(cycle.minutes):
        return max(_NEVER * float(model.scene["duration"]) / (lead.minutes * MINUTE), 1.0)
    return cycle.minutes / lead.minutes


def _code(element: Element) -> int:
    stated = element.attributes.get("code", "")
    if not stated.isdecimal() or int(stated) not in MODELS:
        known = ", ".join(f"{code} {m.name}" for code, m in MODELS.items() if code not in (3, 4))
        raise element.error(f"has the code {stated!r}, must be one of {known}")
    return int(stated)


def _cycle(kind: Kind) -> Cycle:
    """Return the cycle of a type: its own phases, its parent's of this model, or usual ones."""
    own = kind.own("cycle")
    above = None if kind.parent is None else _cycle(kind.parent)
    if own is None or "code" not in own.attributes:
        return above or _cycle_of(MODELS[0], MODELS[0].usual)
    found = MODELS[_code(own)]
    stages = list(above.stages if above is not None and above.model is found else found.usual)
    for one, start, stage in _stated(own):
        if not 0 <= start < len(stages):
            raise one.error(f"is of phase {start}, but '{found.name}' has {len(stages)}")
        stages[start] = stage
    return _cycle_of(found, tuple(stages))


def _cycle_of(model: CycleModel, stages: tuple[Stage, ...]) -> Cycle:
    rates = (math.inf if s.minutes == 0.0 else 1.0 / s.minutes for s in stages)
    return Cycle(model, stages, tuple(rates))


def _exits(model: Model, kind: Kind, place: int) -> list[Rule]:
    """Return the rules about leaving a phase of a type."""
    name = f"exit from cycle phase {place}" if place else "cycle entry"
    return rules_of(model, name, [kind])


def _with_rules(model: Model, kind: Kind, cycle: Cycle) -> Cycle:
    """Return a cycle whose phases that only rules end last as long as at their saturation."""
    stages = list(cycle.stages)
    for place, stage in enumerate(stages):
        most = max((rule.end for rule in _exits(model, kind, place)), default=0.0)
        if math.isinf(stage.minutes) and most > 0.0:
            stages[place] = Stage(1.0 / most, stage.fixed)
    return replace(cycle, stages=tuple(stages))


def _set_paces(model: Model, known: Mapping[Kind, Cycle], lead: Kind) -> None:
    """Let types go through the phases at their own rates, and rules change these."""
    phases = model.part("growth")["phases"]
    cycling = {kind: cycle for kind, cycle in known.items() if math.isfinite(cycle.minutes)}
    for phase, after in zip(_NAMES, (*_NAMES[1:], _NAMES[0]), strict=True):
        length = phases[phase]["duration"]
        exits = {
            rule: place
            for kind, cycle in cycling.items()
            for place, home in enumerate(cycle.model.homes)
            for rule in _exits(model, kind, place)
            if home == phase
        }

        def pace(
            kind: Kind, rule: Rule | None, phase: str = phase, length: float = length,
            exits: Mapping[Rule, int] = exits,
        ) -> float:  # fmt: skip
            cycle, minutes = cycling[kind], 0.0
            for place, home in enumerate(cycle.model.homes):
                if home == phase:
                    ruled = rule is not None and exits[rule] == place
                    rate = rule.end if rule is not None and ruled else cycle.rates[place]
                    minutes += 1.0 / rate if rate > 0.0 else math.inf
            if max(minutes * MINUTE, length) <= _INSTANT:
                return 1.0
            # factors are over the lengths that a type's scale gives the phases of all
            own = _scale(model, cycle, known[lead]) if len(model.kinds) > 1 else 1.0
            return length * own / max(minutes * MINUTE, _INSTANT)

        note = ""
        if any(_is_shared(cycling[r.kind], p) for r, p in exits.items() if r.kind):
            note = "its phase has two stages, or lasts equally long for all cells"
        set_behaviour(model, f"entry into {after}", 1.0, pace, cycling, exits, note)


def _is_shared(cycle: Cycle, place: int) -> bool:
    home = cycle.model.homes[place]
    return cycle.stages[place].fixed or cycle.model.homes.count(home) > 1


def _stated(cycle: Element) -> list[tuple[Element, int, Stage]]:
    """Return the phases that an element states, by rate or duration, and where."""
    made = []
    rates = cycle.all("phase_transition_rates/rate") + cycle.all("transition_rates/rate")
    for one in rates:
        rate = one.number(at_least=0.0)
        minutes = 1.0 / rate if rate > 1e-15 else math.inf
        made.append((one, one.whole("start_index"), Stage(minutes, one.says("fixed_duration"))))
    for one in cycle.all("phase_durations/duration"):
        minutes = one.number(at_least=0.0)
        stage = Stage(minutes if minutes < 1e15 else math.inf, one.says("fixed_duration"))
        made.append((one, one.whole("index"), stage))
    return made


def _account_for_cycle(
    model: Model, kind: Kind, known: Mapping[Kind, Cycle], lead: Kind | None
) -> None:
    element, account = kind.own("cycle"), model.account
    if element is None:
        return
    cycle = known[kind]
    if lead is None or not math.isfinite(cycle.minutes):
        key, note = "types.*.cycle_scale" if lead else "growth", "these cells do not divide"
        account.take(element, Fate.MAPPED, key, note, cycle.model.name)
        for one, _, _ in _stated(element):
            account.take(one, Fate.MAPPED, note=note)
    else:
        homes = ", ".join(f"{n} {home}" for n, home in enumerate(cycle.model.homes))
        note = f"volume doubles in the time in which it grows; its phases here: {homes}"
        account.take(element, Fate.APPROXIMATED, "growth.phases", note, cycle.model.name)
        alike = _alike(cycle, known[lead])
        scale = cycle.minutes / known[lead].minutes
        pairs = zip(cycle.stages, known[lead].stages, strict=False)
        same = all(math.isclose(a.minutes, scale * b.minutes, abs_tol=1e-9) for a, b in pairs)
        for one, _, _ in _stated(element):
            own = f"responses.entry_into_*_of_{kind.key}"
            if alike and same:
                account.take(one, Fate.MAPPED, "growth.phases")
            elif alike:
                account.take(one, Fate.MAPPED, own)
            else:
                note = f"its mean; whether all cells take that long is as in '{lead.name}'"
                account.take(one, Fate.APPROXIMATED, own, note)
    for one in element.all("standard_asymmetric_division"):
        _account_for_daughters(model, kind, one, grows=lead is not None)


def _daughters(kind: Kind) -> dict[str, float]:
    """Return the chances that a division gives a daughter of another type, by its name."""
    found = kind.given("cycle/standard_asymmetric_division")
    if found is None or not found.says("enabled"):
        return {}
    return {
        one.attributes.get("name", ""): max(one.number(at_most=1.0), 0.0)
        for one in found.all("asymmetric_division_probability")
    }


def _set_daughters(model: Model) -> None:
    """Read chances of asymmetric division: here each of two daughters has half of it."""
    for to in model.kinds:
        known = {kind: _daughters(kind).get(to.name, 0.0) for kind in model.kinds if kind is not to}

        def value(kind: Kind, rule: Rule | None, known: dict[Kind, float] = known) -> float:
            return 0.5 * (known[kind] if rule is None else rule.end)

        rules = rules_of(model, f"asymmetric division to {to.name}", known)
        set_behaviour(model, f"mutation to {to.key}", 0.0, value, known, rules, _HALVED)


def _account_for_daughters(model: Model, kind: Kind, table: Element, *, grows: bool) -> None:
    on = table.says("enabled") and grows
    for one in table.all("asymmetric_division_probability"):
        to = model.kind_named(one.attributes.get("name", ""))
        if not on or to is None or to is kind or one.number() <= 0.0:
            model.account.take(one, Fate.OFF)
        else:
            key = f"responses.mutation_to_{to.key}_of_{kind.key}"
            model.account.take(one, Fate.APPROXIMATED, key, _HALVED)
    model.account.take_all([table], Fate.OFF)


def _alike(cycle: Cycle, lead: Cycle) -> bool:
    """Return whether phases of two cycles differ in nothing but how long they last."""
    return cycle.model is lead.model and all(
        a.fixed == b.fixed for a, b in zip(cycle.stages, lead.stages, strict=True)
    )


def _account_for_volume(model: Model, kind: Kind, cycle: Cycle, lead: Kind | None) -> None:
    table, account = kind.own("volume"), model.account
    if table is None:
        return
    for one in table.all("total"):
        alike = lead is None or math.isclose(kind.volume, lead.volume)
        if alike or not math.isfinite(cycle.minutes):
            account.take(one, Fate.MAPPED, "cells.division_radius, radius in cells.csv")
        else:
            note = "at the start; types share the volume at division"
            account.take(one, Fate.APPROXIMATED, "radius in cells.csv", note)
    grows = "growth" in model.scene
    for one in table.all(_RATE):
        note = (
            "V' = r (K - V) at this rate; with another cycle time in proportion, and for all types "
            "as for that of most dividing cells"
        )
        account.take(one, *((Fate.APPROXIMATED, "growth.target", note) if grows else (Fate.OFF,)))
    note = "that of each model of death counts"
    account.take_all(table.all("relative_rupture_volume"), Fate.OFF, note=note)
