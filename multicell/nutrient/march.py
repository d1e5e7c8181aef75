"""A field that changes with time: implicit steps under error control.

A step is backward Euler, whose equations are those of the steady state with 1/dt added to the
rates and c/dt to the supply: M-matrices again, so that no concentration is negative, and the steady
state is exactly where the march comes to rest. Each step is done once in full and once in halves;
their distance is the estimate of the error, and 2 (halves) - (full) is of second order. That is
taken where it is nowhere negative, else the halves are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed

_MOST_STEPS: Final = 20_000
_SHORTEST: Final = 1e-9  # of the interval
_REFUSED: Final = 0.25  # of a step that was not solved, the next one tried


class StepRefused(Exception):  # noqa: N818 - a shorter step may do
    """A step whose equations were not solved."""


@final
@dataclass
class March:
    """The counts and amounts of a march under way."""

    amounts: FloatArray
    steps: int = 0
    rejections: int = 0
    first_order: int = 0
    error: float = 0.0


def march(
    step: Callable[[FloatArray, float, float], tuple[FloatArray, FloatArray]],
    error_of: Callable[[FloatArray, FloatArray], float],
    c: FloatArray,
    begin: float,
    end: float,
    *,
    tolerance: float,
    done: March,
    opening: float,
) -> FloatArray:
    """Bring a state from ``begin`` to ``end`` (s) by steps of backward Euler and their halves.

    - ``step``: (state, length in s, time at its end) -> the state there and what happened, in the
      shape of ``done.amounts``. It may raise :class:`StepRefused`: a shorter step is tried then.
    - ``error_of``: (by halves, in full) -> their distance over what it may be compared with
    - ``c``: the state at the beginning; not changed
    - ``tolerance``: largest error of a step, as ``error_of`` says it
    - ``done``: counts and amounts, which are added to
    - ``opening``, float, s: first step
    """
    length = end - begin
    elapsed, dt = 0.0, opening
    while elapsed < length:
        dt = min(dt, length - elapsed)
        if length - elapsed - dt < 1e-9 * length:
            dt = length - elapsed
        if done.steps > _MOST_STEPS or dt < _SHORTEST * length:
            raise NutrientFailed(
                f"a transient field needs steps of {dt:.3g} s, too many to go on",
                "Raise time_tolerance, or let the field be steady",
            )
        t = begin + elapsed
        try:
            full, once = step(c, dt, t + dt)
            middle, first = step(c, 0.5 * dt, t + 0.5 * dt)
            halves, second = step(middle, 0.5 * dt, t + dt)
        except StepRefused:
            done.rejections += 1
            dt *= _REFUSED
            continue
        error = error_of(halves, full)
        factor = min(4.0, 0.9 * (tolerance / max(error, 1e-300)) ** 0.5)
        if error > tolerance:
            done.rejections += 1
            dt *= max(0.1, factor)
            continue
        amounts = first + second
        better = 2.0 * halves - full
        if better.min(initial=0.0) >= 0.0:
            c, amounts = better, amounts + amounts - once
        else:
            c = halves
            done.first_order += 1
        done.amounts = done.amounts + amounts
        done.steps += 1
        done.error = max(done.error, error)
        elapsed = length if dt == length - elapsed else elapsed + dt
        dt *= max(0.3, factor)
    return c
