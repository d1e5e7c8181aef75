"""A slab of cubes or squares, and a ball of shells, whose sides are kept at one level."""

import numpy as np
from pde import CartesianGrid, SphericalSymGrid

LEVEL = 0.07
SIZE = {"cubes": 160.0, "squares": 180.0, "shells": 120.0}
NODES = {"cubes": 16, "squares": 24, "shells": 40}


def layers_of(kind, times=1):
    """Return a slab of cubes or squares across x, or a ball of shells."""
    size, n = SIZE[kind], NODES[kind]
    if kind == "shells":
        return SphericalSymGrid(size, n * times)
    # what lies across x does not matter: few nodes do where it is refined
    rest = n if times == 1 else 2
    h = size / (n * times)
    axes = 2 if kind == "cubes" else 1
    return CartesianGrid([(0.0, size)] + [(0.0, rest * h)] * axes, [n * times] + [rest] * axes)


def ends_of(kind):
    if kind == "shells":
        return {"value": LEVEL}
    return {"x": {"value": LEVEL}, "*": {"derivative": 0.0}}


def along(kind, data):
    """Return a field along x, or along the radius; it is the same across."""
    if kind == "shells":
        return data
    first = data.reshape(data.shape[0], -1)
    assert np.ptp(first, axis=1).max() < 1e-9 * LEVEL
    return first[:, 0]
