"""Cycle and growth: PhysiCell's models of the cycle as G1, S, G2 and M."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, final

from multicell.behaviours.growth_laws.laws import RelaxationGrowth
from multicell.cells import SPHERE
from multicell.importing.files import Element
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, CellDefinition, Model
from multicell.importing.physicell.rules import Rule, rules_of, set_behaviour
from multicell.importing.physicell.water import DivisionRate, rate_with_water
from multicell.units import whole_number

_INSTANT = 1.0
"""Length of a phase that a model does not have, s."""
_NEVER = 1e6
"""Mean cycle over the duration of the run, for types whose cells do not divide."""
_RATES = {
    "cytoplasmic_biomass_change_rate": 0.0045,
    "nuclear_biomass_change_rate": 0.0055,
    "fluid_change_rate": 0.05,
}
"""Rates at which parts of a cell go to their targets, 1/min, with PhysiCell's entries for them."""
_PARTS = (*_RATES, "fluid_fraction", "nuclear")
_SLOWEST, _FASTEST = 0.7, 12.0
"""Bounds of rate times growing time for the volume that is called that of division."""
_PACES = 1e-9, 1e4
"""Rates of growth, 1/min, that stand for those of cells that do not grow, or grow at once."""
_NAMES = ("G1", "S", "G2", "M")


class Stage(NamedTuple):
    """A phase of PhysiCell: minutes (infinite: never left), and whether all take that long."""

    minutes: float
    fixed: bool


@final
@dataclass(frozen=True)
class CycleModel:
    """A model of the cycle."""

    name: str
    usual: tuple[tuple[float, bool], ...]  # its phases with PhysiCell's entries for them
    homes: tuple[str, ...]  # the phase of ours in which each of them is
    doubles_before: bool = True  # whether volume doubles before division, not after it


# minutes, and whether the phase is fixed: PhysiCell's standard models
_SHORT = ((4.59 * 60, False), (15.5 * 60, True))
# 0.0432 divisions an hour: PhysiCell's standard models
_LIVE = CycleModel("live", ((60.0 / 0.0432, False),), ("G1",), doubles_before=False)
MODELS: Final[Mapping[int, CycleModel]] = {
    0: CycleModel(
        "Ki67 (advanced)",
        ((3.62 * 60, False), (13.0 * 60, True), (2.5 * 60, True)),
        ("G1", "S", "G1"),
    ),
    1: CycleModel("Ki67 (basic)", _SHORT, ("G1", "S")),
    2: CycleModel(
        "flow cytometry (basic)",
        ((1 / 0.00324, False), (1 / 0.00208, False), (1 / 0.00333, False)),
        ("G1", "S", "M"),
    ),
    3: _LIVE,
    4: _LIVE,
    5: _LIVE,
    6: CycleModel(
        "flow cytometry (separated)",
        ((1 / 0.00335, False), (1 / 0.00208, False), (1 / 0.00417, False), (1 / 0.0167, False)),
        _NAMES,
    ),
    7: CycleModel("cycling-quiescent", _SHORT, ("G1", "S")),
}
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
        """Return G1, S, G2 and M as a scene says them.

        Cells grow in all of them. Where the target of volume doubles before division, it is half of
        the others' in G1.
        """
        made = {}
        for name in _NAMES:
            parts = [
                s for s, home in zip(self.stages, self.model.homes, strict=True) if home == name
            ]
            made[name] = _length([s for s in parts if s.minutes > 0.0])
        if self.model.doubles_before:
            made["G1"]["target_scale"] = 0.5
        return made

    @property
    def growing(self) -> float:
        """Mean time from the moment when the target of volume doubles to division, min."""
        stages = zip(self.stages, self.model.homes, strict=True)
        before = self.model.doubles_before
        return sum(stage.minutes for stage, home in stages if home != "G1" or not before)

    @property
    def after_division(self) -> float:
        """Time from division to the first phase, where PhysiCell's cells start, min."""
        return sum(
            stage.minutes
            for stage, home in zip(self.stages[1:], self.model.homes[1:], strict=True)
            if home == self.model.homes[0]
        )


