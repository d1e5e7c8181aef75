"""Explicit methods: with a fixed step, under error control, and stabilised.

The loops run compiled (:mod:`multicell.integrators.stepping`), each compiled when it is first
used. All methods refuse a step that moves a cell further than ``max_displacement`` of its
radius, or to where there is no velocity: under error control the step is tried shorter, with a
fixed step the integration ends.

Error control. The estimate of a step is measured as CVODE does, in the root mean square of
e_k / (atol + rtol |x_k|), and PI control (Gustafsson 1991) chooses the next step. The first
step of a coupling step is derived from its state (Hairer, Nørsett & Wanner), so that nothing
is carried over. Where the result is of lower order p than the estimate, the error of a
step may not exceed θ^(1/p), θ = rtol + atol / mean radius, in that norm, in place of one:
the number of steps grows like θ^(-1/p), so that the error of the interval follows the
tolerance (tolerance calibration, Söderlind & Wang 2006).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.integrators import stepping
from multicell.integrators.base import Outcome
from multicell.integrators.limits import beyond
from multicell.mechanics import forces
from multicell.mechanics.neighbours import PairList
from multicell.mechanics.system import Mechanics

_MOST_STAGES = 200
"""Under error control: a step that needs more is taken shorter."""
_MOST_FIXED_STAGES = 5000
_STEP_HINT = "Choose a shorter integrator.step, or the method 'cvode'"
_TOLERANCE_HINT = "Choose a shorter coupling_step, or the method 'cvode'"


@final
@dataclass(frozen=True)
class Euler:
    """x ← x + Δt v(t, x), order 1, stable for Δt < 2/λ_max.

    Parameters
    ----------
    step
        Largest step, s; a coupling step is cut into equal steps no longer than this.
    max_displacement
        Fraction of its radius that a cell may move in one step. The step is fixed, so a
        cell that would move further ends the integration.
    """

    step: float
    max_displacement: float = 0.5

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        return _runge_kutta(system, position, EULER, self.step, self.max_displacement)


@final
@dataclass(frozen=True)
class Heun:
    """Heun's method, order 2, stable for Δt < 2/λ_max; parameters as for :class:`Euler`."""

    step: float
    max_displacement: float = 0.5

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        return _runge_kutta(system, position, HEUN, self.step, self.max_displacement)


@final
@dataclass(frozen=True)
class RungeKutta4:
    """The classical method, order 4, stable for Δt < 2.785/λ_max; as :class:`Euler`."""

    step: float
    max_displacement: float = 0.5

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        return _runge_kutta(system, position, RUNGE_KUTTA_4, self.step, self.max_displacement)


@final
@dataclass(frozen=True)
class AdamsBashforth2:
    """Two steps back, order 2, one evaluation a step, stable for Δt < 1/λ_max; as :class:`Euler`.

    The first step of each coupling step is Heun's.
    """

    step: float
    max_displacement: float = 0.5

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        steps = _equal_steps(system, self.step)

        def run(source: Any, pairs: Any, state: FloatArray, length: float, counts: Any) -> Any:
            return _loop(stepping.adams_bashforth, source)(
                source, pairs, state, length, steps, self.max_displacement,
                system.motion.radius, counts,
            )  # fmt: skip

        return _integrate(system, position, run, self.max_displacement, _STEP_HINT)


@final
@dataclass(frozen=True)
class AdaptiveEuler:
    """Euler under error control, its distance from Heun's result being the estimate.

    Parameters
    ----------
    rtol, atol
        Relative tolerance, and absolute tolerance in µm.
    max_steps
        Largest number of steps in a coupling step.
    max_displacement
        Fraction of its radius that a cell may move in one step; otherwise it is refused
        and tried shorter.

    Raises
    ------
    ValueError
        For a negative ``rtol``, or an ``atol`` that is not positive.
    """

    rtol: float = 1e-6
    atol: float = 1e-2
    max_steps: int = 10_000
    max_displacement: float = 0.5

    def __post_init__(self) -> None:
        _check_tolerances(self.rtol, self.atol)

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        strictness = _share(self.rtol, self.atol, system)
        control = stepping.Control(
            self.rtol, self.atol, strictness, 2.0, self.max_steps, self.max_displacement
        )
        return _adaptive(system, position, EULER_HEUN, control)


