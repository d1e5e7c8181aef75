"""Adhesion and repulsion of cells, and the walls of the box."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from multicell.cells import stokes_drag
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, VISCOSITY, Kind, Model
from multicell.importing.physicell.rules import Rule, rules_of, set_behaviour

if TYPE_CHECKING:
    from multicell.importing.files import Element

_WALL = 100.0 / MINUTE
"""Strength of PhysiCell's walls, µm/s."""
_STIFFEST = 1e9
_AFFINITIES = "mechanics/cell_adhesion_affinities", "cell_adhesion_affinity"
_LENGTH = 1.0
_POISSON = 0.5
_COMPLIANCE = 0.75 * (1.0 - _POISSON**2)


def strength(speed: float) -> float:
    """Return the strength 3πη v in nN/µm of what PhysiCell gives as a velocity v in µm/min."""
    return 0.5 * stokes_drag(VISCOSITY) * speed / MINUTE


def read_mechanics(model: Model) -> None:
    """Read ``mechanics`` of all types, and ``virtual_wall_at_domain_edge``."""
    model.part("drag")["viscosity"] = VISCOSITY
    model.part("cells").update(poisson=_POISSON, young_variation=0.0)
    model.scene["contact"] = {"law": "physicell", "length": _LENGTH}
    _read_repulsion(model)
    _read_range(model)
    _read_adhesion(model)
    _read_wall(model)


def _repulsion(kind: Kind) -> float:
    return kind.number_of("mechanics/cell_cell_repulsion_strength", 10.0, at_least=0.0)


def _young(repulsion: float) -> float:
    """Return the modulus of cells that repel each other with E_ij times the law's length."""
    return 2.0 * _COMPLIANCE * strength(repulsion) / _LENGTH


def _read_repulsion(model: Model) -> None:
    path = "mechanics/cell_cell_repulsion_strength"
    leading = _repulsion(model.leader) or 10.0
    model.part("cells")["young"] = _young(leading)
    known = {kind: _repulsion(kind) for kind in model.kinds}
    mixed = len(set(known.values())) > 1
    for kind, value in known.items():
        if mixed and value > 0.0:
            model.of_type(kind, "young", _young(value))
    _read_stiffness(model, known)
    for kind, element in model.each(path):
        if known[kind] == 0.0:
            note = f"cells repel each other here: as those of '{model.leader.name}'"
            model.account.leave_out([element], note)
        elif mixed:
            note = "between types the harmonic mean of the strengths, not the geometric one"
            model.account.take(element, Fate.APPROXIMATED, f"types.{kind.key}.young", note)
        else:
            model.account.take(element, Fate.MAPPED, "cells.young")


def _read_stiffness(model: Model, known: dict[Kind, float]) -> None:
    """Let rules change how strongly cells repel others."""
    firm = [kind for kind in model.kinds if known[kind] > 0.0]

    def value(kind: Kind, rule: Rule | None) -> float:
        return 1.0 if rule is None else rule.end / known[kind]

    rules = [rule for rule in rules_of(model, "cell-cell repulsion", firm) if rule.end > 0.0]
    note = "the harmonic mean of two cells' strengths, not the geometric one"
    set_behaviour(model, "Young's modulus", 1.0, value, firm, rules, note)


def _range(kind: Kind) -> float:
    return kind.number_of("mechanics/relative_maximum_adhesion_distance", 1.25)


def _read_range(model: Model) -> None:
    """Set the range of adhesion, which is one for all types."""
    sticky = [kind for kind in model.kinds if _adhesion(kind) > 0.0]
    leader = max(sticky, key=lambda kind: kind.count, default=model.leader)
    cutoff = min(max(_range(leader), 1.0), 10.0) if sticky else 1.25
    model.scene["contact"]["cutoff"] = cutoff
    for kind, element in model.each("mechanics/relative_maximum_adhesion_distance"):
        if _adhesion(kind) == 0.0:
            model.account.take(element, Fate.OFF, note="these cells do not adhere")
        elif element.number() == cutoff:
            model.account.take(element, Fate.MAPPED, "contact.cutoff")
        else:
            note = f"{cutoff:g}: types share one range, of 1 to 10 radii"
            model.account.take(element, Fate.APPROXIMATED, "contact.cutoff", note)


