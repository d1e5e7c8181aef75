"""Solutions by SciPy of motions whose right-hand sides are written out here, apart from ours."""

import functools

import numpy as np
from scipy.integrate import solve_ivp
from strategies import mechanics


def four_cells():
    """Four cells that touch each other for longer than the tests last: a smooth problem."""
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    shift = np.random.default_rng(0).normal(0.0, 0.2, (4, 3))
    radius, young = np.array([5.0, 4.6, 4.8, 5.2]), np.array([1.0, 1.1, 0.9, 1.05])
    return 4.4 * corners / np.sqrt(2.0) + shift, radius, young


def two_cells():
    return np.array([[0.0, 0, 0], [6, 1, 2]]), np.array([5.0, 4.5]), np.array([1.0, 1.1])


@functools.cache
def exact_end(cells, law, duration):
    """Return where some cells end, by DOP853; the right-hand side is written out from eq. 3.6."""
    position, radius, young = cells()
    i, j = np.triu_indices(len(radius), 1)
    reduced = radius[i] * radius[j] / (radius[i] + radius[j])
    modulus = 1.0 / (0.75 * 0.75 * (1.0 / young[i] + 1.0 / young[j]))
    sticky = np.sqrt(6.0 * np.pi * getattr(law, "surface_energy", 0.0))

    def rhs(_, y):
        x = y.reshape(-1, 3)
        d = x[j] - x[i]
        distance = np.linalg.norm(d, axis=1)
        h = radius[i] + radius[j] - distance
        assert (h > 0.0).all()
        force = modulus * reduced**0.5 * h**1.5 - sticky * np.sqrt(modulus * (reduced * h) ** 1.5)
        pull = (force / distance)[:, None] * d
        total = np.zeros_like(x)
        np.add.at(total, i, -pull)
        np.add.at(total, j, pull)
        return (total / (6.0 * np.pi * 5.0 * radius[:, None])).ravel()

    span = (0.0, duration)
    solution = solve_ivp(rhs, span, position.ravel(), method="DOP853", rtol=1e-13, atol=1e-13)
    return solution.y[:, -1].reshape(-1, 3)


def smooth_scene():
    """Twenty cells in a helix of tetrahedra: each keeps its contacts, and no kink is passed."""
    k, edge = np.arange(20), 6.6
    angle, width = k * np.arccos(-2 / 3), 0.3 * np.sqrt(3) * edge
    position = np.stack(
        [width * np.cos(angle), width * np.sin(angle), k * edge / np.sqrt(10)], axis=1
    ) + np.random.default_rng(3).normal(0.0, 0.1, (20, 3))
    return position, lambda: mechanics(np.full(20, 5.0), np.ones(20), duration=60.0)


def reference(system, position, tolerance=1e-13):
    """Return where DOP853 leads the cells of a system, in steps that may throw none away."""
    from multicell.integrators.scipy import Scipy

    outcome = Scipy("DOP853", 3e-14, tolerance).integrate(system, position)
    assert outcome.done
    return outcome.position