def _length(parts: list[Stage]) -> dict[str, Any]:
    """Return the distribution of the sum of fixed times and of exponential ones.

    It is exact for one exponential time or several alike; else mean and variance are.
    """
    mean = sum(stage.minutes for stage in parts) * MINUTE
    random = [stage.minutes * MINUTE for stage in parts if not stage.fixed]
    if mean < _INSTANT:
        return {"duration": _INSTANT}
    if not random:
        return {"duration": mean}
    # a gamma distribution whose variation is its mean is an exponential one
    made = {"duration": mean, "distribution": "gamma", "variation": math.hypot(*random) / mean}
    if len(random) < len(parts):
        made |= {"distribution": "shifted-gamma", "shift": 1.0 - sum(random) / mean}
    return made


def read_cycle(model: Model) -> None:
    """Read ``cycle`` and ``volume/total`` of all types; set how large cells become."""
    known = {kind: _with_rules(model, kind, _cycle(kind)) for kind in model.kinds}
    dividing = [kind for kind, cycle in known.items() if math.isfinite(cycle.minutes)]
    lead = max(dividing, key=lambda kind: kind.count, default=None)
    sizes = 2.0 * model.leader.volume, 0.0
    if lead is not None:
        growth = model.part("growth")
        growth.update(phases=known[lead].phases(), restriction=False, law="relaxation")
        model.part("initial")["stage"] = "birth"  # the table says where in their cycle they are
        sizes = _sizes(lead, known[lead])
        for kind, cycle in known.items():
            model.of_type(kind, "cycle_scale", _scale(model, cycle, known[lead]))
        _set_paces(model, known, lead)
        quickest = min(cycle.minutes for cycle in known.values()) * MINUTE
        model.scene["coupling_step"] = min(model.scene["coupling_step"], quickest)
    # with phases cells divide by their clock, at up to twice the volume of division
    assert model.cells is not None
    most = float(model.cells.volume.max()) * (1.0 if lead is None else 0.5)
    volume = max(sizes[0], most)
    model.part("cells")["division_radius"] = math.cbrt(volume / SPHERE)
    if lead is not None:
        _set_growth(model, known, lead, sizes[1] * sizes[0] / volume)
        _set_start(model, known, lead)
    for kind in model.kinds:
        _account_for(model, kind, known, lead)


def _set_growth(
    model: Model, known: Mapping[CellDefinition, Cycle], lead: CellDefinition, target: float
) -> None:
    """Set how fast cells grow, and to which volume, given over that of division."""
    growth, law = model.part("growth"), RelaxationGrowth(target=target if target > 1.0 else 2.0)
    growth["parameters"] = {"target": law.target}
    if law.target != target:  # some cells are larger at the start than those that divide
        for phase in growth["phases"].values():
            phase["target_scale"] = phase.get("target_scale", 1.0) * target / law.target
    rates = {kind: _growth_rate(model, kind, cycle) for kind, cycle in known.items()}
    for kind in (lead, *known):
        rate = min(max(rates[kind], _PACES[0]), _PACES[1])
        time = law.exponent * MINUTE / rate
        if kind is lead:
            growth["volume_doubling_time"] = time
        elif time != growth["volume_doubling_time"]:
            model.of_type(kind, "volume_doubling_time", time)


def _growth_rate(model: Model, kind: CellDefinition, cycle: Cycle) -> float:
    """Return the rate of growth of a type, 1/min, which a rule about its volume makes another."""
    rate, entry = _pace(kind), cycle.rates[0]
    for rule in _exits(model, kind, 0):
        if cycle.model.doubles_before or rule.signal != "volume" or rule.end <= entry:
            continue
        found = rate_with_water(kind, DivisionRate(entry, rule.end, rule.half, rule.power))
        if rate == 0.0 or found is None:
            continue
        note = f"{found:.4g} for {rate:.4g} 1/min: a rule about volume lets cells divide as often "
        note += "as PhysiCell's, whose water follows the solids"
        key = "growth.volume_doubling_time"
        model.account.take(kind.own(f"volume/{next(iter(_RATES))}"), Fate.APPROXIMATED, key, note)
        return found
    return rate


