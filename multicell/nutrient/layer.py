"""The layer of medium round a tissue on a grid of cubes or squares, which ends at one distance.

A box round the tissue has corners, which are farther from the tissue than its faces: by itself it
makes the layer thicker there. So nodes farther from the tissue than the layer is thick exchange
with the medium, much faster than by diffusion; and a node inside, of which a neighbour lies
outside, exchanges as much as makes the flow between both that to the medium where the layer ends.
With the end at a part θ of the way, that flow is D (c_medium - c) / (θ h) and diffusion between the
nodes gives D (c_medium - c) / h already: the rate is D/h² (1/θ - 1), never negative, so that the
equations stay an M-matrix. It is of second order in the spacing (Gibou, Fedkiw, Cheng & Kang 2002,
J. Comput. Phys. 176:205), and continuous as the tissue moves.

The layer is the balls of ``reach`` round the cells. What lies outside all of them and is not shut
in by them is medium.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import INNER, KERNEL, typed
from multicell.nutrient.cartesian import Box
from multicell.scene.field_solvers import HELD_RATE
from multicell.vectors import corners, lengths

_jit, _inner = typed(**KERNEL), typed(**INNER)

_CLOSED: Final = 1.5
"""Least reach over the radius of a cell: gaps in tissue are no medium, however thin the layer."""

_BINS: Final = 4_000_000  # at most, by which cells inside the tissue are left out


def exchange_beyond(
    box: Box, tissue: FloatArray, position: FloatArray, radius: FloatArray, margin: float
) -> FloatArray:
    """Return the rate of exchange with the medium of all nodes over D/h², shape of the box.

    - ``tissue``, (n, 3) µm: where cells count for the layer; those that have strayed from their
      ``position`` to there (:func:`multicell.nutrient.tissue.drawn_in`) reach less far by as much
    - ``radius``, (n,), ``margin``, µm: of the cells, thickness of the layer from their centres
    """
    reach = np.maximum(margin, _CLOSED * radius)
    if tissue is not position:
        reach = reach - lengths(position - tissue)
        tissue, reach = tissue[reach > 0.0], reach[reach > 0.0]
    flat = box.height is not None
    nx, ny, nz = box.shape
    # one node more at each end, beyond the faces
    distance = np.full((nx + 2, ny + 2, nz if flat else nz + 2), np.float32(np.inf))
    first = np.array(box.origin) - 0.5 * box.spacing
    first[2] = 0.0 if flat else first[2]
    points = (tissue - first) / box.spacing
    points[:, 2] *= not flat
    rows = _outer(points[:, : 2 if flat else 3], reach / box.spacing)
    _stamp(points[rows], reach[rows] / box.spacing, distance)
    out = np.empty(box.shape)
    _exchange(distance, _beyond(distance), flat, out)
    return out


def mean_end(position: FloatArray, radius: FloatArray, margin: float) -> float:
    """Return the distance of the end of the layer from the origin, its mean over directions, µm.

    - ``position``, (n, 3) µm: of cells round the origin
    """
    found = np.full(len(_DIRECTIONS), -np.inf)
    _reach_along(_DIRECTIONS, position, np.maximum(margin, _CLOSED * radius), found)
    return float(np.maximum(found, 0.0).mean())


def _directions(count: int) -> FloatArray:
    """Return directions that are spread evenly, a spiral of Fibonacci, (count, 3)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.arange(count) * math.pi * (3.0 - math.sqrt(5.0))
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


_DIRECTIONS: Final = _directions(100)


@_jit
def _reach_along(directions: Any, position: Any, reach: Any, found: Any) -> None:
    """Write how far along directions from the origin the balls round the cells reach."""
    least = -np.inf
    for cell in range(position.shape[0]):
        x, y, z, size = position[cell, 0], position[cell, 1], position[cell, 2], reach[cell]
        square = x * x + y * y + z * z
        if math.sqrt(square) + size <= least:  # most cells of a ball lie deeper
            continue
        for m in range(found.size):
            along = x * directions[m, 0] + y * directions[m, 1] + z * directions[m, 2]
            left = size * size - square + along * along
            if left > 0.0:
                found[m] = max(found[m], along + math.sqrt(left))
        least = np.min(found)


def _outer(points: FloatArray, reach: FloatArray) -> NDArray[np.int64]:
    """Return the cells that may reach farthest: all but those with others on every side.

    A cell is inside where all bins round its own hold cells, in two lattices of bins half as wide
    as cells reach. Its ball is then covered by theirs.
    """
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    low, high = (x[: points.shape[1]] for x in corners(np.resize(points.T, (3, len(points))).T))
    width = 0.5 * float(reach.max())
    whole = reach >= reach.max() * (1.0 - 1e-12)
    if float(np.prod((high - low) / width + 4.0)) > _BINS or not whole.all():
        return np.arange(len(points))
    outer = np.zeros(len(points), dtype=np.bool_)
    for shift in (1.0, 1.5):
        bins = ((points - low) * (1.0 / width) + shift).astype(np.int64)
        filled = np.zeros(bins.max(axis=0) + 2, dtype=np.bool_)
        place = tuple(bins.T)
        filled[place] = True
        for axis in range(filled.ndim):
            line = np.moveaxis(filled, axis, 0)
            inner = line.copy()
            inner[1:] &= line[:-1]
            inner[:-1] &= line[1:]
            filled = np.moveaxis(inner, 0, axis)
        outer |= ~filled[place]
    return np.flatnonzero(outer)


