"""GMRES, and about the inverse of the linear systems of fields that react with each other.

The systems are -D_i L0 x_i + Σ_j B_ij x_j = r_i, with blocks B(node) of all that is local: decay,
the slopes of uptake, 1/dt, and less the derivatives of the reactions' rates.

In a box the inverse is that of M (-D L0 + B̄), with B̄ the mean of B and
M = (2K + B) (2K + B̄)⁻¹, K = diag(D_i w / h²) at each node (w the relative coefficient of diffusion
there). Where B is the same everywhere it is exact; where reactions are much faster than diffusion
between nodes it is about B. The middle is diagonal but for blocks in sines and cosines, where the
sides of all fields are of the same kinds; else only the diagonal of B̄ is taken.
On shells the block-tridiagonal system is solved itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import solve_banded

from multicell.cells import FloatArray
from multicell.compiling import KERNEL, typed
from multicell.nutrient.diffusion import Diffusion, _transform
from multicell.nutrient.operators import AnyOperator
from multicell.nutrient.spherical import Shells
from multicell.nutrient.stencil import flat_dot

_jit = typed(**KERNEL)

Solve = Callable[[FloatArray], FloatArray]

_DIMENSION, _CYCLES = 20, 6  # of GMRES


def inverse_of_blocks(operators: Sequence[AnyOperator], blocks: FloatArray) -> Solve:
    """Return a function of r, (m, nodes), that gives about the solution x.

    - ``operators``: diffusion of each field, all on one grid
    - ``blocks``, (m, m, nodes), 1/s: see the module's text
    """
    if isinstance(operators[0], Diffusion):
        return _in_box([op for op in operators if isinstance(op, Diffusion)], blocks)
    return _on_shells([op for op in operators if isinstance(op, Shells)], blocks)


def _in_box(operators: list[Diffusion], blocks: FloatArray) -> Solve:
    m, _, nodes = blocks.shape
    mean = blocks.mean(axis=2)
    for i, op in enumerate(operators):
        if op.exchange is not None:  # at few nodes, and much faster than all else
            mean[i, i] -= float(op.exchange.mean())
    alike = all(op.kinds == operators[0].kinds for op in operators)
    if not alike:
        mean = np.diag(np.diag(mean))
    k = np.empty((m, nodes))
    for i, op in enumerate(operators):
        k[i] = 2.0 * op.stiffness * (1.0 if op.varied is None else op.varied.ravel())
    weights = np.empty((m, m, nodes))
    node_weights(blocks, mean, k, weights)
    shape, first = operators[0].shape, operators[0]
    stiffness = np.array([op.stiffness for op in operators])
    ax, ay, az = (np.asarray(a) / first.stiffness for a in first.eigenvalues)

    def solve(r: FloatArray) -> FloatArray:
        y = apply_node_blocks(weights, np.ascontiguousarray(r)).reshape(m, *shape)
        if not alike:
            for i, op in enumerate(operators):
                y[i] = op.invert(y[i].copy(), float(mean[i, i]))[0]
            return y.reshape(m, nodes)
        spectra = np.empty_like(y)
        for i in range(m):
            spectra[i] = _transform(y[i], first.kinds, inverse=False)
        divide_by_blocks(spectra, ax, ay, az, stiffness, mean)
        for i in range(m):
            y[i] = _transform(spectra[i], first.kinds, inverse=True)
        return y.reshape(m, nodes)

    return solve


def _on_shells(operators: list[Shells], blocks: FloatArray) -> Solve:
    """Return the solution of the block-tridiagonal system, unknowns of a shell side by side."""
    m, _, n = blocks.shape
    volumes = operators[0].volumes
    banded = np.zeros((2 * m + 1, n, m))
    for i, op in enumerate(operators):
        g = op.conductance
        diagonal = np.zeros(n)
        diagonal[:-1] += g
        diagonal[1:] += g
        diagonal[-1] += op.leak()
        banded[0, 1:, i] = -g
        banded[2 * m, :-1, i] = -g
        for j in range(m):
            # the entry of row i and column j of a shell stands i - j below the diagonal
            banded[m + i - j, :, j] += blocks[i, j] * volumes
        banded[m, :, i] += diagonal
    matrix = banded.reshape(2 * m + 1, n * m)

    def solve(r: FloatArray) -> FloatArray:
        right = (r * volumes).T.ravel()
        found = solve_banded((m, m), matrix, right, check_finite=False)
        return np.ascontiguousarray(found.reshape(n, m).T)

    return solve


@_jit
def eliminate(a: FloatArray, b: FloatArray) -> None:
    """Solve a x = b for columns b in place, with partial pivoting; ``a`` is used up.

    A pivot of zero is taken as one: what this is for is an approximation anyway.
    """
    m, columns = a.shape[0], b.shape[1]
    for p in range(m):
        best = p
        for i in range(p + 1, m):
            if abs(a[i, p]) > abs(a[best, p]):
                best = i
        if best != p:
            for j in range(m):
                a[p, j], a[best, j] = a[best, j], a[p, j]
            for j in range(columns):
                b[p, j], b[best, j] = b[best, j], b[p, j]
        pivot = a[p, p] if a[p, p] != 0.0 else 1.0
        for i in range(p + 1, m):
            share = a[i, p] / pivot
            for j in range(p + 1, m):
                a[i, j] -= share * a[p, j]
            for j in range(columns):
                b[i, j] -= share * b[p, j]
    for p in range(m - 1, -1, -1):
        pivot = a[p, p] if a[p, p] != 0.0 else 1.0
        for j in range(columns):
            total = b[p, j]
            for i in range(p + 1, m):
                total -= a[p, i] * b[i, j]
            b[p, j] = total / pivot


@_jit
def node_weights(blocks: FloatArray, mean: FloatArray, k: FloatArray, out: FloatArray) -> None:
    """Write (2K + B̄) (2K + B)⁻¹ of all nodes; ``k`` (m, nodes) is 2K, all in 1/s."""
    m, nodes = k.shape
    a, b = np.empty((m, m)), np.empty((m, m))
    for x in range(nodes):
        # transposed: X (2K + B) = 2K + B̄
        for i in range(m):
            for j in range(m):
                a[j, i] = blocks[i, j, x]
                b[j, i] = mean[i, j]
            a[i, i] += k[i, x]
            b[i, i] += k[i, x]
        eliminate(a, b)
        for i in range(m):
            for j in range(m):
                out[i, j, x] = b[j, i]


@_jit
def apply_node_blocks(blocks: FloatArray, v: FloatArray) -> FloatArray:
    """Return Σ_j blocks[i, j] v[j] at all nodes, (m, nodes)."""
    m, nodes = v.shape
    out = np.zeros((m, nodes))
    for i in range(m):
        for j in range(m):
            for x in range(nodes):
                out[i, x] += blocks[i, j, x] * v[j, x]
    return out


@_jit
def divide_by_blocks(
    spectra: FloatArray,
    ax: FloatArray,
    ay: FloatArray,
    az: FloatArray,
    stiffness: FloatArray,
    block: FloatArray,
) -> None:
    """Solve (stiffness_i (ax + ay + az) + block) x = spectra for every mode, in place.

    ``spectra`` is (m, nx, ny, nz), ``stiffness`` (m,) 1/s, ``block`` (m, m) 1/s; ax, ay, az are the
    eigenvalues of minus the second differences along the axes.
    """
    m, nx, ny, nz = spectra.shape
    a, b = np.empty((m, m)), np.empty((m, 1))
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                mode = ax[i] + ay[j] + az[k]
                for p in range(m):
                    for q in range(m):
                        a[p, q] = block[p, q]
                    a[p, p] += stiffness[p] * mode
                    b[p, 0] = spectra[p, i, j, k]
                eliminate(a, b)
                for p in range(m):
                    spectra[p, i, j, k] = b[p, 0]


def gmres(product: Solve, near: Solve, right: FloatArray, goal: float) -> tuple[FloatArray, int]:
    """Return x of A x = right, and how many products that took (Saad & Schultz 1986).

    On one thread: no sum depends on how many there are.

    - ``near``: v -> about the inverse of A
    - ``goal``: part of the right-hand side's norm that may be left over; as little as was reached
      is returned where it is not
    """
    x, taken = np.zeros_like(right), 0
    r = right.copy()
    first = float(np.sqrt(flat_dot(r, r)))
    for _ in range(_CYCLES):
        size = float(np.sqrt(flat_dot(r, r)))
        if not size > goal * first:
            break
        basis = np.empty((_DIMENSION + 1, right.size))
        basis[0] = r / size
        h = np.zeros((_DIMENSION + 1, _DIMENSION))
        for k in range(_DIMENSION):
            w = np.ascontiguousarray(product(near(basis[k])))
            taken += 1
            for j in range(k + 1):
                h[j, k] = flat_dot(basis[j], w)
                w -= h[j, k] * basis[j]
            h[k + 1, k] = norm = np.sqrt(flat_dot(w, w))
            basis[k + 1] = (1.0 / norm if norm > 0.0 else 0.0) * w
            known, start = h[: k + 2, : k + 1], np.zeros(k + 2)
            start[0] = size
            y = np.linalg.lstsq(known, start, rcond=None)[0]
            left = float(np.linalg.norm(start - known @ y))
            if not left > goal * first or h[k + 1, k] == 0.0:
                break
        x += near((y[:, None] * basis[: y.size]).sum(axis=0))
        r = right - product(x)
    return x, taken
