"""CBMOS's own problem with our methods: evaluations and time for a given error.

Problem   1 000 cells in a hexagonal close-packed ball at 0.8 of the rest distance, displaced
          at random by 0.05, cubic force with μ = 50 (12.5 per length at rest), cutoff 1.5,
          drag 1, until T = 1; lengths in cell diameters (Mathias et al. 2020 and 2022).
Theirs    BDF at 1e-3: 96 evaluations and 4 dense Jacobians for an error of 1e-3; RK23 at 1e-6:
          329 evaluations for 7e-6; 41 ms an evaluation, so 10 to 14 s on the machine that
          this project is developed on.
Cost      half a minute
Command   python tests/benchmarks/compare_cbmos.py
"""

from __future__ import annotations

import math
import time

import numpy as np

from multicell.biology.initial import packed_ball
from multicell.contact import Cubic
from multicell.integrators import METHODS, make
from multicell.mechanics import Mechanics, Motion
from multicell.parts import IntegratorOptions

CELLS, SPACING, NOISE, END = 1000, 0.8, 0.05, 1.0
CANDIDATES = ("euler-adaptive", "dopri5", "rkc2", "cvode", "cvode-sparse", "auto")


def setup(seed: int = 0) -> np.ndarray:
    """Return the centres at the start, (1000, 3), in cell diameters."""
    noise = np.random.default_rng(seed).normal(0.0, NOISE, (CELLS, 3))
    return SPACING * packed_ball(CELLS) + noise


def solve(position: np.ndarray, method: str, tolerance: float) -> tuple[np.ndarray, Mechanics]:
    """Return the centres at the end, and the mechanics with its counts."""
    system = Mechanics(Cubic(stiffness_at_rest=12.5, cutoff=1.5), 1.0 / (6.0 * math.pi * 0.5))
    half, nothing = np.full(CELLS, 0.5), np.zeros(CELLS)
    system.begin(Motion(half, nothing, np.ones(CELLS), nothing, 0.0, END))
    options = IntegratorOptions(
        method=method, rtol=tolerance, atol=tolerance, max_displacement=1.0, max_steps=10**6
    )
    outcome = make(options).integrate(system, position)
    if not outcome.done:
        raise RuntimeError(outcome.problem)
    return outcome.position, system


def main() -> None:
    """Print a table."""
    start = setup()
    exact, _ = solve(start, "dopri5", 1e-12)
    check, _ = solve(start, "scipy-dop853", 1e-12)
    print(f"reference: dopri5 and SciPy's DOP853 agree to {np.abs(exact - check).max():.1e}")
    print(f"{'method':15} {'tolerance':>9} {'error':>8} {'evaluations':>11} {'J':>5} "
          f"{'J v':>5} {'wall / s':>9}")  # fmt: skip
    for method in CANDIDATES:
        if method not in METHODS:
            continue
        # Euler's steps shrink like the tolerance: it would take minutes below
        finest = 4.1 if method == "euler-adaptive" else 6.6
        for tolerance in 10.0 ** -np.arange(1.5, finest, 0.5):
            end, system = solve(start, method, float(tolerance))
            walls = []
            for _ in range(3):
                begin = time.perf_counter()
                solve(start, method, float(tolerance))
                walls.append(time.perf_counter() - begin)
            error = np.linalg.norm(end - exact, axis=1).max()
            work = system.work
            print(f"{method:15} {tolerance:9.1e} {error:8.1e} {work.evaluations:11} "
                  f"{work.linearisations:5} {work.jacobian_products:5} "
                  f"{min(walls):9.4f}")  # fmt: skip


if __name__ == "__main__":
    main()
