"""Refuse coupling steps that double precision cannot resolve, before they are tried.

So is one that begins with positions that are no numbers.

An implicit step solves (I - γJ) x = b. Rigid motions, and all motions of cells that touch
nothing, have the eigenvalue 1; pressing two cells together has 1 + γλ. Rounding the largest
entries, by ε γλ, is therefore an error in the 1: from ε γλ = 1 on, the matrix no longer says that
cells at rest stay where they are. Newton's method then converges to states in which cells were
thrown apart, where no contact is left, no force, and so nothing for error control to see. Up to
ε λΔt = 10⁻³ each iteration still gains three digits in the slow motions.

Error control says nothing either where the tolerance exceeds a cell's diameter: then no error
is too large.
"""

from __future__ import annotations

import math

import numpy as np

from multicell.cells import FloatArray
from multicell.integrators.base import Outcome
from multicell.mechanics.rows import COMPLIANCE
from multicell.mechanics.system import Mechanics

LARGEST_STIFFNESS = 1e-3 / float(np.finfo(float).eps)
"""Largest λΔt, 4.5·10¹², that is tried; tissue in water has 10⁷."""
PACKED_CONTACTS = 8.0
"""Largest decay rate of packed cells, in stiffness of a pair over the drag of a cell."""

_SHARE = 0.03
"""Share of the tolerances that a norm over many cells gets. With a tenth, one coupling step in
twenty at 0.5 kPa·s had a cell off by more than three times what a shift by the tolerance does."""


def norm_share(cells: int) -> float:
    """Return the share of the tolerances that a mean over all coordinates may have.

    The mean hides single cells: one daughter among thousands of cells at rest may be wrong by many
    tolerances in a step. Few cells get 1/√(3n), with which the mean bounds each of them.
    """
    return max(_SHARE, 1.0 / math.sqrt(3.0 * max(cells, 1)))


def stiffness_scale(system: Mechanics) -> float:
    """Return the order of magnitude of the largest decay rate λ, 1/s, without any evaluation.

    That of packed cells of mean size and of the largest modulus, pressed together by half
    their effective radius. Found once for a coupling step, since with few cells it costs as much as
    some evaluations.
    """
    if len(system) < 2 or system.stiffness_scale is not None:
        return system.stiffness_scale or 0.0
    motion = system.motion
    radius, least = motion.mean_radius, float(system.rows[:, COMPLIANCE].min())
    modulus = 0.5 / least  # of two cells with the least compliance
    _, slope, _ = system.law.evaluate(0.25 * radius, modulus, 0.5 * radius, rest=2.0 * radius)
    system.stiffness_scale = PACKED_CONTACTS * abs(float(slope)) / (system.drag * radius)
    return system.stiffness_scale


def find_failure(system: Mechanics, position: FloatArray, atol: float = 0.0) -> Outcome | None:
    """Return how a coupling step ends that cannot be followed, or None if it can.

    - ``system``: made ready for the coupling step
    - ``position``: (n, 3) µm, at its beginning
    - ``atol``: absolute tolerance, µm; zero for methods without error control
    """
    motion = system.motion
    finite = np.isfinite(position)
    if np.count_nonzero(finite) < finite.size:
        hint = "Look at what happened before: a coupling step must begin with numbers"
        cell = int(finite.all(axis=1).argmin())
        return Outcome(motion.begin, position, "a position is not a number", hint, cell)
    length = motion.end - motion.begin
    stiffness = stiffness_scale(system) * length
    if not stiffness <= LARGEST_STIFFNESS:
        return Outcome(
            motion.begin,
            position,
            f"contacts relax about {stiffness:.2g} times within a coupling step of {length:.3g} s; "
            f"double precision follows up to {LARGEST_STIFFNESS:.2g}",
            "Raise drag.viscosity, soften the cells or shorten coupling_step",
        )
    diameter = 2.0 * motion.mean_radius if len(system) else np.inf
    if not atol <= diameter:
        return Outcome(
            motion.begin,
            position,
            f"the tolerance of {atol:.3g} um exceeds the cells' diameter of {diameter:.3g} um: "
            "no error would be too large",
            "Choose a smaller integrator.atol",
        )
    return None
