"""Integrators by name; each is loaded when it is asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multicell.integrators.base import Integrator
    from multicell.scene.parts import IntegratorOptions


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
        from multicell.integrators import runge_kutta

        kind = getattr(runge_kutta, _FIXED_STEP[options.method])
        return kind(options.step, options.max_displacement)  # type: ignore[no-any-return]
    if options.method in _EXPLICIT_ADAPTIVE:
        from multicell.integrators import runge_kutta

        kind = getattr(runge_kutta, _EXPLICIT_ADAPTIVE[options.method])
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
        from multicell.integrators.scipy import Scipy

        return Scipy(options.method.removeprefix("scipy-"), *controlled)
    if options.method == "auto":
        from multicell.integrators.auto import Auto

        return Auto(*controlled)
    raise ValueError(f"no integrator is called {options.method!r}")


METHODS: dict[str, str] = {
    "auto": "ab2-adaptive, dopri5, rkc2 or cvode, chosen for each coupling step",
    "cvode": "implicit: SUNDIALS CVODE, BDF with Newton-Krylov",
    "cvode-sparse": "implicit: SUNDIALS CVODE, BDF with a direct sparse solver (SuperLU_MT)",
    "cvode-adams": "implicit: SUNDIALS CVODE, Adams formulas, solved by the same Newton-Krylov",
    "backward-euler": "implicit Euler with a fixed step, Newton with conjugate gradients",
    "euler": "explicit Euler with a fixed step",
    "euler-adaptive": "explicit Euler under error control",
    "heun": "explicit Runge-Kutta of order 2 with a fixed step",
    "ab2": "explicit Adams-Bashforth of order 2 with a fixed step",
    "ab2-adaptive": "explicit Adams-Bashforth of order 2 under error control",
    "rk4": "explicit Runge-Kutta of order 4 with a fixed step",
    "dopri5": "explicit Runge-Kutta of Dormand and Prince, order 5, under error control",
    "rkc2": "explicit, stabilised: Runge-Kutta-Chebyshev of order 2 under error control",
    "scipy-rk45": "outside reference: SciPy's RK45",
    "scipy-dop853": "outside reference: SciPy's DOP853",
    "scipy-lsoda": "outside reference: SciPy's LSODA, up to 1000 cells",
    "scipy-radau": "outside reference: SciPy's Radau, up to 3000 cells",
    "scipy-bdf": "outside reference: SciPy's BDF, up to 6000 cells",
}
"""Name of each integration method -> what it is, in one line."""

FIXED_STEP = ("backward-euler", "euler", "heun", "ab2", "rk4")
"""Methods that take equal steps of the length that the scene gives."""
