"""The function of a law from the parts that a user gives; the others are derived.

All parts are called as ``part(overlap, modulus, radius, p, rest, adhesion)``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from multicell.contact.constants import further_arguments

Scalar = Callable[..., float]

_STEP = 1e-5
"""Step of the difference quotient of a force, in radii r_ij: truncation and rounding about even."""
_AGREED = 1e-13  # difference of two integrals of a panel over that of |F| over all
_TRIED = 500  # panels after which a force is taken to be no smoother than its rounding
_BISECTIONS = 60  # narrow any overlap to rounding
_NARROWEST = 1e-12
"""Panel over the whole, or over where that begins: its points differ by more than rounding."""
# Gauss-Legendre nodes of an interval: exact for polynomials of degree 15
_NODES, _WEIGHTS = (tuple(map(float, part)) for part in np.polynomial.legendre.leggauss(8))


def with_arguments(f: Scalar) -> Scalar:
    """Return a function with all arguments that a law of the user's may have."""
    further = further_arguments(f)
    if further == ():
        return lambda overlap, modulus, radius, p, rest, adhesion: f(overlap, modulus, radius, p)
    if further == ("rest",):
        return lambda overlap, modulus, radius, p, rest, adhesion: f(
            overlap, modulus, radius, p, rest
        )
    if further == ("adhesion",):
        return lambda overlap, modulus, radius, p, rest, adhesion: f(
            overlap, modulus, radius, p, adhesion
        )
    if further == ("rest", "adhesion"):
        return f
    raise TypeError(f"{f.__name__} must be without {' and '.join(further[1:])}")


def _begin_of(reach: Scalar | None) -> Scalar:
    """Return the function of the overlap from which a law acts."""
    if reach is None:
        return lambda modulus, radius, rest, p: 0.0
    return lambda modulus, radius, rest, p: -reach(modulus, radius, rest, p)


def force_alone(force: Scalar, reach: Scalar | None) -> Callable[..., Any]:
    """Return the function of the law with zeros for stiffness and energy."""
    begin_of = _begin_of(reach)

    def law(overlap, modulus, radius, p, rest, adhesion):  # type: ignore[no-untyped-def]
        if overlap <= begin_of(modulus, radius, rest, p):
            return 0.0, 0.0, 0.0
        return force(overlap, modulus, radius, p, rest, adhesion), 0.0, 0.0

    return law


def without_energy(
    force: Scalar, stiffness: Scalar | None, reach: Scalar | None
) -> Callable[..., Any]:
    """Return the function of the law with a zero for the energy."""
    begin_of = _begin_of(reach)
    slope_of = _difference(force, begin_of) if stiffness is None else stiffness

    def law(overlap, modulus, radius, p, rest, adhesion):  # type: ignore[no-untyped-def]
        if overlap <= begin_of(modulus, radius, rest, p):
            return 0.0, 0.0, 0.0
        slope = slope_of(overlap, modulus, radius, p, rest, adhesion)
        return force(overlap, modulus, radius, p, rest, adhesion), slope, 0.0

    return law


def whole_law(
    force: Scalar, stiffness: Scalar | None, energy: Scalar | None, reach: Scalar | None
) -> Callable[..., Any]:
    """Return the function of the law with all three results."""
    begin_of, beginning = _begin_of(reach), without_energy(force, stiffness, reach)
    energy_of = _integral(force, begin_of) if energy is None else energy

    def law(overlap, modulus, radius, p, rest, adhesion):  # type: ignore[no-untyped-def]
        push, slope, _ = beginning(overlap, modulus, radius, p, rest, adhesion)
        work = 0.0
        if overlap > begin_of(modulus, radius, rest, p):
            work = energy_of(overlap, modulus, radius, p, rest, adhesion)
        return push, slope, work

    return law


def rest_search(force: Scalar, reach: Scalar | None) -> Scalar:
    """Return the function of the overlap at rest below one at which a law repels, by bisection."""
    begin_of = _begin_of(reach)

    def at_rest(overlap, modulus, radius, p, rest):  # type: ignore[no-untyped-def]
        low, high = begin_of(modulus, radius, rest, p), overlap
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if force(middle, modulus, radius, p, rest, 0.0) > 0.0:
                high = middle
            else:
                low = middle
        return low

    return at_rest


def _difference(force: Scalar, begin_of: Scalar) -> Scalar:
    """Return the slope of a force by a central difference that stays where the law acts."""

    def slope(overlap, modulus, radius, p, rest, adhesion):  # type: ignore[no-untyped-def]
        dh = _STEP * radius
        middle = max(overlap, begin_of(modulus, radius, rest, p) + dh)
        above = force(middle + dh, modulus, radius, p, rest, adhesion)
        below = force(middle - dh, modulus, radius, p, rest, adhesion)
        return (above - below) / (2.0 * dh)

    return slope


def _integral(force: Scalar, begin_of: Scalar) -> Scalar:
    """Return the integral of a force from where the law begins to act.

    Gauss-Legendre panels that follow the force: one is taken where its two halves agree with it,
    else the first half is tried. So kinks, and singularities that can be integrated, get panels as
    narrow as they need, down to those that no longer count.
    """

    def energy(overlap, modulus, radius, p, rest, adhesion):  # type: ignore[no-untyped-def]
        at = begin_of(modulus, radius, rest, p)
        left = overlap - at
        width, narrowest, total, scale = left, _NARROWEST * max(left, abs(at)), 0.0, 0.0
        tried = 0
        while left > 0.0:
            width, tried = min(width, left), tried + 1
            whole, halves, size = 0.0, 0.0, 0.0
            for part in range(3):
                # the panel, and its two halves
                half = 0.5 * width if part == 0 else 0.25 * width
                centre = at + half if part < 2 else at + 3.0 * half
                for k in range(len(_NODES)):
                    value = (
                        half
                        * _WEIGHTS[k]
                        * force(centre + half * _NODES[k], modulus, radius, p, rest, adhesion)
                    )
                    if part == 0:
                        whole += value
                        size += abs(value)
                    else:
                        halves += value
            scale = max(scale, size)
            if abs(whole - halves) > _AGREED * scale and width > narrowest and tried < _TRIED:
                width *= 0.5
                continue
            total += halves
            at += width
            left = 0.0 if width == left else left - width
            width *= 2.0
        return total

    return energy
