"""Apoptosis and necrosis: rates, and how the dead lose their volume."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

from multicell.importing.files import Element
from multicell.importing.imported import Fate
from multicell.importing.physicell.cycle import stated_phases
from multicell.importing.physicell.model import MINUTE, CellDefinition, Model
from multicell.importing.physicell.rules import rules_of, set_behaviour
from multicell.roots import brent_root

APOPTOSIS, NECROSIS = "100", "101"
_NAMES = {APOPTOSIS: "apoptosis", NECROSIS: "necrosis"}
_REMOVED = 0.01, 0.1
"""Bounds of the fraction of the birth volume at which the dead are removed."""
_USUAL = {
    NECROSIS: {
        "unlysed_fluid_change_rate": 0.67 / 60.0,
        "lysed_fluid_change_rate": 0.05 / 60.0,
        "cytoplasmic_biomass_change_rate": 0.0032 / 60.0,
        "nuclear_biomass_change_rate": 0.013 / 60.0,
        "relative_rupture_volume": 2.0,
    },
    APOPTOSIS: {
        "unlysed_fluid_change_rate": 3.0 / 60.0,
        "lysed_fluid_change_rate": 0.0,
        "cytoplasmic_biomass_change_rate": 1.0 / 60.0,
        "nuclear_biomass_change_rate": 0.35 / 60.0,
        "relative_rupture_volume": 2.0,
    },
}
"""1/min, and a ratio: PhysiCell's entries."""
_BURSTS = "lysed_fluid_change_rate", "relative_rupture_volume"


@final
@dataclass(frozen=True)
class Dying:
    """One way in which a type dies: 1/min, and the length of the last phase in min."""

    rate: float
    parameters: dict[str, float]
    last: float


def read_death(model: Model) -> None:
    """Read ``death`` of all types; what types share is that of the type with most cells."""
    apoptosis, necrosis = (_lead(model, code) for code in (APOPTOSIS, NECROSIS))
    removed = _REMOVED[1]
    if apoptosis is not None:
        death, how = model.part("death"), _dying(apoptosis, APOPTOSIS)
        # at the end of the phase that is the fraction left of what shrinks in this mean time
        shrinking = max(_shrinking(apoptosis, how), 1e-9)
        removed = min(max(math.exp(-how.last / shrinking), _REMOVED[0]), _REMOVED[1])
        death["apoptosis_rate"] = how.rate / MINUTE
        death["apoptosis_time"] = _fading(how.last, removed) * MINUTE
        _set_rates(model, APOPTOSIS, how.rate / MINUTE)
    if necrosis is not None:
        _set_necrosis(model, necrosis, removed)
        _set_rates(model, NECROSIS, 0.0)
    if "death" in model.scene:
        model.part("death")["removal_fraction"] = removed
    for kind in model.kinds:
        _account_for(model, kind)


def _lead(model: Model, code: str) -> CellDefinition | None:
    """Return the type with most cells of those that die in a way, by themselves or by rules."""
    ruled = {rule.kind for rule in rules_of(model, _NAMES[code], model.kinds) if rule.end > 0.0}
    dying = [kind for kind in model.kinds if kind in ruled or _dying(kind, code).rate > 0.0]
    return max(dying, key=lambda kind: kind.count, default=None)


def _set_rates(model: Model, code: str, usual: float) -> None:
    own = {kind: _dying(kind, code).rate / MINUTE for kind in model.kinds}
    rules = rules_of(model, _NAMES[code], model.kinds)
    set_behaviour(model, f"{_NAMES[code]} rate", usual, own, rules, lambda r: r.end / MINUTE)


def _set_necrosis(model: Model, lead: CellDefinition, removed: float) -> None:
    necrosis, death = _dying(lead, NECROSIS), model.part("death")
    swelling = _time_to_burst(lead, necrosis)
    if swelling is not None:
        death["swelling"] = min(max(necrosis.parameters["relative_rupture_volume"], 1.0), 8.0)
        death["swelling_time"] = swelling * MINUTE
    lysed = necrosis.parameters["lysed_fluid_change_rate"]
    death["lysis_time"] = (1.0 / lysed if lysed > 0.0 else _fading(necrosis.last, removed)) * MINUTE


def _fading(minutes: float, removed: float) -> float:
    """Return the mean time in which a cell must shrink to be removed after a time."""
    return min(max(minutes, 1e-3), 1e7) / math.log(1.0 / removed)


