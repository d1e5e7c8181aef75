"""What can be measured of a scene's runs: the observables that its history and summary will hold.

Known from the scene alone, so that data can be refused before anything runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.results.quantities import UNITS, unit_of
from multicell.results.summary import counts_contacts
from multicell.schema import near_miss

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

_ALWAYS: Final = (
    "cells", "diameter", "necrotic_radius", "viable_rim", "packing_ratio", "largest_pressure",
    "proliferating", "quiescent", "necrotic", "apoptotic",
)  # fmt: skip
_OF_A_RUN: Final = ("divisions", "removals", "volume_released")
_OF_A_LEDGER: Final = (
    "inflow", "outflow", "washed", "uptake", "secreted", "decayed", "stored", "content",
)  # fmt: skip


def signed(name: str) -> bool:
    """Return whether an observable may be negative."""
    return name in ("instability_rate", "tissue_pressure") or name.startswith("force_")


def in_history(scene: Scene) -> dict[str, str]:
    """Return the observables that have a value at any time of a run, with their base units.

    Columns of a history that tell of the computation and not of the tissue (steps, spacings,
    estimated errors) are left out.
    """
    names = list(_ALWAYS)
    if counts_contacts(scene):
        names.append("contacts")
    if len(scene.types) > 1:
        names.append("heterotypic_fraction")
    if scene.pull is not None:
        names.append("pull")
    names += [f"force_{motion}_{axis}" for motion in scene.motions for axis in "xyz"]
    if scene.springs:
        names += ["springs", "largest_tension"]
    if scene.dimensions == 3 and scene.domain is not None and scene.domain.wall == "elastic":
        names += ["volume_fraction", "wall_pressure", "tissue_pressure"]
    if scene.growth is not None and scene.growth.critical_pressure is not None:
        names += ["pressure_factor", "held_by_pressure"]
    if scene.output.instability:
        names.append("instability_rate")
    if scene.dimensions == 3 and any(n.layout != "box" for n in scene.nutrients.values()):
        names.append("departure_from_a_ball")
    for field, nutrient in scene.nutrients.items():
        if nutrient.quiescence is not None:
            names.append(f"hypoxic_radius_{field}")
        if nutrient.finite_medium is not None:
            names.append(f"medium_{field}")
    return {name: unit_of(name) for name in names}


def at_the_end(scene: Scene) -> dict[str, str]:
    """Return the observables that only the summary of a run holds, by dotted names, with units."""
    names = list(_OF_A_RUN)
    if scene.pull is not None:
        names += ["separation.time", "separation.force"]
    names += [f"ledger.{field}.{amount}" for field in scene.nutrients for amount in _OF_A_LEDGER]
    return {name: unit_of(name) for name in names}


def likely(name: str, options: Mapping[str, Any]) -> str:
    """Return which observable may have been meant, and the list of all."""
    parts = [o for o in options if name.lower() in o.lower() or o.lower() in name.lower()]
    known = near_miss(name, options)
    if not parts or known.startswith("Did you mean"):
        return known
    return f"Did you mean '{min(parts, key=len)}'? {known}"


def is_known_elsewhere(name: str) -> bool:
    """Return whether a name is one of some run's numbers, if not of this scene's."""
    if name in UNITS:
        return True
    try:
        unit_of(name)
    except KeyError:
        return False
    return True


def continued(history: Mapping[str, NDArray[np.float64]], name: str) -> NDArray[np.float64]:
    """Return an observable over the steps of a run, (m,): the viable rim also without a core.

    A rim grows into the radius as the core becomes smaller; where nothing is dead it is the radius.
    """
    values = history[name]
    if name != "viable_rim":
        return values
    return np.where(history["necrotic_radius"] == 0.0, 0.5 * history["diameter"], values)


def entry_of(summary: Mapping[str, Any], name: str) -> float:
    """Return a number of a summary by its dotted name, NaN where there is none."""
    found: Any = summary
    for part in name.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return float(found) if isinstance(found, int | float) else float("nan")