def _equilibrium(kind: Kind) -> tuple[float, Element] | None:
    """Return the distance at rest over the radius, where the model sets it, and where."""
    for name, unit in (("absolute", kind.radius), ("relative", 1.0)):
        found = kind.given(f"mechanics/options/set_{name}_equilibrium_distance")
        if found is not None and found.says("enabled"):
            return min(found.number() / unit, 2.0), found
    return None


def _adhesion(kind: Kind) -> float:
    """Return the strength of adhesion of a type, µm/min."""
    found = _equilibrium(kind)
    if found is None:
        return kind.number_of("mechanics/cell_cell_adhesion_strength", 0.4, at_least=0.0)
    share, reach = 0.5 * found[0], _range(kind)
    return float(_repulsion(kind) * ((1.0 - share) / (1.0 - share / max(reach, 1.0))) ** 2)


def _affinities(model: Model, kind: Kind) -> dict[str, float]:
    made = dict.fromkeys((other.name for other in model.kinds), 1.0)
    for one in kind.listed(*_AFFINITIES):
        if one.attributes.get("name", "") in made:
            made[one.attributes["name"]] = one.number()
    return made


def _read_adhesion(model: Model) -> None:
    own = {kind: _adhesion(kind) for kind in model.kinds}
    affinity = {kind: _affinities(model, kind) for kind in model.kinds}
    pairs = {
        (i, j): strength(
            math.sqrt(max(own[i] * affinity[i][j.name] * own[j] * affinity[j][i.name], 0.0))
        )
        for i in model.kinds
        for j in model.kinds
    }
    model.scene["contact"]["surface_energy"] = pairs[model.leader, model.leader]
    if len(set(pairs.values())) > 1:
        for i in model.kinds:
            energies = {
                j.key: pairs[i, j] if i.number <= j.number else pairs[j, i] for j in model.kinds
            }
            model.of_type(i, "surface_energy", energies)
        key = "types.*.surface_energy"
    else:
        key = "contact.surface_energy"
    for kind in model.kinds:
        _account_for_adhesion(model, kind, key)


def _account_for_adhesion(model: Model, kind: Kind, key: str) -> None:
    take, ruled = model.account.take, _equilibrium(kind)
    element = kind.own("mechanics/cell_cell_adhesion_strength")
    if ruled is not None:
        take(element, Fate.OFF, note=f"set by {ruled[1].tag}")
    else:
        take(element, Fate.MAPPED, key)
    for name in ("relative", "absolute"):
        one = kind.own(f"mechanics/options/set_{name}_equilibrium_distance")
        counts = ruled is not None and one is ruled[1]
        take(one, Fate.MAPPED if counts else Fate.OFF, key if counts else "")
    for one in kind.listed(*_AFFINITIES, own=True):
        known = model.kind_named(one.attributes.get("name", "")) is not None
        note = "" if known else "of a type that there is not"
        take(one, Fate.MAPPED if known else Fate.OFF, key if known else "", note)


def _read_wall(model: Model) -> None:
    """Give the box elastic walls: at half a radius they push as PhysiCell's do."""
    found = model.root.find("options/virtual_wall_at_domain_edge")
    # PhysiCell's own push is 100 (1 - d/r)² um/min; Hertz's is E* r² / √8 at d = r/2
    radius, push = model.leader.radius, model.leader.drag * _WALL * 0.25
    own = 1.0 / _COMPLIANCE * model.part("cells")["young"]
    wanted = math.sqrt(8.0) * push / radius**2
    rigid = not wanted < 0.99 * own
    domain = model.part("domain")
    domain["young"] = _STIFFEST if rigid else _COMPLIANCE / (1.0 / wanted - 1.0 / own)
    domain["poisson"] = _POISSON
    if found is None:
        return
    if found.flag():
        how = "as stiff as can be" if rigid else "as strong at a distance of half a radius"
        note = f"elastic walls, {how}; PhysiCell's push is quadratic"
    else:
        note = "cells that leave the box stop for good in PhysiCell; here elastic walls hold them"
    model.account.take(found, Fate.APPROXIMATED, "domain.wall", note)
