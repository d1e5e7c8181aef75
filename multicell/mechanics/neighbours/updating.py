"""The one place where a list of neighbours is brought up to date: repaired, or built anew.

:func:`update_list` is an ordinary function. :class:`.neighbour_list.NeighbourList` calls it in
Python with kernels, loops of explicit methods (:mod:`multicell.integrators.stepping`) compiled with
their addresses.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload, register_jitable

from multicell.cells import FloatArray
from multicell.compiling import called_at
from multicell.mechanics.neighbours import building, repairing
from multicell.mechanics.neighbours.margins import widened

REPAIRED, BUILT, TOO_CROWDED = range(3)
"""What became of a list; after :data:`TOO_CROWDED` there is none: too many pairs are close."""
REPAIR_FROM = 1000  # cells from which on lists are repaired, which takes seconds to compile


@register_jitable
def update_list(
    rebuild,
    repair,
    position,
    reference,
    reach,
    margin,
    least,
    chunk,
    pairs,
    room_first,
    room_second,
):
    """Repair a list where few cells have drifted, else build it anew.

    - ``rebuild``, ``repair``: the kernels, for one thread or for all, or their addresses; 0 where
      lists are not repaired
    - ``position``, (n, 3), µm: now, finite
    - ``reference``, (n, 3), µm, and ``margin``, (n,), µm: where the cells were at the last list,
      not a number without one, and how far they may drift from there; changed in place
    - ``reach``, (n,), µm, ``least``, µm: half of the distance within which a pair matters, and the
      least margin
    - ``pairs``: first, second, start, inner_end and outer_end as in :class:`.pair_list.PairList`; a
      repair changes the first two in place
    - ``room_first``, ``room_second``: arrays that a new list may overwrite

    Returns what became of the list, and the list in the same form.
    """
    first, second, start, inner_end, outer_end = pairs
    if repair != 0:
        repaired, inner, outer = _repair_by(
            repair,
            position,
            reference,
            reach,
            margin,
            least,
            chunk,
            first,
            second,
            start,
            inner_end,
            outer_end,
        )
        if repaired:
            return REPAIRED, (first, second, start, inner, outer)
    wide = widened(position, reference, reach, least, margin)
    crowded, first, second, start, inner_end, outer_end = _rebuild_by(
        rebuild, position, wide, 0.0, chunk, room_first, room_second
    )
    if crowded:
        # the old list is overwritten, and does not fit the new margins: the next state builds
        reference[:] = np.nan
        return TOO_CROWDED, pairs
    return BUILT, (first, second, start, inner_end, outer_end)


def kernel_calls(
    position: FloatArray, reach: FloatArray, chunk: int, pairs: tuple[Any, ...], *, shared: bool
) -> dict[str, tuple[Any, ...]]:
    """Return the kernels that update lists as :func:`multicell.compiling.address_of` takes them.

    - ``shared``: for all threads, not for one
    """
    rebuild, repair = kernels(len(reach), shared=shared)
    first, second = pairs[:2]
    found: dict[str, tuple[Any, ...]] = {
        "rebuild_at": (rebuild, (True, *pairs), position, reach, 0.0, chunk, first, second)
    }
    if repair != 0:
        found["repair_at"] = (
            repair,
            (True, *pairs[3:]),
            position,
            position,
            reach,
            reach,
            0.0,
            chunk,
            *pairs,
        )
    return found


def kernels(n: int, *, shared: bool) -> tuple[Any, Any]:
    """Return the kernels that build lists of ``n`` cells and repair them; 0 where they are not.

    - ``shared``: for all threads, not for one
    """
    rebuild = building.rebuild_parallel if shared else building.rebuild
    repair = repairing.repair_parallel if shared else repairing.repair
    return rebuild, repair if n >= REPAIR_FROM else 0


def _rebuild_by(kernel, position, wide, skin, chunk, first, second):
    """Call :func:`.building.rebuild`; compiled, at its address."""
    return kernel(position, wide, skin, chunk, first, second)


def _repair_by(
    kernel, position, reference, reach, margin, least, chunk, first, second, start, inner, outer
):
    """Call :func:`.repairing.repair`; compiled, at its address."""
    return kernel(
        position, reference, reach, margin, least, chunk, first, second, start, inner, outer
    )


@overload(_rebuild_by)
def _rebuild_there(kernel, position, wide, skin, chunk, first, second):
    def run(kernel, position, wide, skin, chunk, first, second):
        return _rebuild_at(kernel, position, wide, skin, chunk, first, second)

    return run


@overload(_repair_by)
def _repair_there(
    kernel, position, reference, reach, margin, least, chunk, first, second, start, inner, outer
):
    def run(
        kernel, position, reference, reach, margin, least, chunk, first, second, start, inner, outer
    ):
        return _repair_at(
            kernel,
            position,
            reference,
            reach,
            margin,
            least,
            chunk,
            first,
            second,
            start,
            inner,
            outer,
        )

    return run


_PLACES, _ENDS = types.int32[::1], types.int64[::1]
_rebuild_at = called_at(
    6, lambda *_: types.Tuple((types.boolean, _PLACES, _PLACES, _ENDS, _ENDS, _ENDS))
)
_repair_at = called_at(11, lambda *_: types.Tuple((types.boolean, _ENDS, _ENDS)))
