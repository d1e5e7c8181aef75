"""Code fields as differences from the prediction of a stencil: exact, a third of the size.

Outside the cells nothing is taken up, so a steady field is harmonic there: a node follows from the
two layers of nodes before it by the Laplacian of seven points, up to the residual of the solver
(1e-14 of its value; a plain difference of neighbours leaves 1e-2). So a layer is predicted from the
two before it, and what is kept is the difference of the two bit patterns, taken as integers. Inside
the tissue the prediction is poorer, and nothing but size depends on it.

The prediction consists of sums, differences and products of float64 one by one, which IEEE 754
defines to the bit: every machine predicts, and so reads, the same.

Beyond a face the missing neighbour is ``2 b - c`` where the field has the value b there, or the
node's own c where it has no slope. Which of them holds, and b, is estimated from the field itself
and kept with it: (6,) float64, NaN for no slope, faces in the order x-, x+, y-, y+, z-, z+.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray

Coded = NDArray[np.uint64]


def encode(values: FloatArray) -> tuple[Coded, FloatArray]:
    """Return a field coded, and what holds at its faces.

    - ``values``, (nx, ny, nz): any numbers, also such as are not finite

    Returns coded, (nx, ny, nz) uint64: 2 d for a difference d >= 0 of the bit patterns as
    integers, -2 d - 1 for a negative one; faces, (6,) float64.
    """
    values = np.ascontiguousarray(values, dtype="<f8")
    faces = _faces(values)
    coded = np.empty(values.shape, "<u8")
    for layer in range(len(values)):
        difference = _bits(values[layer]) - _bits(_prediction(values, layer, faces))
        coded[layer] = ((difference << 1) ^ (difference >> 63)).view("<u8")
    return coded, faces


def decode(coded: Coded, faces: FloatArray) -> FloatArray:
    """Return the field that :func:`encode` was given."""
    values = np.zeros(coded.shape, "<f8")
    for layer in range(len(values)):
        whole, sign = coded[layer] >> np.uint64(1), coded[layer] & np.uint64(1)
        difference = whole.view("<i8") ^ -sign.view("<i8")
        values[layer] = (difference + _bits(_prediction(values, layer, faces))).view("<f8")
    return values


def _bits(values: FloatArray) -> NDArray[np.int64]:
    return np.ascontiguousarray(values).view("<i8")


def _prediction(values: FloatArray, layer: int, faces: FloatArray) -> FloatArray:
    """Predict a layer, (ny, nz), from those before it; zeros for the first.

    The Laplacian vanishes at the layer before: ``c[+1] = 2 d c - c[-1] - other neighbours`` for d
    directions with more than one node.
    """
    if layer == 0:
        return np.zeros(values.shape[1:])
    here = values[layer - 1]
    with np.errstate(all="ignore"):
        before = values[layer - 2] if layer > 1 else _beyond(here, faces[0])
        around = before + 0.0
        directions = 1
        for axis, length in enumerate(here.shape):
            if length > 1:
                directions += 1
                around = around + _neighbours(here, axis, faces[2 * axis + 2 : 2 * axis + 4])
        found = 2.0 * directions * here - around
    return np.where(np.isfinite(found), found, 0.0)


def _neighbours(layer: FloatArray, axis: int, faces: FloatArray) -> FloatArray:
    """Return the sums of both neighbours along an axis of a layer."""
    line = np.moveaxis(layer, axis, 0)
    low, high = _beyond(line[:1], faces[0]), _beyond(line[-1:], faces[1])
    total = np.concatenate([low, line[:-1]]) + np.concatenate([line[1:], high])
    return np.moveaxis(total, 0, axis)


def _beyond(nodes: FloatArray, face: float) -> FloatArray:
    """Return the values beyond a face, for the nodes next to it."""
    return nodes if np.isnan(face) else 2.0 * face - nodes


def _faces(values: FloatArray) -> FloatArray:
    """Return the value that fits each face best, NaN where none fits better than no slope.

    From the nodes at the middle of a face: by the stencil they predict the value beyond it.
    """
    faces = np.full(6, np.nan)
    if not np.isfinite(values).all():
        return faces
    for axis, length in enumerate(values.shape):
        for high in (0, 1):
            if length >= 3:
                line = np.moveaxis(values, axis, 0)
                faces[2 * axis + high] = _face(line[::-1] if high else line)
    return faces


def _face(line: FloatArray) -> float:
    """Return the value on the face before the first layer, or NaN."""
    inner = tuple(slice(1, -1) if n > 2 else slice(None) for n in line.shape[1:])
    here = line[0][inner]
    if here.size == 0:
        return float("nan")
    around, directions = line[1][inner].copy(), 1
    for axis, length in enumerate(line.shape[1:]):
        if length > 2:
            directions += 1
            cut = [s if k != axis else slice(None) for k, s in enumerate(inner)]
            wide = np.moveaxis(line[0][tuple(cut)], axis, 0)
            around += np.moveaxis(wide[:-2] + wide[2:], 0, axis)
    beyond = 2.0 * directions * here - around
    value = float(np.median(0.5 * (beyond + here)))
    fits = np.median(np.abs(beyond - (2.0 * value - here))) < np.median(np.abs(beyond - here))
    return value if fits else float("nan")
