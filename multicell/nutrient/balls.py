"""Shares of a cell at each node: one operator spreads amounts of cells and reads fields.

A cell is a ball of uniform density to its fields, a disc in a plane, and a point where its radius
is zero. Its weight at a node is the mean of the node's hat function over it: cells read the mean of
the interpolated field over their ball, and amounts are spread by the transpose. Weights are not
negative and sum to one, lines are read exactly, and means and densities tend to those of the ball
with the square of the spacing.

The ball is built of boxes, for which means of hat functions are closed forms: k boxes of one size
along each axis, each as dense as the part of it that the ball fills, in a lattice with the ball's
second moments. Where the spacing is not much below the radius it is one box: a cube of
uniform density, whose mean potential is within 1.3 % of the ball's. Else there are as many as leave
the error of the spacing the larger one.

On shells the weight is the part of the ball in each shell, a closed form too. There the ball is
wider by what hat functions widen it in a box (half a squared spacing), so that concentrations do
not jump where a cell crosses from shell to shell.

Parts of a ball beyond a face are mirrored there, those beyond the last shell count for that.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple, final

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import INLINED, INNER, KERNEL, UNCOUNTED
from multicell.compiling.threads import Team
from multicell.nutrient.cartesian import Box

_POINT = 0.01
"""Radius over the spacing below which a cell is a point: as near as 2e-5 squared spacings."""

_PER_RADIUS = 1.8
"""Boxes along an axis for each spacing that a radius is long: their error in the potential of a
ball, 0.14 over their number squared, is a tenth of that by the spacing, 0.42 squared spacings over
the squared radius."""

_ONE = 1.6
"""Radius over the spacing up to which one box makes a ball."""

_MOST = 24
"""Boxes along an axis at most: the mean potential of a ball is then right to 3e-4."""

_PART = 10_000
"""Least number of cells for each thread that shares them."""

_BLOCK = 64
"""Cells whose weights are found together."""

_LINES = 12
"""Lines over the width of a box by which the part of it in the ball is found."""


@lru_cache(maxsize=64)
def _boxes_of(count: int, flat: bool) -> tuple[FloatArray, float]:
    """Return the densities of the boxes, (k, k, k) or (k, k, 1), and their size over the radius.

    Densities sum to one.
    """
    axes = 2 if flat else 3
    along = _filled(count, axes)  # by lines along the last axis: the others have their turn
    filled = np.mean([np.moveaxis(along, -1, axis) for axis in range(axes)], axis=0)
    filled = np.ascontiguousarray(0.5 * (filled + filled.swapaxes(0, 1)))
    filled = filled[:, :, None] if flat else filled
    filled /= filled.sum()
    away = np.arange(count) - 0.5 * (count - 1)
    moment = float(filled.sum(axis=(1, 2)) @ away**2) + 1.0 / 12.0
    return filled, math.sqrt((0.25 if flat else 0.2) / moment)


def _filled(count: int, axes: int) -> FloatArray:
    """Return the part of each square or cube in a disc or ball of radius count / 2, by lines."""
    half, lines = 0.5 * count, ((np.arange(count * _LINES) + 0.5) / _LINES - 0.5 * count) ** 2
    square = half**2 - (lines if axes == 2 else lines[:, None] + lines)
    chord = np.sqrt(np.maximum(square, 0.0))[..., None]
    edges = np.clip(np.arange(count + 1) - half, -chord, chord)
    parts = np.diff(edges, axis=-1).reshape(*[count, _LINES] * (axes - 1), count)
    return np.asarray(parts.mean(axis=tuple(range(1, 2 * axes - 2, 2))))


@lru_cache(maxsize=16)
def _tables(most: int, flat: bool) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Return densities of the boxes, (all,), where those of each number begin, and sizes."""
    known = [_boxes_of(count, flat) for count in range(1, most + 1)]
    first = np.cumsum([0, 0, *(filled.size for filled, _ in known)])
    sizes = np.array([0.0, *(size for _, size in known)])
    return np.concatenate([filled.ravel() for filled, _ in known]), first, sizes


