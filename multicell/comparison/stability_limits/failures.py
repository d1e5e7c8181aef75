"""Failures of methods on recorded coupling steps, each named by the outcome of an experiment.

An end is right if its worst cell is off by no more than three times the conditioning of the step.
Of a wrong one the method, or the reference from where the method ended, solves a part once more,
and the outcome gives the failure its name.
"""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from multicell.cells import FloatArray, IntArray
from multicell.comparison.base import Row
from multicell.comparison.ladders import Method
from multicell.comparison.norms import worst_distance
from multicell.comparison.replay import advance_system, set_deadline, timeout_words
from multicell.comparison.stability_limits.recorded import RecordedState
from multicell.comparison.stability_limits.trial import BLOW_UP, STABLE, STALL, THROWN, WRONG
from multicell.comparison.stability_limits.truth import TrueStep
from multicell.integrators import registry
from multicell.integrators.base import Integrator
from multicell.integrators.shift import SHIFT

MISSED: Final = "stepped over a contact"
DAMPED: Final = "damped an instability"
SNAP: Final = "left a snap's branch"
COARSE: Final = "inaccurate"
POCKET: Final = "another pocket, as shifts do"

MAX_RATIO: Final = 3.0
"""Error of the worst cell over the conditioning of the step up to which an end is right."""

STEP_ENDS: Final = {
    STABLE: "the worst cell is off by at most three times the effect of shifts of the start, or by "
    "less than the shift itself",
    POCKET: "so it is, but a cell is off by more than a twentieth of a radius and has other "
    "contacts: nobody can know the pocket in which it ends",
    BLOW_UP: "positions grow beyond all bounds or are no numbers, a step would throw a cell away, "
    "or a fixed step is beyond the method's limit, so that the fastest modes grow until contacts "
    "open",
    STALL: "the end is not reached within the allowed steps or time",
    DAMPED: "the cells end where a small displacement grows within the step, and the true ones "
    "have left there",
    MISSED: "a contact that truly forms is missing, and the end is right once the method stops "
    "about when it forms",
    SNAP: "an eighth of a step later the cells are where the true ones are: a snap near the end "
    "came too early or too late",
    WRONG: "a cell ends in another pocket, and no shift of the start moves it there; the words say "
    "what shifts within the step do",
    COARSE: "all true contacts are there, but a cell is off by more than is allowed",
}
"""End of a trial from a recorded state -> its meaning. The first one that applies counts."""

_LARGE: Final = 0.05  # error in radii from which a cell counts as being in another pocket
_LATER: Final = 0.125  # part of a step after which a snap is over
_HEALED: Final = 0.1  # error that is left then, over that at the end
_GROWN: Final = 5.0  # growth rate times length of the step of a place that is no place to rest
_LESS: Final = 0.5  # growth rate at the true end, over that at the end that a method finds
_LOST: Final = 10.0  # distance in radii, beyond the extent of the tissue, that is no place


@final
@dataclass(frozen=True)
class StepTrial:
    """A trial of a method from a recorded state.

    - ``setting``: tolerance in µm, or step in s
    - ``words``: of a failure on the way; empty where the end was reached
    - ``end``, (n, 3) µm; ``steps``, ``effort``: in evaluations; ``wall``, s
    """

    method: Method
    setting: float
    words: str
    end: FloatArray
    steps: int
    effort: int
    wall: float


def integrator_of(state: RecordedState, method: Method, setting: float) -> Integrator:
    """Return a method as a run of the scene has it with this ``atol`` (µm) or ``step`` (s)."""
    known = registry.METHODS.get(method.name)
    if known is None or known is not method.info:
        return method.make(setting / state.radius if method.control == "tolerance" else setting)
    key = "atol" if method.control == "tolerance" else "step"
    options: Any = {"method": method.name, key: setting}
    return registry.instantiate(known, replace(state.scene.integrator, **options))


def try_step(state: RecordedState, method: Method, setting: float, patience: float) -> StepTrial:
    """Let a method solve the coupling step of a state; ``patience``: wall time for it, s."""
    system, begin = state.system(), clock.perf_counter()
    if patience < math.inf:
        set_deadline(system, begin + patience, timeout_words(patience))
    words, end = advance_system(system, integrator_of(state, method, setting), state.start)
    wall, work = clock.perf_counter() - begin, system.work
    reach = float(np.ptp(state.start, axis=0).max()) + _LOST * state.radius
    if not words and np.abs(end - state.start.mean(axis=0)).max() > reach:
        words = "positions are not finite or left all bounds"
    return StepTrial(method, setting, words, end, work.steps, work.effort, wall)


