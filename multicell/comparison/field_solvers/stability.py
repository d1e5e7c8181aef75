"""Where solvers of fields fail: steps or tolerances against the strength of uptake.

Uptake is stated as a Thiele modulus: the radius of the tissue over the depth to which a substance
is fed where uptake is linear, R sqrt(q / (K D)) with the mean largest uptake q per volume of the
nodes that take up at all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from multicell.comparison.field_solvers.measure import attempted, judged
from multicell.comparison.field_solvers.problems import Case, Piece, fastest_rate, scaled
from multicell.comparison.field_solvers.reference import Exact, on_one_grid
from multicell.comparison.field_solvers.solvers import CONTROLLED, DIRECT, FieldSolver
from multicell.comparison.files import Row

FACTORS: Final = tuple(10.0**k for k in np.arange(-1.0, 3.51, 0.9))
"""Uptake over that of the scene."""

STEPS: Final = tuple(2.0**k for k in range(-4, 6))
"""Steps over the largest stable one of explicit Euler without uptake."""

TRIAL_PATIENCE: Final = 0.2
"""Longest trial over the longest solve of the comparison."""

TOLERANCES: Final = tuple(10.0**-k for k in range(1, 7))
"""Tolerances over the scale."""


def stability_rows(
    problem: Case,
    solvers: Sequence[FieldSolver],
    backend: str,
    patience: float,
    tell: Callable[[str], None],
) -> list[Row]:
    """Return how each solver ends for each step or tolerance and strength of uptake.

    Steps are relative to explicit Euler's limit without uptake, which is the same in all rows.
    """
    rows: list[Row] = []
    diffusive = 2.0 / fastest_rate(scaled(problem.whole, 0.0), problem.scale, problem.start)
    for factor in FACTORS:
        equation = scaled(problem.whole, factor)
        limit = 2.0 / fastest_rate(equation, problem.scale, problem.start)
        piece = Piece(equation, 0.0, problem.end)
        stiff = replace(problem, whole=equation, pieces=(piece,), limit=diffusive)
        exact = on_one_grid(stiff)
        modulus = thiele(stiff)
        for solver in solvers:
            if solver.kind == DIRECT or solver.refusal(stiff):
                continue
            tell(f"stability: {solver.name} at a Thiele modulus of {modulus:.2g}")
            for setting in TOLERANCES if solver.kind == CONTROLLED else STEPS:
                row = _trial(solver, stiff, setting, backend, TRIAL_PATIENCE * patience, exact)
                about = {"factor": factor, "thiele": modulus, "limit": limit / diffusive}
                rows.append({**row, **about, "explicit_limit": diffusive})
    return rows


def _trial(
    solver: FieldSolver, problem: Case, setting: float, backend: str, patience: float, exact: Exact
) -> Row:
    """Return how one solve ends."""
    data, _, found = attempted(solver, problem, setting, backend, patience)
    kind, words, error = found["kind"], found["words"], math.nan
    if data is not None:
        kind, words, error = judged(data, exact, problem.scale)
    return {
        "field": problem.field, "geometry": problem.geometry,
        "spacing": problem.layout.spacing, "nodes": problem.nodes, "solver": solver.name,
        "backend": "kernels" if solver.ours else backend, "control": solver.control(problem),
        "setting": setting, "kind": kind, "words": words, "error": error, "cpu": found["cpu"],
    }  # fmt: skip


def thiele(problem: Case) -> float:
    """Return the Thiele modulus of a problem's tissue."""
    term = next(iter(problem.whole.terms.values()))
    substance, volumes = term.substance, np.broadcast_to(problem.layout.volumes, term.shape)
    takes = term.sink > 0.0
    if not takes.any():
        return 0.0
    volume = float(volumes[takes].sum())
    demand = float((volumes * term.sink)[takes].sum()) / volume
    radius = float((0.75 * volume / math.pi) ** (1.0 / 3.0))
    return radius * math.sqrt(demand / (substance.half_saturation * substance.diffusion))
