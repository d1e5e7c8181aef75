"""Parts of the mechanics that a scene may lack: those without them do not load their kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multicell.mechanics.friction import PairFriction
    from multicell.mechanics.motion import Motion
    from multicell.mechanics.prescribed import Prescribed
    from multicell.mechanics.system import Linearisation


def friction(coefficients: tuple[float, float], n: int, drag: float, chunk: int) -> PairFriction:
    """Return the friction between cells of a coupling step."""
    from multicell.mechanics.friction import PairFriction

    return PairFriction(coefficients, n, drag, chunk)


def prescribed(motion: Motion) -> Prescribed | None:
    """Return the prescribed motion of a coupling step."""
    if motion.held is None or motion.velocity is None:
        return None
    from multicell.mechanics.prescribed import Prescribed

    return Prescribed(motion.held, motion.velocity, motion.begin)


def stiffened(linear: Linearisation) -> Linearisation:
    """Return a linearisation whose pairs stand for many-body stiffness as well."""
    if linear.coupling is None:
        return linear
    from multicell.mechanics import compression

    return compression.stiffened(linear)