def trial_row(truth: TrueStep, trial: StepTrial) -> Row:
    """Return the row of a trial, with the name of its end."""
    state, method = truth.state, trial.method
    shift = SHIFT
    if method.control == "tolerance":
        shift = max(shift, trial.setting)
    conditioning = truth.conditioning(shift)
    error = math.inf if trial.words else worst_distance(trial.end, truth.end)
    kind, words = _name(truth, trial, error, max(MAX_RATIO * conditioning, shift))
    if kind == WRONG:
        within = truth.conditioning_within(shift)
        words += f"; shifts by {shift:g} um at 32 times of the step do up to {within:.3g} um"
    return {
        "state": state.name,
        "cells": len(state.start),
        "method": method.name,
        "control": method.control,
        "setting": trial.setting,
        "error_um": error,
        "shift_um": shift,
        "conditioning_um": conditioning,
        "ratio": error / conditioning if conditioning else math.nan,
        "null_ratio": truth.null_error() / conditioning if conditioning else math.nan,
        "kind": kind,
        "words": words,
        "steps": trial.steps,
        "effort": trial.effort,
        "wall": trial.wall,
    }


def _name(truth: TrueStep, trial: StepTrial, error: float, allowed: float) -> tuple[str, str]:
    """Return the name of an end, and what was seen, in words."""
    if trial.words:
        return (BLOW_UP if THROWN.search(trial.words) else STALL), trial.words
    radius = truth.state.radius
    if error > _LARGE * radius:
        damped = _damped(truth, trial.end)
        if damped:
            return DAMPED, damped
    off = f"the worst cell is {error:.3g} um off"
    if error <= allowed:
        elsewhere = error > _LARGE * radius and any(_contacts_apart(truth, trial, _LARGE * radius))
        return (POCKET, off) if elsewhere else (STABLE, "")
    over = _beyond_limit(truth, trial)
    if over > 1.0:
        return BLOW_UP, f"the step is {over:.3g} times the method's limit; {off}"
    missing, more = _contacts_apart(truth, trial, allowed)
    differs = bool(missing or more)
    if differs or error > _LARGE * radius:
        later = _later(truth, trial.end)
        if later <= max(_HEALED * error, allowed / MAX_RATIO):
            return SNAP, f"{off}, and {later:.2g} um an eighth of a step later"
    for pair in missing:
        cured = _stopped_there(truth, trial, pair)
        if cured is not None and cured[1] <= max(allowed, _HEALED * error):
            i, j = truth.state.ids[pair]
            return MISSED, (
                f"cells {i} and {j} touch from {cured[0]:.6g} s on; {off}, and {cured[1]:.2g} um "
                "where the method stops then"
            )
    if differs:
        return WRONG, f"{off}; {len(missing)} contacts are missing and {len(more)} are too many"
    return COARSE, off


def _damped(truth: TrueStep, end: FloatArray) -> str:
    """Return words if cells ended where a displacement grows, and the true ones left there."""
    rate, true = truth.growth(end), truth.growth(truth.end)
    start = truth.state.start
    off = np.sqrt(np.square(end - truth.end).sum(axis=1)).argmax()
    moved, left = (float(np.linalg.norm(x[off] - start[off])) for x in (end, truth.end))
    if not (rate * truth.state.length > _GROWN and true < _LESS * rate and moved < left):
        return ""
    return (
        f"where the cells end a displacement grows at {rate:.3g}/s, {max(true, 0.0):.2g}/s at the "
        f"true end; the worst cell moved by {moved:.3g} um, truly by {left:.3g}"
    )


def _beyond_limit(truth: TrueStep, trial: StepTrial) -> float:
    """Return a fixed step over the largest one that is stable, zero where there is no limit."""
    stable = trial.method.info.stable
    if trial.method.control != "step" or not math.isfinite(stable):
        return 0.0
    return trial.setting * truth.decay() / stable


def _later(truth: TrueStep, end: FloatArray) -> float:
    """Return how far the worst cell is off once both ends have been continued, µm."""
    found, exact = (truth.later(x, _LATER) for x in (end, truth.end))
    return math.inf if found is None or exact is None else worst_distance(found, exact)


def _stopped_there(truth: TrueStep, trial: StepTrial, pair: IntArray) -> tuple[float, float] | None:
    """Return when a true contact forms, s, and the error of the method that stops there, µm."""
    time = truth.contact_time(pair)
    if time is None or time >= truth.state.motion.end:
        return None
    method = integrator_of(truth.state, trial.method, trial.setting)
    end = truth.stopping(method, time)
    return None if end is None else (time, worst_distance(end, truth.end))


def _contacts_apart(
    truth: TrueStep, trial: StepTrial, allowed: float
) -> tuple[list[IntArray], list[IntArray]]:
    """Return the pairs whose true contact is missing, and those that touch and should not.

    Only pairs with a cell that is off by more than is allowed, µm.
    """
    off = np.sqrt(np.square(trial.end - truth.end).sum(axis=1)) > allowed
    true, found = truth.contacts(truth.end), truth.contacts(trial.end)
    return _difference(true, found, off), _difference(found, true, off)


def _difference(these: IntArray, those: IntArray, wrong: FloatArray) -> list[IntArray]:
    """Return the pairs that are among these and not those, and have a cell that is off."""
    known = set(map(tuple, those.tolist()))
    return [pair for pair in these if tuple(pair.tolist()) not in known and wrong[pair].any()]
