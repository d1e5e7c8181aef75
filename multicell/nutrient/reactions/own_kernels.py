"""Calls of kernels to the functions of reactions of the user's own.

By the type of a NamedTuple whose name holds a fingerprint of the function and of all that it
reads: where :func:`all_nodes` calls :func:`_at_node`, numba compiles what belongs to the type.
Compiled code is kept on disk under it, and cannot be stale.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numba.extending import overload, register_jitable
from numba.np.unsafe.ndarray import to_fixed_tuple

from multicell.compiling import KERNEL
from multicell.plugins.fingerprints import fingerprint, helpers_of
from multicell.plugins.stand_ins import stand_in_types

Rate = Callable[[tuple[float, ...], Any], Sequence[float]]

_STEP = 1e-5  # of a difference quotient, relative: truncation and rounding about even
_TINY = 1e-12  # mM, below which a difference quotient takes no shorter steps


class Cell(NamedTuple):
    """A place where a reaction proceeds: a cell of the grid."""

    tissue: float
    """Part of it that is tissue, 0 to 1."""


_type, __getattr__ = stand_in_types(__name__, "Reaction_", lambda name: ["unit"])
_FUNCTIONS: dict[Any, tuple[Rate, int]] = {}


def type_of(rate: Rate, fields: Sequence[str]) -> Any:
    """Return the type that stands for a reaction."""
    made = _type(f"Reaction_{len(fields)}_{fingerprint(rate, modules=True)}")
    _FUNCTIONS[made] = rate, len(fields)
    return made


def _at_node(p, c, tissue, out, slope):
    """Write rates and derivative at one node, where no concentration is below zero."""
    raise NotImplementedError


@overload(_at_node, jit_options={"error_model": "numpy"})
def _compiled_at_node(p, c, tissue, out, slope):
    if not isinstance(p, types.BaseNamedTuple) or p.instance_class not in _FUNCTIONS:
        return None
    rate, m = _FUNCTIONS[p.instance_class]
    for part in (*helpers_of(rate), rate):
        register_jitable(error_model="numpy")(part)
    return _by_differences(rate, m)


def _by_differences(rate: Any, m: int) -> Any:
    def at_node(p, c, tissue, out, slope):
        cell = Cell(tissue)
        found = rate(to_fixed_tuple(c, m), cell)
        for i in range(m):
            out[i] = found[i]
        for j in range(m):
            value = c[j]
            h = _STEP * value
            if h > _TINY:
                c[j] = value + h
                above = rate(to_fixed_tuple(c, m), cell)
                c[j] = value - h
                below = rate(to_fixed_tuple(c, m), cell)
                for i in range(m):
                    slope[i, j] = (above[i] - below[i]) / (2.0 * h)
            else:  # none may be below zero: one-sided, of second order too
                c[j] = value + _TINY
                above = rate(to_fixed_tuple(c, m), cell)
                c[j] = value + 2.0 * _TINY
                farther = rate(to_fixed_tuple(c, m), cell)
                for i in range(m):
                    rise = 4.0 * above[i] - 3.0 * found[i] - farther[i]
                    slope[i, j] = rise / (2.0 * _TINY)
            c[j] = value

    return at_node


@njit(**KERNEL)
def all_nodes(p, c, tissue, out, slope):
    """Write rates and derivative at all nodes; below zero rates go on along their tangent."""
    m, nodes = c.shape
    here, rates, steep = np.empty(m), np.empty(m), np.empty((m, m))
    for x in range(nodes):
        for i in range(m):
            here[i] = max(c[i, x], 0.0)
        _at_node(p, here, tissue[x], rates, steep)
        for i in range(m):
            out[i, x] = rates[i]
            for j in range(m):
                slope[i, j, x] = steep[i, j]
                if c[j, x] < 0.0:
                    out[i, x] += steep[i, j] * c[j, x]
