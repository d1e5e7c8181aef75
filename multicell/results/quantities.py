"""The unit of every number that a run hands out: in its history, its summary and its tables.

Each name is declared here, also where it is a count or a ratio (with the unit ``""``): a name that
is not is a mistake, which :func:`unit_of` refuses. A star stands for a name that the scene gives,
such as that of a field.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

from multicell.results.measures import OBSERVABLES
from multicell.results.observable import OWN_OBSERVABLES
from multicell.scene.own_units import own_units

_AMOUNTS: Final = (
    "relaid",
    "remainder",
    "made",
    "used",
    "released",
    "medium_held",
    "medium_fresh",
    "medium_discarded",
    "medium_decayed",
    "medium_remainder",
)
"""Entries of a ledger that are no observables."""
_COUNTS: Final = (
    "evaluations",
    "linearisations",
    "jacobian_products",
    "preconditioner_setups",
    "preconditioner_solves",
    "list_builds",
    "list_repairs",
    "steps",
    "rejections",
    "newton_iterations",
    "linear_iterations",
    "factorisations",
    "friction_iterations",
    "steps_*",
)

_RATIOS: Final = (
    "step",
    "steps",
    "seed",
    "threads",
    "stability_ratio",
    "splitting_volume_error",
    "splitting_worst_cell_error",
    "splitting_events_error",
    "splitting_first_order_error",
    "splitting_networks_error",
    "splitting.relative_volume_error",
    "splitting.worst_cell_error",
    "splitting.events_error",
    "splitting.first_order_error",
    "coupling_steps.exceeded",
    "splitting.networks_error",
    "integrator.replays",
    "integrator.stability_checks",
    "integrator.checks_beyond_stability",
    "integrator.largest_stability_ratio",
    "ledger.*.relative_remainder",
    "ledger.relative_remainder",
    "fields.*.departure_from_a_ball",
)
"""Further numbers without a unit."""
QUANTITY_UNITS: Final[Mapping[str, str]] = {
    **{o.name: o.unit for o in OBSERVABLES},
    **{o.entry: o.unit for o in OBSERVABLES if o.entry is not None},
    # of the computation
    "time": "s",
    "shift_effect": "um",
    "coupling_step": "s",
    "coupling_steps.shortest": "s",
    "coupling_steps.longest": "s",
    "splitting.volume_error": "um^3",
    "integrator.largest_shift_effect": "um",
    "fields.*.spacing": "um",
    "fields.*.layer": "um",
    "wall.*": "s",
    "peak_memory": "MB",
    **{f"ledger.*.{name}": "amol" for name in _AMOUNTS},
    "fields.*.medium": "mM",
    "fields.*.discretisation_error": "mM",
    **{f"start.{name}": "" for name in ("quiescent", "necrotic", "unfit")},
    **{f"integrator.{name}": "" for name in _COUNTS},
    **dict.fromkeys(_RATIOS, ""),
    # tables
    "cells.time": "s",
    "cells.concentration_*": "mM",
    "contacts.time": "s",
    "contacts.distance": "um",
    "contacts.overlap": "um",
    **{f"lineage.{event}_time": "s" for event in ("birth", "death", "end")},
    **{f"lineage.{name}": "" for name in ("id", "parent", "kind", "end")},
    **{f"contacts.{name}": "" for name in ("frame", "first_id", "second_id")},
    "cells.frame": "",
}
"""Unit by name; the columns of ``cells`` that are not here are those of :class:`Cells`."""

ABSENT_WORDS: Final[Mapping[str, str]] = {
    **{o.name: o.absent for o in OBSERVABLES if o.absent},
    **{o.entry: o.absent for o in OBSERVABLES if o.absent and o.entry and "*" in o.entry},
    "shift_effect": "before the first coupling step that is taken twice",
    "stability_ratio": "with methods whose step has no limit of stability",
}
"""Numbers that need not exist, and when they do not: NaN in a history, None in a summary.

All others are finite in every state.
"""


@lru_cache(maxsize=1024)  # each run of a study asks for the same names
def _unit_with_star(name: str) -> str | None:
    """Return the unit of a name that matches one with a star, None if it matches none."""
    for known, unit in QUANTITY_UNITS.items():
        if "*" in known and re.fullmatch("[^.]+".join(map(re.escape, known.split("*"))), name):
            return unit
    return None


def unit_of(name: str) -> str:
    """Return the unit of a number by its name, ``""`` for a count, a ratio or a text.

    - ``name``: of a column of the history (``"hypoxic_radius_oxygen"``), of an entry of the summary
      with dots (``"ledger.oxygen.inflow"``), or of a column of a table with the table's name
      (``"cells.radius"``). One of the user's own that has several units in this process has none
      here.
    """
    if name in QUANTITY_UNITS:
        return QUANTITY_UNITS[name]
    table, _, column = name.partition(".")
    if table == "cells":
        from multicell.cells import Cells

        schema = Cells.schema()
        if column in schema:
            return str(schema[column]["unit"])
        if "." in column:  # a state of a network, in the network's own unit
            return ""
    unit = _unit_with_star(name)
    if unit is not None:
        return unit
    own = {o.unit for o in OWN_OBSERVABLES.values() if o.name == name} or own_units(name)
    if own:
        return own.pop() if len(own) == 1 else ""
    raise KeyError(
        f"no unit is declared for {name!r}: see multicell.results.quantities.QUANTITY_UNITS"
    )


def is_taken(name: str) -> bool:
    """Return whether a number or a part of a run or of a study has a name."""
    first = {declared.partition(".")[0] for declared in QUANTITY_UNITS}
    return (
        name in first
        or name in ("title", "notes", "versions", "units", "interrupted", "point", "reason")
        or _unit_with_star(name) is not None
    )


def known_unit(name: str) -> str:
    """Return the unit of a number, ``""`` also for a name of another version that this one lacks.

    For readers of finished runs: a run itself asks :func:`unit_of`.
    """
    try:
        return unit_of(name)
    except KeyError:
        return ""


def units_of(summary: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Return the units of all entries of a summary that have one, by their dotted names."""
    units: dict[str, str] = {}
    for name, value in summary.items():
        path = f"{prefix}{name}"
        if isinstance(value, Mapping):
            units |= units_of(value, f"{path}.")
        elif value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
            units[path] = unit_of(path)
    return {path: unit for path, unit in units.items() if unit}


_TITLES: Final = {
    **{o.name: o.title for o in OBSERVABLES},
    "discretisation_error": "estimated error at the cells",
    "largest_stability_ratio": "largest fixed step over its limit of stability",
    "stability_checks": "coupling steps in which that was measured",
    "checks_beyond_stability": "of these beyond the limit",
    "replays": "coupling steps taken again from shifted positions",
    "largest_shift_effect": "farthest that a shift of 0.01 µm moved the end of a cell",
    "startup": "start-up",
}


def title_of(name: str) -> str:
    """Return a number's name in words; a dotted one is also found by its last part."""
    return _TITLES.get(name) or _TITLES.get(name.rpartition(".")[2], name).replace("_", " ")


def entry(summary: Mapping[str, Any], name: str) -> Any:
    """Return an entry of a summary by its dotted name, None where there is none."""
    found: Any = summary
    for part in name.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found