def _balls(radius: FloatArray, spacing: float, flat: bool) -> tuple[Any, ...]:
    """Return of each cell how many boxes it is made of along an axis, and their size in spacings.

    Besides densities of boxes, where those of each number begin, and the most nodes along an axis,
    of all cells and of those that are one box. Raises ValueError for radii that are none.
    """
    filled, first, sizes = _tables(1, flat)
    counts, widths = np.empty(len(radius), dtype=np.int64), np.empty(len(radius))
    most = _single_boxes(radius, spacing, sizes[1], counts, widths)
    if not most < np.inf:
        raise ValueError("a radius is negative or not finite")
    largest = most / spacing
    single = sizes[1] * largest
    nodes = int(single) + 4
    if largest > _ONE:
        size = radius / spacing
        large = size > _ONE
        counts[large] = np.minimum(np.ceil(_PER_RADIUS * size[large]), _MOST)
        filled, first, sizes = _tables(int(counts.max()), flat)
        widths = sizes[counts] * size
        single = widths.max(where=~large, initial=0.0)
        nodes = int((counts * widths).max()) + 4
        widths[size <= _POINT] = 0.0
    number = max(int(single) + 3, 4) if single > _POINT else 2
    return counts, widths, filled, first, nodes, number


@njit(**KERNEL)
def _single_boxes(radius, spacing, wide, counts, widths):
    """Write that cells are one box each, ``wide`` times their radius, or points.

    Return the largest radius; infinite where one is none.
    """
    most = 0.0
    for cell in range(radius.size):
        r = radius[cell]
        most = max(most, r) if 0.0 <= r < np.inf else np.inf
        size = r / spacing
        counts[cell], widths[cell] = 1, 0.0 if size <= _POINT else wide * size
    return most


@njit(**INNER)
def _spread(u, width, count, n, weights):
    """Write the weights of ``count`` boxes of a ``width`` side by side round ``u`` in spacings.

    ``u`` is zero at the first of ``n`` nodes. Return the first node with weights, which are
    ``(box, node)``, their number, and whether some were mirrored at an end.
    """
    low = u - 0.5 * count * width
    first = int(np.floor(low))
    number = int(np.floor(count * width)) + 3  # the same for equal cells, for the branch predictor
    if width == 0.0:
        weights[0, 1] = u - first
        weights[0, 0] = 1.0 - weights[0, 1]
        weights[0, 2] = 0.0
    else:
        share = 1.0 / width
        for box in range(count):
            left = low - first + box * width
            for i in range(number):
                part = _hat_below(left + width - i) - _hat_below(left - i)
                weights[box, i] = max(part, 0.0) * share
    if first >= 0 and first + number <= n:
        return first, number, False
    # what lies beyond an end goes to the nodes that mirror it
    begin, end = max(first, 0), min(first + number, n)
    for box in range(count):
        for i in range(number):
            node = first + i
            if node < 0 or node >= n:
                node = -1 - node if node < 0 else 2 * n - 1 - node
                weights[box, min(max(node, begin), end - 1) - first] += weights[box, i]
        for i in range(end - begin):
            weights[box, i] = weights[box, begin - first + i]
    return begin, end - begin, True


@njit(**INLINED)
def _hat_below(x):
    """Return the integral of a hat function of width two up to ``x`` from its middle."""
    x = max(-1.0, min(1.0, x))
    return 0.5 + x * (1.0 - 0.5 * abs(x))


@njit(**INNER)
def _plane(filled, first, box, count, deep, wy, wz, ny, nz, line, plane):
    """Write the weights of one layer of boxes along y and z, of which there are ``deep``."""
    for j in range(ny):
        for k in range(nz):
            plane[j, k] = 0.0
    for b in range(count):
        for k in range(nz):
            line[k] = 0.0
        for c in range(deep):
            dense = filled[first + (box * count + b) * deep + c]
            if dense != 0.0:
                for k in range(nz):
                    line[k] += dense * wz[c, k]
        for j in range(ny):
            if wy[b, j] != 0.0:
                for k in range(nz):
                    plane[j, k] += wy[b, j] * line[k]


