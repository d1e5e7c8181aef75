"""Fit the model of costs of `auto` to the solves of auto_costs.py; write it as data.

What is minimised is the mean of log(cost of the chosen method over the least) at equal tolerances,
in which the choice is made gradual, and a part of the squares of log(counted / expected), which
keeps the expectations what they are called. All scenes weigh the same. Costs of a pass are medians
of CPU times, in those of a compiled evaluation of many cells. Two more numbers say what a run may
learn: how a step that is dearer than expected by one method is by another, and in the next step.
"""

from __future__ import annotations

import math
from collections import Counter
from itertools import combinations, pairwise
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

import multicell
from multicell.integrators import auto

Row = dict[str, Any]
Array = NDArray[np.float64]
KINDS = {
    "ab2-adaptive": "stability",
    "rk4-adaptive": "stability",
    "rkc2": "stabilised",
    "rosenbrock": "implicit",
    "cvode": "implicit",
}
LOGARITHMIC = ("steps", "onset", "start", "rate")
"""What is fitted as its logarithm."""
USUAL = {"steps": (-3.0, 6.0), "onset": (-6.0, 6.0), "power": (0.0, 0.8), "cells": (0.0, 0.3)}
BOUNDS = {
    "ab2-adaptive": {"relief": (0.0, 0.0), "start": (1.5, 3.5), "rate": (-0.4, 0.2)},
    "rk4-adaptive": {"relief": (0.0, 0.0), "start": (2.5, 4.0), "rate": (0.1, 0.6)},
    "rkc2": {"relief": (0.0, 0.4), "start": (2.7, 4.0), "rate": (0.0, 0.8)},
    "rosenbrock": {
        "relief": (0.0, 0.4),
        "start": (2.5, 4.0),
        "rate": (-2.0, 3.0),
        "growth": (0.15, 0.5),
    },
    "cvode": {
        "relief": (0.0, 0.4),
        "start": (1.5, 4.0),
        "rate": (-2.0, 3.0),
        "growth": (0.15, 0.5),
    },
}
"""Between what each number may be: λΔt at the limit of stability, and what data do not reach."""
BEGIN = {
    "steps": (0.05, 0.62, 3.3, 2.8, 2.3),
    "onset": (1.4, 6.0, -0.6, 5.2, 6.0),
    "power": (0.58, 0.31, 0.36, 0.33, 0.28),
    "cells": (0.13, 0.18, 0.15, 0.26, 0.3),
    "relief": (0.0, 0.0, 0.05, 0.1, 0.1),
    "start": (2.4, 3.4, 2.8, 2.5, 2.0),
    "rate": (0.0, 0.36, 0.3, -0.6, -1.0),
    "growth": (0.0, 0.0, 0.0, 0.23, 0.15),
}
"""Where the fit begins, for each method."""
LOOSEST, WRONG, UNSURE = 0.35, 1.0, 0.02
"""Tolerances, µm, and errors above which a solve says nothing; and uncertainties of a reference."""
REACHED = 1e-3
"""Error at which no finer tolerances of a method were tried: they cost about as much."""
GRADUAL, SQUARES, SOFT = 0.15, (1.0, 0.3), 0.3
"""Logarithm of the costs over which the choice is gradual; weight of the squares, in turns; and
log(counted / expected) from which on they count as distances."""
LARGEST, NOT_SOLVED = 2.5, 2.0
"""Log(cost / least) that counts at most, and that of a method that was given up as too dear."""
MANY, SOME = 600, (50, 300)
"""Cells from which on a pass costs what its cells do, and of runs where calls are seen."""


class Sample(NamedTuple):
    """Solves at one tolerance of a step: passes and unit by each method, and what they follow from.

    - ``place``: scene, step and tolerance
    """

    place: tuple[str, int, float]
    passes: dict[str, float]
    units: dict[str, float]
    states: dict[str, tuple[float, float, float]]


def fit(rows: list[Row]) -> str:
    """Write costs.toml from rows of auto_costs.py; return it, and what it reaches."""
    units = _units(rows)
    samples = _samples(rows, units)
    names = [(method, name) for method in KINDS for name in _bounds(method)]
    bounds = [_bounds(method)[name] for method, name in names]
    target = _Target(samples)
    first = np.array([BEGIN[name][list(KINDS).index(method)] for method, name in names])
    found = np.clip(first, *np.transpose(bounds))
    for squares in SQUARES:
        found = minimize(
            lambda x, squares=squares: target.value(_tables(names, x), squares),
            found,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": 200},
        ).x
    tables = {
        method: {name: float(f"{x:.3g}") for name, x in table.items()}
        for method, table in _tables(names, found).items()
    }
    alike, gain = target.learning(tables)
    text = _toml(tables, units, alike, gain)
    place = Path(multicell.__file__).parent / "integrators" / "costs.toml"
    place.write_text(text, encoding="utf-8")
    mean, third, twice = target.reached(tables)
    return (
        f"{text}\n{len(samples)} samples: dearer than the cheapest method by {mean:.3f} in the "
        f"mean of the logarithm, by more than 1.3 times in {third:.0%}, twice in {twice:.0%}"
    )


