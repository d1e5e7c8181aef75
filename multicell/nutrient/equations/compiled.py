"""The rates of a field equation for py-pde's numba backend.

The function that py-pde compiles only hands arrays on to the kernels of our solvers, which numba
keeps on disk. Arrays are reached by their address: as constants they would be compiled in.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba.extending import register_jitable
from pde.backends.numba.utils import make_array_constructor

from multicell.cells import FloatArray
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.equations.schedule import level
from multicell.nutrient.equations.term import Term
from multicell.nutrient.operators import leak
from multicell.nutrient.shell_kernels import shell_imbalance
from multicell.nutrient.stencil import imbalance_of_planes

Fill = Callable[[FloatArray, float, FloatArray], None]
"""(c, t, where the rate is written)."""

_F = TypeVar("_F", bound=Callable[..., Any])
_jitable = cast(Callable[[_F], _F], register_jitable)
_at = cast(Callable[[FloatArray], Callable[[], FloatArray]], make_array_constructor)


def compiled_rate(
    terms: list[Term], shape: tuple[int, ...]
) -> Callable[[FloatArray, float], FloatArray]:
    """Return the rates as a function of a state's data and time.

    The terms own the arrays that it reads: keep them as long as it is used.
    """
    count, nodes = len(terms), terms[0].shape
    fill = _all([_fill(term) for term in terms])

    def rate(state_data: FloatArray, t: float) -> FloatArray:
        c = np.ascontiguousarray(state_data).reshape((count, *nodes))
        out = np.empty((count, *nodes))
        fill(c, t, out)
        return out.reshape(shape)

    return rate


def _all(fills: list[Fill], first: int = 0) -> Fill:
    """Return a function that fills the rates of all terms, one after another."""
    this, rest = fills[0], fills[1:]
    if not rest:

        @_jitable
        def last(c: FloatArray, t: float, out: FloatArray) -> None:
            this(c[first], t, out[first])

        return last
    others = _all(rest, first + 1)

    @_jitable
    def both(c: FloatArray, t: float, out: FloatArray) -> None:
        this(c[first], t, out[first])
        others(c, t, out)

    return both


def _fill(term: Term) -> Fill:
    """Return a function that fills the rate of one term."""
    source, op = _source(term), term.operator
    get_sink = _at(term.sink)
    half, linear = float(term.substance.half_saturation), float(term.linear)
    if isinstance(op, Diffusion):
        weights, stiffness = _weights(op), float(op.stiffness)
        get_ghost = _at(op.ghost)

        @_jitable
        def box(c: FloatArray, t: float, out: FloatArray) -> None:
            imbalance_of_planes(
                0, len(c), c, get_sink(), source(t), half, stiffness, linear, get_ghost(),
                weights(), out, np.empty_like(c), np.empty((3, 1)), len(c),
            )  # fmt: skip

        return box
    outer = leak(op)
    get_conductance, get_volumes = (
        _at(op.conductance), _at(op.volumes)
    )  # fmt: skip

    @_jitable
    def shells(c: FloatArray, t: float, out: FloatArray) -> None:
        shell_imbalance(
            c, get_sink(), source(t), half, linear, get_conductance(), outer, get_volumes(), out,
            np.empty_like(c),
        )  # fmt: skip

    return shells


def _source(term: Term) -> Callable[[float], FloatArray]:
    """Return what nodes gain as a function of time."""
    get_base = _at(term.base)
    if term.per_level is None:

        @_jitable
        def constant(t: float) -> FloatArray:
            return get_base()

        return constant
    get_per_level = _at(term.per_level)
    schedule = term.schedule
    times, start, slope = schedule.times, schedule.start, schedule.slope

    @_jitable
    def changing(t: float) -> FloatArray:
        return get_base() + level(times, start, slope, t) * get_per_level()

    return changing


def _weights(op: Diffusion) -> Callable[[], Any]:
    """Return the coefficients at the faces as a function, None where there is one everywhere."""
    if op.weights is None:

        @_jitable
        def none() -> None:
            return None

        return none
    get_x, get_y, get_z = (_at(w) for w in op.weights)

    @_jitable
    def all_three() -> tuple[FloatArray, FloatArray, FloatArray]:
        return get_x(), get_y(), get_z()

    return all_three