@_inner
def _ends(middle: float, far: float, count: int) -> Any:
    """Return the first node within ``far`` of a place along an axis, and the one after the last."""
    return max(int(np.ceil(middle - far)), 0), min(int(np.floor(middle + far)) + 1, count)


@_jit
def _stamp(points: Any, reach: Any, distance: Any) -> None:
    """Write the distance of nodes from the balls' surfaces, negative inside, up to one spacing.

    Most balls have one size: of these squared distances from the middles are compared.
    """
    nx, ny, nz = distance.shape
    most = np.max(reach) if reach.size > 0 else 0.0
    square, size = np.empty(nz, np.float32), np.float32(most)
    for turn in range(2):
        for cell in range(points.shape[0]):
            if (reach[cell] == most) != (turn == 0):
                continue
            x, y, z, far = points[cell, 0], points[cell, 1], points[cell, 2], reach[cell] + 1.001
            i0, i1 = _ends(x, far, nx)
            j0, j1 = _ends(y, far, ny)
            k0, k1 = _ends(z, far, nz)
            for k in range(k0, k1):
                square[k] = (k - z) ** 2
            along, own = square[k0:k1], np.float32(reach[cell])
            for i in range(i0, i1):
                for j in range(j0, j1):
                    away = np.float32((i - x) ** 2 + (j - y) ** 2)
                    if away > far * far:
                        continue
                    row = distance[i, j, k0:k1]
                    if turn == 0:
                        for k in range(row.size):
                            row[k] = min(row[k], away + along[k])
                    else:
                        for k in range(row.size):
                            row[k] = min(row[k], np.sqrt(away + along[k]) - own)
        if turn == 0:
            found = distance.reshape(-1)
            for n in range(found.size):
                found[n] = np.sqrt(found[n]) - size


@_jit
def _beyond(distance: Any) -> Any:
    """Return which nodes are medium: outside all balls, and joined to the ends by such nodes."""
    nx, ny, nz = distance.shape
    medium = np.zeros((nx, ny, nz), np.uint8)
    flat, found = medium.reshape(-1), distance.reshape(-1)
    stack, filled = np.empty(flat.size, np.int64), 0
    for i in range(nx):
        for j in range(ny):
            inside = 0 < i < nx - 1 and 0 < j < ny - 1
            if inside and nz == 1:
                continue
            row, marks = distance[i, j], medium[i, j]
            for turn in range(2):  # along the rows first: all but hollows behind overhangs
                for m in range(nz):
                    k = m if turn == 0 else nz - 1 - m
                    if row[k] >= 0.0:
                        marks[k] = 1
                    elif inside:
                        break
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if distance[i, j, k] < 0.0 or medium[i, j, k]:
                    continue
                beside = (i > 0 and medium[i - 1, j, k]) or (i < nx - 1 and medium[i + 1, j, k])
                beside |= (j > 0 and medium[i, j - 1, k]) or (j < ny - 1 and medium[i, j + 1, k])
                if beside:
                    n = (i * ny + j) * nz + k
                    flat[n], stack[filled] = 1, n
                    filled += 1
    while filled > 0:
        filled -= 1
        n = stack[filled]
        i, j, k = n // (ny * nz), n // nz % ny, n % nz
        for face in range(6):
            side = 2 * (face % 2) - 1
            a = i + side if face // 2 == 0 else i
            b = j + side if face // 2 == 1 else j
            d = k + side if face // 2 == 2 else k
            if 0 <= a < nx and 0 <= b < ny and 0 <= d < nz:
                m = (a * ny + b) * nz + d
                if flat[m] == 0 and found[m] >= 0.0:
                    flat[m], stack[filled] = 1, m
                    filled += 1
    return medium


@_jit
def _exchange(distance: Any, medium: Any, flat: bool, out: Any) -> None:
    """Write the rates of exchange over D/h²."""
    nx, ny, nz = out.shape
    up = 0 if flat else 1
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                a, b, c = i + 1, j + 1, k + up
                if medium[a, b, c]:
                    out[i, j, k] = HELD_RATE
                    continue
                inside, total = -float(distance[a, b, c]), 0.0
                for face in range(4 if flat else 6):
                    side = 2 * (face % 2) - 1
                    d = a + side if face // 2 == 0 else a
                    e = b + side if face // 2 == 1 else b
                    f = c + side if face // 2 == 2 else c
                    if medium[d, e, f]:
                        beyond = float(distance[d, e, f])
                        # a face of the grid is half a spacing away, and counts as that already
                        edge = d == 0 or d == nx + 1 or e == 0 or e == ny + 1
                        edge = edge or (not flat and (f == 0 or f == nz + 1))
                        ratio = (inside + beyond) / max(inside, 1e-9)
                        total += max(ratio - (2.0 if edge else 1.0), 0.0)
                out[i, j, k] = min(total, HELD_RATE)


def exchanged(exchange: FloatArray, c: FloatArray, level: float) -> tuple[float, float]:
    """Return the gain of all nodes from the medium and their loss to it, mM times ``exchange``.

    - ``level``, mM: of the medium
    """
    gained, given = _exchanged(exchange.ravel(), c.ravel(), level)
    return float(gained), float(given)


@_jit
def _exchanged(exchange: Any, c: Any, level: float) -> Any:
    gained = given = 0.0
    for n in range(c.size):
        if exchange[n] > 0.0:
            net = exchange[n] * (level - c[n])
            if net > 0.0:
                gained += net
            else:
                given -= net
    return gained, given
