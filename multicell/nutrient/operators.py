"""Operators of boxes and shells alike, for balances that are evaluated and not solved."""

from __future__ import annotations

import numpy as np

from multicell.cells import FloatArray
from multicell.nutrient import stencil
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.spherical import Shells
from multicell.nutrient.uptake import uptake_and_slope

AnyOperator = Diffusion | Shells


def source_imbalance(
    operator: AnyOperator,
    c: FloatArray,
    sink: FloatArray,
    source: FloatArray,
    half: float,
    linear: float,
) -> tuple[FloatArray, FloatArray]:
    """Return sources less sinks of all nodes (mM/s), and the sinks' derivative (1/s).

    Arguments as for :func:`multicell.nutrient.stencil.write_imbalance`; ``source`` holds what the
    sides bring (``brought``).
    """
    if isinstance(operator, Shells):
        flow = np.concatenate(
            [[0.0], operator.conductance * np.diff(c), [-operator.leak() * c[-1]]]
        )
        taken, slope = uptake_and_slope(sink, c, half)
        return np.diff(flow) / operator.volumes + source - taken - linear * c, slope + linear
    out, slope = np.empty_like(c), np.empty_like(c)
    stencil.write_imbalance(
        c,
        sink,
        source,
        half,
        operator.stiffness,
        linear,
        operator.ghost,
        operator.weights,
        operator.exchange,
        operator.level,
        out,
        slope,
    )
    return out, slope


def linearised(operator: AnyOperator, v: FloatArray, rate: FloatArray) -> FloatArray:
    """Return (-D L0 + rate) v, with ``rate`` (1/s) at the nodes."""
    if isinstance(operator, Diffusion):
        out = np.empty_like(v)
        stencil.apply_operator(v, rate, operator.stiffness, operator.ghost, operator.weights, out)
        return out
    none = np.zeros_like(v)
    spread, _ = source_imbalance(operator, v, none, none, 1.0, 0.0)
    return np.asarray(rate * v - spread)


def lifted(
    operator: AnyOperator,
    c: FloatArray,
    sink: FloatArray,
    source: FloatArray,
    half: float,
    linear: float,
    loss: FloatArray,
    most: int,
) -> FloatArray:
    """Return a state near its balance with no node below zero, unless ``most`` sweeps are too few.

    ``source`` (mM/s) must not be negative, and ``loss`` (1/s) is what else takes a node's content.
    In a box only nodes below zero are changed, each to its own balance; a ball is solved anew with
    an M-matrix and a right-hand side that is not negative.
    """
    if not source.any():
        return np.zeros_like(c)
    if isinstance(operator, Diffusion):
        c = c.copy()
        # uptake's slope at zero is sink / half: so ``loss`` is exact where this is used
        stencil.balance_negative(
            c,
            sink + half * loss,
            source,
            half,
            operator.stiffness,
            linear,
            operator.ghost,
            operator.weights,
            operator.exchange,
            operator.level,
            np.inf,
            most,
        )
        return c
    taken = (sink / (half + np.maximum(c, 0.0)) + linear + loss) * operator.volumes
    return operator.solve_linear(taken, source * operator.volumes)