@final
@dataclass(frozen=True)
class Dopri5:
    """Dormand & Prince's pair of orders 5 and 4, the higher one propagated; stable to 3.3/λ_max.

    Parameters as for :class:`AdaptiveEuler`.
    """

    rtol: float = 1e-6
    atol: float = 1e-2
    max_steps: int = 10_000
    max_displacement: float = 0.5

    def __post_init__(self) -> None:
        _check_tolerances(self.rtol, self.atol)

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        control = stepping.Control(
            self.rtol, self.atol, 1.0, 5.0, self.max_steps, self.max_displacement
        )
        return _adaptive(system, position, DORMAND_PRINCE, control)


@final
@dataclass(frozen=True)
class AdaptiveAdams:
    """Adams-Bashforth of order 2 under error control, one evaluation a step; to 1/λ_max.

    Parameters
    ----------
    rtol, atol, max_steps, max_displacement
        As for :class:`AdaptiveEuler`.
    patience
        Largest number of evaluations that a coupling step may be expected to take; beyond, the
        integration ends early, with ``problem`` set. Zero for any number.
    """

    rtol: float = 1e-6
    atol: float = 1e-2
    max_steps: int = 10_000
    max_displacement: float = 0.5
    patience: int = 0

    def __post_init__(self) -> None:
        _check_tolerances(self.rtol, self.atol)

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        return self.attempt(system, position)[0]

    def attempt(self, system: Mechanics, position: FloatArray) -> tuple[Outcome, float]:
        """Integrate; return also how many evaluations were expected where it gave up, or 0."""
        from multicell.integrators import adams_bashforth

        strictness = math.sqrt(_share(self.rtol, self.atol, system))
        control = stepping.Control(
            self.rtol, self.atol, strictness, 3.0, self.max_steps, self.max_displacement
        )
        motion = system.motion

        def run(source: Any, pairs: Any, state: FloatArray, length: float, counts: Any) -> Any:
            return _loop(adams_bashforth.adaptive_adams, source)(
                source, pairs, control, self.patience, state, length, motion.radius, counts
            )

        ended: list[stepping.Report] = []
        outcome = _integrate(
            system, position, run, self.max_displacement, _TOLERANCE_HINT, ended, self.atol
        )
        long = bool(ended) and ended[0].status == stepping.TOO_LONG
        return outcome, float(ended[0].moved) if long else 0.0


@final
@dataclass(frozen=True)
class Rkc2:
    """Stabilised Runge-Kutta of order 2 with s stages, stable for Δt < 0.65 s²/λ_max.

    Under error control unless ``step`` is given. See :mod:`multicell.integrators.rkc`.

    Parameters
    ----------
    rtol, atol, max_steps, max_displacement
        As for :class:`AdaptiveEuler`.
    step
        Fixed step, s, for studies of order and stability; zero for error control.
    stages
        Fixed number of stages, 2 or more, only with ``step``; zero for as many as the
        stiffness asks for.

    Raises
    ------
    ValueError
        For a number of stages that there is no method of, or one without ``step``; for
        tolerances that are not positive.
    """

    rtol: float = 1e-6
    atol: float = 1e-2
    max_steps: int = 10_000
    max_displacement: float = 0.5
    step: float = 0.0
    stages: int = 0

    def __post_init__(self) -> None:
        _check_tolerances(self.rtol, self.atol)
        if self.stages and (self.stages < 2 or self.step <= 0.0):
            raise ValueError(f"stages is {self.stages}, must be 2 or more and go with a step")

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        from multicell.integrators import rkc

        radius = system.motion.radius

        def fixed(source: Any, pairs: Any, state: FloatArray, length: float, counts: Any) -> Any:
            return _loop(rkc.fixed_chebyshev, source)(
                source, pairs, state, length, _equal_steps(system, self.step), self.stages,
                _MOST_FIXED_STAGES, self.max_displacement, radius, counts,
            )  # fmt: skip

        def adaptive(source: Any, pairs: Any, state: FloatArray, length: float, counts: Any) -> Any:
            share = _share(self.rtol, self.atol, system)
            control = stepping.Control(
                self.rtol, self.atol, math.sqrt(share), 3.0, self.max_steps, self.max_displacement
            )
            # s² times the rounding of a stage must stay below the tolerance
            finest = math.sqrt(share / (10.0 * np.finfo(float).eps))
            most = int(min(_MOST_STAGES, max(2.0, finest)))
            return _loop(rkc.adaptive_chebyshev, source)(
                source, pairs, control, most, state, length, radius, counts
            )

        if self.step > 0.0:
            return _integrate(system, position, fixed, self.max_displacement, _STEP_HINT)
        return _integrate(
            system, position, adaptive, self.max_displacement, _TOLERANCE_HINT, atol=self.atol
        )


