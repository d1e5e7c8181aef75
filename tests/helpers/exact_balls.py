"""A ball that consumes, in 160 shells: closed forms, SciPy, and the package's own solution."""

import numpy as np
from scipy.integrate import solve_bvp

from multicell.nutrient.spherical import Shells

D, R, SHELLS = 1000.0, 150.0, 160
UPTAKE, CORE = 0.02, 60.0  # mM/s, and radius of the starved core, µm
RADII = (np.arange(SHELLS) + 0.5) * R / SHELLS
SURFACE = UPTAKE / (6 * D) * (R**2 - 3 * CORE**2 + 2 * CORE**3 / R)


def shells(uptake, half, surface, linear=0.0):
    """Return the concentrations of the package's solver."""
    start = np.full(SHELLS, surface)
    solver = Shells(R, SHELLS, D, surface)
    return solver.solve(np.full(SHELLS, uptake), half, start, linear=linear)[0]


def starved(r):
    """Return c of uptake of zeroth order, which ends at the core: c = c' = 0 there."""
    rim = UPTAKE / (6 * D) * (r**2 - 3 * CORE**2 + 2 * CORE**3 / r)
    return np.where(r > CORE, rim, 0.0)


def michaelis_menten(half):
    """Return c over the radius by SciPy, for the uptake and surface of the starved ball."""

    def between(r, y):
        r = np.maximum(r, 1e-9)
        return np.stack([y[1], UPTAKE * y[0] / (half + y[0]) / D - 2 * y[1] / r])

    mesh = np.linspace(1e-3, R, 400)
    start = np.stack([np.full(400, SURFACE), np.zeros(400)])
    ends = lambda a, b: np.array([a[1], b[0] - SURFACE])  # noqa: E731
    found = solve_bvp(between, ends, mesh, start, tol=1e-8, max_nodes=10**5)
    assert found.success
    return lambda r: found.sol(r)[0]
