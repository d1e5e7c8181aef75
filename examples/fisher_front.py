"""The front of a Fisher-Kolmogorov equation, by solvers of py-pde and of multicell
================================================================================

Problem
    Fisher-Kolmogorov: du/dt = D u'' + u (1 - u) in 1/growth rate and D = 1. The front
    u = (1 + exp((x - c t) / sqrt(6)))^-2 with c = 5 / sqrt(6) is exact (Ablowitz & Zeppetella
    1979). Nodes 0.1 apart carry it from t = 0 to 4, by `multicell-implicit`, by py-pde's
    explicit Euler and Runge-Kutta solvers, by SciPy's RK45 through py-pde, and by
    py-pde's Crank-Nicolson, whose fixed-point iteration fails beyond the explicit limit.
Scaling
    Explicit steps are at most h^2 / 2D = 0.005, 800 of them; the front crosses one unit
    of length in 0.5.
Cost
    A few seconds, most of them to load libraries and for the explicit solvers.
Command
    .. code-block:: sh

        python examples/fisher_front.py [FOLDER]

    It writes FOLDER/fisher_front.png.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pde import CartesianGrid, PDEBase, ScalarField
from pde.solvers.base import ConvergenceError

import multicell as mc

LENGTH, NODES, END, START = 50.0, 500, 4.0, 25.0
SPEED = 5.0 / np.sqrt(6.0)
SIDES = {"x": {"derivative": 0.0}}
LIMIT = (LENGTH / NODES) ** 2 / 2.0
"""Largest stable step of explicit Euler."""

ATTEMPTS: dict[str, dict[str, Any]] = {
    "multicell-implicit, rtol 1e-3": {"solver": mc.ImplicitFieldSolver, "rtol": 1e-3},
    "multicell-implicit, rtol 1e-5": {"solver": mc.ImplicitFieldSolver, "rtol": 1e-5},
    "multicell-implicit, rtol 1e-7": {"solver": mc.ImplicitFieldSolver, "rtol": 1e-7},
    "py-pde euler": {"solver": "euler", "dt": 0.9 * LIMIT},
    "py-pde runge-kutta": {"solver": "runge-kutta", "dt": LIMIT},
    "py-pde scipy (RK45)": {"solver": "scipy", "rtol": 1e-5, "atol": 1e-8},
    "py-pde crank-nicolson, step 8 limits": {"solver": "crank-nicolson", "dt": 8.0 * LIMIT},
}


class Fisher(PDEBase):  # type: ignore[misc]
    """Diffusion and logistic growth; the two attributes are all that our solvers ask for."""

    diffusivity = 1.0
    bc = SIDES

    def __init__(self) -> None:
        super().__init__()
        self.evaluations = 0

    def evolution_rate(self, state: ScalarField, t: float = 0.0) -> ScalarField:
        """Return du/dt."""
        self.evaluations += 1
        laplace = state.laplace(self.bc, backend="scipy")
        return laplace + state * (1.0 - state)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Found:
    """What one solver made: evaluations of the rate, s of CPU time, largest errors.

    ``error`` is against the same equation on the same nodes by tight tolerances, and
    ``discrete`` that one's own against the exact front.
    """

    evaluations: int
    seconds: float
    error: float
    discrete: float


def exact(x: NDArray[np.float64], t: float) -> NDArray[np.float64]:
    """Return the front that begins in the middle."""
    return (1.0 + np.exp((x - START - SPEED * t) / np.sqrt(6.0))) ** -2.0


def solved(**options: Any) -> tuple[NDArray[np.float64], int, float]:
    """Return the front at the end, and what it cost; NaN where the solver gives up."""
    grid = CartesianGrid([(0.0, LENGTH)], NODES)
    equation, start = Fisher(), ScalarField(grid, exact(grid.axes_coords[0], 0.0))
    begun = time.process_time()
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # of an iteration that diverges
            end = equation.solve(start, END, backend="numpy", tracker=None, **options).data
    except ConvergenceError:
        end = np.full(NODES, np.nan)
    return end, equation.evaluations, time.process_time() - begun


def compare(attempts: dict[str, dict[str, Any]]) -> dict[str, Found]:
    """Return what each solver makes of the front."""
    tight, _, _ = solved(solver=mc.ImplicitFieldSolver, rtol=1e-10, atol=1e-12)
    x = (np.arange(NODES) + 0.5) * LENGTH / NODES
    discrete = float(np.abs(tight - exact(x, END)).max())
    found = {}
    for name, options in attempts.items():
        end, evaluations, seconds = solved(**options)
        found[name] = Found(evaluations, seconds, float(np.abs(end - tight).max()), discrete)
    return found


def main(output: str | Path) -> dict[str, Found]:
    """Draw error against evaluations; return what each solver made."""
    from matplotlib.figure import Figure

    found = compare(ATTEMPTS)
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.subplots()
    for name, result in found.items():
        ours = name.startswith("multicell")
        if np.isfinite(result.error):
            axes.loglog(result.evaluations, result.error, "o" if ours else "s", label=name)
    axes.axhline(result.discrete, color="grey", linewidth=1, label="error of the nodes")
    axes.set(xlabel="evaluations of the rate", ylabel=f"largest error at t = {END:g}")
    axes.legend(frameon=False, fontsize=8)
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "fisher_front.png", dpi=150)
    return found


if __name__ == "__main__":
    for name, result in main(*(sys.argv[1:2] or ["out/fisher_front"])).items():
        error = f"error {result.error:.1e}" if np.isfinite(result.error) else "failed"
        print(f"{name:38s} {result.evaluations:7,} evaluations {result.seconds:6.2f} s  {error}")
    print(f"error of the nodes themselves {result.discrete:.1e}")
