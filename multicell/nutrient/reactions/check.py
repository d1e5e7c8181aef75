"""Checks of a reaction's promises at points over its range of concentrations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multicell.cells import FloatArray

if TYPE_CHECKING:
    from multicell.nutrient.reactions.own import OwnReaction

_POINTS = 40  # states at which a reaction is tried
_LINES, _ALONG = 12, 1500  # lines through states, and points along each
_LEAST = 1e-6  # of the range, where lines from nothing begin
_AGREE = 2e-2  # what the integral of a derivative may lack of the change of a rate


def problems(made: OwnReaction) -> list[str]:
    """Return the faults of a reaction and their remedies; nothing if all is well."""
    return _at_points(made) or _derivative_of_another(made)


def _points(made: OwnReaction) -> tuple[FloatArray, FloatArray]:
    """Return concentrations (m, points) over six decades, in all combinations with zero."""
    rng = np.random.default_rng(1)
    m = len(made.fields)
    c = made.upto * 10.0 ** rng.uniform(-6.0, 0.0, (m, _POINTS))
    c[:, 0], c[:, 1] = 0.0, made.upto
    without = [np.where(np.arange(m)[:, None] == i, 0.0, c) for i in range(m)]
    whole = np.concatenate([c, *without], axis=1)
    return np.asarray(whole, dtype=np.float64), np.array(rng.uniform(0.0, 1.0, whole.shape[1]))


def _at_points(made: OwnReaction) -> list[str]:
    """Look for what is not finite, and for what is consumed where there is none."""
    c, tissue = _points(made)
    rates, slope = made.evaluate(c, tissue)
    bad = ~np.isfinite(rates).all(axis=0)
    if bad.any():
        return [f"is not finite at {_place(made, c[:, np.argmax(bad)])}"]
    bad = ~np.isfinite(slope).all(axis=(0, 1))
    if bad.any():
        where = _place(made, c[:, np.argmax(bad)])
        return [f"has a derivative that is not found at {where}", "Give a smooth rate."]
    least = -1e-12 * np.abs(rates).max(initial=0.0)
    for i, name in enumerate(made.fields):
        bad = (c[i] == 0.0) & (rates[i] < least)
        if bad.any():
            k = int(np.argmax(bad))
            return [
                f"takes {-rates[i, k]:.3g} mM/s of {name} where there is none "
                f"({_place(made, c[:, k])})",
                f"Its loss must end with {name}: concentrations would fall below zero.",
            ]
    return []


def _derivative_of_another(made: OwnReaction) -> list[str]:
    """Compare the integrals of the derivative along lines with the changes of the rates."""
    rng = np.random.default_rng(2)
    m = len(made.fields)
    for line in range(_LINES):
        begin = made.upto * _LEAST * rng.uniform(0.5, 1.0, m)
        ratio = 10.0 ** rng.uniform(2.0, 6.0, m)
        if line < m:  # along one axis
            begin = np.where(np.arange(m) == line, begin, made.upto * rng.uniform(0.1, 1.0, m))
            ratio = np.where(np.arange(m) == line, 1e6, 1.0)
        way = np.linspace(0.0, 1.0, _ALONG)
        c = np.minimum(begin[:, None] * ratio[:, None] ** way, made.upto)
        rates, slope = made.evaluate(c, np.full(_ALONG, rng.uniform(0.0, 1.0)))
        steps = np.diff(c, axis=1)
        middle = 0.5 * (slope[:, :, 1:] + slope[:, :, :-1])
        predicted = np.einsum("ijx,jx->ix", middle, steps)
        missing = np.abs(np.diff(rates, axis=1) - predicted)
        whole = np.abs(np.diff(rates, axis=1)).sum(axis=1)
        amiss = missing.sum(axis=1) > _AGREE * whole + 1e-14 * np.abs(rates).max()
        if amiss.any():
            i = int(np.argmax(amiss))
            where = _place(made, c[:, int(np.argmax(missing[i]))])
            problem = f"has no derivative that can be found: that of {made.fields[i]} jumps at"
            return [f"{problem} {where}", "Give a rate without jumps."]
    return []


def _place(made: OwnReaction, c: FloatArray) -> str:
    return ", ".join(f"{name} = {x:.3g} mM" for name, x in zip(made.fields, c, strict=True))