def _set_start(model: Model, known: Mapping[CellDefinition, Cycle], lead: CellDefinition) -> None:
    """Set what is Ki67-positive, and begin after what precedes PhysiCell's first phase in G1."""
    growth, cycle = model.part("growth"), known[lead]
    dividing = [own.model for own in known.values() if math.isfinite(own.minutes)]
    if all(own.name.startswith("Ki67") for own in dividing):
        growth["ki67_decay"] = cycle.after_division * MINUTE
    if not cycle.stages[-1].fixed:
        return
    first, begun = growth["phases"]["G1"], cycle.after_division * MINUTE
    if "shift" in first:
        begun = first["duration"] * first["shift"]  # as the shortest G1 is found, to the last bit
    assert model.cells is not None
    for kind, own in known.items():
        # cells that never divide are where Ki67 is gone
        if own.model is cycle.model or not math.isfinite(own.minutes):
            model.cells.begun[kind] = begun * _scale(model, own, cycle)


def _pace(kind: CellDefinition) -> float:
    """Return the rate r of V' = r (K - V) in 1/min by which a whole cell grows.

    PhysiCell's solids s of nucleus and cytoplasm go to their targets at rates of their own, and
    water F after them, F' = k (f V - F). 1/r is the mean time in which the volume follows a target
    that is doubled: the shares of the solids over their rates, and f / ((1 - f) k).
    """
    cytoplasm, nucleus, water = (
        kind.number_of(f"volume/{tag}", usual, at_least=0.0) for tag, usual in _RATES.items()
    )
    fluid = kind.number_of("volume/fluid_fraction", 0.75, at_least=0.0, at_most=1.0)
    if cytoplasm == 0.0 or (fluid > 0.0 and (water == 0.0 or fluid == 1.0)):
        return 0.0
    share = min(kind.number_of("volume/nuclear", 540.0, at_least=0.0) / kind.volume, 1.0)
    share = share if nucleus > 0.0 else 0.0  # the rest grows without it
    time = (1.0 - share) / cytoplasm
    if share > 0.0:
        time += share / nucleus
    return 1.0 / (time + (fluid / ((1.0 - fluid) * water) if fluid > 0.0 else 0.0))


def _sizes(lead: CellDefinition, cycle: Cycle) -> tuple[float, float]:
    """Return the volume at division, µm³, and over it the volume K to which cells grow.

    PhysiCell's volumes go to a target, here at one rate r, V' = r (K - V), for the time T in which
    they grow, and need not reach it. Where the target is doubled before division, cells
    of the volume V₀ divide at V₀ (2 - exp(-r T)), with K V_d = 2 V₀. Where it is after division,
    they grow from half the volume V_d at division: with K V_d = V₀,
    V_d = V₀ (1 - exp(-r T)) / (1 - exp(-r T) / 2). They are those of mean phases.
    """
    span = _pace(lead) * cycle.growing
    span = min(max(span, _SLOWEST), _FASTEST)
    if cycle.model.doubles_before:
        share = 1.0 - 0.5 * math.exp(-span)
        return 2.0 * lead.volume * share, 1.0 / share
    share = -math.expm1(-span) / (1.0 - 0.5 * math.exp(-span))
    return lead.volume * share, 1.0 / share


def _scale(model: Model, cycle: Cycle, lead: Cycle) -> float:
    if not math.isfinite(cycle.minutes):
        never = _NEVER * float(model.scene["duration"]) / (lead.minutes * MINUTE)
        return min(max(never, 1.0), 1e12)
    return cycle.minutes / lead.minutes


def _code(element: Element) -> int:
    stated = element.attributes.get("code", "")
    number = whole_number(stated)
    if number is None or number not in MODELS:
        known = ", ".join(f"{code} {m.name}" for code, m in MODELS.items() if code not in (3, 4))
        raise element.error(f"has the code {stated[:60]!r}, must be one of {known}")
    return number


def _cycle(kind: CellDefinition) -> Cycle:
    """Return the cycle of a type: its own phases, its parent's of this model, or usual ones."""
    own = kind.own("cycle")
    if own is not None and "code" not in own.attributes:
        own = None
    above = None if kind.parent is None else _cycle(kind.parent)
    if above is not None and own is None:
        return above
    found = MODELS[0 if own is None else _code(own)]
    usual = [Stage(*phase) for phase in found.usual]
    stages = list(above.stages) if above is not None and above.model is found else usual
    for one, start, stage in () if own is None else stated_phases(own):
        if not 0 <= start < len(stages):
            raise one.error(f"is of phase {start}, but '{found.name}' has {len(stages)}")
        stages[start] = stage
    rates = (math.inf if stage.minutes == 0.0 else 1.0 / stage.minutes for stage in stages)
    return Cycle(found, tuple(stages), tuple(rates))