def _bounds(method: str) -> dict[str, tuple[float, float]]:
    return USUAL | BOUNDS[method]


def _tables(names: list[tuple[str, str]], x: Array) -> dict[str, dict[str, float]]:
    tables: dict[str, dict[str, float]] = {method: {} for method in KINDS}
    for (method, name), value in zip(names, x, strict=True):
        tables[method][name] = math.exp(value) if name in LOGARITHMIC else float(value)
    return tables


def _units(rows: list[Row]) -> dict[str, dict[str, float]]:
    """Return cost of a pass by each method: for a cell, for a call, and for one through Python."""

    def seconds(method: str, low: int, high: float, python: bool) -> tuple[float, float]:
        """Return s of a pass for each cell, and of how many cells."""
        passes = [
            (s["cpu"] / s["passes"] / row["cells"], row["cells"])
            for row in rows
            for s in row["solves"]
            if s["method"] == method
            and s["passes"] > 0
            and not row["friction"]
            and low <= row["cells"] <= high
            and row["python"] == python
        ]
        # load on the machine adds to CPU times and takes nothing away
        return float(np.quantile([x for x, _ in passes], 0.2)), median(n for _, n in passes)

    cell = {m: seconds(m, MANY, math.inf, False)[0] for m in KINDS}
    one = median(cell[m] for m, kind in KINDS.items() if kind != "implicit")
    units = {}
    for method in KINDS:
        # what differs between compiled explicit methods is noise
        each = 1.0 if KINDS[method] != "implicit" else cell[method] / one
        found = {"cell": float(f"{each:.2g}")}
        for name, python in (("call", False), ("python", True)):
            took, n = seconds(method, *SOME, python)
            found[name] = float(f"{max(took / one - each, 0.0) * n:.2g}")
        units[method] = found
    return units


def _samples(rows: list[Row], units: dict[str, dict[str, float]]) -> list[Sample]:
    samples = []
    for row in rows:
        if row["friction"] or row["uncertainty"] > UNSURE:
            continue
        known = {(s["method"], round(4 * math.log10(s["atol"]))): s for s in row["solves"]}
        finest = {s["method"]: s for s in row["solves"]}  # the last ones
        for atol in sorted({s["atol"] for s in row["solves"] if s["atol"] <= LOOSEST}):
            sample = Sample((row["scene"], row["step"], atol), {}, {}, {})
            rate = max(row["stiffness"], 1e-9)
            finer = auto._finer(row["fastest"], rate, atol)
            for method in KINDS:
                wanted = atol * auto._part(method, finer, rate)
                # the ladder has two rungs a decade
                s = known.get((method, 2 * round(2 * math.log10(wanted))), finest.get(method))
                if (
                    s is None
                    or (s["atol"] > 2.0 * wanted and s["error"] > REACHED)
                    or s["failed"]
                    or not s["error"] < WRONG
                ):
                    continue
                each, python = units[method], row["python"]
                call = each["python" if python else "call"]
                sample.passes[method] = max(float(s["passes"]), 1.0)
                sample.units[method] = each["cell"] + call / row["cells"]
                sample.states[method] = (
                    max(row["stiffness"], 1e-6),
                    row["motion"] / s["atol"],
                    row["cells"] / 100.0,
                )
            if len(sample.passes) > 1:
                samples.append(sample)
    return samples