def _check_tolerances(rtol: float, atol: float) -> None:
    if not (rtol >= 0.0 and atol > 0.0):
        raise ValueError(f"rtol is {rtol} and atol {atol}, must be 0 or above, and above 0")


def needs_python(system: Mechanics) -> bool:
    """Return whether each evaluation must go through Python.

    Exact JKR and surface energies between types keep values for each pair, which are made
    in Python with each neighbour list, friction solves a linear system, and walls are a part
    that scenes without them do not load. The loops are the same then, uncompiled around
    compiled arithmetic.
    """
    rubbed = max(system.friction) > 0.0 or system.walls is not None
    return system.has_pair_values or rubbed


def _runge_kutta(
    system: Mechanics,
    position: FloatArray,
    tableau: Tableau,
    step: float,
    max_displacement: float,
) -> Outcome:
    steps = _equal_steps(system, step)

    def run(source: Any, pairs: Any, state: FloatArray, length: float, counts: Any) -> Any:
        return _loop(stepping.fixed_runge_kutta, source)(
            source, pairs, tableau, state, length, steps, max_displacement,
            system.motion.radius, counts,
        )  # fmt: skip

    return _integrate(system, position, run, max_displacement, _STEP_HINT)


def _adaptive(
    system: Mechanics, position: FloatArray, tableau: Tableau, control: stepping.Control
) -> Outcome:
    def run(source: Any, pairs: Any, state: FloatArray, length: float, counts: Any) -> Any:
        return _loop(stepping.adaptive_runge_kutta, source)(
            source, pairs, tableau, control, state, length, system.motion.radius, counts
        )

    return _integrate(
        system, position, run, control.max_displacement, _TOLERANCE_HINT, atol=control.atol
    )


def _loop(dispatcher: Any, source: Any) -> Any:
    """Return the compiled loop, or its Python for a source in Python."""
    return dispatcher.py_func if isinstance(source, stepping.Called) else dispatcher


def _share(rtol: float, atol: float, system: Mechanics) -> float:
    """Return θ of the module's text, at most 1."""
    radius = system.motion.radius
    # a sum costs a third of a mean, which tells with two cells
    return min(1.0, rtol + atol * len(radius) / float(radius.sum())) if len(radius) else 1.0


def _equal_steps(system: Mechanics, step: float) -> int:
    """Return how many equal steps no longer than ``step`` cover the coupling step."""
    length = system.motion.end - system.motion.begin
    return max(1, math.ceil(length / step * (1.0 - 1e-12)))


def _integrate(
    system: Mechanics,
    position: FloatArray,
    run: Any,
    max_displacement: float,
    hint: str,
    ended: list[stepping.Report] | None = None,
    atol: float = 0.0,
) -> Outcome:
    """Run a loop on a copy of the positions; count its work; put its end into words.

    Its report is appended to ``ended``.
    """
    motion = system.motion
    length = motion.end - motion.begin
    state = np.array(position, dtype=float, order="C")
    if len(system) == 0 or length <= 0.0:
        return Outcome(motion.end, state)
    refused = beyond(system, state, atol)
    if refused is not None:
        return refused
    counts = np.zeros(4, dtype=np.int64)
    if needs_python(system):
        source: Any = stepping.Called(system)
        report, _ = run(source, None, state, length, counts)
    else:
        source, pairs = _borrow(system, counts)
        report, pairs = run(source, pairs, state, length, counts)
        _give_back(system, source, pairs)
    work = system.work
    work.evaluations += int(counts[stepping.EVALUATIONS])
    work.list_builds += int(counts[stepping.LIST_BUILDS])
    work.steps += int(counts[stepping.STEPS])
    work.rejections += int(counts[stepping.REJECTIONS])
    if ended is not None:
        ended.append(report)
    if report.status == stepping.DONE:
        return Outcome(motion.end, state, local_error=float(report.error))
    return _failure(motion.begin, state, report, source, max_displacement, hint)


