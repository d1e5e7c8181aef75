"""What our solvers of py-pde's kind need of an equation.

py-pde's own implicit solvers are fixed-point iterations, which fail beyond about the largest step
of an explicit one. Ours know more of an equation than its rates, which it offers by methods:
:class:`Invertible`, :class:`Stepped`, :class:`Steady`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from pde.fields.collection import FieldCollection

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed, SceneError

if TYPE_CHECKING:
    from pde.pdes.base import PDEBase

Inverse = Callable[[FloatArray, float], FloatArray]
"""(r, shift) -> about (shift - J)⁻¹ r, arrays like a state's data."""


class Invertible(Protocol):
    """An equation that about inverts the derivative of its rates."""

    def rates(self, data: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
        """Return the rates, and the local part of their derivative with opposite sign."""

    def shifted_inverse(self, data: FloatArray, t: float) -> Inverse:
        """Return about (shift - J)⁻¹ near a state."""

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two at which the rates jump."""

    def growing(self, data: FloatArray) -> str:
        """Return in words which field grows without bound; empty if none does."""


class Stepped(Protocol):
    """An equation that takes steps of backward Euler, whatever their length."""

    @property
    def names(self) -> list[str]:
        """Names of the substances in its account."""

    def implicit_step(self, data: FloatArray, dt: float, t: float) -> tuple[FloatArray, FloatArray]:
        """Return the data at the end of a step, and what happened in it, (m, columns)."""

    def scales(self, data: FloatArray, begin: float, end: float) -> FloatArray:
        """Return the concentration of each field that errors are small beside, (m,)."""

    def growing(self, data: FloatArray) -> str:
        """Return in words which field grows without bound; empty if none does."""

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two at which the rates jump."""


class Steady(Protocol):
    """An equation that knows the state in which it rests."""

    def steady_state(self, data: FloatArray, t: float) -> tuple[FloatArray, dict[str, Any]]:
        """Return the state that rests with the conditions of a time, and what it took."""

    def exchanges(self, data: FloatArray, t: float, reports: dict[str, Any]) -> FloatArray:
        """Return what happens in that state, (m, columns)."""


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