@njit(**INNER)
def _inside(u, n):
    return -0.5 <= u <= n - 0.5  # not so of what is no number either


@njit(**INNER)
def _lay(position, begin, size, origin, spacing, widths, points, number, axes, first, weights):
    """Write first nodes and weights of a block of cells that are one box each, or all ``points``.

    Along each of ``axes`` there are ``number`` nodes from ``first``, (3, cell), with ``weights``,
    (3, node, cell).
    """
    left, right, share = np.empty(size), np.empty(size), np.empty(size)
    for c in range(size):
        share[c] = 1.0 / widths[begin + c]
    for axis in range(axes):
        low = origin[axis]
        for c in range(size):
            width = widths[begin + c]
            end = (position[begin + c, axis] - low) / spacing - (0.5 + 0.5 * width)
            first[axis, c] = np.floor(end)
            left[c] = end - first[axis, c]
            right[c] = left[c] + width
        for i in range(number):  # neither sums nor branches inside, for the vector units
            if points:
                for c in range(size):
                    weights[axis, i, c] = max(1.0 - abs(left[c] - i), 0.0)
            else:
                for c in range(size):
                    part = _hat_below(right[c] - i) - _hat_below(left[c] - i)
                    weights[axis, i, c] = max(part, 0.0) * share[c]  # not below by rounding


_FOUR = ir.VectorType(ir.DoubleType(), 4)


def _rows_of(context: Any, builder: Any, signature: Any, given: Any) -> tuple[list[Any], Any]:
    """Write code that reaches four rows of four nodes, which a cell has in a plane, in registers.

    The compiler does not find that by itself, and takes twice as long for the same bits. ``given``:
    nodes, the first, distance of rows, a factor, four weights of rows and four along them. Return
    pointers to the rows with the factor times their weights, and the weights along them.
    """
    nodes, first, stride, factor, rows, along = given
    data = context.make_array(signature.args[0])(context, builder, nodes).data
    vector, found, number = _FOUR(ir.Undefined), [], ir.IntType(32)
    for k in range(4):
        vector = builder.insert_element(vector, builder.extract_value(along, k), number(k))
        place = builder.add(first, builder.mul(stride, ir.IntType(64)(k)))
        pointer = builder.bitcast(builder.gep(data, [place]), _FOUR.as_pointer())
        weight = builder.fmul(factor, builder.extract_value(rows, k))
        one = builder.insert_element(_FOUR(ir.Undefined), weight, number(0))
        same = ir.Constant(ir.VectorType(number, 4), [0] * 4)
        found.append((pointer, builder.shuffle_vector(one, one, same)))
    return found, vector


_GIVEN = (types.intp, types.intp, types.float64, *[types.UniTuple(types.float64, 4)] * 2)


@intrinsic
def _add_rows(_, density, first, stride, amount, rows, along):
    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        lines, vector = _rows_of(context, builder, signature, given)
        for pointer, weight in lines:
            part = builder.fmul(weight, vector)
            builder.store(builder.fadd(builder.load(pointer, align=8), part), pointer, align=8)
        return context.get_dummy_value()

    return types.void(density, *_GIVEN), code


@intrinsic
def _read_rows(_, values, first, stride, factor, rows, along):
    def code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        lines, vector = _rows_of(context, builder, signature, given)
        total = _FOUR([0.0] * 4)
        for pointer, weight in lines:
            total = builder.fadd(total, builder.fmul(weight, builder.load(pointer, align=8)))
        total = builder.fmul(total, vector)
        a, b, c, d = (builder.extract_element(total, ir.IntType(32)(k)) for k in range(4))
        return builder.fadd(builder.fadd(a, b), builder.fadd(c, d))

    return types.float64(values, *_GIVEN), code


