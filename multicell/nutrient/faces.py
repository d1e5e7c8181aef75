"""What a field is near the faces of its grid, where the last nodes lie half a spacing inside.

Beyond each face one more node is added. By the condition on the face it is ``const + factor c``
with the last node's c: the linear interpolation between the two has the value or the slope that the
condition asks for, and is nowhere negative. For derivatives, which may have any sign, it is on the
parabola through the last three nodes: central differences are then exact for parabolas up to the
face, whatever the condition.
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
    values: FloatArray, conditions: Mapping[str, Mapping[str, Any]], spacing: float, axes: str
) -> FloatArray:
    """Return the values with a node more at both ends of the named axes, by the conditions.

    - ``conditions``: on the faces ``"x-"``, ``"x+"`` ... of these axes, in py-pde's terms.
    """
    for axis, name in enumerate(axes):
        v = np.moveaxis(values, axis, 0)
        ends = []
        for side, last in (("-", v[:1]), ("+", v[-1:])):
            const, factor = ghost_terms(conditions[name + side], spacing)
            ends.append(const + factor * last)
        values = np.moveaxis(np.concatenate([ends[0], v, ends[1]]), 0, axis)
    return np.ascontiguousarray(values)


def by_parabola(values: FloatArray, axes: int) -> FloatArray:
    """Return the values with a node more at both ends of the first ``axes`` axes, extrapolated.

    With two nodes along an axis the line through them is taken, with one the value stays.
    """
    for axis in range(axes):
        v = np.moveaxis(values, axis, 0)
        values = np.moveaxis(np.concatenate([beyond(v)[None], v, beyond(v[::-1])[None]]), 0, axis)
    return np.ascontiguousarray(values)


def beyond(v: FloatArray) -> FloatArray:
    """Return what comes before the first entry along the first axis, by the parabola there."""
    if len(v) >= 3:
        return np.asarray(3.0 * v[0] - 3.0 * v[1] + v[2])
    return np.asarray(2.0 * v[0] - v[1] if len(v) == 2 else v[0])
