"""The layer of medium round a tissue on a grid of cubes or squares, which ends at one distance.

A box round the tissue has corners, which are farther from the tissue than its faces: by itself it
makes the layer thicker there. So nodes farther from the tissue than the layer is thick exchange
with the medium, much faster than by diffusion; and a node inside, of which a neighbour lies
outside, exchanges as much as makes the flow between both that to the medium where the layer ends.
With the end at a part θ of the way, that flow is D (c_medium - c) / (θ h) and diffusion between the
nodes gives D (c_medium - c) / h already: the rate is D/h² (1/θ - 1), never negative, so that the
equations stay an M-matrix. It is of second order in the spacing (Gibou, Fedkiw, Cheng & Kang 2002,
J. Comput. Phys. 176:205), and continuous as the tissue moves.

The layer is the balls of ``margin`` round the cells, or of their own radii where these are larger.
What lies outside all of them and is not shut in by them is medium. Gaps in tissue are none, however
thin the layer: which nodes are shut in is decided by balls of 1.5 radii or more.
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
"""Reach over the radius of a cell within which gaps in tissue are no medium."""

_BINS: Final = 4_000_000  # at most, by which cells inside the tissue are left out
_BIN: Final = 3.25  # edge of a bin in radii of cells: few are empty in dense tissue
_COVERS: Final = 0.42
"""Largest edge of a bin over how far cells reach: so near ones cover each other's balls."""

_COARSE: Final = 4.0  # least reach in spacings at which every second node is near enough
_MANY: Final = 100_000  # rows of nodes, about, that cells reach before less is worth it


def exchange_beyond(
    box: Box, tissue: FloatArray, position: FloatArray, radius: FloatArray, margin: float
) -> FloatArray:
    """Return the rate of exchange with the medium of all nodes over D/h², shape of the box.

    - ``tissue``, (n, 3) µm: where cells count for the layer; those that have strayed from their
      ``position`` to there (:func:`multicell.nutrient.tissue.drawn_in`) reach less far by as much
    - ``radius``, (n,), ``margin``, µm: of the cells, thickness of the layer from their centres
    """
    reach, closed = _reaches(radius, margin)
    if tissue is not position:
        away = lengths(position - tissue)
        near = reach > away
        tissue, reach, closed = tissue[near], (reach - away)[near], (closed - away)[near]
    flat, out = box.height is not None, np.empty(box.shape)
    if len(tissue) == 0:
        out.fill(HELD_RATE)
        return out
    first = np.array(box.origin) - 0.5 * box.spacing
    if flat:
        tissue, first[2] = tissue * [1.0, 1.0, 0.0], 0.0
    # one node more at each end, beyond the faces
    counts = [n + 2 for n in box.shape[:2]] + [1 if flat else box.shape[2] + 2]
    width = _BIN * float(radius.mean())
    distance = _distances(tissue, closed, width, first, box.spacing, counts)
    medium = _beyond(distance)
    opened = float((closed - reach).max()) / box.spacing
    if opened > 0.0:
        from scipy.ndimage import binary_dilation

        distance = _distances(tissue, reach, width, first, box.spacing, counts)
        rings = math.ceil(opened)  # towards the cells, and no farther into gaps
        medium = binary_dilation(medium, iterations=rings, mask=distance >= 0.0).view(np.uint8)
    _exchange(distance, medium, flat, HELD_RATE, out)
    return out


def _reaches(radius: FloatArray, margin: float) -> tuple[FloatArray, FloatArray]:
    """Return how far from cells the layer ends, and within which distance gaps are none, µm."""
    return np.maximum(margin, radius), np.maximum(margin, _CLOSED * radius)


def farthest_end(radius: FloatArray, margin: float) -> float:
    """Return how far from the outermost centres a grid extends round the layer, µm."""
    return max(margin, _CLOSED * float(radius.max(initial=1.0)))


