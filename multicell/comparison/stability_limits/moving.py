"""Trials of methods on recorded coupling steps of real runs, in which tissue moves.

Measurements are on disk state by state and method by method, so that a map that was ended early
continues.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from multicell.comparison.base import Row
from multicell.comparison.ladders import Method, select_methods
from multicell.comparison.measured import Measurements, named_only, open_measurements
from multicell.comparison.replay import solve_compiled
from multicell.comparison.stability_limits.failure_map import FAILURE_FILES, FailureMap
from multicell.comparison.stability_limits.failures import trial_row, try_step
from multicell.comparison.stability_limits.recorded import RecordedState, state_at
from multicell.comparison.stability_limits.truth import TrueStep
from multicell.errors import SceneError
from multicell.integrators.base import Integrator, count_equal_steps
from multicell.integrators.registry import METHODS
from multicell.integrators.shift import SHIFT
from multicell.results.folder import versions

MAP_TOLERANCES: Final = (0.001, 0.01, 0.03, 0.1, 0.3)
"""Absolute tolerances that are tried, µm; the defaults of all methods are among them."""

_OF_LIMIT: Final = (4.0, 2.0, 1.0, 0.5, 0.1)  # fixed explicit steps over Euler's limit at the end
_OF_STEP: Final = (1, 4, 16, 64)  # fixed implicit steps in a coupling step


def moving_stability(
    states: Sequence[str | Path | RecordedState] | str | Path,
    methods: Sequence[str | Method | type[Integrator] | Integrator] | None = None,
    output: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
    *,
    patience: float = 20.0,
    threads: int | None = None,
    overwrite: bool = False,
) -> FailureMap:
    """Find how methods end recorded coupling steps of real runs, and name their failures.

    Each method solves each step at several tolerances, or with several fixed steps, from the state
    that the run has passed. The error of the worst cell is compared with the conditioning of the
    step: the largest effect of twelve random shifts of the start, by 0.01 µm or by the tolerance,
    if that is larger. Every row has the score of a method that knows no mechanics.

    Parameters
    ----------
    states
        Texts ``"FOLDER:TIME"``: the folder of a run, and when the coupling step begins.
    methods
        As for :func:`multicell.stability`; by default all but SciPy's that can hold the scene.
    output
        Folder for the files of :meth:`FailureMap.save`; a map that was ended early continues.
    progress
        Called with a line of words for everything that is begun.
    patience
        Wall time in s after which a trial counts as a stall.
    threads, overwrite
        As for :func:`multicell.stability`.

    Returns
    -------
    FailureMap

    Raises
    ------
    SceneError, OutputError
        For states, methods and folders that cannot be used.
    StepFailed
        If the true end of a step cannot be computed.
    """
    note = progress or (lambda _: None)
    texts = [states] if isinstance(states, str | Path) else list(states)
    if not texts:
        raise SceneError("state", "is empty: there is no run to take a step from")
    found = [x if isinstance(x, RecordedState) else state_at(x, threads) for x in texts]
    twice = {s.name for s in found if [o.name for o in found].count(s.name) > 1}
    if twice:
        raise SceneError("state", f"two states are called {min(twice)!r}")
    usual = [name for name, info in METHODS.items() if not info.outside]
    names = usual if methods is None else methods
    chosen = select_methods(names, found[0].scene, found[0].radius)
    begin = clock.perf_counter()
    with _opened(output, found, chosen, names, patience, overwrite=overwrite) as measured:
        table: list[Row] = []
        for state in found:
            table += _Trials(state, measured, note, patience).rows(chosen)
        facts = {"wall": clock.perf_counter() - begin, "versions": versions()}
        result = FailureMap(found[0].scene, table, facts)
        if output is not None:
            result.save(output)
    return result


def _opened(
    output: str | Path | None,
    states: Sequence[RecordedState],
    methods: Sequence[Method],
    names: Sequence[Any],
    patience: float,
    *,
    overwrite: bool,
) -> AbstractContextManager[Measurements]:
    """Open the folder of a map, whose entries are pairs of a state and a method."""
    named, marks = named_only(names), {state.name: state.mark for state in states}
    entries = [f"{s.name} {m.name}" for s in states for m in methods]
    kept = [f"{s.name} {name}" for s in states for name in ("truth", *named)]
    what = {"states": marks, "patience": patience}
    scene = states[0].scene
    return open_measurements(output, FAILURE_FILES, scene, what, entries, kept, overwrite=overwrite)


@final
@dataclass
class _Trials:
    """Trials from one state."""

    state: RecordedState
    measured: Measurements
    note: Callable[[str], None]
    patience: float
    truth: TrueStep | None = None

    def rows(self, methods: Sequence[Method]) -> list[Row]:
        """Return the rows of all methods that can hold the state."""
        table: list[Row] = []
        friction = self.state.scene.friction is not None
        for method in methods:
            if method.info.refusal(len(self.state.start), friction=friction) is not None:
                continue
            entry = f"{self.state.name} {method.name}"
            known = self.measured.find(entry)
            if known is None:
                self.note(entry)
                known = {"rows": [self._row(method, s) for s in self._settings(method)]}
                self.measured.add(entry, **known)
            else:
                self.note(f"{entry}: was measured before")
            table += known["rows"]
        return table

    def _row(self, method: Method, setting: float) -> Row:
        trial, _ = solve_compiled(lambda: try_step(self.state, method, setting, self.patience))
        return trial_row(self._true(), trial)

    def _settings(self, method: Method) -> list[float]:
        """Return the tolerances in µm, or the steps in s, that are tried, from fine to coarse."""
        if method.control == "tolerance":
            return list(MAP_TOLERANCES)
        if method.control != "step":
            return [float("nan")]
        length, rate = self.state.length, self._true().decay()
        if method.info.implicit or not rate:
            return [length / n for n in reversed(_OF_STEP)]
        wanted = [min(2.0 * f / rate, length) for f in _OF_LIMIT]
        return sorted({length / count_equal_steps(length, step) for step in wanted})

    def _true(self) -> TrueStep:
        """Return the truth of the state, from the folder if it was solved before."""
        if self.truth is None:
            entry = f"{self.state.name} truth"
            known = self.measured.find(entry)
            if known is None:
                self.note(f"{self.state.name}: the true end, and of twelve shifted starts")
                truth = TrueStep.of(self.state)
                for shift in sorted({SHIFT, *(t for t in MAP_TOLERANCES if t > SHIFT)}):
                    truth.conditioning(shift)
                known = {
                    "end": truth.end.tolist(),
                    "uncertainty": truth.uncertainty,
                    "by": truth.method,
                    "moved": [[*pair] for pair in truth.moved.items()],
                }
                self.measured.add(entry, **known)
            end, moved = np.array(known["end"]), dict(known["moved"])
            self.truth = TrueStep(self.state, end, known["uncertainty"], known["by"], moved)
        return self.truth
