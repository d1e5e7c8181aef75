"""What our solvers of py-pde's kind need of an equation, its own or made for it.

py-pde's own implicit solvers are fixed-point iterations, which fail beyond about the largest step
of an explicit one. Ours have Newton's method with Krylov iterations, preconditioned by an inverse
of diffusion (:mod:`multicell.nutrient.equations.transforms`). An equation that knows a better
inverse, or its steady state, says so by methods: :class:`Invertible`, :class:`Steady`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from pde.fields.collection import FieldCollection
from pde.fields.scalar import ScalarField

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.equations.transforms import inverse_on

if TYPE_CHECKING:
    from pde.pdes.base import PDEBase
    from pde.solvers.base import SolverBase

Rate = Callable[[FloatArray, float], FloatArray]
"""(a state's data, t) -> their rates."""

Inverse = Callable[[FloatArray, float], FloatArray]
"""(r, shift) -> about (shift - J)⁻¹ r, arrays like a state's data."""

Diffusivity = float | Sequence[float] | Mapping[str, float] | None


@runtime_checkable
class Invertible(Protocol):
    """An equation that has compiled rates, and about inverts their derivative, itself."""

    def rates(self, data: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
        """Return the rates, and the local part of their derivative with opposite sign."""

    def shifted_inverse(self, data: FloatArray, t: float) -> Inverse:
        """Return about (shift - J)⁻¹ near a state."""

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two at which the rates jump."""

    def check(self, state: Any) -> None:
        """Refuse a state that is not one of this equation."""


@runtime_checkable
class Stepped(Protocol):
    """An equation that takes steps of backward Euler, whatever their length."""

    @property
    def names(self) -> list[str]:
        """Names of the substances in its account."""

    def implicit_step(self, data: FloatArray, dt: float, t: float) -> tuple[FloatArray, FloatArray]:
        """Return the data at the end of a step, and what happened in it, (m, 7)."""

    def scales(self, data: FloatArray, begin: float, end: float) -> FloatArray:
        """Return the concentration of each field that errors are small beside, (m,)."""

    def growing(self, data: FloatArray) -> str:
        """Return in words which field grows without bound; empty if none does."""

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two at which the rates jump."""


def refuse_unsuitable(pde: PDEBase, state: Any) -> None:
    """Refuse what our solvers cannot solve.

    Raises
    ------
    SceneError
    """
    if getattr(pde, "is_sde", False):
        hint = "Take one of py-pde's solvers, for example 'euler'."
        raise SceneError("equation", "has noise, which our solvers do not know", hint)
    if getattr(pde, "complex_valued", False) or np.iscomplexobj(state.data):
        raise SceneError("state", "is complex, must be real")
    check = getattr(pde, "check", None)
    if check is not None:
        check(state)


def rate_of(solver: SolverBase, state: Any) -> Rate:
    """Return the rates of a solver's equation, by its backend; they are refused if not finite."""
    pde, names = solver.pde, labels(state)
    if isinstance(pde, Invertible) and solver.backend_name == "auto":
        own = pde

        def evaluate(data: FloatArray, t: float) -> FloatArray:
            return own.rates(data, t)[0]

    else:
        solver._select_backend(state)
        backend = solver.backend
        native = backend.make_pde_rhs(pde, state)

        def evaluate(data: FloatArray, t: float) -> FloatArray:
            found = backend.native_to_numpy(native(backend.numpy_to_native(data), t))
            return np.broadcast_to(found, data.shape)

    def rate(data: FloatArray, t: float) -> FloatArray:
        found = evaluate(data, t)
        if not np.isfinite(found).all():
            raise NutrientFailed(*_runaway(names, data, found, t))
        return found

    return rate


def _runaway(names: list[str], data: FloatArray, found: FloatArray, t: float) -> tuple[str, str]:
    """Return in words which field's rate is not finite."""
    fields, rates = (x.reshape(len(names), -1) for x in (data, found))
    bad = int(np.argmax(~np.isfinite(rates).all(axis=1)))
    problem = f"the rate of {names[bad]} is not finite at t = {t:.6g}"
    largest = f"where its largest value is {np.abs(fields[bad]).max():.3g}"
    return f"{problem}, {largest}", "Look for a reaction that makes it grow without bound"


def labels(state: Any) -> list[str]:
    """Return a name for each field of a state."""
    fields = list(state) if isinstance(state, FieldCollection) else [state]
    return [field.label or f"field {i}" for i, field in enumerate(fields)]


def inverse_of(
    pde: PDEBase, state: Any, diffusivity: Diffusivity, bc: Any
) -> Callable[[FloatArray, float], Inverse] | None:
    """Return a function of a state's data and time that gives about (shift - J)⁻¹, or None.

    Parameters
    ----------
    pde
        Its own ``shifted_inverse`` is taken where it has one, else its ``diffusivity`` and ``bc``
        where the arguments are None.
    diffusivity
        Of each field, one for all or by name.
    bc
        Conditions for Laplacians of all fields.

    Raises
    ------
    SceneError
        If the diffusivities do not fit the fields.
    """
    if isinstance(pde, Invertible):
        return pde.shifted_inverse
    found = getattr(pde, "diffusivity", None) if diffusivity is None else diffusivity
    if found is None:
        return None
    values = diffusivities(found, state)
    sides = getattr(pde, "bc", None) if bc is None else bc
    parts = [inverse_on(state.grid, value, sides) for value in values]
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None

    def inverse(r: FloatArray, shift: float) -> FloatArray:
        fields = r.reshape(len(known), *state.grid.shape)
        solved = [part(field, shift) for part, field in zip(known, fields, strict=True)]
        return np.array(solved).reshape(r.shape)

    return lambda data, t: inverse


def diffusivities(given: Any, state: Any) -> list[float]:
    """Return the diffusivity of each field of a state.

    Raises
    ------
    SceneError
    """
    fields = list(state) if isinstance(state, FieldCollection) else [state]
    if not all(isinstance(field, ScalarField) for field in fields):
        raise SceneError("state", "has fields that are not scalar, of which no inverse is known")
    if isinstance(given, Mapping):
        names = labels(state)
        if set(given) != set(names):
            problem = f"is of {', '.join(sorted(given))}, expected {', '.join(names)}"
            raise SceneError("diffusivity", problem)
        given = [given[name] for name in names]
    values = [float(value) for value in np.ravel(given)]
    values = values * len(fields) if len(values) == 1 else values
    if len(values) != len(fields):
        raise SceneError("diffusivity", f"has {len(values)} numbers for {len(fields)} fields")
    if not all(np.isfinite(value) and value >= 0.0 for value in values):
        raise SceneError("diffusivity", f"is {values}, must be zero or more")
    return values