def _distances(
    position: FloatArray,
    reach: FloatArray,
    width: float,
    first: FloatArray,
    spacing: float,
    counts: list[int],
) -> NDArray[np.float32]:
    """Return the distance of nodes from the balls' surfaces in spacings, negative inside.

    - ``width``, µm: of bins, by which cells inside the tissue are left out

    Where many cells reach many nodes they are found at every second node along each axis, and are
    means of these between, where a surface is smooth at the scale of nodes.
    """
    most = float(reach.max()) / spacing
    few = len(position) * most**2 <= _MANY
    exposed = np.full(len(position), 255, np.uint8) if few else _exposed(position, reach, width)
    many = np.count_nonzero(exposed) * most**2 > max(_MANY, math.prod(counts))
    step = 2 if most >= _COARSE and many else 1
    coarse = [1 if n == 1 else (n - 1) // step + 2 for n in counts]
    square = np.full(coarse, np.float32(np.inf))
    # two nodes that are diagonally across lie on either side of one that is a spacing beyond
    beyond = 1.001 if step == 1 else 1.4
    _stamp(position, reach, exposed, first, 1.0 / (step * spacing), beyond, square)
    found = np.sqrt(square, out=square)
    found -= np.float32(most / step)
    if step == 2:
        found *= np.float32(step)
        for axis in range(found.ndim):
            if counts[axis] > 1:
                found = _with_middles(found, axis)
    nx, ny, nz = counts
    return np.ascontiguousarray(found[:nx, :ny, :nz])


def _with_middles(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Return values with the means of neighbours between them along an axis."""
    values = np.moveaxis(values, axis, 0)
    out = np.empty((2 * len(values) - 1, *values.shape[1:]), np.float32)
    out[::2] = values
    np.add(values[1:], values[:-1], out=out[1::2])
    out[1::2] *= np.float32(0.5)
    return np.moveaxis(out, 0, axis)


def mean_end(position: FloatArray, radius: FloatArray, margin: float) -> float:
    """Return the distance of the end of the layer from the origin, its mean over directions, µm.

    - ``position``, (n, 3) µm: of cells round the origin
    """
    found = np.full(len(_DIRECTIONS), -np.inf)
    reach, closed = _reaches(radius, margin)
    _reach_along(_DIRECTIONS, position, closed, found)
    return float(np.maximum(found, 0.0).mean() - (closed - reach).mean())


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


def _exposed(position: FloatArray, reach: FloatArray, width: float) -> NDArray[np.uint8]:
    """Return the octants of cells' balls that others need not cover, a bit for each, (n,).

    - ``width``, µm: of bins, which cells are sorted into

    Where bins towards an octant hold cells that reach as far as any, these cover that part of a
    ball, but for what is as near to the cell as they are.
    """
    out = np.full(len(position), 255, dtype=np.uint8)
    low, high = corners(position)
    width = min(width, _COVERS * float(reach.max()))
    counts = ((high - low) / width).astype(np.int64) + 4
    if math.prod(counts.tolist()) <= _BINS:
        out[:] = 0
        for shift in (1.0, 1.5):  # in one lattice cells beyond may be hardly farther out
            origin = low - shift * width
            _expose(position, reach, origin, 1.0 / width, np.zeros(counts, np.uint8), out)
    return out


@_jit
def _expose(position: Any, reach: Any, origin: Any, scale: float, filled: Any, out: Any) -> None:
    """Add the octants of cells' balls that have bins without cells; ``filled`` are the bins.

    Bits of octants count up along z, y and x. A plane has one bin along z, which covers both ways.
    """
    nx, ny, nz = filled.shape
    places = np.empty((out.size, 3), np.int32)
    whole, flat = np.max(reach) * (1.0 - 1e-12), True
    for cell in range(out.size):
        for axis in range(3):
            places[cell, axis] = int((position[cell, axis] - origin[axis]) * scale)
        flat = flat and position[cell, 2] == position[0, 2]
        if reach[cell] >= whole:
            filled[places[cell, 0], places[cell, 1], places[cell, 2]] = 1
    found = np.zeros((nx, ny, nz), np.uint8)
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            for k in range(1, nz - 1):
                bits = 0
                for octant in range(8):
                    a, b = 2 * (octant // 4) - 1, 2 * (octant // 2 % 2) - 1
                    c = 0 if flat else 2 * (octant % 2) - 1
                    near = filled[i + a, j, k] & filled[i, j + b, k] & filled[i, j, k + c]
                    near &= filled[i + a, j + b, k] & filled[i, j + b, k + c]
                    near &= filled[i + a, j, k + c] & filled[i + a, j + b, k + c]
                    if not near:
                        bits |= 1 << octant
                found[i, j, k] = bits
    for cell in range(out.size):
        out[cell] |= found[places[cell, 0], places[cell, 1], places[cell, 2]]


@_inner
def _ends(middle: float, far: float, count: int, low: bool, high: bool) -> Any:
    """Return the first node within ``far`` of a place along an axis, and the one after the last.

    Without ``low``, ``high`` those below it, above it are left out.
    """
    first = np.ceil(middle - far if low else middle)
    last = np.floor(middle + far if high else middle)
    return max(int(first), 0), min(int(last) + 1, count)


@_jit
def _stamp(
    position: Any, reach: Any, exposed: Any, first: Any, scale: float, beyond: float, square: Any
) -> None:
    """Write the squared distances of nodes from cells, as far as ``beyond`` the surfaces of balls.

    ``first`` is the first node, 1 / ``scale`` their distance. Cells that reach less far than others
    count as farther away by as much.
    """
    nx, ny, nz = square.shape
    most = np.max(reach) * scale
    along = np.empty(nz, np.float32)
    for cell in range(reach.size):
        if exposed[cell] == 0:
            continue
        x, y = (position[cell, 0] - first[0]) * scale, (position[cell, 1] - first[1]) * scale
        z, own = (position[cell, 2] - first[2]) * scale, reach[cell] * scale
        less, bits, far = np.float32(most - own), int(exposed[cell]), own + beyond
        k0, k1 = _ends(z, far, nz, True, True)
        for k in range(k0, k1):
            along[k] = (k - z) ** 2
        for quarter in range(4):
            ways = bits >> (2 * quarter) & 3
            if ways == 0:
                continue
            i0, i1 = _ends(x, far, nx, quarter < 2, quarter >= 2)
            j0, j1 = _ends(y, far, ny, quarter % 2 == 0, quarter % 2 == 1)
            k0, k1 = _ends(z, far, nz, ways != 2, ways != 1)
            rest = along[k0:k1]
            for i in range(i0, i1):
                for j in range(j0, j1):
                    away = np.float32((i - x) ** 2 + (j - y) ** 2)
                    if away > far * far:
                        continue
                    row = square[i, j, k0:k1]
                    if less == 0.0:
                        for k in range(row.size):
                            row[k] = min(row[k], away + rest[k])
                    else:
                        for k in range(row.size):
                            row[k] = min(row[k], (np.sqrt(away + rest[k]) + less) ** 2)


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
def _exchange(distance: Any, medium: Any, flat: bool, most: float, out: Any) -> None:
    """Write the rates of exchange over D/h², of which ``most`` is the largest."""
    nx, ny, nz = out.shape
    up = 0 if flat else 1
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                a, b, c = i + 1, j + 1, k + up
                if medium[a, b, c]:
                    out[i, j, k] = most
                    continue
                inside, total = -float(distance[a, b, c]), 0.0
                if inside <= 0.0:  # in a gap
                    out[i, j, k] = 0.0
                    continue
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
                out[i, j, k] = min(total, most)


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
