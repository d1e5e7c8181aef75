"""Run an explicit method: its loop on a copy of the positions, its work, its outcome in words.

The loops (:mod:`multicell.integrators.loops`) run compiled, each compiled when it is first used.
All methods refuse a step that moves a cell further than ``max_displacement`` of its radius, or to
where there is no velocity: under error control the step is tried shorter, with a fixed step the
integration ends.

Error control. The estimate of a step is measured as CVODE does, in the root mean square of
e_k / (atol + rtol |x_k|), which stays below :func:`.limits.norm_share`, and PI control (Gustafsson
1991) chooses the next step. The first step of a coupling step is derived from its state (Hairer,
Nørsett & Wanner), so that nothing is carried over. Where the result is of lower order p than the
estimate, the error of a step may not exceed θ^(1/p), θ = rtol + atol / mean radius, in that norm:
the number of steps grows like θ^(-1/p), so that the error of the interval follows the tolerance
(tolerance calibration, Söderlind & Wang 2006).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.cells import FloatArray
from multicell.integrators import base, stepping
from multicell.integrators.base import Outcome
from multicell.integrators.limits import find_failure, norm_share
from multicell.mechanics import forces
from multicell.mechanics.any_law import law_values
from multicell.mechanics.system import Mechanics

if TYPE_CHECKING:
    from multicell.integrators.base import EqualSteps, ErrorControl
    from multicell.integrators.rkc import Rkc2

_STEP_HINT = "Choose a shorter integrator.step, or the method 'cvode'"
_TOLERANCE_HINT = "Choose a shorter coupling_step, or the method 'cvode'"


def needs_python(system: Mechanics) -> bool:
    """Return whether each evaluation must go through Python.

    Exact JKR and surface energies that differ between cells keep values for each pair, made
    in Python with each neighbour list, friction solves a linear system, and walls, prescribed
    motion, resistance to compression and space that repeats are parts that scenes without them do
    not load. The loops
    are the same then, uncompiled around compiled arithmetic.
    """
    return (
        system.has_pair_values
        or system.walls is not None
        or system.prescribed is not None
        or system.compression is not None
        or system.period is not None
        or max(system.friction) > 0.0
    )


def control(method: ErrorControl, system: Mechanics, order: float, lower: int) -> stepping.Control:
    """Return the settings of error control for a coupling step.

    - ``method``: its tolerances and limits
    - ``system``: made ready for the coupling step
    - ``order``: exponent of the step in the estimated error
    - ``lower``: order p of the result where it is below that of the estimate, else 0
    """
    radius = system.motion.radius
    # θ of the module's text; a sum costs a third of a mean, which matters with two cells
    mean = len(radius) / float(radius.sum()) if len(radius) else math.inf
    share = min(1.0, method.rtol + method.atol * mean)
    strictness = (norm_share(len(radius)), share, math.sqrt(share))[lower]
    return stepping.Control(
        method.rtol, method.atol, strictness, order, method.max_steps, method.max_displacement
    )


def run_equal_steps(
    system: Mechanics, position: FloatArray, loop: Any, method: EqualSteps | Rkc2, *settings: Any
) -> Outcome:
    """Run a loop with equal steps no longer than ``method.step``; see :class:`Integrator`."""
    steps = base.count_equal_steps(system.motion.end - system.motion.begin, method.step)
    allowed = method.max_displacement
    return _run(system, position, loop, (steps, allowed, *settings), allowed, _STEP_HINT)


def adaptive(
    system: Mechanics,
    position: FloatArray,
    loop: Any,
    control: stepping.Control,
    *settings: Any,
    **uses: bool,
) -> Outcome:
    """Run a loop under error control; ``uses`` are those of :func:`source_of`."""
    settings, allowed = (control, *settings), control.max_displacement
    return _run(system, position, loop, settings, allowed, _TOLERANCE_HINT, control.atol, **uses)


def _run(
    system: Mechanics,
    position: FloatArray,
    loop: Any,
    settings: tuple[Any, ...],
    max_displacement: float,
    hint: str,
    atol: float = 0.0,
    **uses: bool,
) -> Outcome:
    """Run a loop on a copy of the positions; count its work; put its end into words."""
    motion = system.motion
    length = motion.end - motion.begin
    state = np.array(position, dtype=float, order="C")
    if len(system) == 0 or length <= 0.0:
        return Outcome(motion.end, state)
    refused = find_failure(system, state, atol)
    if refused is not None:
        return refused
    counts = np.zeros(5, dtype=np.int64)
    common = (state, length, motion.radius, counts)
    if needs_python(system):
        source: Any = stepping.Called(system)
        report, _ = loop.py_func(source, None, *common, *settings)
    else:
        source, pairs = source_of(system, counts, **uses)
        report, pairs = loop(source, pairs, *common, *settings)
        system.take_list(pairs)
    work = system.work
    work.evaluations += int(counts[stepping.EVALUATIONS])
    work.list_builds += int(counts[stepping.LIST_BUILDS])
    work.list_repairs += int(counts[stepping.LIST_REPAIRS])
    work.steps += int(counts[stepping.STEPS])
    work.rejections += int(counts[stepping.REJECTIONS])
    if report.status == stepping.DONE:
        return Outcome(motion.end, state)
    return _failure(motion.begin, state, report, source, max_displacement, hint)


def _failure(
    begin: float,
    state: FloatArray,
    report: stepping.Report,
    source: Any,
    max_displacement: float,
    hint: str,
) -> Outcome:
    last_step = f"step of {report.dt:.3g} s"
    cell = int(report.cell) if report.cell >= 0 else None
    if report.status == stepping.MOVED:
        problem = base.move_words(report.dt, report.moved, max_displacement)
    elif report.status == stepping.OUT_OF_STEPS:
        problem = f"the largest number of internal steps did not reach the end (last {last_step})"
        hint = base.OUT_OF_STEPS_HINT
    elif report.status == stepping.TOO_LONG:
        problem = f"the whole interval would take about {report.moved:.0f} evaluations"
        hint = "Take a method for stiff problems, such as 'cvode' or 'rkc2'"
    elif report.status == stepping.STALLED:
        problem = f"steps became too short to continue (last {last_step})"
    elif report.status == stepping.REJECTED:
        words = getattr(source, "problem", "") or "cells lie on top of each other"
        problem = f"in a {last_step} {words}"
    else:
        lost = ~np.isfinite(state).all(axis=1)
        cell = int(lost.argmax()) if cell is None and lost.any() else cell
        problem = f"in a {last_step} a position is not a number"
    return Outcome(begin + report.elapsed, state, problem, hint, cell)


def source_of(
    system: Mechanics, counts: Any, *, watched: bool = False, **uses: bool
) -> tuple[stepping.Source, forces.PairData]:
    """Return the arguments of a loop, with a neighbour list of its own.

    - ``watched``, ``uses``: what the loop uses, see :func:`.stepping.with_addresses`
    """
    known, pairs, shared = system.kernel_data()
    source = stepping.Source(known[0], law_values(known[1]), *known[2:], counts)
    watched = watched and stepping.meets_driven(system)
    source = stepping.with_addresses(
        source, pairs, known[1], shared=shared, watched=watched, **uses
    )
    return source, pairs
