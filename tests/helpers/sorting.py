"""Sorting of cells of two types, by their contacts."""

import numpy as np
from scipy.spatial import Delaunay


def mixed(frame):
    """Return the part of contacts between types, of neighbours by Delaunay within 1.5 diameters.

    Cells have a diameter of 10 µm.
    """
    place = frame.cells.position[:, :2]
    corners = Delaunay(place).simplices
    edges = np.unique(np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0)
    near = np.linalg.norm(place[edges[:, 0]] - place[edges[:, 1]], axis=1) < 15.0
    first, second = frame.cells.kind[edges[near]].T
    return float((first != second).mean())
