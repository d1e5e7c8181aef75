"""Integrators by name; each is loaded when it is asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from multicell.integrators.names import METHODS

if TYPE_CHECKING:
    from multicell.integrators.base import Integrator
    from multicell.parts import IntegratorOptions

__all__ = ["METHODS", "make"]

_FIXED_STEP = {
    "euler": "Euler",
    "heun": "Heun",
    "ab2": "AdamsBashforth2",
    "rk4": "RungeKutta4",
}
_EXPLICIT_ADAPTIVE = {
    "euler-adaptive": "AdaptiveEuler",
    "ab2-adaptive": "AdaptiveAdams",
    "dopri5": "Dopri5",
    "rkc2": "Rkc2",
}


def make(options: IntegratorOptions) -> Integrator:
    """Return the integrator that a scene asks for (see :class:`IntegratorOptions`)."""
    if options.method in _FIXED_STEP:
        from multicell.integrators import explicit

        kind = getattr(explicit, _FIXED_STEP[options.method])
        return kind(options.step, options.max_displacement)  # type: ignore[no-any-return]
    if options.method in _EXPLICIT_ADAPTIVE:
        from multicell.integrators import explicit

        kind = getattr(explicit, _EXPLICIT_ADAPTIVE[options.method])
        return kind(  # type: ignore[no-any-return]
            options.rtol, options.atol, options.max_steps, options.max_displacement
        )
    controlled = (options.rtol, options.atol, options.max_steps, options.max_displacement)
    if options.method in ("cvode", "cvode-adams"):
        from multicell.integrators.cvode import Cvode

        adams = options.method == "cvode-adams"
        return Cvode.adams(*controlled) if adams else Cvode(*controlled)
    if options.method == "cvode-sparse":
        from multicell.integrators.cvode_sparse import CvodeSparse

        return CvodeSparse(*controlled)
    if options.method == "backward-euler":
        from multicell.integrators.backward_euler import BackwardEuler

        return BackwardEuler(options.step, 0.01 * options.atol, options.max_displacement)
    if options.method.startswith("scipy-"):
        from multicell.integrators.scipy_methods import Scipy

        return Scipy(options.method.removeprefix("scipy-"), *controlled)
    if options.method == "auto":
        from multicell.integrators.auto import Auto

        return Auto(*controlled)
    raise ValueError(f"no integrator is called {options.method!r}")
