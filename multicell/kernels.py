"""All jitted pair kernels: bare floats and arrays in base units (µm, s, nN), no objects.

One file, because numba's disk cache does not notice a change in another module.

Layout. ``rows`` holds for each cell ``x, y, z, radius, compliance`` (the last from
:func:`multicell.contact.compliance`), so that a pair is gathered from two short runs of
memory. Pairs come in chunks (see :mod:`multicell.neighbours`); a chunk works through its pairs
in blocks of :data:`BLOCK`: gather into small arrays, evaluate the law there (which the
compiler turns into SIMD), scatter. Every chunk writes to its own cells only, so that the
serial and the parallel drivers give the same bits.

Laws are chosen by the integer ``code`` of the classes in :mod:`multicell.contact`. With the
Hertz contact radius q = √(r_ij h) the approximate JKR force (eq. 3.6) is
F = E_ij h q - √(6πσ) q √(E_ij q), which needs three square roots and no power. Hertz is
the same with σ = 0, and its kernel leaves the last root out.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

BLOCK = 256
"""Pairs that are gathered before the law is evaluated on them."""

HERTZ, JKR = 0, 1
_TINY = 1e-300
"""Keeps coincident centres finite: their direction, and so their force, is zero."""


@njit(cache=True)
def pack_chunk(c, chunk, position, reference, radius, rate, elapsed, limit, rows):
    """Fill the rows of one chunk at a time ``elapsed``; return 1 if a cell has drifted.

    Drifted means further than √``limit`` from ``reference``, or not a number.
    """
    drifted = 0
    for i in range(c * chunk, min((c + 1) * chunk, rows.shape[0])):
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        rows[i, 0] = x
        rows[i, 1] = y
        rows[i, 2] = z
        rows[i, 3] = radius[i] + rate[i] * elapsed
        x -= reference[i, 0]
        y -= reference[i, 1]
        z -= reference[i, 2]
        drifted |= not (x * x + y * y + z * z <= limit)
    return drifted


@njit(cache=True)
def _gather(rows, first, second, begin, count, dx, dy, dz, total, product, soft):
    """Collect the geometry of a block of pairs."""
    for p in range(count):
        i, j = np.uint32(first[begin + p]), np.uint32(second[begin + p])
        dx[p] = rows[j, 0] - rows[i, 0]
        dy[p] = rows[j, 1] - rows[i, 1]
        dz[p] = rows[j, 2] - rows[i, 2]
        total[p] = rows[i, 3] + rows[j, 3]
        product[p] = rows[i, 3] * rows[j, 3]
        soft[p] = rows[i, 4] + rows[j, 4]


@njit(cache=True, error_model="numpy")
def _law_force(law, adhesion, count, dx, dy, dz, total, product, soft, force):
    """Write F / distance for a block of pairs; zero where they do not touch."""
    if law == HERTZ:
        for p in range(count):
            d = math.sqrt(dx[p] * dx[p] + dy[p] * dy[p] + dz[p] * dz[p] + _TINY)
            h = max(total[p] - d, 0.0)
            # one division serves r_ij, E_ij and 1 / d
            w = 1.0 / (total[p] * soft[p] * d)
            q = math.sqrt(product[p] * (w * soft[p] * d) * h)
            force[p] = (w * total[p] * d) * h * q * (w * total[p] * soft[p])
    else:
        for p in range(count):
            d = math.sqrt(dx[p] * dx[p] + dy[p] * dy[p] + dz[p] * dz[p] + _TINY)
            h = max(total[p] - d, 0.0)
            w = 1.0 / (total[p] * soft[p] * d)
            q = math.sqrt(product[p] * (w * soft[p] * d) * h)
            e = w * total[p] * d
            force[p] = (e * h * q - adhesion * q * math.sqrt(e * q)) * (w * total[p] * soft[p])


@njit(cache=True)
def _force_chunk(c, chunk, rows, first, second, start, inner_end, outer_end, law, adhesion, out):
    """Sum the pair forces on the cells of one chunk into ``out``, nN."""
    for i in range(c * chunk, min((c + 1) * chunk, rows.shape[0])):
        out[i, 0] = 0.0
        out[i, 1] = 0.0
        out[i, 2] = 0.0
    dx, dy, dz = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    total, product, soft = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    force = np.empty(BLOCK)
    for begin in range(start[c], inner_end[c], BLOCK):
        count = min(BLOCK, inner_end[c] - begin)
        _gather(rows, first, second, begin, count, dx, dy, dz, total, product, soft)
        _law_force(law, adhesion, count, dx, dy, dz, total, product, soft, force)
        for p in range(count):
            i, j = np.uint32(first[begin + p]), np.uint32(second[begin + p])
            fx, fy, fz = force[p] * dx[p], force[p] * dy[p], force[p] * dz[p]
            out[i, 0] -= fx
            out[i, 1] -= fy
            out[i, 2] -= fz
            out[j, 0] += fx
            out[j, 1] += fy
            out[j, 2] += fz
    for begin in range(inner_end[c], outer_end[c], BLOCK):
        count = min(BLOCK, outer_end[c] - begin)
        _gather(rows, first, second, begin, count, dx, dy, dz, total, product, soft)
        _law_force(law, adhesion, count, dx, dy, dz, total, product, soft, force)
        for p in range(count):
            i = np.uint32(first[begin + p])
            out[i, 0] -= force[p] * dx[p]
            out[i, 1] -= force[p] * dy[p]
            out[i, 2] -= force[p] * dz[p]


@njit(cache=True)
def _drag_chunk(c, chunk, rows, drag, out):
    """Turn forces into velocities: divide by ``drag`` times the radius (Stokes)."""
    for i in range(c * chunk, min((c + 1) * chunk, rows.shape[0])):
        mobility = 1.0 / (drag * rows[i, 3])
        out[i, 0] *= mobility
        out[i, 1] *= mobility
        out[i, 2] *= mobility


@njit(cache=True)
def pack(chunk, position, reference, radius, rate, elapsed, limit, rows):
    """Fill ``rows`` for all cells; return whether any has drifted (see the chunk's)."""
    drifted = 0
    for c in range(-(-rows.shape[0] // chunk)):
        drifted |= pack_chunk(c, chunk, position, reference, radius, rate, elapsed, limit, rows)
    return drifted > 0


@njit(cache=True)
def velocities(
    chunk, position, reference, radius, rate, elapsed, limit, rows,
    first, second, start, inner_end, outer_end, law, adhesion, drag, out,
):  # fmt: skip
    """Write the velocities of all cells, µm/s; stop and return True if a cell has drifted."""
    if pack(chunk, position, reference, radius, rate, elapsed, limit, rows):
        return True
    for c in range(start.size):
        _force_chunk(c, chunk, rows, first, second, start, inner_end, outer_end, law, adhesion, out)
        _drag_chunk(c, chunk, rows, drag, out)
    return False


@njit(cache=True, parallel=True)
def velocities_parallel(
    chunk, position, reference, radius, rate, elapsed, limit, rows,
    first, second, start, inner_end, outer_end, law, adhesion, drag, out,
):  # fmt: skip
    """Do the same as :func:`velocities`, with the chunks shared among threads."""
    drifted = 0
    for c in prange(start.size):
        drifted += pack_chunk(c, chunk, position, reference, radius, rate, elapsed, limit, rows)
    if drifted > 0:
        return True
    for c in prange(start.size):
        _force_chunk(c, chunk, rows, first, second, start, inner_end, outer_end, law, adhesion, out)
        _drag_chunk(c, chunk, rows, drag, out)
    return False


@njit(cache=True, error_model="numpy")
def _pair(rows, i, j, law, adhesion):
    """Return vector, distance, force, stiffness and energy of one pair."""
    dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
    d = math.sqrt(dx * dx + dy * dy + dz * dz + _TINY)
    h = rows[i, 3] + rows[j, 3] - d
    if h <= 0.0:
        return dx, dy, dz, d, 0.0, 0.0, 0.0
    e = 1.0 / (rows[i, 4] + rows[j, 4])
    q = math.sqrt(rows[i, 3] * rows[j, 3] / (rows[i, 3] + rows[j, 3]) * h)
    elastic = e * h * q
    sticky = adhesion * q * math.sqrt(e * q) if law == JKR else 0.0
    # F = a h^(3/2) - b h^(3/4): each power rule brings its exponent over h
    stiffness = (1.5 * elastic - 0.75 * sticky) / h
    energy = (0.4 * elastic - sticky * (4.0 / 7.0)) * h
    return dx, dy, dz, d, elastic - sticky, stiffness, energy


@njit(cache=True)
def energy_and_virials(
    rows, first, second, start, inner_end, outer_end, law, adhesion, half_virial
):  # fmt: skip
    """Return the contact energy, fJ, and write ½ Σ_j F_ij d_ij of each cell, nN µm.

    An outer pair stands in two chunks and brings half its energy in each.
    """
    total = 0.0
    half_virial[:] = 0.0
    for c in range(start.size):
        for p in range(start[c], outer_end[c]):
            i, j = first[p], second[p]
            _, _, _, d, force, _, energy = _pair(rows, i, j, law, adhesion)
            half_virial[i] += 0.5 * force * d
            if p < inner_end[c]:
                half_virial[j] += 0.5 * force * d
                total += energy
            else:
                total += 0.5 * energy
    return total


@njit(cache=True)
def linearise_chunk(c, rows, first, second, start, outer_end, law, adhesion, normal, along, across):
    """Store direction, dF/dh + F/d and F/d of the pairs of one chunk."""
    for p in range(start[c], outer_end[c]):
        dx, dy, dz, d, force, stiffness, _ = _pair(rows, first[p], second[p], law, adhesion)
        normal[p, 0] = dx / d
        normal[p, 1] = dy / d
        normal[p, 2] = dz / d
        along[p] = stiffness + force / d
        across[p] = force / d


@njit(cache=True)
def linearise(rows, first, second, start, outer_end, law, adhesion, normal, along, across):
    """Store what :func:`products` needs for all pairs, from the state in ``rows``.

    The stiffness of a pair is K = k n nᵀ - (F/d)(I - n nᵀ) with k = dF/dh. For a pair out
    of contact everything stored is zero.
    """
    for c in range(start.size):
        linearise_chunk(
            c, rows, first, second, start, outer_end, law, adhesion, normal, along, across
        )


@njit(cache=True, parallel=True)
def linearise_parallel(
    rows, first, second, start, outer_end, law, adhesion, normal, along, across
):  # fmt: skip
    """Do the same as :func:`linearise`, with the chunks shared among threads."""
    for c in prange(start.size):
        linearise_chunk(
            c, rows, first, second, start, outer_end, law, adhesion, normal, along, across
        )


@njit(cache=True)
def _product_chunk(
    c, chunk, rows, first, second, start, inner_end, outer_end, normal, along, across, drag,
    v, out,
):  # fmt: skip
    """Write (J v) for the cells of one chunk."""
    low, high = c * chunk, min((c + 1) * chunk, rows.shape[0])
    out[low:high] = 0.0
    for p in range(start[c], outer_end[c]):
        i, j = np.uint32(first[p]), np.uint32(second[p])
        vx, vy, vz = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]
        nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
        stretch = along[p] * (nx * vx + ny * vy + nz * vz)
        fx = stretch * nx - across[p] * vx
        fy = stretch * ny - across[p] * vy
        fz = stretch * nz - across[p] * vz
        out[i, 0] += fx
        out[i, 1] += fy
        out[i, 2] += fz
        if p < inner_end[c]:
            out[j, 0] -= fx
            out[j, 1] -= fy
            out[j, 2] -= fz
    for i in range(low, high):
        mobility = 1.0 / (drag * rows[i, 3])
        out[i, 0] *= mobility
        out[i, 1] *= mobility
        out[i, 2] *= mobility


@njit(cache=True)
def products(
    chunk, rows, first, second, start, inner_end, outer_end, normal, along, across, drag, v, out
):  # fmt: skip
    """Write J v, the directional derivative of the velocities along ``v``, 1/s times ``v``."""
    for c in range(start.size):
        _product_chunk(
            c, chunk, rows, first, second, start, inner_end, outer_end,
            normal, along, across, drag, v, out,
        )  # fmt: skip


@njit(cache=True, parallel=True)
def products_parallel(
    chunk, rows, first, second, start, inner_end, outer_end, normal, along, across, drag, v, out
):  # fmt: skip
    """Do the same as :func:`products`, with the chunks shared among threads."""
    for c in prange(start.size):
        _product_chunk(
            c, chunk, rows, first, second, start, inner_end, outer_end,
            normal, along, across, drag, v, out,
        )  # fmt: skip


@njit(cache=True)
def diagonal_blocks(rows, first, second, start, inner_end, outer_end, normal, along, across, out):
    """Write for each cell Σ_j max(k, 0) n nᵀ + max(-F/d, 0) (I - n nᵀ), nN/µm.

    The six entries are ``xx, yy, zz, xy, xz, yz``. Only the stable part of each pair's
    stiffness enters: the blocks are positive semidefinite, I + γ/Γ times a block can be
    inverted for every γ > 0, and twice their largest eigenvalue bounds the decay rates.
    """
    out[:] = 0.0
    for c in range(start.size):
        for p in range(start[c], outer_end[c]):
            t = max(-across[p], 0.0)
            k = max(along[p] - across[p], 0.0) - t
            nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
            for side in range(2 if p < inner_end[c] else 1):
                i = first[p] if side == 0 else second[p]
                out[i, 0] += k * nx * nx + t
                out[i, 1] += k * ny * ny + t
                out[i, 2] += k * nz * nz + t
                out[i, 3] += k * nx * ny
                out[i, 4] += k * nx * nz
                out[i, 5] += k * ny * nz


@njit(cache=True)
def invert_blocks(rows, blocks, gamma, drag, out):
    """Write the inverse of I + γ/Γ_i times each block, in the same six entries."""
    for i in range(rows.shape[0]):
        w = gamma / (drag * rows[i, 3])
        a, b, c = 1.0 + w * blocks[i, 0], 1.0 + w * blocks[i, 1], 1.0 + w * blocks[i, 2]
        f, g, h = w * blocks[i, 3], w * blocks[i, 4], w * blocks[i, 5]
        xx, xy, xz = b * c - h * h, g * h - f * c, f * h - b * g
        scale = 1.0 / (a * xx + f * xy + g * xz)
        out[i, 0] = xx * scale
        out[i, 1] = (a * c - g * g) * scale
        out[i, 2] = (a * b - f * f) * scale
        out[i, 3] = xy * scale
        out[i, 4] = xz * scale
        out[i, 5] = (f * g - a * h) * scale


@njit(cache=True)
def apply_blocks(inverse, vector, out):
    """Write the product of each cell's symmetric 3 x 3 matrix with its part of ``vector``."""
    for i in range(inverse.shape[0]):
        x, y, z = vector[i, 0], vector[i, 1], vector[i, 2]
        out[i, 0] = inverse[i, 0] * x + inverse[i, 3] * y + inverse[i, 4] * z
        out[i, 1] = inverse[i, 3] * x + inverse[i, 1] * y + inverse[i, 5] * z
        out[i, 2] = inverse[i, 4] * x + inverse[i, 5] * y + inverse[i, 2] * z
