"""The largest step or tolerance at which each method of a network ends where it should."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, final

from multicell.cells import FloatArray
from multicell.comparison.base import Row
from multicell.comparison.measured import open_measurements
from multicell.comparison.network_reference import largest_rates, network_reference
from multicell.comparison.network_steps import (
    NetworkProblem,
    methods_of_networks,
    record_network,
    solve_steps,
    which_network,
)
from multicell.comparison.stability_limits.result import (
    STABILITY_FILES,
    StabilityMap,
    StabilityWords,
)
from multicell.comparison.stability_limits.search import PRECISION, bracket, search_up
from multicell.comparison.stability_limits.trial import BLOW_UP, STABLE, STALL, WRONG
from multicell.networks.loop import CELL_STEPS
from multicell.networks.methods import NetworkMethod
from multicell.results.folder import versions
from multicell.scene.scene import Scene, load_scene

MOMENTS: Final = 6
"""Coupling steps from which methods start, spread over the run."""

ALLOWED: Final = 0.01
"""Largest error of a state over its size that counts as right."""

_LIMITS: Final = {"euler": 2.0, "rk4": 2.785}  # h |λ| on the negative real axis
_FIRST = 0.45  # first step that is tried, over Euler's limit
_TOLERANCES: Final = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1)  # up to the loosest of a scene
_TIGHTEST: Final = 1e-8  # tried where the tightest of these fails

WORDS: Final = StabilityWords(
    ends={
        STABLE: f"all states of all cells end within {100.0 * ALLOWED:g} % of the reference",
        BLOW_UP: "a state or a rate is no finite number",
        STALL: "the end is not reached within the allowed steps",
        WRONG: f"a state of a cell ends off by more than {100.0 * ALLOWED:g} %",
    },
    tolerance="relative tolerance",
    subtitle="Each method takes the networks of the same cells through the same coupling steps.",
    note="Of a method under error control the loosest relative tolerance is given, and its mean "
    "step there over Euler's limit.",
)


def network_stability(
    scene: Scene | str | Path,
    network: str = "",
    methods: Sequence[str] | None = None,
    output: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
    *,
    patience: float = 20.0,
    threads: int | None = None,
    overwrite: bool = False,
) -> StabilityMap:
    """Find the largest step, or the loosest tolerance, at which the networks of cells end right.

    The scene is run once. From six coupling steps spread over the run each method solves the
    networks of the same cells; a setting is good if all states of all cells end within 1 % of a
    reference. ``facts["moments"]`` has the limits of methods with fixed steps for each of the six.

    Parameters
    ----------
    scene
        The scene, the name of a built-in one, or a TOML file.
    network, methods
        As for :func:`multicell.compare_networks`.
    output, progress, patience, threads, overwrite
        As for :func:`multicell.stability`; ``threads`` are those of the run.

    Raises
    ------
    SceneError, OutputError
        For input that cannot be used.
    StepFailed
        If the scene cannot be run, or the reference cannot be computed.
    """
    described = scene if isinstance(scene, Scene) else load_scene(scene)
    tell = progress or (lambda _: None)
    name, chosen = which_network(described, network), methods_of_networks(methods)
    what = {"network": name, "patience": patience, "threads": threads}
    asked = [method.name for method in chosen]
    own = described.networks[name].network is not None  # it may have changed since
    with open_measurements(
        output, STABILITY_FILES, described, what, asked, [] if own else asked, overwrite=overwrite
    ) as measured:
        wall, table, moments, trials = 0.0, [], {}, None
        for method in chosen:
            known = measured.find(method.name)
            if known is not None:
                tell(f"{method.name}: was measured before")
            else:
                if trials is None:
                    trials = _trials(described, name, patience, threads, tell)
                tell(method.name)
                begin = clock.perf_counter()
                known = trials.measured(method)
                known["wall"] = clock.perf_counter() - begin
                measured.add(method.name, **known)
            table += known["rows"]
            wall += known["wall"]
            moments[method.name] = known["moments"]
        facts = {
            "precision": PRECISION,
            "wall": wall,
            "versions": versions(),
            "moments": _by_moment(moments),
        }
        result = StabilityMap(described, table, facts, WORDS)
        if output is not None:
            result.save(output)
    return result


def _trials(
    scene: Scene, name: str, patience: float, threads: int | None, tell: Callable[[str], None]
) -> _Trials:
    """Return the steps that are tried, with their reference."""
    problem = record_network(scene, name, MOMENTS, threads, tell)
    tell("reference")
    exact = network_reference(problem)
    return _Trials(problem.parts(), exact.states, largest_rates(problem), patience)


@final
@dataclass
class _Trials:
    """Trials of methods on single coupling steps.

    - ``parts``: problems of one step each; ``states``: how they end; ``fastest``, 1/s: their |λ|
    - ``ends``: how a method ended at a setting from one of them, in kind and words; work and span
    """

    parts: list[NetworkProblem]
    states: list[FloatArray]
    fastest: list[float]
    patience: float
    ends: dict[tuple[str, float, int], tuple[str, str, float]] = field(default_factory=dict)

    def measured(self, method: NetworkMethod) -> dict[str, Any]:
        """Return the rows of one method, and for each coupling step the limit of fixed steps."""
        tried: dict[float, Row] = {}

        def right(setting: float) -> bool:
            if setting not in tried:
                tried[setting] = self._row(method, setting)
            return bool(tried[setting]["kind"] == STABLE)

        moments = []
        for k, (part, rate) in enumerate(zip(self.parts, self.fastest, strict=True)):
            limit = math.nan
            if method.fixed:
                guess = min(_FIRST * _LIMITS["euler"] / rate if rate else math.inf, part.span)
                limit = bracket(partial(self._right, method, k), guess, part.span)
            moments.append({"time": part.steps[0].time, "rate": rate, "limit": limit})
        if not method.fixed:
            search_up(right, _TOLERANCES, _TIGHTEST)
        else:
            for limit in {moment["limit"] for moment in moments}:
                right(limit)
            for k in range(_COARSER):
                right(max(part.span for part in self.parts) / 4.0**k)
            least = min(moment["limit"] for moment in moments)
            right(least * (1.0 + PRECISION))
            right(least / 2.0)
        return {"rows": [tried[setting] for setting in sorted(tried)], "moments": moments}

    def _right(self, method: NetworkMethod, k: int, setting: float) -> bool:
        return self._end(method, k, setting)[0] == STABLE

    def _end(self, method: NetworkMethod, k: int, setting: float) -> tuple[str, str, float]:
        """Return how a method ends from a step, in kind and words, and its steps for each cell."""
        key = method.name, setting, k
        if key not in self.ends:
            part, exact = self.parts[k], self.states[k]
            found, _ = solve_steps(part, method.name, setting, self.patience)
            if found.problem:
                kind = BLOW_UP if "finite" in found.problem else STALL
                self.ends[key] = kind, found.problem, 0.0
            else:
                error = max(float(x.max()) for x in part.errors(found.states, [exact]))
                kind = STABLE if error <= ALLOWED else WRONG
                words = "" if kind == STABLE else f"a state ends off by {100.0 * error:.3g} %"
                self.ends[key] = kind, words, float(found.work[CELL_STEPS] / len(exact))
        return self.ends[key]

    def _row(self, method: NetworkMethod, setting: float) -> Row:
        """Try one setting from every step."""
        begin = clock.perf_counter()
        ends = [self._end(method, k, setting) for k in range(len(self.parts))]
        kind, words, _ = min(ends, key=lambda end: _ORDER.index(end[0]))
        rate, fixed = max(self.fastest), method.fixed
        theory, steps = _LIMITS.get(method.name, math.nan) / rate, sum(end[2] for end in ends)
        span = sum(part.span for part, end in zip(self.parts, ends, strict=True) if end[2])
        mean = setting if fixed else (span / steps if steps else math.nan)
        return {
            "cells": max(part.cells[1] for part in self.parts),
            "rate": rate,
            "method": method.name,
            "control": "step" if fixed else "tolerance",
            "setting": setting,
            "theory": theory,
            "of_theory": setting / theory if fixed else math.nan,
            "of_euler": mean * rate / _LIMITS["euler"],
            "kind": kind,
            "words": words,
            "steps": round(steps),
            "wall": clock.perf_counter() - begin,
        }


_ORDER: Final = (BLOW_UP, STALL, WRONG, STABLE)
_COARSER: Final = 3  # long steps that are tried beyond the limit


def _by_moment(moments: Mapping[str, Sequence[Row]]) -> list[Row]:
    """Return for each coupling step how long fixed steps may be in it, s, by method."""
    found: list[Row] = []
    for k, first in enumerate(next(iter(moments.values()))):
        rate = first["rate"]
        euler = _LIMITS["euler"] / rate if rate else math.inf
        row = {"time": first["time"], "rate": rate, "Euler's limit": euler}
        limits = {name: known[k]["limit"] for name, known in moments.items()}
        found.append(row | {name: x for name, x in limits.items() if not math.isnan(x)})
    return found
