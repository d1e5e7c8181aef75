"""Diagonal blocks of I - γJ, 3 x 3 for each cell: their sums over contacts, and inverses."""

from __future__ import annotations

from numba import njit

from multicell.compiling import INLINED, INNER, KERNEL
from multicell.mechanics.rows import RADIUS

XX, YY, ZZ, XY, XZ, YZ = range(6)  # columns of symmetric matrices, one a row

NEARLY_SINGULAR = 1e7  # ratio of eigenvalues from which on cofactors of a block have no digits left


@njit(**INLINED)
def add_block(out, i, k, t, nx, ny, nz):
    """Add k n nᵀ + t I to the block of cell i."""
    out[i, XX] += k * nx * nx + t
    out[i, YY] += k * ny * ny + t
    out[i, ZZ] += k * nz * nz + t
    out[i, XY] += k * nx * ny
    out[i, XZ] += k * nx * nz
    out[i, YZ] += k * ny * nz


@njit(**KERNEL)
def diagonal_blocks(pairs, normal, along, across, out):
    """Write for each cell Σ_j max(k, 0) n nᵀ + max(-F/d, 0) (I - n nᵀ), nN/µm.

    The six entries are ``xx, yy, zz, xy, xz, yz``. Only the stable part of each pair's
    stiffness enters: the blocks are positive semidefinite, I + γ/Γ times a block can be
    inverted for every γ > 0, and twice their largest eigenvalue bounds the decay rates.
    """
    out[:] = 0.0
    for c in range(pairs.start.size):
        for p in range(pairs.start[c], pairs.outer_end[c]):
            t = max(-across[p], 0.0)
            k = max(along[p] - across[p], 0.0) - t
            nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
            for side in range(2 if p < pairs.inner_end[c] else 1):
                i = pairs.first[p] if side == 0 else pairs.second[p]
                add_block(out, i, k, t, nx, ny, nz)


@njit(**INNER)
def invert_by_pivots(a, b, c, f, g, h, least, out):
    """Write the inverse of a symmetric matrix whose eigenvalues are ``least`` or more.

    ``a, b, c`` stand on the diagonal, ``f, g, h`` at xy, xz, yz. By L D Lᵀ: cofactors lose all
    digits where a stiff contact stands beside a free direction. No pivot is below ``least``;
    where rounding says so, it is rounding.
    """
    one = 1.0 / max(a, least)
    p, q = f * one, g * one
    two = 1.0 / max(b - p * f, least)
    s = (h - p * g) * two
    three = 1.0 / max(c - q * g - s * (h - p * g), least)
    t = p * s - q
    out[XX] = one + p * p * two + t * t * three
    out[YY] = two + s * s * three
    out[ZZ] = three
    out[XY] = -p * two - t * s * three
    out[XZ] = t * three
    out[YZ] = -s * three


@njit(**KERNEL)
def invert_blocks(rows, blocks, gamma, drag, out):
    """Write the inverse of I + γ/Γ_i times each block, in the same six entries."""
    for i in range(rows.shape[0]):
        w = gamma / (drag * rows[i, RADIUS])
        a, b, c = 1.0 + w * blocks[i, XX], 1.0 + w * blocks[i, YY], 1.0 + w * blocks[i, ZZ]
        f, g, h = w * blocks[i, XY], w * blocks[i, XZ], w * blocks[i, YZ]
        if max(a, b, c) > NEARLY_SINGULAR:
            invert_by_pivots(a, b, c, f, g, h, 1.0, out[i])
            continue
        xx, xy, xz = b * c - h * h, g * h - f * c, f * h - b * g
        scale = 1.0 / (a * xx + f * xy + g * xz)
        out[i, XX] = xx * scale
        out[i, YY] = (a * c - g * g) * scale
        out[i, ZZ] = (a * b - f * f) * scale
        out[i, XY] = xy * scale
        out[i, XZ] = xz * scale
        out[i, YZ] = (f * g - a * h) * scale


@njit(**KERNEL)
def apply_blocks(inverse, vector, out):
    """Write the product of each cell's symmetric 3 x 3 matrix with its part of ``vector``."""
    for i in range(inverse.shape[0]):
        x, y, z = vector[i, 0], vector[i, 1], vector[i, 2]
        out[i, 0] = inverse[i, XX] * x + inverse[i, XY] * y + inverse[i, XZ] * z
        out[i, 1] = inverse[i, XY] * x + inverse[i, YY] * y + inverse[i, YZ] * z
        out[i, 2] = inverse[i, XZ] * x + inverse[i, YZ] * y + inverse[i, ZZ] * z
