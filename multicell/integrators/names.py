"""The names of the methods; a light module, so that a scene can be read without loading them."""

from __future__ import annotations

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
