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
from typing import Generic, Protocol, Self, TypeVar, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient.steady import SolveReport

Solve = Callable[[FloatArray, float, float], tuple[FloatArray, SolveReport, float]]
"""(c at the beginning, step in s, time at its end) -> c at the end, the report of the solve, and
the concentration of the medium then, mM."""

COLUMNS = ("inflow", "uptake", "supplied", "mass", "level", "made", "used")
"""What happened to a field in some time: amol, but ``mass`` in amol s and ``level`` in mM s."""

_MOST_STEPS = 20_000
_SHORTEST = 1e-9  # of the interval
_REFUSED = 0.25  # of a step that was not solved, the next one tried


@final
@dataclass(frozen=True)
class Amounts:
    """What happened in some time, amol; ``mass`` is ∫∫ c dV dt, ``level`` ∫ medium dt."""

    inflow: float = 0.0
    uptake: float = 0.0
    supplied: float = 0.0
    mass: float = 0.0
    level: float = 0.0

    def plus(self, other: Amounts, share: float = 1.0) -> Amounts:
        """Return these and a share of others."""
        return Amounts(*(a + share * b for a, b in zip(_values(self), _values(other), strict=True)))


def _values(amounts: Amounts) -> tuple[float, ...]:
    return (amounts.inflow, amounts.uptake, amounts.supplied, amounts.mass, amounts.level)


@final
@dataclass(frozen=True)
class TransientReport:
    """What a march took, and where all molecules went, amol.

    ``inflow`` includes what a perfusion brought; ``relaid`` is what the grid gained when it was
    laid anew before. The field holds ``inflow + produced + relaid - uptake - decayed`` more than
    before.

    Attributes
    ----------
    steps, rejections, first_order : int
        Steps taken and refused, and steps whose second-order value was negative somewhere.
    error : float
        Largest estimate of a step's error over the concentration scale.
    washed : float
        What a perfusion took with it.
    """

    inflow: float
    uptake: float
    produced: float
    decayed: float
    relaid: float
    steps: int
    rejections: int
    first_order: int
    error: float
    washed: float = 0.0
    made: float = 0.0
    used: float = 0.0


class Additive(Protocol):
    """Amounts of a step, of which sums are taken."""

    def plus(self, other: Self, share: float = 1.0) -> Self:
        """Return these and a share of others."""


A = TypeVar("A", bound=Additive)


class StepRefused(Exception):  # noqa: N818 - a shorter step may do
    """A step whose equations were not solved."""


@final
@dataclass
class March(Generic[A]):
    """The counts and amounts of a march under way."""

    amounts: A
    steps: int = 0
    rejections: int = 0
    first_order: int = 0
    error: float = 0.0


def march(
    solve: Solve,
    volumes: FloatArray | float,
    c: FloatArray,
    begin: float,
    end: float,
    *,
    tolerance: float,
    scale: float,
    done: March[Amounts],
    opening: float = 0.1,
) -> FloatArray:
    """Bring a field from ``begin`` to ``end`` (s).

    Parameters
    ----------
    solve
        One implicit step.
    volumes
        Of the nodes, µm³.
    c : mM
        At the beginning; not changed.
    tolerance
        Largest error of a step over ``scale`` or the largest concentration, whichever is more.
    scale : mM
    done
        Counts and amounts, which are added to.
    opening
        First step over the whole time.

    Raises
    ------
    NutrientFailed
        If steps become too many or too short, or one cannot be solved.
    """

    def step(c: FloatArray, dt: float, time: float) -> tuple[FloatArray, Amounts]:
        return _step(solve, volumes, c, dt, time)

    def error(halves: FloatArray, full: FloatArray) -> float:
        largest = max(scale, float(np.abs(halves).max(initial=0.0)))
        return float(np.abs(halves - full).max(initial=0.0)) / largest if largest > 0.0 else 0.0

    return controlled(
        step, error, c, begin, end, tolerance=tolerance, done=done, opening=opening * (end - begin)
    )


def controlled(
    step: Callable[[FloatArray, float, float], tuple[FloatArray, A]],
    error_of: Callable[[FloatArray, FloatArray], float],
    c: FloatArray,
    begin: float,
    end: float,
    *,
    tolerance: float,
    done: March[A],
    opening: float,
) -> FloatArray:
    """Bring a state from ``begin`` to ``end`` (s) by steps of backward Euler and their halves.

    Parameters
    ----------
    step
        (state, length in s, time at its end) -> the state there and what happened. It may raise
        :class:`StepRefused`: a shorter step is tried then.
    error_of
        (by halves, in full) -> their distance over what it may be compared with.
    c, tolerance, done
        As for :func:`march`.
    opening : float, s
        First step.

    Raises
    ------
    NutrientFailed
        If steps become too many or too short.
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
        pair = first.plus(second)
        better = 2.0 * halves - full
        if better.min(initial=0.0) >= 0.0:
            c, amounts = better, pair.plus(pair).plus(once, -1.0)
        else:
            c, amounts = halves, pair
            done.first_order += 1
        done.amounts = done.amounts.plus(amounts)
        done.steps += 1
        done.error = max(done.error, error)
        elapsed = length if dt == length - elapsed else elapsed + dt
        dt *= max(0.3, factor)
    return c


def _step(
    solve: Solve, volumes: FloatArray | float, c: FloatArray, dt: float, time: float
) -> tuple[FloatArray, Amounts]:
    """Take one step of backward Euler; return the end and what happened."""
    after, report, level = solve(c, dt, time)
    mass = float(np.sum(volumes * after))
    return after, Amounts(
        dt * report.inflow, dt * report.uptake, dt * report.supplied, dt * mass, dt * level
    )
