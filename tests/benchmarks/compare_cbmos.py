"""CBMOS's own problem with our methods: evaluations and time for a given error.

Problem   1 000 cells in a hexagonal close-packed ball at 0.8 of the rest distance, displaced
          at random by 0.05, cubic force with μ = 50 (12.5 per length at rest), cutoff 1.5,
          drag 1, until T = 1; lengths in cell diameters (Mathias et al. 2020 and 2022).
Theirs    BDF at 1e-3: 96 evaluations and 4 dense Jacobians for an error of 1e-3; RK23 at 1e-6:
          329 evaluations for 7e-6; 41 ms an evaluation, so 10 to 14 s on the machine that
          this project is developed on.
Found     The first is met by Adams formulas with a Jacobian that is kept: an error of 3.4e-4 with
          90 evaluations, 2 sparse Jacobians and 169 products with them in 0.055 s. The second
          has few evaluations (201, with 4 Jacobians and 289 products, 6.0e-6 in 0.087 s) only
          where products are not counted, each of which costs about half an evaluation; dopri5
          has it with 356 evaluations and no Jacobian (5.6e-6 in 0.063 s). cvode-sparse is left
          out: it did not end within half a minute.
Cost      a minute
Command   python tests/benchmarks/compare_cbmos.py
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from multicell.biology.initial import packed_ball
from multicell.contact.springs import Cubic
from multicell.integrators.registry import from_options
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.scene.parts import IntegratorOptions

KEPT = "cvode-adams, J kept"
"""Linearises only when SUNDIALS asks for it, which is every fifty steps."""
CELLS, SPACING, NOISE, END = 1000, 0.8, 0.05, 1.0
CANDIDATES = (
    "euler-adaptive", "ab2-adaptive", "dopri5", "rkc2", "cvode", "cvode-adams", KEPT, "auto"
)  # fmt: skip
TARGETS = ((1e-3, 96, 4), (7e-6, 329, 0))
"""Error in cell diameters, and their evaluations and Jacobians for it."""
LONGEST = 0.10
"""Seconds: a hundredth of their shortest time."""


@dataclass(frozen=True)
class Row:
    """What one method needed at one tolerance, and its error."""

    method: str
    tolerance: float
    error: float
    evaluations: int
    jacobians: int
    products: int
    wall: float

    def __str__(self) -> str:
        return (
            f"{self.method} at {self.tolerance:.1e}: error {self.error:.1e}, {self.evaluations} "
            f"evaluations, {self.jacobians} J, {self.products} J v, {self.wall:.3f} s"
        )


def verdict(rows: list[Row], error: float, evaluations: int, jacobians: int) -> str:
    """Return a sentence: whether a target is met, and by what.

    Products with J are made from sparse J of 1000 cells; each costs less than an evaluation. They
    are shown, and those who count them as evaluations find the sum that they ask for.
    """
    close = [row for row in rows if row.error <= error]
    few = [row for row in close if row.evaluations < evaluations]
    met = [row for row in few if row.jacobians <= jacobians and row.wall < LONGEST]
    allowed = f"fewer than {evaluations} evaluations" + (
        f" and {jacobians} Jacobians" if jacobians else ""
    )
    text = f"Error {error:.0e} with {allowed} in under {LONGEST:g} s: "
    if met:
        return text + "met by " + str(min(met, key=lambda row: row.wall)) + "."
    text += "not met. "
    if few:
        text += f"Few evaluations, but more Jacobians or time: {min(few, key=_work)}. "
    if close:
        text += f"Fastest with that error: {min(close, key=lambda row: row.wall)}."
    return text


def _work(row: Row) -> int:
    return row.evaluations + row.jacobians + row.products


def setup(seed: int = 0) -> np.ndarray:
    """Return the centres at the start, (1000, 3), in cell diameters."""
    noise = np.random.default_rng(seed).normal(0.0, NOISE, (CELLS, 3))
    return SPACING * packed_ball(CELLS) + noise


def solve(position: np.ndarray, method: str, tolerance: float) -> tuple[np.ndarray, Mechanics]:
    """Return the centres at the end, and the mechanics with its counts."""
    system = Mechanics(Cubic(stiffness_at_rest=12.5, cutoff=1.5), 1.0 / (6.0 * math.pi * 0.5))
    half, nothing = np.full(CELLS, 0.5), np.zeros(CELLS)
    system.begin(Motion(half, nothing, np.ones(CELLS), nothing, 0.0, END))
    name = method.partition(",")[0]
    options = IntegratorOptions(
        method=name, rtol=tolerance, atol=tolerance, max_displacement=1.0, max_steps=10**6
    )
    integrator = from_options(options)
    if method == KEPT:
        integrator = replace(integrator, refresh="asked", light=False)
    outcome = integrator.integrate(system, position)
    if not outcome.done:
        raise RuntimeError(outcome.problem)
    return outcome.position, system


def main() -> None:
    """Print a table."""
    start = setup()
    exact, _ = solve(start, "dopri5", 1e-12)
    check, _ = solve(start, "scipy-dop853", 1e-12)
    print(f"reference: dopri5 and SciPy's DOP853 agree to {np.abs(exact - check).max():.1e}")
    print(f"{'method':19} {'tolerance':>9} {'error':>8} {'evaluations':>11} {'J':>5} "
          f"{'J v':>5} {'wall / s':>9}")  # fmt: skip
    rows: list[Row] = []
    for method in CANDIDATES:
        # Euler's steps shrink like the tolerance: it would take minutes below
        finest = {"euler-adaptive": 4.1}.get(method, 7.1 if "cvode" in method else 6.6)
        for tolerance in 10.0 ** -np.arange(1.5, finest, 0.25):
            end, system = solve(start, method, float(tolerance))
            walls = []
            for _ in range(3):
                begin = time.perf_counter()
                solve(start, method, float(tolerance))
                walls.append(time.perf_counter() - begin)
            error = np.linalg.norm(end - exact, axis=1).max()
            work = system.work
            print(f"{method:19} {tolerance:9.1e} {error:8.1e} {work.evaluations:11} "
                  f"{work.linearisations:5} {work.jacobian_products:5} "
                  f"{min(walls):9.4f}", flush=True)  # fmt: skip
            rows.append(Row(method, float(tolerance), float(error), work.evaluations,
                            work.linearisations, work.jacobian_products, min(walls)))  # fmt: skip
    for target in TARGETS:
        print(verdict(rows, *target))


if __name__ == "__main__":
    main()