def _shares(kind: CellDefinition) -> tuple[float, float, float]:
    """Return the shares of water, solid cytoplasm and solid nucleus in the volume of a cell."""
    fluid = kind.number_of("volume/fluid_fraction", 0.75)
    nucleus = kind.number_of("volume/nuclear", 540.0) / kind.volume
    return fluid, (1.0 - fluid) * (1.0 - nucleus), (1.0 - fluid) * nucleus


def _shrinking(kind: CellDefinition, dying: Dying) -> float:
    """Return the mean time in which an apoptotic cell shrinks, min; infinite for a part that stays.

    Water and both solids fall to 0 at rates of their own: it is the sum of shares over rates.
    """
    rates = [dying.parameters[tag] for tag in _USUAL[APOPTOSIS] if tag not in _BURSTS]
    return sum(
        share / rate if rate > 0.0 else math.inf
        for share, rate in zip(_shares(kind), rates, strict=True)
        if share > 0.0
    )


def _code(model: Element) -> str:
    codes = {name: code for code, name in _NAMES.items()}
    named = codes.get(model.attributes.get("name", "").lower(), "")
    return model.attributes.get("code") or named


def _dying(kind: CellDefinition, code: str) -> Dying:
    last = 516.0 if code == APOPTOSIS else 86400.0
    found = next((one for one in kind.listed("death", "model") if _code(one) == code), None)
    if found is None:
        return Dying(0.0, _USUAL[code], last)
    rate = found.number_at("rate", 0.0, at_least=0.0)
    parameters = {
        tag: found.number_at(f"parameters/{tag}", value, at_least=0.0)
        for tag, value in _USUAL[code].items()
    }
    # the dead are removed at the end of the only phase of apoptosis, of the second one of necrosis
    for _, phase, stage in stated_phases(found):
        if phase == (code == NECROSIS) and math.isfinite(stage.minutes):
            last = stage.minutes
    return Dying(found.number_at("death_rate", rate, at_least=0.0), parameters, last)


def _time_to_burst(kind: CellDefinition, dying: Dying) -> float | None:
    """Return when a necrotic cell reaches the volume at which it bursts, min; None if never.

    Its solids s decay, and fluid F comes in as long as there are solids: dF/dt = k (V - F) = k s.
    """
    goal = dying.parameters["relative_rupture_volume"]
    k = dying.parameters["unlysed_fluid_change_rate"]
    fluid, cytoplasm, nucleus = _shares(kind)
    parts = [
        (cytoplasm, dying.parameters["cytoplasmic_biomass_change_rate"]),
        (nucleus, dying.parameters["nuclear_biomass_change_rate"]),
    ]

    def volume(t: float) -> float:
        solid = sum(part * math.exp(-rate * t) for part, rate in parts)
        came = sum(
            part * (-math.expm1(-rate * t) / rate if rate > 0.0 else t) for part, rate in parts
        )
        return fluid + solid + k * came

    if not 1.0 < goal <= volume(1e5):
        return None
    return brent_root(lambda t: volume(t) - goal, 0.0, 1e5, xtol=1e-9, rtol=1e-14)


def _account_for(model: Model, kind: CellDefinition) -> None:
    """Account for models of death that no cell dies of, or that are not those of all types."""
    take_all = model.account.take_all
    for one in kind.listed("death", "model", own=True):
        code = _code(one)
        if code not in _NAMES:
            take_all([one], Fate.LEFT_OUT, note="neither apoptosis nor necrosis")
            continue
        leader = _lead(model, code)
        if leader is None:
            take_all([one], Fate.OFF, note="no cell dies in this way")
            continue
        lead, own = _dying(leader, code), _dying(kind, code)
        known = [tag for table in one.all("parameters") for tag in table.children]
        known = [tag for tag in known if tag.tag in _USUAL[code]]
        if code == APOPTOSIS:
            burst = [tag for tag in known if tag.tag in _BURSTS]
            take_all(burst, Fate.OFF, note="cells that shrink do not burst")
        if (lead.parameters, lead.last) != (own.parameters, own.last):
            note = f"as in '{leader.name}': types share it"
            phases = [part for part in one.children if part.tag.startswith("phase")]
            take_all([*phases, *known], Fate.APPROXIMATED, "death", note)
