"""Small smooth problems of motion, and where SciPy leads their cells."""

import functools

import numpy as np
from formulas import end_of
from strategies import mechanics


def four_cells():
    """Four cells that touch each other for longer than the tests last: a smooth problem."""
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    shift = np.random.default_rng(0).normal(0.0, 0.2, (4, 3))
    radius, young = np.array([5.0, 4.6, 4.8, 5.2]), np.array([1.0, 1.1, 0.9, 1.05])
    return 4.4 * corners / np.sqrt(2.0) + shift, radius, young


@functools.cache
def exact_end(cells, law, duration):
    """Return where some cells end, by DOP853; the right-hand side is that of :mod:`formulas`."""
    return end_of(*cells(), law, duration)


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

    outcome = Scipy(3e-14, tolerance, name="DOP853").integrate(system, position)
    assert outcome.done
    return outcome.position
