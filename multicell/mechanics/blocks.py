"""Diagonal blocks of I - γJ, 3 x 3 for each cell: their sums over contacts, and inverses."""

from __future__ import annotations

from numba import njit

from multicell.compiling import INLINED, KERNEL

NEARLY_SINGULAR = 1e7  # ratio of eigenvalues from which on cofactors of a block have no digits left


@njit(**INLINED)
def add_block(out, i, k, t, nx, ny, nz):
    """Add k n nᵀ + t I to the block of cell i."""
    out[i, 0] += k * nx * nx + t
    out[i, 1] += k * ny * ny + t
    out[i, 2] += k * nz * nz + t
    out[i, 3] += k * nx * ny
    out[i, 4] += k * nx * nz
    out[i, 5] += k * ny * nz


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


@njit(**KERNEL)
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
    out[0] = one + p * p * two + t * t * three
    out[1] = two + s * s * three
    out[2] = three
    out[3] = -p * two - t * s * three
    out[4] = t * three
    out[5] = -s * three


@njit(**KERNEL)
def invert_blocks(rows, blocks, gamma, drag, out):
    """Write the inverse of I + γ/Γ_i times each block, in the same six entries."""
    for i in range(rows.shape[0]):
        w = gamma / (drag * rows[i, 3])
        a, b, c = 1.0 + w * blocks[i, 0], 1.0 + w * blocks[i, 1], 1.0 + w * blocks[i, 2]
        f, g, h = w * blocks[i, 3], w * blocks[i, 4], w * blocks[i, 5]
        if max(a, b, c) > NEARLY_SINGULAR:
            invert_by_pivots(a, b, c, f, g, h, 1.0, out[i])
            continue
        xx, xy, xz = b * c - h * h, g * h - f * c, f * h - b * g
        scale = 1.0 / (a * xx + f * xy + g * xz)
        out[i, 0] = xx * scale
        out[i, 1] = (a * c - g * g) * scale
        out[i, 2] = (a * b - f * f) * scale
        out[i, 3] = xy * scale
        out[i, 4] = xz * scale
        out[i, 5] = (f * g - a * h) * scale


@njit(**KERNEL)
def apply_blocks(inverse, vector, out):
    """Write the product of each cell's symmetric 3 x 3 matrix with its part of ``vector``."""
    for i in range(inverse.shape[0]):
        x, y, z = vector[i, 0], vector[i, 1], vector[i, 2]
        out[i, 0] = inverse[i, 0] * x + inverse[i, 3] * y + inverse[i, 4] * z
        out[i, 1] = inverse[i, 3] * x + inverse[i, 1] * y + inverse[i, 5] * z
        out[i, 2] = inverse[i, 4] * x + inverse[i, 5] * y + inverse[i, 2] * z
