"""Approximate inverses of I - γJ by name, for the methods that solve with it iteratively."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, final

from multicell.cells import FloatArray
from multicell.mechanics.system import Mechanics


class Preconditioner(Protocol):
    """Made ready by ``setup`` at the last linearisation, applied by ``solve``."""

    def setup(self, system: Mechanics, gamma: float) -> None:
        """Prepare for I - γJ."""

    def solve(self, system: Mechanics, vector: FloatArray, out: FloatArray) -> None:
        """Write the approximate solution for ``vector``, both (n, 3)."""


@final
class Blocks:
    """The inverse 3 x 3 diagonal blocks (see :meth:`Mechanics.setup_preconditioner`)."""

    def setup(self, system: Mechanics, gamma: float) -> None:
        """Invert the blocks."""
        system.setup_preconditioner(gamma)

    def solve(self, system: Mechanics, vector: FloatArray, out: FloatArray) -> None:
        """Multiply by the inverses."""
        system.precondition(vector, out)


def _sweeps() -> Preconditioner:
    from multicell.mechanics.jacobian import Sweeps

    return Sweeps()


def _incomplete() -> Preconditioner:
    from multicell.mechanics.jacobian import Sweeps

    return Sweeps(incomplete=True)


PRECONDITIONERS: dict[str, Callable[[], Preconditioner]] = {
    "blocks": Blocks,
    "gauss-seidel": _sweeps,
    "incomplete": _incomplete,
}
"""Name -> maker. ``"none"`` stands for no preconditioner where a method allows it."""


def preconditioner(name: str, system: Mechanics) -> Preconditioner:
    """Return the preconditioner called ``name`` for a system.

    With friction between cells J = Γ⁻¹K is not a matrix of pairs, and the system's own
    blocks are taken in place of the sweeps.
    """
    if max(system.friction) > 0.0:
        return Blocks()
    return PRECONDITIONERS[name]()
