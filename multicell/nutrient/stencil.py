"""Loops over all nodes that the steady solver needs, each fused into one pass.

All run on one thread but for the imbalance of many nodes, whose sums are those of planes, so that
none depends on the number of threads. At a face of the box the
missing neighbour is ``ghost[face]`` times the node itself, faces in the order x-, x+, y-, y+, z-,
z+, and what else the condition brings is part of the source: py-pde's convention, in which a value
gives -1 and a slope 1. A test holds the stencil against py-pde's own operator.

Where the coefficient of diffusion differs from place to place, ``weights`` holds it at all faces
across x, y and z, relative to that of tissue: (nx + 1, ny, nz), (nx, ny + 1, nz), (nx, ny, nz + 1).
Else it is None, and what it needs is not compiled. So is ``exchange``, (nx, ny, nz) 1/s, the rate
at which nodes exchange with a medium of ``level`` mM. ``ghost`` is (6,), ``stiffness`` D/h² in 1/s.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling import INLINED, KERNEL, arithmetic, typed
from multicell.compiling.threads import Team
from multicell.nutrient.uptake import balanced, uptake, uptake_and_slope

Weights = tuple[FloatArray, FloatArray, FloatArray] | None
Float32Array = NDArray[np.float32]

MAX_CG = 500
"""Iterations per Newton step; a system not solved by then gives a poorer step, no failure."""

Floats = FloatArray | Float32Array
# No fastmath: with it, a function compiled now and the same one read from numba's disk cache were
# seen to differ in the last bits. Division as NumPy does it has no branch.
_jit = typed(**KERNEL, nogil=True)
_inner = typed(**INLINED, nogil=True)
_both = partial(arithmetic, nogil=True)
_bare = partial(arithmetic, nogil=True, _nrt=False)


REPEATS = 2.0
"""Factor of the ghost values at a face where space repeats: the neighbour is at the other end.