def _failure(
    begin: float,
    state: FloatArray,
    report: stepping.Report,
    source: Any,
    max_displacement: float,
    hint: str,
) -> Outcome:
    step = f"step of {report.step:.3g} s"
    cell = int(report.cell) if report.cell >= 0 else None
    if report.status == stepping.MOVED:
        problem = (
            f"a {step} would move the cell by {report.moved:.3g} of its radius "
            f"(allowed: {max_displacement:g})"
        )
    elif report.status == stepping.OUT_OF_STEPS:
        problem = f"the largest number of internal steps did not reach the end (last {step})"
        hint = "Raise integrator.max_steps, loosen integrator.atol or shorten coupling_step"
    elif report.status == stepping.TOO_LONG:
        problem = f"the whole interval would take about {report.moved:.0f} evaluations"
        hint = "Take a method for stiff problems, such as 'cvode' or 'rkc2'"
    elif report.status == stepping.STALLED:
        problem = f"steps became too short to go on (last {step})"
    elif report.status == stepping.REJECTED:
        words = getattr(source, "problem", "") or "cells lie on top of each other"
        problem = f"in a {step} {words}"
    else:
        cell = _worst(state) if cell is None else cell
        problem = f"in a {step} a position is not a number"
    return Outcome(begin + report.elapsed, state, problem, hint, cell)


def _worst(state: FloatArray) -> int | None:
    """Return the first cell that is nowhere, if there is one."""
    lost = ~np.isfinite(state).all(axis=1)
    return int(lost.argmax()) if lost.any() else None


def _borrow(system: Mechanics, counts: Any) -> tuple[Any, forces.PairData]:
    """Return what the kernels need, with a list of its own or one that is built at first use."""
    motion = system.motion
    chunks = -(-len(system) // system.chunk)
    if system._pairs is None:
        index, ends = np.empty(0, dtype=np.int32), np.zeros(chunks, dtype=np.int64)
        pairs = forces.PairData(index, index, ends, ends, ends, None, None, None)
        # no cell is close to a place that is not a number: the first evaluation builds
        reference = np.full((len(system), 3), np.nan)
    else:
        pairs, reference = system._pair_data, np.array(system._cells.reference)
    cells = forces.CellData(
        system.chunk,
        (0.5 * system._skin) ** 2,
        reference,
        motion.radius,
        motion.radius_rate,
        motion.bonds,
        motion.push,
    )
    shared = system.threads > 1 and chunks >= system.shared_chunks
    kind = stepping.Shared if shared else stepping.Serial
    source = kind(
        cells, system._offsets.data, system._law, system._list_radius, system._skin, system._rows,
        counts,
    )  # fmt: skip
    return source, pairs


def _give_back(system: Mechanics, source: Any, pairs: forces.PairData) -> None:
    """Let the mechanics go on with the list that the loop has built last."""
    if pairs.first.size == 0 and system._pairs is None:
        return
    system._cells = source.cells
    system._pair_data = pairs
    system._pairs = PairList(
        pairs.first, pairs.second, pairs.start, pairs.inner_end, pairs.outer_end,
        system.chunk, len(system),
    )  # fmt: skip


class Tableau(NamedTuple):
    """An explicit Runge-Kutta method.

    Attributes
    ----------
    a : (s, s)
        Stage i is at x + h Σ_j a_ij k_j, below the diagonal.
    b : (s,)
        Weights of the result.
    c : (s,)
        Times of the stages, in steps.
    error : (s,)
        Weights of the estimated error; no entries where there is no estimate. Methods with
        one must be "first same as last": the last stage is at the result.
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    c: NDArray[np.float64]
    error: NDArray[np.float64]


def _tableau(rows: list[list[float]], b: list[float], error: list[float] | None = None) -> Tableau:
    """Return the arrays of a method; the stages' times are the sums of their rows."""
    a = np.zeros((len(b), len(b)))
    for i, row in enumerate(rows, start=1):
        a[i, : len(row)] = row
    return Tableau(a, np.array(b), a.sum(axis=1), np.array(error or [], dtype=float))


EULER = _tableau([], [1.0])
HEUN = _tableau([[1.0]], [0.5, 0.5])
RUNGE_KUTTA_4 = _tableau([[0.5], [0.0, 0.5], [0.0, 0.0, 1.0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6])

EULER_HEUN = _tableau([[1.0]], [1.0, 0.0], [0.5, -0.5])
"""Euler, with its distance from Heun as the estimate: no evaluation more than Euler."""

DORMAND_PRINCE = _tableau(
    [
        [1 / 5],
        [3 / 40, 9 / 40],
        [44 / 45, -56 / 15, 32 / 9],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
        [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ],
    [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0.0],
    [71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40],
)
"""Dormand & Prince 1980, order 5 with an estimate of order 4."""