@njit(**UNCOUNTED)
def _beyond(position, begin, size, widths, number, grid, low, high):
    """Return whether no cell of a block reaches the planes ``low:high``.

    What lies beyond the grid, or is no number, belongs to the planes at its ends; all with some
    room.
    """
    (planes, _, _), origin, spacing, _ = grid
    reaching = size if low == 0 and high == planes else 0
    for c in range(begin, begin + size):
        first = (position[c, 0] - origin[0]) / spacing - (0.5 + 0.5 * widths[c])
        below = (first < low - number - 1) & (low > 0)
        reaching += not (below | ((first > high + 1) & (high < planes)))
    return reaching == 0


@njit(**UNCOUNTED)
def _fits(first, number, n):
    return first >= 0.0 and first + number <= n  # nor does this


@njit(**KERNEL, nogil=True)
def _transfer(position, amount, values, density, out, grid, balls, left, low, high):
    """Spread amounts of cells over the nodes, or, if ``density`` has none, read ``values``.

    Both are flat. Cells of several boxes and those at faces are ``left``; return how many. Of the
    planes across x only those in ``low:high`` are written or read.
    """
    counts, widths, _, _, _, number = balls
    (nx, ny, nz), origin, spacing, flat = grid
    spread, cells = density.size > 0, position.shape[0]
    first, weights = np.zeros((3, _BLOCK)), np.ones((3, number, _BLOCK))
    axes, deepest, rest, widest = 2 if flat else 3, 1 if flat else number, 0, 0.0
    for width in widths:
        widest = max(widest, width)
    points = widest == 0.0  # no literal, with which the next function would be compiled once more
    beyond = False
    for cell in range(cells):
        c = cell % _BLOCK
        if c == 0:
            size = min(_BLOCK, cells - cell)
            beyond = _beyond(position, cell, size, widths, number, grid, low, high)
            if not beyond:
                _lay(
                    position,
                    cell,
                    size,
                    origin,
                    spacing,
                    widths,
                    points,
                    number,
                    axes,
                    first,
                    weights,
                )
        if beyond:
            continue
        x, y, z = first[0, c], first[1, c], first[2, c]
        fits = _fits(x, number, nx) and _fits(y, number, ny) and _fits(z, deepest, nz)
        if not (fits and counts[cell] == 1 and (widths[cell] > 0.0 or points)):
            left[rest] = cell
            rest += 1
            continue
        i0, j0, k0, total = int(x), int(y), int(z), 0.0
        if deepest == 4:
            along_y = weights[1, 0, c], weights[1, 1, c], weights[1, 2, c], weights[1, 3, c]
            along_z = weights[2, 0, c], weights[2, 1, c], weights[2, 2, c], weights[2, 3, c]
            for i in range(max(low - i0, 0), min(high - i0, 4)):
                row, a = ((i0 + i) * ny + j0) * nz + k0, weights[0, i, c]
                if spread:
                    _add_rows(density, row, nz, a * amount[cell], along_y, along_z)
                else:
                    total += _read_rows(values, row, nz, a, along_y, along_z)
        elif deepest == 2:  # the compiler unrolls what has a number for its end
            left_z, right_z = weights[2, 0, c], weights[2, 1, c]
            for i in range(max(low - i0, 0), min(high - i0, 2)):
                for j in range(2):
                    row = np.uint64(((i0 + i) * ny + j0 + j) * nz + k0)
                    a = weights[0, i, c] * weights[1, j, c]
                    if spread:
                        density[row] += amount[cell] * a * left_z
                        density[row + np.uint64(1)] += amount[cell] * a * right_z
                    else:
                        total += a * values[row] * left_z
                        total += a * values[row + np.uint64(1)] * right_z
        else:
            for i in range(max(low - i0, 0), min(high - i0, number)):
                for j in range(number):
                    # unsigned numbers cannot count from the end of an array: no test for that
                    row = np.uint64(((i0 + i) * ny + j0 + j) * nz + k0)
                    a = weights[0, i, c] * weights[1, j, c]
                    for k in range(deepest):
                        if spread:
                            density[row + np.uint64(k)] += amount[cell] * a * weights[2, k, c]
                        else:
                            total += a * values[row + np.uint64(k)] * weights[2, k, c]
        if not spread:
            out[cell] = total
    return rest


