"""Error over time of the solvers of a run's fields: py-pde's registry and the run's own."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, ClassVar, Final, NamedTuple, final

from multicell.cells import FloatArray
from multicell.comparison.base import CLOCKS, FAILED, SKIPPED, SOLVED, Row
from multicell.comparison.field_steps import (
    FieldRun,
    FieldStep,
    record_fields,
    solve_fields,
    which_field,
)
from multicell.comparison.measure import default_budget, solve_row, solve_times
from multicell.comparison.measured import Measurements, open_measurements
from multicell.comparison.norms import Norm
from multicell.comparison.numbers import COMPARISON_FILES, NUMBERS_FILE
from multicell.comparison.precision import Precision
from multicell.errors import NutrientFailed, SceneError, StepFailed
from multicell.integrators.base import MethodInfo
from multicell.nutrient.equations.outside import settle
from multicell.results.folder import versions
from multicell.scene.field_solvers import known_solvers, longest_step
from multicell.scene.nutrient import OWN_SOLVERS
from multicell.scene.scene import Scene, load_scene
from multicell.schema import near_miss

_IMPLICIT: Final = {"implicit", "crank-nicolson", "multicell-implicit", *OWN_SOLVERS}
_LOOKS: Final = {
    "multicell-steady": ("", "o", "-"),
    "multicell-march": ("", "o", "-"),
    "multicell-implicit": ("", "D", "-"),
    "explicit": ("", "s", "-"),
    "scipy": ("", "^", "--"),
}
_SURE: Final = 1e-9  # tolerance of the reference, of which solvers take a tenth
_FINER: Final = 2.0  # from one fixed step to the next
_RUNGS: Final = 7  # tolerances, and fixed steps down to a 64th
_EXPLICIT: Final = 0.3  # steps of SciPy's RK45 over the fastest rate times the span, nearly
_MARCHES: Final = 14  # marches to rest, each twice as long, from 100 of the fastest times
_SHARE: Final = 0.01  # of what a step changes, that is judged where that is little
_MODE: Final = "the last coupling step"
_FOLLOWED: Final = 1e-9  # error below which a march to rest needs no longer one

FIELD_NORMS: Final[dict[str, Norm]] = {
    name: Norm(name, quantity, "last", "highest concentration", None)  # type: ignore[arg-type]
    for name, quantity in (
        ("nodes", "concentration at any node"),
        ("worst_cell", "concentration of any cell"),
    )
}
"""Name of each norm -> the norm; :class:`multicell.comparison.field_steps.FieldStep` has both."""


@final
class FieldPrecision(Precision):
    """Error and time of each solver on the fields of a coupling step.

    ``table`` has one row for each solver and setting as that of
    :class:`multicell.comparison.result.WorkPrecision`: a relative tolerance, a step in s, or, of
    steady fields, the time in s that is marched towards rest. Errors are over the highest
    concentration.
    """

    main: ClassVar[str] = "nodes"
    last: ClassVar[str] = "nodes"
    counts: ClassVar[tuple[str, ...]] = ()

    def measures(self) -> dict[str, Norm]:
        """Return all norms of the table by their names."""
        return FIELD_NORMS

    def info(self, method: str) -> MethodInfo | None:
        """Return the properties of a solver."""
        return MethodInfo(method, implicit=method in _IMPLICIT)

    def verdict(self, error: float = 0.01, norm: str | None = None) -> str:
        """Return in a sentence which solver reaches an error at the least cost, and by how much.

        Where the step changes the fields by less than that, about a hundredth of the change is
        judged.
        """
        change = self.facts["change"][self.check_norm(norm)]
        if change > error:
            return super().verdict(error, norm)
        nothing = f"At {100.0 * error:g} % no solve is needed: the step changes fields by less."
        if change == 0.0:
            return nothing
        return f"{nothing} {super().verdict(10.0 ** math.floor(math.log10(_SHARE * change)), norm)}"

    def shown(self) -> tuple[str, dict[str, tuple[str, str]]]:
        """Return a note and the columns of the page's table of all solves."""
        note = "Times in s; errors over the highest concentration, at any node and of any cell."
        return note, {
            "wall": ("wall", "{:.3g}"),
            "cpu": ("processor", "{:.3g}"),
            "error_nodes": ("error", "{:.2e}"),
            "error_worst_cell": ("worst cell", "{:.2e}"),
            "steps": ("steps", "{:,.0f}"),
        }


