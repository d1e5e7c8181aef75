"""Cycle and growth: PhysiCell's models of the cycle as G1, S, G2 and M."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

from multicell.cells import SPHERE
from multicell.importing.account import Fate
from multicell.importing.physicell.model import MINUTE, Kind, Model

if TYPE_CHECKING:
    from multicell.importing.xml import Element

_INSTANT = 1.0
"""Length of a phase that a model does not have, s."""
_NEVER = 1e6
"""Mean cycle over the duration of the run, for types whose cells do not divide."""
_RATE = "cytoplasmic_biomass_change_rate"
_PARTS = ("fluid_fraction", "nuclear", "fluid_change_rate", "nuclear_biomass_change_rate")
"""Elements about parts of a cell's volume."""
_SLOWEST, _FASTEST = 0.7, 12.0
"""Bounds of rate times growing time: beyond, cells become ever smaller, or grow at once."""
_NAMES = ("G1", "S", "G2", "M")


@final
@dataclass(frozen=True)
class Stage:
    """A phase of PhysiCell: minutes (infinite: never left), and whether all take that long."""

    minutes: float
    fixed: bool


@final
@dataclass(frozen=True)
class CycleModel:
    """A model of the cycle.

    Attributes
    ----------
    name : str
    usual : tuple of Stage
        Its phases with what PhysiCell has for them.
    homes : tuple of str
        The phase of ours in which each of them is.
    doubles_before : bool
        Whether volume doubles before division, not after it.
    """

    name: str
    usual: tuple[Stage, ...]
    homes: tuple[str, ...]
    doubles_before: bool = True


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
    """The cycle of a type: its model, and its phases with their durations."""

    model: CycleModel
    stages: tuple[Stage, ...]
    limited: bool = False

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
            # a phase that a substance slows is one with growth
            grows = name != "G1" or not self.model.doubles_before or self.limited
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
    known = {kind: _cycle(kind) for kind in model.kinds}
    dividing = [kind for kind, cycle in known.items() if math.isfinite(cycle.minutes)]
    lead = max(dividing, key=lambda kind: kind.count, default=None)
    sizes = 2.0 * model.leader.volume, 0.0
    if lead is not None:
        growth = model.part("growth")
        growth.update(phases=known[lead].phases(), restriction=False, law="relaxation")
        sizes = _sizes(model, lead, known[lead])
        for kind, cycle in known.items():
            model.of_type(kind, "cycle_scale", _scale(model, cycle, known[lead]))
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
        return above or Cycle(MODELS[0], MODELS[0].usual)
    found = MODELS[_code(own)]
    stages = list(above.stages if above is not None and above.model is found else found.usual)
    for one, start, stage in _stated(own):
        if not 0 <= start < len(stages):
            raise one.error(f"is of phase {start}, but '{found.name}' has {len(stages)}")
        stages[start] = stage
    if kind.entry is not None:
        stages[0] = Stage(1.0 / kind.entry if kind.entry > 0.0 else math.inf, stages[0].fixed)
    return Cycle(found, tuple(stages), kind.limited or kind.entry is not None)


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
        alike = cycle.model is known[lead].model and _ratio(cycle, known[lead])
        for one, start, _ in _stated(element):
            if start == 0 and kind.entry is not None:
                note = f"at most {kind.entry:g}: a rule lets a substance decide on it"
                account.take(one, Fate.APPROXIMATED, "growth.phases", note)
            elif alike:
                account.take(one, Fate.MAPPED, "growth.phases")
            else:
                note = f"phases as those of '{lead.name}', of this type's mean cycle in all"
                account.take(one, Fate.APPROXIMATED, f"types.{kind.key}.cycle_scale", note)
    for one in element.all("standard_asymmetric_division"):
        note = "daughters are of the type of their mother"
        account.leave_out([one], note, acts=one.says("enabled"))


def _ratio(cycle: Cycle, lead: Cycle) -> bool:
    """Return whether all phases are those of another cycle times one number."""
    scale = cycle.minutes / lead.minutes
    return all(
        a.fixed == b.fixed and math.isclose(a.minutes, scale * b.minutes, abs_tol=1e-9)
        for a, b in zip(cycle.stages, lead.stages, strict=True)
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
    _account_for_rates(model, kind, table)
    for tag in _PARTS:
        account.leave_out(table.all(tag), "a cell has one volume")
    for tag in ("calcified_fraction", "calcification_rate"):
        for one in table.all(tag):
            account.leave_out([one], "no calcium", acts=one.number() != 0.0)
    note = "that of each model of death counts"
    account.take_all(table.all("relative_rupture_volume"), Fate.OFF, note=note)


def _account_for_rates(model: Model, kind: Kind, table: Element) -> None:
    """Account for how fast parts of a cell's volume go to their targets."""
    account, grows = model.account, "growth" in model.scene
    for one in table.all(_RATE):
        note = (
            "V' = r (K - V) at this rate; with another cycle time in proportion, and for all types "
            "as for that of most dividing cells"
        )
        fate = Fate.APPROXIMATED if grows else Fate.OFF
        account.take(one, fate, "growth.target" if grows else "", note if grows else "")
