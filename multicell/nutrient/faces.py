"""Values of a field near the faces of its grid, whose last nodes lie half a spacing inside.

Beyond each face nodes are added. By the condition on the face they are ``const + factor c`` with
the c of the node that mirrors them: the line between the two has the value or the slope that the
condition asks for. What lies beyond a face weighs no more in a reading than what mirrors it, so
that with a value or a supply none is negative. For derivatives, which may have any sign, one node
is on the parabola through the last three: central differences are then exact for parabolas up to
the face, whatever the condition.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from multicell.cells import FloatArray


def ghost_terms(condition: Mapping[str, float], spacing: float) -> tuple[float, float]:
    """Return ``const`` and ``factor`` of the node beyond a face with py-pde's ``condition``."""
    if "derivative" in condition:
        return spacing * condition["derivative"], 1.0
    return 2.0 * condition["value"], -1.0


def by_condition(
    values: FloatArray,
    conditions: Mapping[str, Mapping[str, Any]],
    spacing: float,
    axes: str,
    layers: int = 1,
) -> FloatArray:
    """Return the values with ``layers`` of nodes at both ends of the named axes, by the conditions.

    - ``conditions``: on the faces ``"x-"``, ``"x+"`` ... of these axes, in py-pde's terms.
    """
    for axis, name in enumerate(axes):
        v = np.moveaxis(values, axis, 0)
        low: list[FloatArray] = []
        high: list[FloatArray] = []
        for side, ends, mirror in (("-", low, v), ("+", high, v[::-1])):
            for layer in range(layers):
                const, factor = ghost_terms(conditions[name + side], (2 * layer + 1) * spacing)
                ends.append(const + factor * mirror[min(layer, len(v) - 1)])
        values = np.moveaxis(np.concatenate([low[::-1], v, high]), 0, axis)
    return np.ascontiguousarray(values)


def by_parabola(values: FloatArray, axes: int) -> FloatArray:
    """Return the values with a node more at both ends of the first ``axes`` axes, extrapolated.

    With two nodes along an axis the line through them is taken, with one the value stays.
    """
    for axis in range(axes):
        v = np.moveaxis(values, axis, 0)
        values = np.moveaxis(
            np.concatenate([extrapolate_face(v)[None], v, extrapolate_face(v[::-1])[None]]), 0, axis
        )
    return np.ascontiguousarray(values)


def extrapolate_face(v: FloatArray) -> FloatArray:
    """Return the value before the first entry of the first axis, by the parabola there."""
    if len(v) >= 3:
        return np.asarray(3.0 * v[0] - 3.0 * v[1] + v[2])
    return np.asarray(2.0 * v[0] - v[1] if len(v) == 2 else v[0])
