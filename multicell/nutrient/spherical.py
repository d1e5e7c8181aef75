"""Diffusion in a ball whose fields depend on the distance from its centre only.

Finite volumes on py-pde's ``SphericalSymGrid``: n shells of equal thickness, values at their
middles, flows through the spheres between them. What leaves one shell enters the next, so that
amounts are conserved exactly, and the matrix is a symmetric tridiagonal M-matrix: as for the box,
no concentration is negative.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient.faces import ghost_terms
from multicell.nutrient.steady import BALANCE_TOLERANCE, MAX_BACKTRACKS, SolveReport
from multicell.nutrient.uptake import rate, uptake, uptake_and_slope

_MAX_NEWTON = 60  # and as many more as there are shells: the edge of a starved core may move by one
_NOTHING_LEFT = float(np.finfo(float).tiny)  # amol/s; below it numbers lose their digits


@final
class Shells:
    """Diffusion in a ball with a condition on its surface.

    - ``radius``, float, µm: of the ball
    - ``count``, int: number of shells
    - ``diffusion``, float, µm²/s: in tissue
    - ``boundary``: concentration in mM on the surface, or py-pde's description of one condition
      (``{"value": v}``, ``{"derivative": d}``)
    - ``varied``, (count,), optional: coefficient of diffusion in the shells over that of tissue
    """

    def __init__(
        self,
        radius: float,
        count: int,
        diffusion: float,
        boundary: float | Mapping[str, Any],
        *,
        varied: FloatArray | None = None,
    ) -> None:
        self.radius, self.count, self.diffusion = radius, count, diffusion
        self.spacing = radius / count
        faces = np.linspace(0.0, radius, count + 1)
        self.volumes = 4.0 * np.pi / 3.0 * np.diff(faces**3)
        areas = 4.0 * np.pi * faces**2
        relative = np.ones(count) if varied is None else np.asarray(varied, dtype=float)
        means = 2.0 * relative[1:] * relative[:-1] / (relative[1:] + relative[:-1])
        # µm³/s: what flows for each mM of difference
        self.conductance = diffusion / self.spacing * areas[1:-1] * means
        self._outer = diffusion / self.spacing * areas[-1] * relative[-1]
        self.set_boundary(boundary)

    def set_boundary(self, boundary: float | Mapping[str, Any]) -> None:
        """Take another condition on the surface: its ghost value is ``const + factor c``."""
        condition = boundary if isinstance(boundary, Mapping) else {"value": float(boundary)}
        self._const, self._factor = ghost_terms(condition, self.spacing)

    def inflow(self, c: FloatArray) -> float:
        """Return the flow in through the surface, amol/s."""
        return float(self._outer * (self._const + (self._factor - 1.0) * c[-1]))

    def leak(self) -> float:
        """Return the outflow through the surface for each mM in the last shell, µm³/s."""
        ends = np.zeros(self.count)
        without = self.inflow(ends)
        ends[-1] = 1.0
        return without - self.inflow(ends)

    def brought(self) -> FloatArray:
        """Return the gain over the surface of shells at 0 mM, (count,) mM/s."""
        return np.asarray(self.gain(np.zeros(self.count)) / self.volumes)

    def fastest(self) -> float:
        """Return about the largest rate at which diffusion empties a shell, 1/s."""
        flow = np.append(self.conductance, self.leak())
        return float(((flow + np.append(0.0, flow[:-1])) / self.volumes).max())

    def gain(self, c: FloatArray) -> FloatArray:
        """Return the gain of each shell by diffusion, (count,) amol/s."""
        flow = self.conductance * np.diff(c)
        gain = np.zeros(self.count)
        gain[:-1] += flow
        gain[1:] -= flow
        gain[-1] += self.inflow(c)
        return gain

    def solve(
        self,
        sink: FloatArray,
        half_saturation: float,
        start: FloatArray,
        *,
        linear: float = 0.0,
        supply: FloatArray | None = None,
    ) -> tuple[FloatArray, SolveReport]:
        """Solve for the steady concentration as ``solve_steady`` does in a box."""
        problem = _Balance(self, sink, half_saturation, linear, supply)
        c = np.array(start, dtype=float)
        if self._const == 0.0 and not problem.supply.any():
            c[:] = 0.0  # as for boxes: nothing comes in
        left, total = problem.residual(c)
        for newton in range(_MAX_NEWTON + self.count):
            size = float(np.abs(left).sum())
            if size <= max(BALANCE_TOLERANCE * total, problem.rounding(c), _NOTHING_LEFT):
                if c.min() < 0.0:
                    c = problem.lifted(c)
                    size = float(np.abs(problem.residual(c)[0]).sum())
                return c, problem.report(c, newton, size)
            c, left, total = problem.newton_step(c, left)
        raise NutrientFailed(
            f"the steady radial field did not converge: after {newton + 1} Newton steps "
            f"{float(np.abs(left).sum()):.3g} amol/s are not accounted for",
            "Check uptake, diffusion and half_saturation of the nutrient for sensible values",
        )

    def solve_linear(self, taken: FloatArray, right: FloatArray) -> FloatArray:
        """Solve for c of which ``taken`` and diffusion, in µm³/s, take ``right``, amol/s."""
        from scipy.linalg import solveh_banded

        g = self.conductance
        diagonal = taken.copy()
        diagonal[:-1] += g
        diagonal[1:] += g
        diagonal[-1] += self._outer * (1.0 - self._factor)
        banded = np.zeros((2, self.count))
        banded[0, 1:] = -g
        banded[1] = diagonal
        return np.asarray(solveh_banded(banded, right, check_finite=False))


@final
class _Balance:
    """Sources minus sinks of all shells: the negative gradient of a convex energy."""

    def __init__(
        self,
        shells: Shells,
        sink: FloatArray,
        half: float,
        linear: float,
        supply: FloatArray | None,
    ) -> None:
        self.shells, self.half, self.linear = shells, half, linear
        self.most = sink * shells.volumes
        self.supply = np.zeros(shells.count) if supply is None else supply * shells.volumes

    def residual(self, c: FloatArray) -> tuple[FloatArray, float]:
        """Return the imbalance of each shell and the sum of all sinks, amol/s."""
        spent, slope = uptake_and_slope(self.most, c, self.half)
        spent += self.linear * self.shells.volumes * c
        self._slope = slope + self.linear * self.shells.volumes
        return self.shells.gain(c) + self.supply - spent, float(spent.sum())

    def newton_step(self, c: FloatArray, left: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Return the state after a Newton step that lowers the energy, and its imbalance."""
        correction = self.shells.solve_linear(self._slope, left)
        slope, share = float(left @ correction), 1.0
        for _ in range(MAX_BACKTRACKS):
            trial = c + share * correction
            there, total = self.residual(trial)
            now = float(there @ correction)
            if not now < -0.9 * slope:
                break
            share *= max(slope / (slope - now), 0.25)
        return trial, there, total

    def lifted(self, c: FloatArray) -> FloatArray:
        """Return the state with the share q / (K + c) of uptake from ``c``, and none below zero.

        Every right-hand side is a supply and the matrix an M-matrix, whose factors have no
        positive entry beside the diagonal: nothing is subtracted on the way to the solution.
        """
        shells = self.shells
        taken = rate(self.most, np.maximum(c, 0.0), self.half) + self.linear * shells.volumes
        brought = self.supply.copy()
        brought[-1] += shells._outer * shells._const
        return shells.solve_linear(taken, brought)

    def rounding(self, c: FloatArray) -> float:
        """Return the part of the imbalance that is rounding, amol/s."""
        shells = self.shells
        flows = float(np.sum(shells.conductance) + shells._outer)
        flows += self.linear * float(shells.volumes.sum())
        return 32.0 * float(np.finfo(float).eps) * flows * float(np.abs(c).max(initial=0.0))

    def report(self, c: FloatArray, newton: int, size: float) -> SolveReport:
        """Return the balance."""
        total, inflow = float(np.sum(uptake(self.most, c, self.half))), self.shells.inflow(c)
        return SolveReport(newton, 0, size, inflow, total, max(-inflow, 0.0))