def compare_fields(
    scene: Scene | str | Path,
    field: str = "",
    methods: Sequence[str] | None = None,
    output: str | Path | None = None,
    *,
    clock: str = "cpu",
    repeats: int = 3,
    patience: float = 10.0,
    budget: float | None = None,
    threads: int | None = None,
    overwrite: bool = False,
    progress: Callable[[str], None] | None = None,
) -> FieldPrecision:
    """Measure error and time of solvers on the fields of a scene's last coupling step.

    The scene is run once. Each solver then meets the same equation: a transient field is brought
    through the step, a steady one is brought to rest, by time-marching solvers for longer and
    longer. The reference is CVODE at a tolerance of 1e-10, of steady fields marched until they
    rest; it is compared with itself at 1e-9, and with Newton's method.

    Parameters
    ----------
    scene
        The scene, the name of a built-in one, or a TOML file.
    field
        Its name, by default the first one; fields that react with it are solved with it.
    methods
        Names as ``nutrients.NAME.solver`` takes them, by default all that fit the regime.
    output
        Folder for the files of :meth:`FieldPrecision.save`.
    clock, repeats, patience, budget, threads, overwrite, progress
        As for :func:`multicell.compare`; solves that seem to take longer than ``patience`` are left
        out, and ``threads`` are those of the run.

    Raises
    ------
    SceneError, OutputError
        For input that cannot be used.
    StepFailed
        If the scene cannot be run, or the reference cannot be computed.
    """
    described = scene if isinstance(scene, Scene) else load_scene(scene)
    if clock not in CLOCKS:
        raise SceneError("clock", f"is {clock!r}, must be {' or '.join(map(repr, CLOCKS))}")
    tell, name = progress or (lambda _: None), which_field(described, field)
    chosen = _solvers(methods)
    what = {"field": name, "clock": clock, "repeats": repeats, "patience": patience,
            "budget": budget, "threads": threads}  # fmt: skip
    with open_measurements(
        output, COMPARISON_FILES, described, what, chosen, chosen, overwrite=overwrite
    ) as measured:
        if output is not None and measured.has(chosen) and (Path(output) / NUMBERS_FILE).is_file():
            result = FieldPrecision.read(Path(output) / NUMBERS_FILE)
            result.save(output)  # what is made of it is all that was lacking
            return result
        step = record_fields(described, name, threads, tell)
        tell("reference")
        exact = _Exact.of(step)
        total = default_budget(exact.wall) if budget is None else budget
        table: list[Row] = []
        unfit = "multicell-march" if step.steady else "multicell-steady"
        for solver in chosen:
            if solver != unfit:
                share = total / len(chosen)
                table += _climb(solver, step, exact, (patience, share), measured, tell)
        tell("timing, all solvers in turns")
        solved = [(row, list[tuple[float, float]]()) for row in table if row["status"] == SOLVED]
        for _ in range(repeats):
            for row, times in solved:
                again = solve_fields(step, row["method"], row["control"], row["setting"])
                times.append((again.wall, again.cpu))
                row.update(solve_times(times))
        facts = _facts(step, exact, [] if methods is None else chosen)
        result = FieldPrecision(described, table, facts, exact.errors, clock)
        if output is not None:
            result.save(output)
    return result


@final
class _Exact(NamedTuple):
    """The solution that others are compared with.

    - ``data``, (m, ...) mM; ``errors``: its uncertainty in each norm; ``words``
    - ``wall``, s: that it took; ``rate``, s: one evaluation of all rates
    """

    data: FloatArray
    errors: dict[str, float]
    words: str
    wall: float
    rate: float

    @classmethod
    def of(cls, step: FieldStep) -> _Exact:
        """Return the reference of a step; raises StepFailed where there is none."""
        if step.steady:
            begin = perf_counter()
            data, other = _at_rest(step), solve_fields(step, "multicell-steady", "none", 0.0)
            wall, words = perf_counter() - begin, "CVODE until the field rests, and Newton's method"
        else:
            found = solve_fields(step, "multicell-implicit", "tolerance", _SURE)
            other = solve_fields(step, "multicell-implicit", "tolerance", 10.0 * _SURE)
            data, wall, words = found.data, found.wall, "CVODE at 1e-10, and at 1e-9"
            _require(step, found)
        _require(step, other)
        begin = perf_counter()
        step.equation.rates(step.data, step.end)
        rate = perf_counter() - begin
        return cls(data, _errors(step, other.data, data), words, wall, rate)


def _at_rest(step: FieldStep) -> FloatArray:
    """Return steady fields as marched to rest."""
    try:
        return settle(step.equation, "multicell-implicit", step.data, step.end, step.scales)[0]
    except NutrientFailed as failure:
        raise StepFailed(step.end, str(failure), "", None) from failure


