"""Search for the limit of stability of each method by bisection, and the kind of failure."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from multicell.comparison.base import Row
from multicell.comparison.ladders import Method, capable_methods, select_methods
from multicell.comparison.measured import open_measurements
from multicell.comparison.replay import solve_compiled
from multicell.comparison.stability_limits.result import STABILITY_FILES, StabilityMap
from multicell.comparison.stability_limits.state import TrialState, settled_state
from multicell.comparison.stability_limits.trial import STABLE, judge, run_trial
from multicell.integrators.base import Integrator
from multicell.results.folder import versions
from multicell.scene.scene import Scene, load_scene
from multicell.scene.sizes import division_radii

LOOSEST_TOLERANCE: Final = 0.1
"""Loosest tolerance that is tried, in mean radii; one that loose asks for hardly anything."""

PRECISION: Final = 0.03  # relative distance at which bisection ends

_TIGHTEST = 1e-8  # tried where the tightest of the usual tolerances fails
_EXTRA = ("rkc2-5", "rkc2-10")
_FIRST, _MAX_STEP = 0.45, 1000.0  # first and longest step that are tried, over Euler's limit
# steps over the limit at which the kind of failure is shown
_BEYOND = (0.25, 0.5, 0.8, 1.25, 1.6, 2.5, 4.0, 8.0, 20.0)
# that are tried, the loosest last
_TOLERANCES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.03, LOOSEST_TOLERANCE)

Trial = Callable[[float], bool]


def stability(
    scene: Scene | str | Path,
    methods: Sequence[str | Method | type[Integrator] | Integrator] | None = None,
    output: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
    *,
    patience: float = 20.0,
    threads: int | None = None,
    overwrite: bool = False,
) -> StabilityMap:
    """Find the largest step, or the loosest tolerance, at which each method stays stable.

    The first cells of the scene settle; then they are pushed a little along the mode that decays
    fastest, and each method must let them come to rest again: a fixed step for 200 steps, a
    method under error control for 2000 / λ_max. The limit is found by bisection and set beside
    the theory; how a method fails beyond is named
    (:data:`multicell.comparison.stability_limits.trial.TRIAL_ENDS`).

    Parameters
    ----------
    scene
        The scene, the name of a built-in one, or a TOML file.
    methods
        Names (:data:`multicell.integrators.registry.METHODS`, or ``"rkc2-8"`` for RKC2 of eight
        stages with a fixed step), methods of the user's own (an object, a class or
        ``"file.py:Name"``) or :class:`Method` objects; by default all that can hold the scene.
    output
        Folder for the files of :meth:`StabilityMap.save`.
    progress
        Called with a line of words for everything that is begun.
    patience
        Wall time in s after which a trial counts as a stall.
    threads
        Number of threads, by default all.
    overwrite
        Whether the folder may hold something: files of an earlier map are replaced. A search that
        was ended early continues when it is asked for again.

    Raises
    ------
    SceneError, OutputError
        For input that cannot be used, before anything is computed.
    StepFailed
        If the scene's cells cannot be settled.
    """
    described = scene if isinstance(scene, Scene) else load_scene(scene)
    note = progress or (lambda _: None)
    names = [*capable_methods(described), *_EXTRA] if methods is None else methods
    chosen = select_methods(names, described, 0.9 * division_radii(described)[0])
    what = {"patience": patience, "threads": threads}
    asked = [method.name for method in chosen]
    with open_measurements(
        output, STABILITY_FILES, described, what, asked, names, overwrite=overwrite
    ) as measured:
        begin, before, table, state = clock.perf_counter(), 0.0, [], None
        for method in chosen:
            known = measured.find(method.name)
            if known is not None:
                note(f"{method.name}: was measured before")
                before += known["wall"]
            else:
                if state is None:
                    note("settling")
                    state = settled_state(described, threads)
                note(method.name)
                started = clock.perf_counter()
                known = {"rows": _rows(state, method, patience)}
                known["wall"] = clock.perf_counter() - started
                measured.add(method.name, **known)
            table += known["rows"]
        wall = before + clock.perf_counter() - begin  # also of those from the folder
        facts = {"precision": PRECISION, "wall": wall, "versions": versions()}
        result = StabilityMap(described, table, facts)
        if output is not None:
            result.save(output)
    return result


def _rows(state: TrialState, method: Method, patience: float) -> list[Row]:
    """Return the rows of one method: those of the search, and those around it."""
    rows: dict[float, Row] = {}
    theory = method.info.stable / state.rate

    def stable(setting: float) -> bool:
        if setting not in rows:
            rows[setting] = _row(state, method, setting, theory, patience)
        return bool(rows[setting]["kind"] == STABLE)

    if method.control == "tolerance":
        search_up(stable, _TOLERANCES, _TIGHTEST)
        more: Sequence[float] = _TOLERANCES
    else:
        # the search starts well below Euler's limit and knows nothing of the theory
        ceiling = _MAX_STEP * state.stiff_limit
        limit = bracket(stable, _FIRST * state.stiff_limit, ceiling)
        more = [f * limit for f in _BEYOND if f * limit <= ceiling]
    for setting in more:
        # next to a setting of the search there is nothing new
        if not any(abs(math.log(setting / tried)) < 0.1 for tried in rows):
            stable(setting)
    place = {"cells": len(state.start), "rate": state.rate}
    return [{**place, **rows[setting]} for setting in sorted(rows)]


def bracket(stable: Trial, guess: float, ceiling: float) -> float:
    """Bracket the largest stable step and bisect; return it, or the ceiling."""
    low = high = guess
    factor = 1.5
    if stable(guess):
        while stable(high):
            if high >= ceiling:
                return high
            low, high, factor = high, min(high * factor, ceiling), min(2.0 * factor, 8.0)
    else:
        floor = 1e-5 * guess
        while not stable(low):
            if low <= floor:
                return low
            high, low, factor = low, low / factor, min(1.5 * factor, 8.0)
    return bisect(stable, low, high)


def search_up(stable: Trial, tolerances: Sequence[float], tightest: float) -> None:
    """Try tolerances from tight to loose, then bisect below the first one that is not stable.

    Stable settings need not be neighbours: all of them are tried. ``tightest`` is tried
    where the first of them fails.
    """
    ladder = tolerances if stable(tolerances[0]) else (tightest, *tolerances)
    failed = next((k for k, good in enumerate(map(stable, ladder)) if not good), len(ladder))
    if 0 < failed < len(ladder):
        bisect(stable, ladder[failed - 1], ladder[failed])


def bisect(stable: Trial, low: float, high: float) -> float:
    """Halve, geometrically, what lies between a stable and an unstable setting."""
    while high > (1.0 + PRECISION) * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def _row(state: TrialState, method: Method, setting: float, theory: float, patience: float) -> Row:
    """Try one setting."""
    trace, _ = solve_compiled(lambda: run_trial(state, method, setting, patience))
    kind, words = judge(state, trace)
    fixed = method.control == "step"
    mean = setting if fixed else float(trace.times[-1]) / max(trace.steps, 1)
    return {
        "method": method.name,
        "control": method.control,
        "setting": setting,
        "theory": theory,
        "of_theory": setting / theory if fixed else math.nan,
        "of_euler": mean / state.stiff_limit,
        "kind": kind,
        "words": words,
        "steps": len(trace.times) - 1 if fixed else trace.steps,
        "wall": trace.wall,
    }
