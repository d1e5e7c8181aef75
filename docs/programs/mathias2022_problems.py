"""The four problems, three laws and the backward Euler of Mathias, Coulier and Hellander (2022).

Parameters and starts are those of the experiments of github.com/somathias/cbmos at the tag
exp-Mathias2022, lengths in cell diameters, times in hours. ``mathias2022.py`` solves them.
"""

from __future__ import annotations

import heapq
import math
from typing import Any

import numpy as np
from papers import Array, mechanics, motion, solve
from scipy.sparse.linalg import LinearOperator, gmres

import multicell as mc
from multicell.contact.springs import CubicSpring, GeneralisedLinearSpring


@mc.pair_law(
    parameters=dict.fromkeys(("adhesion_strength", "repulsion_strength", "far", "near"), ""),
    reach=lambda modulus, radius, rest, p: (p.far - 1.0) * rest,
    stiffness=lambda overlap, modulus, radius, p, rest: (
        2.0 * p.repulsion_strength / p.near * max(1.0 - (rest - overlap) / p.near, 0.0)
        - 2.0 * p.adhesion_strength / p.far * max(1.0 - (rest - overlap) / p.far, 0.0)
    ),
    energy=lambda overlap, modulus, radius, p, rest: (
        p.repulsion_strength * p.near / 3.0 * max(1.0 - (rest - overlap) / p.near, 0.0) ** 3
        - p.adhesion_strength * p.far / 3.0 * max(1.0 - (rest - overlap) / p.far, 0.0) ** 3
    ),
)
def Quadratic(overlap, modulus, radius, p, rest):  # type: ignore[no-untyped-def]  # noqa: N802
    """F = μ_R (1 - r / near)² - μ_A (1 - r / far)² at a distance r, each part up to its range."""
    r = rest - overlap
    push = max(1.0 - r / p.near, 0.0)
    pull = max(1.0 - r / p.far, 0.0)
    return p.repulsion_strength * push * push - p.adhesion_strength * pull * pull


LAWS = {
    "cubic": CubicSpring(stiffness_at_rest=5.7 * 0.5**2, cutoff=1.5),
    "quadratic": Quadratic(
        adhesion_strength=0.21 * 9.1,
        repulsion_strength=9.1,
        far=1.5,
        near=1.0 / (1.0 - math.sqrt(0.21) / 3.0),
    ),
    "GLS": GeneralisedLinearSpring(stiffness_at_rest=1.95, cutoff=1.5, decay=7.51),
}


class _Tie:
    """An event that is due no earlier than any other."""

    def __lt__(self, other: object) -> bool:
        return False


def problems() -> dict[str, tuple[Array, float, int]]:
    """Return start (n, 3), end in hours and number of dimensions of each problem."""
    rows = np.array([(i + 0.5 * (j % 2), 0.75**0.5 * j, 0.0) for j in range(5) for i in range(5)])
    sheet = np.delete(rows, [0, 4, 9, 19, 20, 24], axis=0)
    # CBMOS draws directions as its queue of simultaneous divisions happens to be sorted
    queue = [(_Tie(), i) for i in range(len(sheet))]
    heapq.heapify(queue)
    angle = np.empty(len(sheet))
    draws = 2.0 * np.pi * np.random.RandomState(17).rand(len(sheet))
    for value in draws:
        angle[heapq.heappop(queue)[1]] = value
    shift = 0.15 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    born = np.concatenate([sheet - shift, sheet + shift])
    large = np.array(
        [(i + 0.5 * (j % 2), 0.75**0.5 * j, 0.0) for j in range(20) for i in range(20)]
    )
    return {
        "daughters": (np.array([(0.0, 0.0, 0.0), (0.3, 0.0, 0.0)]), 1.0, 1),
        "adhering": (np.array([(0.0, 0.0, 0.0), (1.15, 0.0, 0.0)]), 3.0, 1),
        "divided": (solve(LAWS["quadratic"], born, [0, 1e-4], "dopri5", 1e-12).path[-1], 3.0, 2),
        "compressed": (0.8 * large, 3.0, 2),
    }


def trajectory_error(times: Array, path: Array, at: Array, exact: Array, dim: int) -> float:
    """Return the papers' error of a path (k, n, 3) against an exact one at the times ``at``."""
    place = np.minimum(np.searchsorted(times, at, "right"), len(times) - 1)
    before = np.maximum(place - 1, 0)
    part = np.clip((at - times[before]) / np.maximum(times[place] - times[before], 1e-300), 0, 1)
    found = path[before] + part[:, None, None] * (path[place] - path[before])
    weight = np.gradient(at)[:, None, None]
    size = np.sqrt((weight * exact[..., :dim] ** 2).sum(axis=0))
    away = np.sqrt((weight * (found - exact)[..., :dim] ** 2).sum(axis=0))
    return float((away / size).mean(axis=0).sum())


def inexact_euler(
    law: Any,
    start: Array,
    times: Array,
    dim: int,
    *,
    first: bool = True,
    vectors: int = 5,
    tolerance: float | None = None,
) -> tuple[Array, int]:
    """Return path and evaluations of backward Euler with the settings of CBMOS in the paper.

    Newton's method from the last centres until a relative correction below min(0.01, Δt), at most
    20 times; products by differences over 1e-3; GMRES with at most five vectors, no
    preconditioner, and that same number as relative and absolute tolerance of the residual.
    ``first``: whether GMRES makes an iteration before it checks its tolerance, as SciPy's did
    until its pull request 19952 of 2024; without, a residual below the tolerance moves no cell.
    """
    system, trial = mechanics(law), np.zeros_like(start)
    system.begin(motion(len(start), times[0], times[-1]))
    count, step = 0, float(times[1] - times[0])

    def velocity(y: Array) -> Array:
        nonlocal count
        count += 1
        trial[:, :dim] = y.reshape(-1, dim)
        system.velocity(0.0, trial, out := np.empty_like(trial))
        return out[:, :dim].ravel()

    tolerance = min(0.01, step) if tolerance is None else tolerance
    y, path = start[:, :dim].ravel(), [start]
    for _ in times[1:]:
        new = y.copy()
        for _ in range(20):
            residual = new - y - step * velocity(new)

            def product(v: Array, new: Array = new, residual: Array = residual) -> Array:
                moved = new + 1e-3 * v
                return (moved - y - step * velocity(moved) - residual) / 1e-3  # noqa: B023

            norm = float(np.linalg.norm(residual))
            ends = max(tolerance * norm, tolerance)
            change, _ = gmres(
                LinearOperator((len(y), len(y)), matvec=product), -residual, rtol=0.0,
                atol=min(ends, 0.999999 * norm) if first else ends, restart=vectors,
                maxiter=1,
            )  # fmt: skip
            new = new + change
            if np.linalg.norm(change) < tolerance * np.linalg.norm(new):
                break
        y = new
        path.append(np.zeros_like(start))
        path[-1][:, :dim] = y.reshape(-1, dim)
    return np.array(path), count
