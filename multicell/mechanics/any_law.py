"""Forces of any law as loops call them: by the same types of arguments whatever the law.

Kernels are compiled for the type of a law's constants. A loop that took these would be compiled for
each law, too. It takes their values as an array of floats instead, and the address of one of the
small functions here, which makes the constants from the array again. Such a function has one
argument for their type, which is nothing at run time: the loop hands over None.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, typeof, types
from numba.extending import intrinsic

from multicell.cells import FloatArray
from multicell.compiling import ADDRESSED, called_at
from multicell.mechanics import forces
from multicell.mechanics.rows import RADIUS

_typeof: Any = typeof


def law_values(law: Any) -> FloatArray:
    """Return the constants of a law as an array; not a number for those that it lacks (None)."""
    return np.array(law, dtype=np.float64)


def law_type(law: Any) -> Any:
    """Return the type of a law's constants, for the functions of this module."""
    return _typeof(law)


@intrinsic
def _law_of(context: Any, kind: Any, values: Any) -> tuple[Any, Any]:
    """Return the constants of a law from their type and :func:`law_values`."""
    law = kind.instance_type
    if not set(law) <= {types.float64, types.none}:
        raise TypeError(f"the constants of a law must be floats, and are {law}")

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        first = context.make_array(values)(context, builder, given[1]).data
        places = [context.get_constant(types.intp, k) for k in range(len(law))]
        items = [
            context.get_dummy_value()
            if kind == types.none
            else builder.load(builder.gep(first, [place]))
            for kind, place in zip(law, places, strict=True)
        ]
        return context.make_tuple(builder, law, items)

    return law(kind, values), generate


@njit(**ADDRESSED)
def velocities(kind, kernel, cells, pairs, values, position, elapsed, rows, out):
    """Write velocities by :func:`.forces.forces`, for one thread or for all, at its address."""
    law = _law_of(kind, values)
    return _forces_at(kernel, cells, pairs, law, position, elapsed, True, rows, out)


@njit(**ADDRESSED)
def missed_among_all(kind, values, cells, pairs, rows, path, elapsed, dt, moved, tolerance):
    """Do what :func:`.forces.missed_contact` does, of all pairs; a cell moves ``moved`` radii."""
    largest, growth = 0.0, 0.0
    radius, rate = cells.radius, cells.radius_rate
    for i in range(radius.size):
        largest, growth = max(largest, rows[i, RADIUS]), max(growth, abs(rate[i]))
    way = 2.0 * (moved * largest + growth * dt)
    places, found = np.empty(pairs.first.size, np.int64), np.empty(pairs.first.size, np.int64)
    room = np.full(radius.size, 0.5 * way)
    near = places[: forces.pairs_about_to_touch(pairs, rows, elapsed, room, places)]
    forming = forces.forming_pairs(
        near, pairs, radius, rate, *path, elapsed, dt, way, tolerance, found
    )
    law, found = _law_of(kind, values), found[:forming]
    return forces.missed_contact(cells, pairs, law, rows, found, *path, elapsed, dt, tolerance)


_forces_at = called_at(8, lambda *_: types.boolean, frozen=3)
velocities_at = called_at(9, lambda *_: types.boolean)
missed_among_all_at = called_at(10, lambda *_: types.float64)
