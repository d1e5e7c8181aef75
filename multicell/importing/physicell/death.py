"""Apoptosis and necrosis: rates, and how the dead lose their volume."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, Kind, Model
from multicell.importing.physicell.rules import Rule, rules_of, set_behaviour

if TYPE_CHECKING:
    from multicell.importing.files import Element

APOPTOSIS, NECROSIS = "100", "101"
_NAMES = {APOPTOSIS: "apoptosis", NECROSIS: "necrosis"}
_REMOVED = 0.1
_USUAL = {
    APOPTOSIS: {"unlysed_fluid_change_rate": 0.05, "lysed_fluid_change_rate": 0.0,
                "cytoplasmic_biomass_change_rate": 1.0 / 60.0,
                "nuclear_biomass_change_rate": 0.35 / 60.0, "relative_rupture_volume": 2.0},
    NECROSIS: {"unlysed_fluid_change_rate": 0.67 / 60.0, "lysed_fluid_change_rate": 0.05 / 60.0,
               "cytoplasmic_biomass_change_rate": 0.0032 / 60.0,
               "nuclear_biomass_change_rate": 0.013 / 60.0, "relative_rupture_volume": 2.0},
}  # fmt: skip


@final
@dataclass(frozen=True)
class Dying:
    """One way in which a type dies: 1/min, min; the last phase's length is None where unknown."""

    element: Element | None
    rate: float
    parameters: dict[str, float]
    last: float


def read_death(model: Model) -> None:
    """Read ``death`` of all types; what types share is that of the type with most cells."""
    apoptosis, necrosis = (_lead(model, code) for code in (APOPTOSIS, NECROSIS))
    if apoptosis is not None:
        death, how = model.part("death"), _dying(apoptosis, APOPTOSIS)
        death["apoptosis_rate"] = how.rate / MINUTE
        death["apoptosis_time"] = _fading(how.last) * MINUTE
        _set_rates(model, APOPTOSIS, how.rate / MINUTE)
    if necrosis is not None:
        _set_necrosis(model, necrosis)
        _set_rates(model, NECROSIS, 0.0)
    if "death" in model.scene:
        model.part("death")["removal_fraction"] = _REMOVED
    for kind in model.kinds:
        _account_for(model, kind)


def _lead(model: Model, code: str) -> Kind | None:
    """Return the type with most cells of those that die in a way, by themselves or by rules."""
    ruled = {rule.kind for rule in rules_of(model, _NAMES[code], model.kinds) if rule.end > 0.0}
    dying = [kind for kind in model.kinds if kind in ruled or _dying(kind, code).rate > 0.0]
    return max(dying, key=lambda kind: kind.count, default=None)


def _set_rates(model: Model, code: str, usual: float) -> None:
    def value(kind: Kind, rule: Rule | None) -> float:
        return (_dying(kind, code).rate if rule is None else rule.end) / MINUTE

    rules = rules_of(model, _NAMES[code], model.kinds)
    set_behaviour(model, f"{_NAMES[code]} rate", usual, value, model.kinds, rules)


def _set_necrosis(model: Model, lead: Kind) -> None:
    necrosis, death = _dying(lead, NECROSIS), model.part("death")
    swelling = _time_to_burst(lead, necrosis)
    if swelling is not None:
        death["swelling"] = min(max(necrosis.parameters["relative_rupture_volume"], 1.0), 8.0)
        death["swelling_time"] = swelling * MINUTE
    lysed = necrosis.parameters["lysed_fluid_change_rate"]
    death["lysis_time"] = (1.0 / lysed if lysed > 0.0 else _fading(necrosis.last)) * MINUTE


def _fading(minutes: float) -> float:
    """Return the mean time in which a cell must shrink to be removed after a time."""
    return min(max(minutes, 1e-3), 1e7) / math.log(1.0 / _REMOVED)


def _code(model: Element) -> str:
    name = model.attributes.get("name", "").lower()
    return model.attributes.get("code") or {"apoptosis": APOPTOSIS, "necrosis": NECROSIS}.get(
        name, ""
    )


def _dying(kind: Kind, code: str) -> Dying:
    found = next((one for one in kind.listed("death", "model") if _code(one) == code), None)
    rate = None if found is None else found.find("death_rate") or found.find("rate")
    table = None if found is None else found.find("parameters")
    parameters = dict(_USUAL[code])
    for tag in parameters:
        one = None if table is None else table.find(tag)
        if one is not None:
            parameters[tag] = one.number(at_least=0.0)
    last = 516.0 if code == APOPTOSIS else 86400.0
    value = 0.0 if rate is None else rate.number(at_least=0.0)
    return Dying(found, value, parameters, _last(found, code, last))


