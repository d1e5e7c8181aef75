"""Explicit Euler with a fixed step, for comparison with implicit methods."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from multicell.integrators.base import FloatArray, Outcome, furthest
from multicell.mechanics import Mechanics, StateRejected


@final
@dataclass(frozen=True)
class Euler:
    """x ← x + Δt v(t, x), stable for Δt < 2/λ_max.

    Parameters
    ----------
    step
        Largest step, s; a coupling step is cut into equal steps no longer than this.
    max_displacement
        Fraction of its radius that a cell may move in one step. The step is fixed, so a
        cell that would move further ends the integration.
    """

    step: float
    max_displacement: float = 0.5

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        motion = system.motion
        count = max(1, math.ceil((motion.end - motion.begin) / self.step * (1.0 - 1e-12)))
        step = (motion.end - motion.begin) / count
        velocity = np.empty_like(position)
        for k in range(count):
            time = motion.begin + k * step
            try:
                system.velocity(time, position, velocity)
            except StateRejected as error:
                return Outcome(time, position, str(error), "Choose a shorter integrator.step")
            trial = position + step * velocity
            cell, moved = furthest(position, trial, motion.radius)
            if moved > self.max_displacement:
                return Outcome(
                    time, position,
                    f"Euler's step of {step:.3g} s would move the cell by {moved:.3g} of its "
                    f"radius (allowed: {self.max_displacement:g})",
                    "Choose a shorter integrator.step, or the method 'cvode'",
                    cell,
                )  # fmt: skip
            position = trial
            system.work.steps += 1
        return Outcome(motion.end, position)
