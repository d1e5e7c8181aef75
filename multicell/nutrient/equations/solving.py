"""What our solvers of py-pde's kind need of an equation.

py-pde's own implicit solvers are fixed-point iterations, which fail beyond about the largest step
of an explicit one. Ours know more of an equation than its rates, which it offers by methods as
those of :class:`multicell.FieldEquation`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from pde.fields.collection import FieldCollection

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed, SceneError

if TYPE_CHECKING:
    from pde.pdes.base import PDEBase

Inverse = Callable[[FloatArray, float], FloatArray]
"""(r, shift) -> about (shift - J)⁻¹ r, arrays like a state's data."""


def suitable(pde: PDEBase, state: Any, method: str) -> Any:
    """Return an equation that has the method by which a solver solves it."""
    if not hasattr(pde, method):
        problem = f"is {type(pde).__name__}, but multicell's solvers solve equations of fields only"
        raise SceneError("equation", problem, "Take one of py-pde's own solvers.")
    check = getattr(pde, "check", None)
    if check is not None:
        check(state)
    return pde


def labels(state: Any) -> list[str]:
    """Return a name for each field of a state."""
    fields = list(state) if isinstance(state, FieldCollection) else [state]
    return [field.label or f"field {i}" for i, field in enumerate(fields)]


def refuse_runaway(names: list[str], data: FloatArray, found: FloatArray, t: float) -> None:
    """Refuse rates that are not finite; raises NutrientFailed it names the field."""
    if np.isfinite(found).all():
        return
    fields, rates = (x.reshape(len(names), -1) for x in (data, found))
    bad = int(np.argmax(~np.isfinite(rates).all(axis=1)))
    problem = f"the rate of {names[bad]} is not finite at t = {t:.6g}"
    largest = f"where its largest value is {np.abs(fields[bad]).max():.3g}"
    hint = "Look for a reaction that makes it grow without bound"
    raise NutrientFailed(f"{problem}, {largest}", hint)