class _Target:
    """The function that is minimised, over all samples at once."""

    def __init__(self, samples: list[Sample]) -> None:
        self.samples = samples
        count = Counter(sample.place[0] for sample in samples)
        weight = np.array([1.0 / count[sample.place[0]] for sample in samples])
        self.weight = weight / weight.sum()
        shape = len(KINDS), len(samples)
        self.passes, self.units = np.full(shape, np.nan), np.ones(shape)
        self.states = np.ones((3, *shape))
        for j, sample in enumerate(samples):
            some = next(iter(sample.states.values()))
            for i, method in enumerate(KINDS):
                self.passes[i, j] = sample.passes.get(method, np.nan)
                self.units[i, j] = sample.units.get(method, 1.0)
                self.states[:, i, j] = sample.states.get(method, some)
        cost = np.log(self.passes * self.units)
        excess = np.minimum(cost - np.nanmin(cost, axis=0), LARGEST)
        self.excess = np.where(np.isfinite(cost), excess, NOT_SOLVED)

    def expected(self, tables: dict[str, dict[str, float]]) -> Array:
        """Return the logarithm of the passes that are expected, of each method and sample."""
        found = [
            np.log(work(KINDS[method], tables[method], *self.states[:, i]))
            for i, method in enumerate(KINDS)
        ]
        return np.array(found)

    def value(self, tables: dict[str, dict[str, float]], squares: float) -> float:
        """Return the target."""
        expected = self.expected(tables)
        cost = expected + np.log(self.units)
        share = np.exp(-(cost - cost.min(axis=0)) / GRADUAL)
        share /= share.sum(axis=0)
        off = np.nan_to_num(expected - np.log(self.passes)) / SOFT
        soft = SOFT**2 * (np.sqrt(1.0 + off**2) - 1.0).sum(axis=0)
        return float(self.weight @ ((share * self.excess).sum(axis=0) + squares * soft))

    def reached(self, tables: dict[str, dict[str, float]]) -> tuple[float, float, float]:
        """Return mean log(cost / least), and how often it is above 1.3 and 2."""
        cost = self.expected(tables) + np.log(self.units)
        excess = self.excess[cost.argmin(axis=0), np.arange(cost.shape[1])]
        above = [float(self.weight @ (excess > math.log(x))) for x in (1.3, 2.0)]
        return float(self.weight @ excess), above[0], above[1]

    def learning(self, tables: dict[str, dict[str, float]]) -> tuple[float, float]:
        """Return slopes of log(counted / expected): on another method's, on the last step's."""
        off = np.log(self.passes) - self.expected(tables)
        alike = [
            np.polyfit(off[a][both], off[b][both], 1)[0]
            for a, b in combinations(range(len(KINDS)), 2)
            if (both := np.isfinite(off[a] + off[b])).sum() > 10
        ]
        place = {sample.place: j for j, sample in enumerate(self.samples)}
        pairs = [
            (off[i, place[scene, k, atol]], off[i, place[scene, after, atol]])
            for scene, steps in _steps(self.samples).items()
            # the first step of a run is like no other
            for k, after in pairwise(steps[1:])
            for atol in {p[2] for p in place if p[:2] == (scene, k)}
            if (scene, after, atol) in place
            for i in range(len(KINDS))
        ]
        each = np.array([pair for pair in pairs if np.isfinite(sum(pair))])
        return float(np.median(alike)), float(np.polyfit(*each.T, 1)[0])


def _steps(samples: list[Sample]) -> dict[str, list[int]]:
    found: dict[str, set[int]] = {}
    for sample in samples:
        found.setdefault(sample.place[0], set()).add(sample.place[1])
    return {scene: sorted(steps) for scene, steps in found.items()}


def work(kind: str, table: dict[str, float], z: Array, motion: Array, hundreds: Array) -> Array:
    """Return the passes as :meth:`.CouplingStep.work` does, of many steps at once."""
    m = table["steps"] * (1.0 + table["onset"] * motion) ** table["power"]
    m = m * hundreds ** table["cells"] / (1.0 + 0.01 * z) ** table["relief"]
    rate, start = table["rate"], table["start"]
    if kind == "stability":
        return np.asarray(start + np.hypot(m, rate * z))
    if kind == "stabilised":
        return np.asarray(start + np.sqrt(m * m + rate * (1.0 + m / 3.0) * z))
    return np.asarray(start + m * (1.0 + rate * (z / m) ** table["growth"]))


def _toml(
    tables: dict[str, dict[str, float]],
    units: dict[str, dict[str, float]],
    alike: float,
    gain: float,
) -> str:
    lines = [
        "# Made from counted work and CPU times of coupling steps, and not by hand.",
        'source = "python tests/benchmarks/auto_costs.py --results FOLDER --fit"',
        f"gain = {gain:.2g}",
        f"alike = {alike:.2g}",
    ]
    for method, kind in KINDS.items():
        lines += ["", f"[{method}]", f'kind = "{kind}"']
        lines += [f"{name} = {value:g}" for name, value in (tables[method] | units[method]).items()]
    return "\n".join(lines) + "\n"
