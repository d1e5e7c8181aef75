"""Solve a problem of a paper by methods of the package, and what its script prints and draws.

Lengths are in cell diameters and times in hours, as in the papers; the package's own units (µm, s)
stand for them. The drag coefficient of every cell is 1.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from multicell.contact.law import PairLaw
from multicell.integrators.registry import METHODS, from_options
from multicell.mechanics.motion import Motion, Work
from multicell.mechanics.system import Mechanics
from multicell.scene.parts import IntegratorOptions

DOCS = Path(__file__).parents[1]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Solution:
    """Centres (k, n, 3) at the times asked for, up to the last that was reached, and their cost."""

    path: Array
    work: Work
    cpu: float
    problem: str = ""

    @property
    def cost(self) -> int:
        """Evaluations, Jacobians and products with them; a list is not counted."""
        work = self.work
        return work.evaluations + work.linearisations + work.jacobian_products


def mechanics(law: PairLaw) -> Mechanics:
    """Return equations of motion of cells of diameter 1 with a drag coefficient of 1."""
    return Mechanics(law, 1.0 / (6.0 * math.pi * 0.5))


def motion(cells: int, begin: float, end: float) -> Motion:
    """Return the arrays of cells that neither grow nor are driven."""
    none = np.zeros(cells)
    return Motion(np.full(cells, 0.5), none, np.ones(cells), none, begin, end)


def solve(
    law: PairLaw, start: Array, times: Sequence[float] | Array, method: str, setting: float
) -> Solution:
    """Solve from ``start``, (n, 3), and return the centres at ``times``.

    ``setting`` is the step of a method with a fixed one, else its tolerance in both measures.
    A method starts anew at each of the times. Cells may go as far in a step as they will.
    """
    system, cells = mechanics(law), len(start)
    given = (
        {"step": setting, "atol": 1e-6}
        if METHODS[method].control == "step"
        else {"rtol": max(setting, 1e-14), "atol": setting}
    )
    options = IntegratorOptions(method=method, max_steps=10**7, **given)
    integrator = replace(from_options(options), max_displacement=math.inf)
    path, begun = [np.array(start)], time.process_time()
    for begin, end in pairwise(times):
        system.begin(motion(cells, begin, end))
        outcome = integrator.integrate(system, path[-1])
        if not outcome.done:
            return Solution(
                np.array(path), system.work, time.process_time() - begun, outcome.problem
            )
        path.append(outcome.position)
    return Solution(np.array(path), system.work, time.process_time() - begun)


def pick(frame: pd.DataFrame, **equal: object) -> pd.DataFrame:
    """Return the rows whose columns have these values."""
    for name, value in equal.items():
        frame = frame[frame[name] == value]
    return frame


def order(steps: Iterable[float], errors: Iterable[float]) -> float:
    """Return the slope of log error over log step, by regression."""
    return float(np.polyfit(np.log(list(steps)), np.log(list(errors)), 1)[0])


def reached(errors: Iterable[float], costs: Iterable[float], error: float) -> float:
    """Return the least cost of an error by interpolation of logarithms; NaN if never reached.

    Along the ladder of a method the cost rises; the first interval that ends at or below the error
    counts, and a method that begins below it has the cost of its first setting.
    """
    rows = sorted(zip(costs, errors, strict=True))
    for (cost, above), (more, below) in zip(rows[:1] + rows, rows, strict=False):
        if below <= error:
            if above <= error:
                return float(more)
            part = math.log(error / above) / math.log(below / above)
            return float(math.exp(math.log(cost) + part * math.log(more / cost)))
    return math.nan


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in Markdown; numbers with two digits, NaN as a dash."""

    def cell(value: object) -> str:
        if not isinstance(value, float):
            return str(value)
        return "–" if math.isnan(value) else f"{value:.2g}" if value < 100 else f"{value:.0f}"

    lines = [header, ["---"] * len(header), *([cell(v) for v in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
