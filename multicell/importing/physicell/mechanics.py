"""Adhesion and repulsion of cells, and the walls of the box."""

from __future__ import annotations

import math
from itertools import product

from multicell.behaviours.catalogue import SURFACE_ENERGY
from multicell.cells import stokes_drag
from multicell.importing.files import Element
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, VISCOSITY, CellDefinition, Model
from multicell.importing.physicell.rules import rules_of, set_behaviour

_WALL = 100.0 / MINUTE
"""Strength of PhysiCell's walls, µm/s."""
_STIFFEST = 1e9  # kPa, the largest modulus of walls in a scene
_ADHESION = "mechanics/cell_cell_adhesion_strength"
_AFFINITIES = "mechanics/cell_adhesion_affinities", "cell_adhesion_affinity"
_REPULSION = "mechanics/cell_cell_repulsion_strength"
_RANGE = "mechanics/relative_maximum_adhesion_distance"
_MOST = 0.99
"""Most adhesion over repulsion: it draws two cells to 0.025 of the sum of their radii."""
_LENGTH = 1.0
_POISSON = 0.5  # incompressible; moduli are chosen for it
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


def _repulsion(kind: CellDefinition) -> float:
    return kind.number_of(_REPULSION, 10.0, at_least=0.0)


def _young(repulsion: float) -> float:
    """Return the modulus of cells that repel each other with E_ij times the law's length."""
    return 2.0 * _COMPLIANCE * strength(repulsion) / _LENGTH


def _read_repulsion(model: Model) -> None:
    leading = _repulsion(model.leader) or 10.0
    model.part("cells")["young"] = _young(leading)
    known = {kind: _repulsion(kind) for kind in model.kinds}
    mixed = len(set(known.values())) > 1
    for kind, value in known.items():
        if mixed and value > 0.0:
            model.of_type(kind, "young", _young(value))
    _read_stiffness(model, known)
    for kind, value in known.items():
        if value == 0.0:
            note = f"cells repel each other here: as those of '{model.leader.name}'"
            model.account.take(kind.own(_REPULSION), Fate.LEFT_OUT, "", note)
        elif mixed:
            note = "between types the harmonic mean of the strengths, not the geometric one"
            model.account.take(kind.own(_REPULSION), Fate.APPROXIMATED, "types.*.young", note)


def _read_stiffness(model: Model, known: dict[CellDefinition, float]) -> None:
    """Let rules change how strongly cells repel others."""
    firm = [kind for kind in model.kinds if known[kind] > 0.0]

    rules = [rule for rule in rules_of(model, "cell-cell repulsion", firm) if rule.end > 0.0]
    note = "the harmonic mean of two cells' strengths, not the geometric one"
    own, end = dict.fromkeys(firm, 1.0), lambda rule: rule.end / known[rule.kind]
    set_behaviour(model, "Young's modulus", 1.0, own, rules, end, note)


def _range(kind: CellDefinition) -> float:
    return kind.number_of(_RANGE, 1.25)


def _read_range(model: Model) -> None:
    """Set the range of adhesion, which is one for all types."""
    sticky = [kind for kind in model.kinds if _adhesion(kind) > 0.0]
    leader = max(sticky, key=lambda kind: kind.count, default=model.leader)
    cutoff = min(max(_range(leader), 1.0), 10.0) if sticky else 1.25
    model.scene["contact"]["cutoff"] = cutoff
    for kind in model.kinds:
        if _adhesion(kind) == 0.0:
            model.account.take(kind.own(_RANGE), Fate.OFF, note="these cells do not adhere")
        elif _range(kind) != cutoff:
            note = f"{cutoff:g}: types share one range, of 1 to 10 radii"
            model.account.take(kind.own(_RANGE), Fate.APPROXIMATED, "contact.cutoff", note)


def _equilibrium(kind: CellDefinition) -> tuple[float, Element] | None:
    """Return the distance at rest over the radius, where the model sets it, and where."""
    for name, unit in (("absolute", kind.radius), ("relative", 1.0)):
        found = kind.given(f"mechanics/options/set_{name}_equilibrium_distance")
        if found is not None and found.says("enabled"):
            return min(found.number() / unit, 2.0), found
    return None