def _last(found: Element | None, code: str, usual: float) -> float:
    """Return how long the phase lasts at the end of which the dead are removed, min."""
    index = "0" if code == APOPTOSIS else "1"
    for one in [] if found is None else found.all("phase_durations/duration"):
        if one.attributes.get("index") == index:
            return one.number()
    for one in [] if found is None else found.all("phase_transition_rates/rate"):
        if one.attributes.get("start_index") == index and one.number() > 0.0:
            return 1.0 / one.number()
    return usual


def _time_to_burst(kind: Kind, dying: Dying) -> float | None:
    """Return when a necrotic cell reaches the volume at which it bursts, min; None if never.

    Its solids s decay, and fluid F comes in as long as there are solids: dF/dt = k (V - F) = k s.
    """
    from scipy.optimize import brentq

    goal = dying.parameters["relative_rupture_volume"]
    k = dying.parameters["unlysed_fluid_change_rate"]
    fluid = kind.number_of("volume/fluid_fraction", 0.75)
    nucleus = kind.number_of("volume/nuclear", 540.0) / kind.volume
    parts = [
        ((1.0 - fluid) * (1.0 - nucleus), dying.parameters["cytoplasmic_biomass_change_rate"]),
        ((1.0 - fluid) * nucleus, dying.parameters["nuclear_biomass_change_rate"]),
    ]

    def volume(t: float) -> float:
        solid = sum(part * math.exp(-rate * t) for part, rate in parts)
        came = sum(
            part * (-math.expm1(-rate * t) / rate if rate > 0.0 else t) for part, rate in parts
        )
        return fluid + solid + k * came

    if not 1.0 < goal <= volume(1e5):
        return None
    return float(brentq(lambda t: volume(t) - goal, 0.0, 1e5, xtol=1e-9, rtol=1e-14))


def _account_for(model: Model, kind: Kind) -> None:
    for one in kind.listed("death", "model", own=True):
        code = _code(one)
        if code not in (APOPTOSIS, NECROSIS):
            model.account.leave_out([one], "neither apoptosis nor necrosis")
            continue
        _account_for_rate(model, kind, one, code)
        _account_for_course(model, kind, one, code)


def _account_for_rate(model: Model, kind: Kind, one: Element, code: str) -> None:
    rate = one.find("death_rate") or one.find("rate")
    if rate is None:
        return
    if rate.number() == 0.0:
        note = "unless C++ code or a rule sets it" if code == NECROSIS else ""
        model.account.take(rate, Fate.OFF, note=note)
    else:
        lead = _lead(model, code)
        alike = lead is not None and _dying(lead, code).rate == rate.number() and code == APOPTOSIS
        own = f"responses.{_NAMES[code]}_rate_of_{kind.key}"
        model.account.take(rate, Fate.MAPPED, "death.apoptosis_rate" if alike else own)


_COURSE = {
    APOPTOSIS: "volume falls exponentially, to a tenth in the time after which PhysiCell removes",
    NECROSIS: "swells exponentially until it bursts, then shrinks exponentially",
}


def _account_for_course(model: Model, kind: Kind, one: Element, code: str) -> None:
    """Account for phases and parameters of a model of death."""
    leader = _lead(model, code)
    if leader is None:
        model.account.take_all([one], Fate.OFF, note="no cell dies in this way")
        return
    lead, own = _dying(leader, code), _dying(kind, code)
    same = lead.parameters == own.parameters and lead.last == own.last
    note = _COURSE[code] if same else f"as in '{leader.name}': types share how they die"
    fades = "death.apoptosis_time" if code == APOPTOSIS else "death.lysis_time"
    keys = {
        "lysed_fluid_change_rate": "death.lysis_time",
        "relative_rupture_volume": "death.swelling",
        "unlysed_fluid_change_rate": "death.swelling_time",
        "cytoplasmic_biomass_change_rate": "death.swelling_time",
        "nuclear_biomass_change_rate": "death.swelling_time",
    }
    account = model.account
    for tag, key in keys.items():
        leaves = one.all(f"parameters/{tag}")
        if code == APOPTOSIS:
            account.leave_out(leaves, "one time constant describes how apoptotic cells shrink")
        else:
            account.take_all(leaves, Fate.APPROXIMATED, key, note)
    for path in ("phase_durations", "phase_transition_rates", "transition_rates"):
        account.take_all(one.all(path), Fate.APPROXIMATED, fades, note)