@njit(**KERNEL)
def _transfer_rest(position, amount, values, density, out, grid, balls, left):
    """Do the same for the cells ``left``, wherever they are and whatever they are made of.

    Return the first one outside or -1, and whether parts of some were mirrored at faces across x or
    y, and across z.
    """
    counts, widths, filled, begins, nodes, _ = balls
    (nx, ny, nz), origin, spacing, flat = grid
    most = counts.max()
    wx, wy, wz = np.empty((most, nodes)), np.empty((most, nodes)), np.empty((most, nodes))
    line, plane = np.empty(nodes), np.empty((nodes, nodes))
    sides, ends = False, False
    for cell in left:
        u = (position[cell, 0] - origin[0]) / spacing - 0.5
        v = (position[cell, 1] - origin[1]) / spacing - 0.5
        w = (position[cell, 2] - origin[2]) / spacing - 0.5
        if not (_inside(u, nx) and _inside(v, ny) and _inside(w, nz)):
            return cell, sides, ends
        count, width, total = counts[cell], widths[cell], 0.0
        deep = 1 if flat else count
        i0, ni, over_x = _spread(u, width, count, nx, wx)
        j0, nj, over_y = _spread(v, width, count, ny, wy)
        k0, nk, over_z = _spread(w, 0.0 if flat else width, deep, nz, wz)
        sides, ends = sides or over_x or over_y, ends or over_z
        for box in range(count):
            _plane(filled, begins[count], box, count, deep, wy, wz, nj, nk, line, plane)
            for i in range(ni):
                a = wx[box, i]
                for j in range(nj if a != 0.0 else 0):
                    row = np.uint64(((i0 + i) * ny + j0 + j) * nz + k0)
                    for k in range(np.uint64(nk)):
                        weight = a * plane[np.uint64(j), k]
                        if density.size > 0:
                            density[row + k] += amount[cell] * weight
                        else:
                            total += weight * values[row + k]
        if density.size == 0:
            out[cell] = total
    return -1, sides, ends