def _require(step: FieldStep, found: FieldRun) -> None:
    if found.problem:
        raise StepFailed(step.begin, found.problem, "", None)


def _errors(step: FieldStep, found: FloatArray, exact: FloatArray) -> dict[str, float]:
    return {"nodes": step.at_nodes(found, exact), "worst_cell": step.at_cells(found, exact)}


def _solvers(names: Sequence[str] | None) -> list[str]:
    """Return names of solvers, each once; absent: all. Raises SceneError."""
    known = [name for name in known_solvers() if name not in ("auto", "explicit")]  # twice there
    for name in names or ():
        if name not in (*known, "explicit"):
            raise SceneError("methods", f"has no {name!r}", near_miss(str(name), known))
    return list(dict.fromkeys(known if names is None else names))


def _settings(step: FieldStep, name: str) -> tuple[str, list[float]]:
    """Return the control of a solver, and its settings from coarse to fine."""
    fastest, span = step.equation.fastest(step.data), step.end - step.begin
    if step.steady:
        if name == "multicell-steady":
            return "none", [0.0]
        return "time", [100.0 / fastest * _FINER**k for k in range(_MARCHES)]
    longest = longest_step(name, fastest)
    if name == "multicell-march" or not math.isfinite(longest):
        return "tolerance", [10.0**-k for k in range(1, _RUNGS + 1)]
    return "step", [min(longest, span) / _FINER**k for k in range(_RUNGS)]


def _foreseen(step: FieldStep, name: str, exact: _Exact, control: str, setting: float) -> float:
    """Return the time in s that a solve takes at least, as far as that is known."""
    fastest, span = step.equation.fastest(step.data), step.end - step.begin
    if control == "time":
        span = setting
    longest = longest_step(name, fastest)
    if name in (*OWN_SOLVERS, "multicell-implicit"):
        return 0.0
    if not math.isfinite(longest):  # SciPy's, of six stages
        return 6.0 * _EXPLICIT * fastest * span * exact.rate
    return span / (setting if control == "step" else longest) * exact.rate


def _climb(
    name: str,
    step: FieldStep,
    exact: _Exact,
    limits: tuple[float, float],
    measured: Measurements,
    tell: Callable[[str], None],
) -> list[Row]:
    """Solve by one solver from coarse to fine, until patience or budget end; return its rows."""
    known = measured.find(name)
    if known is not None:
        tell(f"{name}: was measured before")
        return list(known["rows"])
    (patience, budget), rows = limits, []
    control, settings = _settings(step, name)
    spent = 0.0
    for setting in settings:
        foreseen = _foreseen(step, name, exact, control, setting)
        if foreseen > patience or spent + foreseen > budget:
            words = f"not tried: it would take about {foreseen:.2g} s, after {spent:.2g} s"
            rows.append(_row(name, control, setting, SKIPPED, words=words))
            continue
        tell(f"{name} at {setting:.3g}")
        found = solve_fields(step, name, control, setting)
        spent += found.wall
        if found.problem:
            rows.append(_row(name, control, setting, FAILED, words=found.problem, spent=found.wall))
            continue
        errors = _errors(step, found.data, exact.data)
        columns = {f"error_{norm}": error for norm, error in errors.items()}
        rows.append(
            _row(name, control, setting, SOLVED, steps=found.steps, spent=found.wall, **columns)
        )
        if control == "time" and errors["nodes"] < _FOLLOWED:
            break
    measured.add(name, rows=rows)
    return rows


def _row(name: str, control: str, setting: float, status: str, **known: Any) -> Row:
    columns = *(f"error_{norm}" for norm in FIELD_NORMS), "steps"
    return solve_row(name, control, setting, status, columns, _MODE, **known)


def _facts(step: FieldStep, exact: _Exact, named: list[str]) -> dict[str, Any]:
    """Return facts about the problem for readers of the chart."""
    change = _errors(step, step.data, exact.data)
    return {
        "fields": step.names,
        "regime": "steady" if step.steady else "transient",
        "nodes": math.prod(step.equation.layout.shape),
        "cells": [len(step.position)] * 2,
        "mode": f"{_MODE} of {' and '.join(step.names)}, which changes by {change['nodes']:.1e}",
        "change": change,
        "stepwise": 1,
        "coupling_steps": 1,
        "time": step.end - step.begin,
        "largest_decay_rate": step.equation.fastest(step.data),
        "threads": 1,
        "reference": exact.words,
        "reference_wall": exact.wall,
        "named": named,
        "looks": _LOOKS,
        "versions": versions(),
    }