Such fields have ``weights``, of one if nothing differs: a test for it in the loops without them
takes two to four times as long.
"""

PART = 100_000
"""Least number of nodes for each thread that shares a loop: with fewer, waking it is no gain."""

_LIGHT = 2
"""Factor of it for loops in which nodes do not see each other: these take a quarter of the time."""


def teams(team: Team, nodes: int) -> tuple[Team, Team]:
    """Return those of a team that are worth waking for loops over so many nodes.

    The second for loops in which nodes do not see each other.
    """
    return team.at_most(nodes // PART), team.at_most(nodes // (_LIGHT * PART))


def face_means(varied: NDArray[Any], axis: int, repeats: bool = False) -> NDArray[Any]:
    """Return the coefficients at the faces across an axis: harmonic means, and the outer nodes'.

    Where space repeats the outer faces lie between the first node and the last.
    """
    v = np.moveaxis(varied, axis, 0)
    if repeats:
        v = np.concatenate([v[-1:], v, v[:1]])
    means = 2.0 * v[1:] * v[:-1] / (v[1:] + v[:-1])
    if repeats:
        return np.ascontiguousarray(np.moveaxis(means, 0, axis))
    return np.ascontiguousarray(np.moveaxis(np.concatenate([v[:1], means, v[-1:]]), 0, axis))


@_inner
def _beyond(ghost: float, own: float, other: float) -> float:
    """Return the value beyond a face of a node, ``other`` being at the other end of the axis."""
    return other if ghost == REPEATS else ghost * own


@_inner
def fill_row(p: FloatArray, ghost: FloatArray, i: int, j: int, row: FloatArray) -> None:
    """Write the sums of neighbours along the last axis to ``row``."""
    nx, ny, nz = p.shape
    e = p[i, j]
    a, wa = (p[i - 1, j], 1.0) if i > 0 else (e, ghost[0])
    b, wb = (p[i + 1, j], 1.0) if i < nx - 1 else (e, ghost[1])
    c, wc = (p[i, j - 1], 1.0) if j > 0 else (e, ghost[2])
    d, wd = (p[i, j + 1], 1.0) if j < ny - 1 else (e, ghost[3])
    for k in range(0, nz, max(nz - 1, 1)):
        across = wa * a[k] + wb * b[k] + wc * c[k] + wd * d[k]
        across += e[k - 1] if k > 0 else ghost[4] * e[k]
        row[k] = across + (e[k + 1] if k < nz - 1 else ghost[5] * e[k])
    # no branches in these loops, for the vector units
    if i == 0 or i == nx - 1 or j == 0 or j == ny - 1:
        for k in range(1, nz - 1):
            across = wa * a[k] + wb * b[k] + wc * c[k] + wd * d[k]
            row[k] = across + e[k - 1] + e[k + 1]
        return
    for k in range(1, nz - 1):
        row[k] = (a[k] + b[k]) + (c[k] + d[k]) + (e[k - 1] + e[k + 1])


@_inner
def _fill_varied(
    p: FloatArray,
    ghost: FloatArray,
    weights: tuple[FloatArray, FloatArray, FloatArray],
    i: int,
    j: int,
    row: FloatArray,
    diagonal: FloatArray,
) -> None:
    """Write the weighted sums of neighbours to ``row`` and those of the weights."""
    nx, ny, nz = p.shape
    wx, wy, wz = weights
    for k in range(nz):
        v = p[i, j, k]
        a, b = wx[i, j, k], wx[i + 1, j, k]
        c, d = wy[i, j, k], wy[i, j + 1, k]
        e, f = wz[i, j, k], wz[i, j, k + 1]
        total = a * (p[i - 1, j, k] if i > 0 else _beyond(ghost[0], v, p[nx - 1, j, k]))
        total += b * (p[i + 1, j, k] if i < nx - 1 else _beyond(ghost[1], v, p[0, j, k]))
        total += c * (p[i, j - 1, k] if j > 0 else _beyond(ghost[2], v, p[i, ny - 1, k]))
        total += d * (p[i, j + 1, k] if j < ny - 1 else _beyond(ghost[3], v, p[i, 0, k]))
        total += e * (p[i, j, k - 1] if k > 0 else _beyond(ghost[4], v, p[i, j, nz - 1]))
        total += f * (p[i, j, k + 1] if k < nz - 1 else _beyond(ghost[5], v, p[i, j, 0]))
        row[k] = total
        diagonal[k] = a + b + c + d + e + f


@_inner
def _weight(weights: Weights, face: int, i: int, j: int, k: int) -> float:
    """Return the coefficient at a face of a node."""
    if weights is None:
        return 1.0
    axis, high = face // 2, face % 2
    if axis == 0:
        return float(weights[0][i + high, j, k])
    if axis == 1:
        return float(weights[1][i, j + high, k])
    return float(weights[2][i, j, k + high])


@_both
def apply_operator(
    p: FloatArray,
    rate: Floats,
    stiffness: float,
    ghost: FloatArray,
    weights: Weights,
    out: FloatArray,
) -> float:
    """Write ``(-D L0 + rate) p`` to ``out`` and return its product with ``p``.

    ``rate`` (nx, ny, nz) is the linearised uptake at the nodes in 1/s.
    """
    nx, ny, nz = p.shape
    row, diagonal = np.empty(nz), np.empty(nz)
    for k in range(nz):
        diagonal[k] = 6.0
    product = 0.0
    for i in range(nx):
        for j in range(ny):
            if weights is None:
                fill_row(p, ghost, i, j, row)
            else:
                _fill_varied(p, ghost, weights, i, j, row, diagonal)
            e, r, o = p[i, j], rate[i, j], out[i, j]
            for k in range(nz):  # no sum, for the vector units
                o[k] = stiffness * (diagonal[k] * e[k] - row[k]) + r[k] * e[k]
            for k in range(nz):
                product += e[k] * o[k]
    return product


def write_imbalance(
    c: FloatArray,
    sink: FloatArray,
    source: FloatArray,
    half: float,
    stiffness: float,
    linear: float,
    ghost: FloatArray,
    weights: Weights,
    exchange: FloatArray | None,
    level: float,
    residual: Floats,
    rate: Floats,
    team: Team | None = None,
) -> tuple[float, float, float, float, float]:
    """Write sources minus sinks of all nodes (mM/s) and the sinks' derivative (1/s).

    The sinks are uptake, ``sink`` at most (mM/s), and ``linear`` (1/s) times c; ``source`` is in
    mM/s, c and ``half`` in mM. ``residual`` and ``rate`` may be in single precision: it is the last
    rounding that they get, and on many nodes memory is what takes the time.

    Return the sums of residual², of all sinks, of c², of the residual, and of what it loses for a
    relative change of all c: over all nodes in their order, or with a ``team``, whose threads share
    the planes, of each plane first.
    """
    planes = len(c)
    law = sink, source, half, stiffness, linear, ghost, weights, exchange, level
    if team is None:
        parts = np.empty((5, 1))
        imbalance_of_planes(0, planes, c, *law, residual, rate, parts, planes)
    else:
        parts = np.empty((5, planes))
        team.share(imbalance_of_planes, planes, c, *law, residual, rate, parts, 1)
    squares, total, size, net, change = parts.sum(axis=1).tolist()
    return squares, total, size, net, change


@_both
def imbalance_of_planes(
    begin: int,
    end: int,
    c: FloatArray,
    sink: FloatArray,
    source: FloatArray,
    half: float,
    stiffness: float,
    linear: float,
    ghost: FloatArray,
    weights: Weights,
    exchange: FloatArray | None,
    level: float,
    residual: Floats,
    rate: Floats,
    parts: FloatArray,
    block: int,
) -> None:
    """Do what :func:`write_imbalance` does for the planes from ``begin`` to ``end``.

    ``parts``, (5, planes / block), are the sums over each ``block`` of planes.
    """
    ny, nz = c.shape[1:]
    row, diagonal = np.empty(nz), np.empty(nz)
    for k in range(nz):
        diagonal[k] = 6.0
    sinks, changes = np.empty(nz), np.empty(nz)
    squares, total, size, net, change = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(begin, end):
        if i % block == 0:
            squares, total, size, net, change = 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(ny):
            if weights is None:
                fill_row(c, ghost, i, j, row)
            else:
                _fill_varied(c, ghost, weights, i, j, row, diagonal)
            e, most, brought = c[i, j], sink[i, j], source[i, j]
            left, slopes = residual[i, j], rate[i, j]
            for k in range(nz):  # no sums, for the vector units
                v = e[k]
                taken, slope = uptake_and_slope(most[k], v, half)
                spent = taken + linear * v
                outward = stiffness * (diagonal[k] * v - row[k])
                row[k] = brought[k] - outward - spent
                left[k] = row[k]
                slopes[k] = slope + linear
                sinks[k] = spent
                changes[k] = outward + (slope + linear) * v
            if exchange is not None:
                pull = exchange[i, j]
                for k in range(nz):  # the difference is exact, which two products are not
                    row[k] += pull[k] * (level - e[k])
                    left[k], slopes[k] = row[k], slopes[k] + pull[k]
                    changes[k] += pull[k] * e[k]
            for k in range(nz):
                squares += row[k] * row[k]
                total += sinks[k]
                size += e[k] * e[k]
                net += row[k]
                change += changes[k]
        place = i // block
        parts[0, place], parts[1, place], parts[2, place] = squares, total, size
        parts[3, place], parts[4, place] = net, change


@_jit
def balance_negative(
    c: FloatArray,
    sink: FloatArray,
    source: FloatArray,
    half: float,
    stiffness: float,
    linear: float,
    ghost: FloatArray,
    weights: Weights,
    exchange: FloatArray | None,
    level: float,
    zero: float,
    most: int,
) -> int:
    """Bring all nodes below zero to their own balance, in sweeps, until there are none.

    A node is given the concentration at which its sinks meet its source and what comes from its
    neighbours; one that has reached zero is left alone from then on. Nodes that are below zero by
    no more than ``zero`` (mM) are taken as empty before. Return how many are below zero after at
    most ``most`` sweeps.
    """
    _, ny, nz = c.shape
    below = np.flatnonzero(c.ravel() < 0.0)
    values = c.ravel()
    for n in below:
        values[n] = 0.0 if values[n] >= -zero else values[n]
    left = below.size
    for sweep in range(most):
        if left == 0:
            break
        left = 0
        for m in range(below.size):
            # every other sweep runs backwards: what a neighbour brings crosses the core at once
            n = below[m if sweep % 2 == 0 else below.size - 1 - m]
            i, j, k = n // (ny * nz), n // nz % ny, n % nz
            if sweep > 0 and c[i, j, k] >= 0.0:
                continue
            gain, loss = source[i, j, k], linear
            if exchange is not None:
                gain, loss = gain + level * exchange[i, j, k], loss + exchange[i, j, k]
            more, other = _diffusing(c, stiffness, ghost, weights, i, j, k)
            v = balanced(gain + more, loss + other, sink[i, j, k], half)
            c[i, j, k] = v
            left += v < 0.0
    return left


@_inner
def _diffusing(
    c: FloatArray, stiffness: float, ghost: FloatArray, weights: Weights, i: int, j: int, k: int
) -> tuple[float, float]:
    """Return the gain of a node by diffusion, mM/s, and its loss for each mM, 1/s."""
    nx, ny, nz = c.shape
    gain = loss = 0.0
    for face in range(6):
        w = _weight(weights, face, i, j, k)
        side = 2 * (face % 2) - 1
        a = i + side if face // 2 == 0 else i
        b = j + side if face // 2 == 1 else j
        d = k + side if face // 2 == 2 else k
        if ghost[face] == REPEATS:
            a, b, d = a % nx, b % ny, d % nz
        if 0 <= a < nx and 0 <= b < ny and 0 <= d < nz:
            gain += stiffness * w * c[a, b, d]
            loss += stiffness * w
        else:
            loss += stiffness * w * (1.0 - ghost[face])
    return gain, loss


@_jit
def balance_ends(
    c: FloatArray,
    sink: FloatArray,
    source: FloatArray,
    half: float,
    stiffness: float,
    linear: float,
    ghost: FloatArray,
    weights: Weights,
    exchange: FloatArray,
    level: float,
    held: float,
) -> None:
    """Bring nodes at which a layer ends to their own balance, one after the other, as a guess.

    They are those that exchange with the medium at less than ``held`` (1/s). Their rates change
    with every move of a cell, and nothing else in a field does so fast.
    """
    nx, ny, nz = c.shape
    for i in range(nx):
        for j in range(ny):
            pull, e = exchange[i, j], c[i, j]
            edge = i == 0 or i == nx - 1 or j == 0 or j == ny - 1
            for k in range(nz):
                if not 0.0 < pull[k] < held:
                    continue
                if edge or k == 0 or k == nz - 1 or weights is not None:
                    gain, loss = _diffusing(c, stiffness, ghost, weights, i, j, k)
                else:
                    across = (c[i - 1, j, k] + c[i + 1, j, k]) + (c[i, j - 1, k] + c[i, j + 1, k])
                    gain, loss = stiffness * (across + (e[k - 1] + e[k + 1])), 6.0 * stiffness
                gain, loss = gain + source[i, j, k] + level * pull[k], loss + linear + pull[k]
                e[k] = balanced(gain, loss, sink[i, j, k], half)


@_bare
def begin(
    rate: Floats,
    residual: Floats,
    weight: FloatArray | None,
    time: float,
    size: float,
    x: FloatArray,
    r: FloatArray,
    p: FloatArray,
    scale: FloatArray,
    y: Float32Array,
) -> float:
    """Start the linear solver: ``scale = (w + time rate)^(-1/2)``, ``y = scale r``, no direction.

    All arrays are flat, (nodes,). ``w`` is the relative coefficient of diffusion at the nodes, one
    without ``weight``, and ``r`` the residual over its ``size``. Return the sum of
    ``scale² rate``.
    """
    for n in range(rate.size):  # no sum, for the vector units
        square = 1.0 / ((1.0 if weight is None else weight[n]) + time * rate[n])
        s = np.sqrt(square)
        v = residual[n] / size
        x[n] = square * rate[n]
        p[n] = 0.0
        r[n] = v
        scale[n] = s
        y[n] = s * v
    total = 0.0
    for n in range(rate.size):
        total += x[n]
        x[n] = 0.0
    return total


@_bare
def update_residual(
    alpha: float,
    x: FloatArray,
    p: FloatArray,
    r: FloatArray,
    q: FloatArray,
    scale: FloatArray,
    y: Float32Array,
) -> float:
    """Do ``x += alpha p``, ``r -= alpha q``, ``y = scale r``, all flat; return ``r . r``."""
    product = 0.0
    for n in range(x.size):
        x[n] += alpha * p[n]
        v = r[n] - alpha * q[n]
        r[n] = v
        y[n] = scale[n] * v
        product += v * v
    return product


@_bare
def new_direction(p: FloatArray, u: Float32Array, scale: FloatArray, beta: float) -> None:
    """Do ``p = scale u + beta p``, all flat."""
    for n in range(p.size):
        p[n] = scale[n] * u[n] + beta * p[n]


@_jit
def divide_spectrum(
    spectrum: Float32Array, ax: FloatArray, ay: FloatArray, az: FloatArray, shift: float
) -> float:
    """Divide by ``ax + ay + az + shift`` in place; return the product of before and after.

    With an orthonormal transform that product is the one of residual and preconditioned residual.
    """
    nx, ny, nz = spectrum.shape
    product = 0.0
    for i in range(nx):
        for j in range(ny):
            base = ax[i] + ay[j] + shift
            for k in range(nz):
                v = spectrum[i, j, k]
                w = v / (base + az[k])
                spectrum[i, j, k] = w
                product += v * w
    return product


@_jit
def flat_dot(a: Floats, b: Floats) -> float:
    """Return the product of two flat fields (NumPy's may use threads and change its bits)."""
    product = 0.0
    for n in range(a.size):
        product += a[n] * b[n]
    return product


@_bare
def flows(
    c: FloatArray, ghost: FloatArray, const: FloatArray, weights: Weights
) -> tuple[float, float]:
    """Return the flows in and out through the faces, over D/h² and a node's volume, mM.

    ``const``, (6,), is what the conditions add to the ghost values of each face, mM.
    """
    nx, ny, nz = c.shape
    across = ((ny, nz), (nx, nz), (nx, ny))
    inward, outward = 0.0, 0.0
    for face in range(6):
        axis, high = face // 2, face % 2
        if ghost[face] == REPEATS:
            continue
        for a in range(across[axis][0]):
            for b in range(across[axis][1]):
                if axis == 0:
                    i, j, k = high * (nx - 1), a, b
                elif axis == 1:
                    i, j, k = a, high * (ny - 1), b
                else:
                    i, j, k = a, b, high * (nz - 1)
                inflow = const[face] + (ghost[face] - 1.0) * c[i, j, k]
                inflow *= _weight(weights, face, i, j, k)
                inward += max(inflow, 0.0)
                outward += max(-inflow, 0.0)
    return inward, outward


@_bare
def account(c: FloatArray, sink: FloatArray, half: float, residual: Floats) -> tuple[float, float]:
    """Return the sums over all nodes of the sizes of the residual and of uptake, mM/s.

    Arguments as for :func:`write_imbalance`.
    """
    nx, ny, nz = c.shape
    left, taken = 0.0, 0.0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                left += abs(residual[i, j, k])
                if sink[i, j, k] != 0.0:
                    taken += uptake(sink[i, j, k], c[i, j, k], half)
    return left, taken
