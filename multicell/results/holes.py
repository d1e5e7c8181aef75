"""The largest hole in a tissue: an empty ball that nothing the size of a cell could come to."""

from __future__ import annotations

import numpy as np

from multicell.cells import Cells, FloatArray, IntArray


def largest_hole(cells: Cells) -> float:
    """Return the radius of the largest empty ball within the tissue, µm; NaN if there is no inside.

    The balls round the tetrahedra of Delaunay's triangulation are the largest between the centres.
    What a probe with the median radius of the living reaches from outside, from tetrahedron to
    tetrahedron through faces that it fits through, is no hole, however deep. A ball ends at the
    largest of the four cells that it touches.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import Delaunay, QhullError

    living = cells.radius[~cells.dead]
    if len(cells) < 5:
        return float("nan")
    try:
        mesh = Delaunay(cells.position)
    except QhullError:  # all in a plane
        return float("nan")
    probe = float(np.median(living if living.size else cells.radius))
    n = len(mesh.simplices)
    wide = _openings(cells, mesh.simplices) > probe
    # the outside is one more tetrahedron, next to all faces of the hull
    inner, face = np.nonzero(wide)
    beyond = np.where(mesh.neighbors < 0, n, mesh.neighbors)[inner, face]
    ones = np.ones(inner.size, dtype=bool)
    joined = coo_array((ones, (inner, beyond)), shape=(n + 1, n + 1))
    _, group = connected_components(joined, directed=False)
    centre, radius = _balls(cells.position[mesh.simplices])
    place = mesh.find_simplex(centre)
    closed = (place >= 0) & (group[place] != group[n]) & (group[:n] != group[n])
    room = radius - cells.radius[mesh.simplices].max(axis=1)
    return float(room[closed].max(initial=0.0)) if closed.any() else float("nan")


def _openings(cells: Cells, simplices: IntArray) -> FloatArray:
    """Return the radius of the largest ball through the face across each corner, (n, 4) µm.

    Of an obtuse triangle it is less than half the longest side.
    """
    found = np.empty(simplices.shape)
    for corner in range(4):
        face = np.delete(simplices, corner, axis=1)
        points = cells.position[face]
        sides = np.linalg.norm(points - np.roll(points, 1, axis=1), axis=2)
        longest, half = sides.max(axis=1), 0.5 * sides.sum(axis=1)
        area = np.sqrt(np.maximum(half * (half[:, None] - sides).prod(axis=1), 0.0))
        obtuse = 2.0 * longest**2 > (sides**2).sum(axis=1)
        with np.errstate(divide="ignore"):
            round_it = sides.prod(axis=1) / (4.0 * area)
        found[:, corner] = np.where(obtuse, 0.5 * longest, round_it)
        found[:, corner] -= cells.radius[face].min(axis=1)
    return found


def _balls(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return centres (n, 3) and radii (n,) of the balls round tetrahedra (n, 4, 3); 0 if flat."""
    edges = corners[:, 1:] - corners[:, :1]
    solid = np.abs(np.linalg.det(edges)) > 1e-9 * np.linalg.norm(edges, axis=2).prod(axis=1)
    offset = np.zeros((len(corners), 3))
    squares = 0.5 * (edges[solid] ** 2).sum(axis=2)
    offset[solid] = np.linalg.solve(edges[solid], squares[:, :, None])[:, :, 0]
    return corners[:, 0] + offset, np.linalg.norm(offset, axis=1)