def _exits(model: Model, kind: CellDefinition, place: int) -> list[Rule]:
    """Return the rules about leaving a phase of a type."""
    name = f"exit from cycle phase {place}" if place else "cycle entry"
    return rules_of(model, name, [kind])


def _with_rules(model: Model, kind: CellDefinition, cycle: Cycle) -> Cycle:
    """Return a cycle whose phases that only rules end last as long as at their saturation."""
    stages = list(cycle.stages)
    for place, stage in enumerate(stages):
        most = max((rule.end for rule in _exits(model, kind, place)), default=0.0)
        if math.isinf(stage.minutes) and most > 0.0:
            stages[place] = Stage(1.0 / most, stage.fixed)
    return replace(cycle, stages=tuple(stages))


def _set_paces(model: Model, known: Mapping[CellDefinition, Cycle], lead: CellDefinition) -> None:
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
            kind: CellDefinition,
            rule: Rule | None = None,
            phase: str = phase,
            length: float = length,
            exits: Mapping[Rule, int] = exits,
        ) -> float:
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
        for rule, place in exits.items():
            cycle = cycling[rule.kind]
            if cycle.stages[place].fixed or cycle.model.homes.count(phase) > 1:
                note = "its phase has two stages, or lasts equally long for all cells"
        own, end = {kind: pace(kind) for kind in cycling}, lambda rule: pace(rule.kind, rule)
        set_behaviour(model, f"entry into {after}", 1.0, own, exits, end, note)


def stated_phases(cycle: Element) -> list[tuple[Element, int, Stage]]:
    """Return the phases that an element states, by rate or duration, and where."""
    made = []
    for one in cycle.all("phase_transition_rates/rate") + cycle.all("transition_rates/rate"):
        rate = one.number(at_least=0.0)
        minutes = 1.0 / rate if rate > 1e-15 else math.inf
        made.append((one, one.whole("start_index"), Stage(minutes, one.says("fixed_duration"))))
    for one in cycle.all("phase_durations/duration"):
        minutes = one.number(at_least=0.0)
        stage = Stage(minutes if minutes < 1e15 else math.inf, one.says("fixed_duration"))
        made.append((one, one.whole("index"), stage))
    return made


def _account_for(
    model: Model,
    kind: CellDefinition,
    known: Mapping[CellDefinition, Cycle],
    lead: CellDefinition | None,
) -> None:
    """Account for the cycle and volumes of a type, where they are not as in all others."""
    element, account, cycle = kind.own("cycle"), model.account, known[kind]
    divides = lead is not None and math.isfinite(cycle.minutes)
    homes = ", ".join(f"{n} {home}" for n, home in enumerate(cycle.model.homes))
    note = f"cells grow at their rate however long phases last; its phases here: {homes}"
    said = (
        (Fate.APPROXIMATED, "growth.phases", note)
        if divides
        else (Fate.MAPPED, "types.*.cycle_scale", "these cells do not divide")
    )
    account.take(element, *said, cycle.model.name)
    fixed = [[stage.fixed for stage in known[one].stages] for one in (kind, lead or kind)]
    alike = lead is not None and cycle.model is known[lead].model and fixed[0] == fixed[1]
    if element is not None and lead is not None and divides and not alike:
        note = f"its mean; whether all cells take that long is as in '{lead.name}'"
        stated = [one for one, _, _ in stated_phases(element)]
        account.take_all(stated, Fate.APPROXIMATED, "responses.entry_into_*", note)
    total = kind.own("volume/total")
    if lead is not None and divides and not math.isclose(kind.volume, lead.volume):
        note = "at the start; types share the volume at division"
        account.take(total, Fate.APPROXIMATED, "radius in cells.csv", note)
    for tag in _PARTS if lead is None else ():
        account.take(kind.own(f"volume/{tag}"), Fate.OFF)