def _adhesion(kind: CellDefinition) -> float:
    """Return the strength of adhesion of a type, µm/min."""
    found = _equilibrium(kind)
    if found is None:
        return kind.number_of(_ADHESION, 0.4, at_least=0.0)
    share, reach = 0.5 * found[0], _range(kind)
    return float(_repulsion(kind) * ((1.0 - share) / (1.0 - share / max(reach, 1.0))) ** 2)


def _affinities(model: Model, kind: CellDefinition) -> dict[str, float]:
    made = dict.fromkeys((other.name for other in model.kinds), 1.0)
    for one in kind.listed(*_AFFINITIES):
        if one.attributes.get("name", "") in made:
            made[one.attributes["name"]] = one.number()
    return made


def _read_adhesion(model: Model) -> None:
    own = {kind: _adhesion(kind) for kind in model.kinds}
    affinity = {kind: _affinities(model, kind) for kind in model.kinds}
    most = _strongest(model)
    pairs = {
        (i, j): math.sqrt(max(own[i] * affinity[i][j.name] * own[j] * affinity[j][i.name], 0.0))
        for i, j in product(model.kinds, repeat=2)
    }
    _account_for_strongest(model, pairs, most)
    pairs = {of: strength(min(value, most[of])) for of, value in pairs.items()}
    model.scene["contact"]["surface_energy"] = pairs[model.leader, model.leader]
    for i in model.kinds:
        if len(set(pairs.values())) > 1:
            energies = {
                j.key: pairs[i, j] if i.number <= j.number else pairs[j, i] for j in model.kinds
            }
            model.of_type(i, "surface_energy", energies)
        if (ruled := _equilibrium(i)) is not None:
            model.account.take_all([i.own(_ADHESION)], Fate.OFF, note=f"set by {ruled[1].tag}")
    # rules change how strongly cells adhere: of two the geometric mean, as there
    known = {i: own[i] for i in own if any(pairs[i, j] > 0.0 for j in own)}
    rules = rules_of(model, "cell-cell adhesion", known)
    ones, end = dict.fromkeys(known, 1.0), lambda rule: rule.end / known[rule.kind]
    set_behaviour(model, SURFACE_ENERGY, 1.0, ones, rules, end)


def _strongest(model: Model) -> dict[tuple[CellDefinition, CellDefinition], float]:
    """Return the most adhesion of each pair of types by which cells do not fall into another."""
    # cells that do not repel others do so here, as those of the leading type
    usual = _repulsion(model.leader) or 10.0
    own = {kind: _repulsion(kind) or usual for kind in model.kinds}
    return {
        (i, j): _MOST * 2.0 * own[i] * own[j] / (own[i] + own[j])
        for i, j in product(model.kinds, repeat=2)
    }


def _account_for_strongest(
    model: Model,
    pairs: dict[tuple[CellDefinition, CellDefinition], float],
    most: dict[tuple[CellDefinition, CellDefinition], float],
) -> None:
    """Account for adhesion that is stronger than repulsion."""
    for i in model.kinds:
        drawn = [j.name for j in model.kinds if pairs[i, j] > most[i, j]]
        if drawn:
            note = f"{_MOST:g} of the repulsion with {', '.join(drawn)[:200]}: in PhysiCell such "
            note += "cells fall into one another"
            given = [i.own(tag) for tag in (_ADHESION, _AFFINITIES[0])]
            model.account.take_all(given, Fate.APPROXIMATED, "contact.surface_energy", note)


def _read_wall(model: Model) -> None:
    """Give the box elastic walls: at half a radius they push as PhysiCell's do, if any can."""
    # PhysiCell's own push is 100 (1 - d/r)² um/min; Hertz's is E* r² / √8 at d = r/2
    radius, push = model.leader.radius, model.leader.drag * _WALL * 0.25
    own = 1.0 / _COMPLIANCE * model.part("cells")["young"]
    wanted = math.sqrt(8.0) * push / radius**2
    rigid = not wanted < 0.99 * own
    domain = model.part("domain")
    domain["young"] = _STIFFEST if rigid else _COMPLIANCE / (1.0 / wanted - 1.0 / own)
    domain["poisson"] = _POISSON
