"""The rates of a field equation for py-pde's numba backend.

The function that py-pde compiles only hands arrays on to the kernels of our solvers, which numba
keeps on disk. Arrays are reached by their address: as constants they would be compiled in.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.extending import register_jitable
from pde.backends.numba.utils import make_array_constructor

from multicell.cells import FloatArray
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.equation_kernels import shell_imbalance
from multicell.nutrient.equation_term import Term, leak
from multicell.nutrient.schedule import level
from multicell.nutrient.stencil import imbalance

Fill = Callable[[FloatArray, float, FloatArray], None]


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

        @register_jitable
        def last(c: FloatArray, t: float, out: FloatArray) -> None:
            this(c[first], t, out[first])

        return last  # type: ignore[no-any-return]
    others = _all(rest, first + 1)

    @register_jitable
    def both(c: FloatArray, t: float, out: FloatArray) -> None:
        this(c[first], t, out[first])
        others(c, t, out)

    return both  # type: ignore[no-any-return]


def _fill(term: Term) -> Fill:
    """Return a function that fills the rate of one term."""
    source, op = _source(term), term.operator
    get_sink = make_array_constructor(term.sink)
    half, linear = float(term.substance.half_saturation), float(term.linear)
    if isinstance(op, Diffusion):
        weights, stiffness = _weights(op), float(op.stiffness)
        get_ghost = make_array_constructor(op.ghost)

        @register_jitable
        def box(c: FloatArray, t: float, out: FloatArray) -> None:
            imbalance(
                c, get_sink(), source(t), half, stiffness, linear, get_ghost(), weights(), out,
                np.empty_like(c),
            )  # fmt: skip

        return box  # type: ignore[no-any-return]
    outer = leak(op)
    get_conductance, get_volumes = (
        make_array_constructor(op.conductance), make_array_constructor(op.volumes)
    )  # fmt: skip

    @register_jitable
    def shells(c: FloatArray, t: float, out: FloatArray) -> None:
        shell_imbalance(
            c, get_sink(), source(t), half, linear, get_conductance(), outer, get_volumes(), out,
            np.empty_like(c),
        )  # fmt: skip

    return shells  # type: ignore[no-any-return]


def _source(term: Term) -> Callable[[float], FloatArray]:
    """Return what nodes gain as a function of time."""
    get_base = make_array_constructor(term.base)
    if term.per_level is None:

        @register_jitable
        def constant(t: float) -> FloatArray:
            return get_base()

        return constant  # type: ignore[no-any-return]
    get_per_level = make_array_constructor(term.per_level)
    schedule = term.schedule
    times, start, slope = schedule.times, schedule.start, schedule.slope

    @register_jitable
    def changing(t: float) -> FloatArray:
        return get_base() + level(times, start, slope, t) * get_per_level()

    return changing  # type: ignore[no-any-return]


def _weights(op: Diffusion) -> Callable[[], Any]:
    """Return the coefficients at the faces as a function, None where there is one everywhere."""
    if op.weights is None:

        @register_jitable
        def none() -> None:
            return None

        return none  # type: ignore[no-any-return]
    get_x, get_y, get_z = (make_array_constructor(w) for w in op.weights)

    @register_jitable
    def all_three() -> tuple[FloatArray, FloatArray, FloatArray]:
        return get_x(), get_y(), get_z()

    return all_three  # type: ignore[no-any-return]
