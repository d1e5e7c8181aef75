"""Cells whose motion is prescribed, as the equations of motion of the others see them.

A held cell h is at x_h(t) = x_h(t₀) + v_h (t - t₀) whatever pushes it. Its place is no unknown: the
free cells f obey

    Γ_ff(x, t) ẋ_f = F_f(x_f, x_h(t)) - Γ_fh v_h,

an equation of their own that depends on time. So integrators see held cells stand still where they
were at the beginning of the coupling step, with velocity zero and zero rows and columns in the
Jacobian, which stays symmetric. Evaluations put them to x_h(t), and at the end of the coupling step
they are there in the closed form: exactly, and with the same bits, for every method.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from multicell.mechanics.rows import RADIUS

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics

_IMMENSE = 1e6  # drag of held cells in a preconditioner, over their true one


@final
@dataclass(frozen=True, eq=False)
class Prescribed:
    """Which cells are held, (n,) bool, and their velocity, (n, 3) µm/s, from ``begin``, s, on."""

    held: NDArray[np.bool_]
    velocity: FloatArray
    begin: float

    @cached_property
    def fastest(self) -> float:
        """Largest speed, µm/s."""
        return float(np.linalg.norm(self.velocity, axis=1).max(initial=0.0))

    def placed(self, time: float, position: FloatArray) -> FloatArray:
        """Return the places at a time of cells that were there at the beginning if held."""
        return np.asarray(position + (time - self.begin) * self.velocity)

    def released(self, vector: FloatArray) -> FloatArray:
        """Return a copy of an (n, 3) array with zeros for held cells."""
        return np.where(self.held[:, None], 0.0, vector)

    def weighed(self, rows: FloatArray) -> FloatArray:
        """Return a copy of rows in which the radius, of which drag is a multiple, is immense."""
        found = rows.copy()
        found[self.held, RADIUS] *= _IMMENSE
        return found


def outside_force(system: Mechanics, time: float, position: FloatArray) -> FloatArray:
    """Return the force that the prescribed motion takes, (n, 3) nN, zero for free cells.

    It is what is missing in Γ v = F with the prescribed velocities: the drag of the medium and the
    friction with other cells, less the force of contacts, walls and from outside.
    """
    given = system.prescribed
    if given is None:
        return np.zeros_like(position)
    force, velocity = system.force(time, position), np.empty_like(position)
    system.velocity(time, position, velocity)
    velocity[given.held] = given.velocity[given.held]
    return np.where(given.held[:, None], system.resistance(velocity) - force, 0.0)