def _run(points: FloatArray, amount: FloatArray, *arrays: Any, threads: int) -> tuple[bool, bool]:
    """Run what is needed of the kernels; refuse positions outside."""
    left = np.empty(len(points), dtype=np.int64)
    threads = min(threads, len(points) // _PART)
    if threads > 1:
        left = _shared(threads, points, amount, *arrays)
    else:
        left = left[: _transfer(points, amount, *arrays, left, 0, arrays[3][0][0])]
    if len(left) == 0:
        return False, False
    outside, sides, ends = _transfer_rest(points, amount, *arrays, left)
    if outside >= 0:
        place = f"{points[outside]} (row {outside})"
        raise ValueError(f"position {place} lies outside the nutrient grid")
    return sides, ends


def _shared(
    threads: int,
    points: FloatArray,
    amount: FloatArray,
    values: FloatArray,
    density: FloatArray,
    out: FloatArray,
    grid: Any,
    balls: Any,
) -> NDArray[np.int64]:
    """Run the first kernel with several threads; return which cells are left.

    Readers share the cells. Those that spread share the planes across x, each with all cells that
    reach its own in their order: a node gets the same sum.
    """
    counts, widths, *tables = balls
    planes, spread, left = grid[0][0], density.size > 0, []

    def run(begin: int, end: int) -> None:
        low, high = (begin, end) if spread else (0, planes)
        first, last = (0, len(points)) if spread else (begin, end)
        part = slice(first, last)
        made, rest = (counts[part], widths[part], *tables), np.empty(last - first, dtype=np.int64)
        count = _transfer(
            points[part], amount[part], values, density, out[part], grid, made, rest, low, high
        )
        if count:
            left.append(first + rest[:count])

    with Team(threads) as team:
        team.share(run, planes if spread else len(points))
    return np.unique(np.concatenate(left)) if left else np.empty(0, dtype=np.int64)


Placed = tuple[FloatArray, Any, Any]
"""Positions on a grid, that, and the balls as the kernels take them."""

_NOTHING = np.empty(0)
_NOTHING.flags.writeable = False


def scatter(
    box: Box,
    position: FloatArray,
    amount: FloatArray,
    radius: FloatArray | None = None,
    threads: int = 1,
    known: Placed | None = None,
) -> FloatArray:
    """Spread an amount of each cell, (n,), over the nodes as a density, amount per µm³.

    Its sum times the volume of a node is the sum of ``amount``.

    - ``position``, (n, 3), and ``radius``, (n,), µm; absent: points
    - ``threads``: how many may share the work; it changes no result
    - ``known``: the same cells as :func:`placed` has found them
    """
    points, grid, balls = known or placed(box, position, radius)
    amounts = _numbers(amount, len(points), "amount")
    out = np.zeros(box.shape)
    density = out.reshape(-1)
    _run(points, amounts, _NOTHING, density, density, grid, balls, threads=threads)
    out /= box.volume
    return out


def gather(
    box: Box,
    position: FloatArray,
    values: FloatArray,
    radius: FloatArray | None = None,
    threads: int = 1,
    known: Placed | None = None,
) -> FloatArray:
    """Return the means of node values (nx, ny, nz) over the cells, (n,).

    They are never outside the range of the nodes at a cell; arguments as for :func:`scatter`.
    """
    return gathered(box, position, values, radius, threads, known)[0]


def gathered(
    box: Box,
    position: FloatArray,
    values: FloatArray,
    radius: FloatArray | None = None,
    threads: int = 1,
    known: Placed | None = None,
) -> tuple[FloatArray, bool]:
    """Do the same; return also whether any cell is beyond the last nodes."""
    points, grid, balls = known or placed(box, position, radius)
    if values.shape != box.shape:
        raise ValueError(f"values has shape {values.shape}, expected {box.shape}")
    out, given = np.empty(len(points)), np.ascontiguousarray(values).reshape(-1)
    given.flags.writeable = False  # as fields are, so that it is compiled once
    sides, ends = _run(points, out, given, np.empty(0), out, grid, balls, threads=threads)
    return out, sides or (ends and box.height is None)


def placed(box: Box, position: FloatArray, radius: FloatArray | None) -> Placed:
    """Return positions on the grid, that, and the balls as the kernel takes them."""
    points = np.ascontiguousarray(position, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"position has shape {points.shape}, expected (n, 3)")
    flat = box.height is not None
    if flat:
        points = points * np.array([1.0, 1.0, 0.0])
    balls = _balls(_radii(radius, len(points)), box.spacing, flat)
    return points, (box.shape, box.origin, box.spacing, flat), balls


def _numbers(values: FloatArray, count: int, what: str) -> FloatArray:
    found = np.ascontiguousarray(values, dtype=np.float64)
    if found.shape != (count,):
        raise ValueError(f"{what} has shape {found.shape}, expected ({count},)")
    return found


def _radii(radius: FloatArray | None, count: int) -> FloatArray:
    if radius is None:
        return np.zeros(count)
    return _numbers(radius, count, "radius")


def _least_and_most(radius: FloatArray) -> tuple[float, float]:
    """Return the ends of radii, where there are any; raise ValueError for one that is none."""
    least, most = radius.min(initial=np.inf), radius.max(initial=0.0)
    if not (least >= 0.0 and most < np.inf):
        raise ValueError("a radius is negative or not finite")
    return float(least), float(most)


@njit(**INNER)
def _part_within(rho, away, radius):
    """Return the part of a ball, its centre ``away``, that lies within ``rho`` of the origin."""
    if rho >= away + radius:
        return 1.0
    if rho <= abs(away - radius):
        return (rho / radius) ** 3 if away < radius else 0.0
    lens = away * away + 2.0 * away * (rho + radius) - 3.0 * (rho - radius) ** 2
    return (rho + radius - away) ** 2 * lens / (16.0 * away * radius**3)


@njit(**KERNEL)
def _weigh(distance, radius, n, spacing, ends, weights):
    """Write the first of ``n`` shells of each cell, the one beyond its last, and their weights.

    Shell ``n`` is what lies beyond. Return the first cell outside, or -1.
    """
    for cell in range(distance.size):
        away, size = distance[cell] / spacing, radius[cell] / spacing
        if not away <= n * (1.0 + 1e-12):  # nor is what is no number
            return cell
        if size <= _POINT:
            lower = int(np.floor(away - 0.5))
            upper = away - 0.5 - lower
            first, end = max(lower, 0), lower + 2
            weights[cell, 0], weights[cell, lower + 1 - first] = 1.0 - upper, upper
            if lower < 0:
                weights[cell, 0] = 1.0
        else:
            wide, before = np.sqrt(size * size + 0.5), 0.0
            first = end = max(int(away - wide), 0)
            while end < n and before < 1.0:
                after = _part_within(end + 1.0, away, wide)
                weights[cell, end - first] = max(after - before, 0.0)
                before, end = after, end + 1
            if before < 1.0:  # outside there is what is on the surface
                weights[cell, n - 1 - first] += 0.5 * (1.0 - before)
                weights[cell, n - first], end = 0.5 * (1.0 - before), n + 1
        ends[cell, 0], ends[cell, 1] = first, end
    return -1


@njit(**KERNEL)
def _transfer_shells(ends, weights, amount, values, total, out):
    """Spread amounts of cells over shells, or, if ``total`` has none, read ``values``."""
    spread = total.size > 0
    for cell in range(len(ends)):
        first, found = ends[cell, 0], 0.0
        for shell in range(first, ends[cell, 1]):
            if spread:
                total[shell] += amount[cell] * weights[cell, shell - first]
            else:
                found += weights[cell, shell - first] * values[shell]
        if not spread:
            out[cell] = found


@final
class OnShells(NamedTuple):
    """Cells on shells: by what weights they reach them, for all that they spread and read.

    - ``shells``: their number, beside one more for what lies beyond
    - ``distance``, (n,) µm: from the centre
    - ``ends``, (n, 2): first shell that a cell reaches, and the one after the last
    - ``weights``, (n, m): of these
    """

    shells: int
    distance: FloatArray
    ends: NDArray[np.int64]
    weights: FloatArray

    @classmethod
    def at(
        cls, count: int, spacing: float, distance: FloatArray, radius: FloatArray | None = None
    ) -> OnShells:
        """Weigh cells at distances (n,) from the centre, with radii (n,) in µm; absent: points."""
        away = np.ascontiguousarray(distance)
        radii = _radii(radius, len(away))
        _, widest = _least_and_most(radii)
        ends = np.empty((len(away), 2), dtype=np.int64)
        reached = min(int(2.0 * math.hypot(widest / spacing, 0.75)) + 4, count + 1)
        weights = np.empty((len(away), reached))
        if _weigh(away, radii, count, spacing, ends, weights) >= 0:
            raise ValueError("a position lies outside the nutrient grid")
        return cls(count, away, ends, weights)

    def scatter(self, amount: FloatArray) -> FloatArray:
        """Spread an amount of each cell, (n,), over the shells: what lies beyond on the last."""
        total, amounts = np.zeros(self.shells + 1), _numbers(amount, len(self.ends), "amount")
        _transfer_shells(self.ends, self.weights, amounts, _NOTHING, total, total)
        total[-2] += total[-1]
        return total[:-1]

    def gather(self, values: FloatArray, beyond: float) -> FloatArray:
        """Return the means of values of shells over the cells, (n,).

        - ``beyond``: of one more shell. Outside the surface cells find what is on it, the mean of
          the last two.
        """
        known, out = np.append(values, beyond), np.empty(len(self.ends))
        known.flags.writeable = False
        _transfer_shells(self.ends, self.weights, out, known, np.empty(0), out)
        return out
