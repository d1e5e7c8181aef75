"""What :class:`~multicell.mechanics.Mechanics` keeps for friction between cells."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from multicell.friction import Friction, FrictionNotSolvedError
from multicell.neighbours import PairList

FloatArray = NDArray[np.float64]

_INNER = 0.1
"""Relative tolerance of Γ⁻¹ in a Jacobian product: a tighter one changed no step of CVODE."""


@final
class Rubbing:
    """Γ at the present state and at the linearisation, and the last velocity as first guess.

    One object serves one coupling step, so that nothing outlives it but the state.

    Parameters
    ----------
    coefficients
        Friction per contact area along the line of centres and across it, nN s/µm³.
    n, drag, chunk
        Number of cells, 6πη in kPa·s, and cells in a chunk.
    """

    failure = FrictionNotSolvedError

    def __init__(self, coefficients: tuple[float, float], n: int, drag: float, chunk: int) -> None:
        friction = Friction(*coefficients)
        self._present = friction.matrix(n, drag, chunk)
        self._linearised = friction.matrix(n, drag, chunk)
        self._last = np.zeros((n, 3))
        self._product = np.empty((n, 3))
        self.force = np.empty((n, 3))

    def velocity(
        self, rows: FloatArray, pairs: PairList, shared: bool, slack: FloatArray, out: FloatArray
    ) -> int:
        """Write the solution of Γ v = ``force``, µm/s; return the iterations it took.

        ``slack`` is the part of each listed pair's overlap that makes no contact; empty for none.
        """
        self._present.measure(rows, pairs, shared, slack)
        try:
            iterations = self._present.solve(self.force, self._last)
        except FrictionNotSolvedError:
            self._last[:] = 0.0
            raise
        out[:] = self._last
        return int(iterations)

    def linearise(self, rows: FloatArray, pairs: PairList, shared: bool, slack: FloatArray) -> None:
        """Keep Γ at a state for :meth:`divide`."""
        self._linearised.measure(rows, pairs, shared, slack)

    def divide(self, out: FloatArray) -> int:
        """Replace forces by Γ⁻¹ times them, roughly; return the iterations it took.

        The derivative of Γ itself is left out: it changed no more than one step in twenty.
        """
        iterations = self._linearised.solve(out, self._product, tolerance=_INNER, warm=False)
        out[:] = self._product
        return int(iterations)
