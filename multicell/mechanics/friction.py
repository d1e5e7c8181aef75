"""Friction between touching cells: the matrix Γ(x) of Γ(x) ẋ = F and its solution.

For every cell (Γ v)_i = 6πη r_i v_i + Σ_j B_ij (v_i - v_j) with, for each pair that touches
(overlap h > 0) and the unit vector n between the centres,

    B_ij = A_ij [ γ_n n nᵀ + γ_t (I - n nᵀ) ],   A_ij = π r_ij h   (Hertz contact area),

γ_n and γ_t in nN s/µm³. The sum over j is a weighted graph Laplacian, and Stokes drag is
positive on the diagonal: Γ is symmetric positive definite. Motion of all cells together
feels no friction between cells, and Σ_i (Γ v)_i = Σ_i 6πη r_i v_i.

Γ v = F is solved by conjugate gradients (Chronopoulos & Gear 1989: one reduction an
iteration), preconditioned by each cell's mean diagonal entry, in one call. Inverse 3 x 3
blocks save no iteration where γ_n = γ_t, one in twenty where γ_n = 4 γ_t, one in eight where
γ_t = 0, and cost more to build; symmetric Gauss-Seidel saves a third but costs as much more.

Layout, chunks and the order of all sums follow :mod:`multicell.mechanics.forces`: each chunk writes
to its own cells, and its partial scalar products are added in the order of the chunks, so that any
number of threads gives the same bits. The kernels stand here and not there because they
form a family of their own, and numba's disk cache does not notice changes in other modules.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numba import njit, prange

from multicell.mechanics.neighbours import PairList

if TYPE_CHECKING:
    from multicell.cells import FloatArray


BLOCK = 256
"""Pairs that are gathered before they are measured."""

_TINY = 1e-300
_NO_SLACK = np.empty(0)


@njit(cache=True, error_model="numpy")
def _gather(rows, first, second, begin, count, spread, slack, dx, dy, dz, gap, area):
    """Measure a block of pairs: overlap beyond slack, contact area, and n √(area spread)."""
    for p in range(count):
        i, j = np.uint32(first[begin + p]), np.uint32(second[begin + p])
        dx[p] = rows[j, 0] - rows[i, 0]
        dy[p] = rows[j, 1] - rows[i, 1]
        dz[p] = rows[j, 2] - rows[i, 2]
        gap[p] = rows[i, 3] + rows[j, 3]
        area[p] = rows[i, 3] * rows[j, 3]
    for p in range(count):
        d = math.sqrt(dx[p] * dx[p] + dy[p] * dy[p] + dz[p] * dz[p] + _TINY)
        w = 1.0 / (d * gap[p])
        h = gap[p] - d
        if slack.size > 0:
            h -= slack[begin + p]
        a = math.pi * area[p] * (w * d) * max(h, 0.0)
        root = math.sqrt(a * spread) * (w * gap[p])
        gap[p] = h
        area[p] = a
        dx[p] *= root
        dy[p] *= root
        dz[p] *= root


@njit(cache=True)
def _keep(
    first, second, begin, count, dx, dy, dz, gap, area, tangential, anisotropic,
    at, near, link, across,
):  # fmt: skip
    """Append the touching pairs of a block at place ``at``; return the next place.

    The write is unconditional and only the count depends on the test: no branch to
    mispredict. There is room, since the kept pairs are never ahead of the ones read.
    """
    for p in range(count):
        near[at, 0] = first[begin + p]
        near[at, 1] = second[begin + p]
        across[at] = area[p] * tangential
        if anisotropic:
            link[at, 0] = dx[p]
            link[at, 1] = dy[p]
            link[at, 2] = dz[p]
            link[at, 3] = across[at]
        at += np.int64(gap[p] > 0.0)
    return at


@njit(cache=True)
def _measure_chunk(
    c, chunk, rows, first, second, start, inner_end, outer_end, normal, tangential, drag,
    slack, near, link, across, ends, stokes, inverse,
):  # fmt: skip
    """Store the touching pairs of one chunk and 1 / mean diagonal of Γ of its cells."""
    sign = np.sign(normal - tangential)
    spread = abs(normal - tangential)
    dx, dy, dz = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    gap, area = np.empty(BLOCK), np.empty(BLOCK)
    at = start[c]
    for side in range(2):
        begin = start[c] if side == 0 else inner_end[c]
        end = inner_end[c] if side == 0 else outer_end[c]
        for block in range(begin, end, BLOCK):
            count = min(BLOCK, end - block)
            _gather(rows, first, second, block, count, spread, slack, dx, dy, dz, gap, area)
            at = _keep(
                first, second, block, count, dx, dy, dz, gap, area, tangential, spread > 0.0,
                at, near, link, across,
            )  # fmt: skip
        ends[c, side] = at
    low, high = c * chunk, min((c + 1) * chunk, rows.shape[0])
    for i in range(low, high):
        stokes[i] = drag * rows[i, 3]
        inverse[i] = stokes[i]
    for p in range(start[c], ends[c, 1]):
        mean = across[p]
        if spread > 0.0:
            x, y, z = link[p, 0], link[p, 1], link[p, 2]
            mean += (sign / 3.0) * (x * x + y * y + z * z)
        inverse[np.uint32(near[p, 0])] += mean
        if p < ends[c, 0]:
            inverse[np.uint32(near[p, 1])] += mean
    for i in range(low, high):
        inverse[i] = 1.0 / inverse[i]


@njit(cache=True)
def _pair_sums(c, sign, start, near, link, ends, v, out):
    """Add Σ_j B_ij (v_i - v_j) to the cells of one chunk."""
    p = start[c]
    # pairs with the same first cell follow each other: its sum stays in registers
    while p < ends[c, 0]:
        own = near[p, 0]
        i = np.uint32(own)
        vx, vy, vz = v[i, 0], v[i, 1], v[i, 2]
        sx, sy, sz = 0.0, 0.0, 0.0
        while p < ends[c, 0] and near[p, 0] == own:
            j = np.uint32(near[p, 1])
            ux, uy, uz = vx - v[j, 0], vy - v[j, 1], vz - v[j, 2]
            x, y, z, w = link[p, 0], link[p, 1], link[p, 2], link[p, 3]
            along = sign * (x * ux + y * uy + z * uz)
            fx, fy, fz = w * ux + along * x, w * uy + along * y, w * uz + along * z
            sx += fx
            sy += fy
            sz += fz
            out[j, 0] -= fx
            out[j, 1] -= fy
            out[j, 2] -= fz
            p += 1
        out[i, 0] += sx
        out[i, 1] += sy
        out[i, 2] += sz
    while p < ends[c, 1]:
        own = near[p, 0]
        i = np.uint32(own)
        vx, vy, vz = v[i, 0], v[i, 1], v[i, 2]
        sx, sy, sz = 0.0, 0.0, 0.0
        while p < ends[c, 1] and near[p, 0] == own:
            j = np.uint32(near[p, 1])
            ux, uy, uz = vx - v[j, 0], vy - v[j, 1], vz - v[j, 2]
            x, y, z, w = link[p, 0], link[p, 1], link[p, 2], link[p, 3]
            along = sign * (x * ux + y * uy + z * uz)
            sx += w * ux + along * x
            sy += w * uy + along * y
            sz += w * uz + along * z
            p += 1
        out[i, 0] += sx
        out[i, 1] += sy
        out[i, 2] += sz


@njit(cache=True)
def _isotropic_sums(c, start, near, across, ends, v, out):
    """Do the same where γ_n = γ_t: B_ij is a number, and a quarter of the time is saved."""
    p = start[c]
    # pairs with the same first cell follow each other: its sum stays in registers
    while p < ends[c, 0]:
        own = near[p, 0]
        i = np.uint32(own)
        vx, vy, vz = v[i, 0], v[i, 1], v[i, 2]
        sx, sy, sz = 0.0, 0.0, 0.0
        while p < ends[c, 0] and near[p, 0] == own:
            j = np.uint32(near[p, 1])
            ux, uy, uz = vx - v[j, 0], vy - v[j, 1], vz - v[j, 2]
            w = across[p]
            fx, fy, fz = w * ux, w * uy, w * uz
            sx += fx
            sy += fy
            sz += fz
            out[j, 0] -= fx
            out[j, 1] -= fy
            out[j, 2] -= fz
            p += 1
        out[i, 0] += sx
        out[i, 1] += sy
        out[i, 2] += sz
    while p < ends[c, 1]:
        own = near[p, 0]
        i = np.uint32(own)
        vx, vy, vz = v[i, 0], v[i, 1], v[i, 2]
        sx, sy, sz = 0.0, 0.0, 0.0
        while p < ends[c, 1] and near[p, 0] == own:
            j = np.uint32(near[p, 1])
            ux, uy, uz = vx - v[j, 0], vy - v[j, 1], vz - v[j, 2]
            w = across[p]
            sx += w * ux
            sy += w * uy
            sz += w * uz
            p += 1
        out[i, 0] += sx
        out[i, 1] += sy
        out[i, 2] += sz


@njit(cache=True)
def _apply_chunk(c, chunk, stokes, sign, start, near, link, across, ends, v, out):
    """Write Γ v for the cells of one chunk; return their share of v · Γ v."""
    low, high = c * chunk, min((c + 1) * chunk, v.shape[0])
    for i in range(low, high):
        out[i, 0] = stokes[i] * v[i, 0]
        out[i, 1] = stokes[i] * v[i, 1]
        out[i, 2] = stokes[i] * v[i, 2]
    if sign == 0.0:
        _isotropic_sums(c, start, near, across, ends, v, out)
    else:
        _pair_sums(c, sign, start, near, link, ends, v, out)
    tx, ty, tz = 0.0, 0.0, 0.0
    for i in range(low, high):
        tx += v[i, 0] * out[i, 0]
        ty += v[i, 1] * out[i, 1]
        tz += v[i, 2] * out[i, 2]
    return tx + ty + tz


@njit(cache=True)
def _clear_chunk(c, chunk, x, w):
    """Start from rest: x = 0 and Γ x = 0, without a look at the pairs."""
    for i in range(c * chunk, min((c + 1) * chunk, x.shape[0])):
        for k in range(3):
            x[i, k] = 0.0
            w[i, k] = 0.0


@njit(cache=True)
def _begin_chunk(c, chunk, inverse, force, x, r, u, w, p, s):
    """Start from x, with ``w`` = Γ x: r = F - Γ x, u = M⁻¹ r; return r·u, r·r, F·F."""
    ru, rr, ff = 0.0, 0.0, 0.0
    for i in range(c * chunk, min((c + 1) * chunk, x.shape[0])):
        for k in range(3):
            r[i, k] = force[i, k] - w[i, k]
            u[i, k] = inverse[i] * r[i, k]
            p[i, k] = 0.0
            s[i, k] = 0.0
            ru += r[i, k] * u[i, k]
            rr += r[i, k] * r[i, k]
            ff += force[i, k] * force[i, k]
    return ru, rr, ff


@njit(cache=True)
def _advance_chunk(c, chunk, inverse, alpha, beta, w, r, u, p, s, x):
    """Take one step in one chunk; return r·u and r·r.

    ``w`` holds Γ u; p and s = Γ p are the direction and its image. Each axis has its own
    sums, which shortens the chain of dependent additions.
    """
    ax, ay, az, bx, by, bz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(c * chunk, min((c + 1) * chunk, x.shape[0])):
        for k in range(3):
            p[i, k] = u[i, k] + beta * p[i, k]
            s[i, k] = w[i, k] + beta * s[i, k]
            x[i, k] += alpha * p[i, k]
            r[i, k] -= alpha * s[i, k]
            u[i, k] = inverse[i] * r[i, k]
        ax += r[i, 0] * u[i, 0]
        ay += r[i, 1] * u[i, 1]
        az += r[i, 2] * u[i, 2]
        bx += r[i, 0] * r[i, 0]
        by += r[i, 1] * r[i, 1]
        bz += r[i, 2] * r[i, 2]
    return ax + ay + az, bx + by + bz


@njit(cache=True)
def _sums(part):
    """Add the chunks' parts in their order: the same bits for any number of threads."""
    a, b, c = 0.0, 0.0, 0.0
    for k in range(part.shape[0]):
        a += part[k, 0]
        b += part[k, 1]
        c += part[k, 2]
    return a, b, c


@njit(cache=True)
def measure(
    chunk, rows, first, second, start, inner_end, outer_end, normal, tangential, drag,
    slack, near, link, across, ends, stokes, inverse,
):  # fmt: skip
    """Store Γ at the state in ``rows``: touching pairs, Stokes drag, inverse diagonal."""
    for c in range(start.size):
        _measure_chunk(
            c, chunk, rows, first, second, start, inner_end, outer_end, normal, tangential,
            drag, slack, near, link, across, ends, stokes, inverse,
        )  # fmt: skip


@njit(cache=True, parallel=True)
def measure_parallel(
    chunk, rows, first, second, start, inner_end, outer_end, normal, tangential, drag,
    slack, near, link, across, ends, stokes, inverse,
):  # fmt: skip
    """Do the same as :func:`measure`, with the chunks shared among threads."""
    for c in prange(start.size):
        _measure_chunk(
            c, chunk, rows, first, second, start, inner_end, outer_end, normal, tangential,
            drag, slack, near, link, across, ends, stokes, inverse,
        )  # fmt: skip


@njit(cache=True)
def apply(chunk, stokes, sign, start, near, link, across, ends, v, out):
    """Write Γ v, nN."""
    for c in range(start.size):
        _apply_chunk(c, chunk, stokes, sign, start, near, link, across, ends, v, out)


@njit(cache=True)
def conjugate_gradients(
    chunk, stokes, sign, start, near, link, across, ends, inverse, force, tolerance, most,
    warm, r, u, w, p, s, x,
):  # fmt: skip
    """Solve Γ x = F from the guess in ``x``; return iterations, |r|² and |F|²."""
    chunks = start.size
    part = np.zeros((chunks, 3))
    for c in range(chunks):
        if warm:
            _apply_chunk(c, chunk, stokes, sign, start, near, link, across, ends, x, w)
        else:
            _clear_chunk(c, chunk, x, w)
        part[c] = _begin_chunk(c, chunk, inverse, force, x, r, u, w, p, s)
    rho, rr, ff = _sums(part)
    if ff == 0.0:
        # nothing pushes: no relative tolerance could be met from a guess that moves
        x[:] = 0.0
        return 0, 0.0, 0.0
    alpha, beta = 1.0, 0.0
    step = 0
    # written so that a number that is not one ends the loop
    while rr > tolerance * tolerance * ff and step < most:
        for c in range(chunks):
            part[c, 0] = _apply_chunk(c, chunk, stokes, sign, start, near, link, across, ends, u, w)
        alpha = rho / (_sums(part)[0] - beta * rho / alpha)
        old = rho
        for c in range(chunks):
            part[c, 0], part[c, 1] = _advance_chunk(
                c, chunk, inverse, alpha, beta, w, r, u, p, s, x
            )
        rho, rr, _ = _sums(part)
        beta = rho / old
        step += 1
    return step, rr, ff


@njit(cache=True, parallel=True)
def conjugate_gradients_parallel(
    chunk, stokes, sign, start, near, link, across, ends, inverse, force, tolerance, most,
    warm, r, u, w, p, s, x,
):  # fmt: skip
    """Do the same as :func:`conjugate_gradients`, with the chunks shared among threads."""
    chunks = start.size
    part = np.zeros((chunks, 3))
    for c in prange(chunks):
        if warm:
            _apply_chunk(c, chunk, stokes, sign, start, near, link, across, ends, x, w)
        else:
            _clear_chunk(c, chunk, x, w)
        part[c] = _begin_chunk(c, chunk, inverse, force, x, r, u, w, p, s)
    rho, rr, ff = _sums(part)
    if ff == 0.0:
        # nothing pushes: no relative tolerance could be met from a guess that moves
        x[:] = 0.0
        return 0, 0.0, 0.0
    alpha, beta = 1.0, 0.0
    step = 0
    # written so that a number that is not one ends the loop
    while rr > tolerance * tolerance * ff and step < most:
        for c in prange(chunks):
            part[c, 0] = _apply_chunk(c, chunk, stokes, sign, start, near, link, across, ends, u, w)
        alpha = rho / (_sums(part)[0] - beta * rho / alpha)
        old = rho
        for c in prange(chunks):
            part[c, 0], part[c, 1] = _advance_chunk(
                c, chunk, inverse, alpha, beta, w, r, u, p, s, x
            )
        rho, rr, _ = _sums(part)
        beta = rho / old
        step += 1
    return step, rr, ff


@njit(cache=True)
def diagonal_blocks(normal, tangential, stokes, start, near, link, across, ends, out):
    """Add the 3 x 3 diagonal blocks of Γ, ``xx, yy, zz, xy, xz, yz``, to ``out``."""
    sign = np.sign(normal - tangential)
    for i in range(stokes.size):
        out[i, 0] += stokes[i]
        out[i, 1] += stokes[i]
        out[i, 2] += stokes[i]
    for c in range(start.size):
        for p in range(start[c], ends[c, 1]):
            x, y, z, w = 0.0, 0.0, 0.0, across[p]
            if sign != 0.0:
                x, y, z = link[p, 0], link[p, 1], link[p, 2]
            for side in range(2 if p < ends[c, 0] else 1):
                i = near[p, side]
                out[i, 0] += w + sign * x * x
                out[i, 1] += w + sign * y * y
                out[i, 2] += w + sign * z * z
                out[i, 3] += sign * x * y
                out[i, 4] += sign * x * z
                out[i, 5] += sign * y * z


class FrictionNotSolvedError(Exception):
    """Conjugate gradients did not reach their tolerance."""


@final
@dataclass(frozen=True)
class Friction:
    """Friction between touching cells, proportional to the contact area.

    Parameters
    ----------
    normal, tangential
        Coefficients γ_n and γ_t against approach and against sliding, nN s/µm³, not negative.
    tolerance
        Γ v = F is solved to |F - Γ v| <= tolerance |F| (Euclidean norms over all cells).
    most_iterations
        Iterations after which the solution is given up.
    """

    normal: float
    tangential: float
    tolerance: float = 1e-6
    most_iterations: int = 2000

    def matrix(self, n: int, drag: float, chunk: int) -> FrictionMatrix:
        """Return a Γ for ``n`` cells with Stokes drag ``drag`` (6πη, kPa s) times radius."""
        return FrictionMatrix(self, n, drag, chunk)


@final
class FrictionMatrix:
    """Γ at one state of the cells, with the work arrays of its solution.

    Call :meth:`measure` first; all vectors are (n, 3).
    """

    def __init__(self, friction: Friction, n: int, drag: float, chunk: int) -> None:
        self.friction, self.drag, self.chunk = friction, drag, chunk
        self._sign = float(np.sign(friction.normal - friction.tangential))
        self._stokes = np.empty(n)
        self._inverse = np.empty(n)
        self._work = [np.empty((n, 3)) for _ in range(5)]
        self._pairs: PairList | None = None
        self._shared = False

    def measure(
        self,
        rows: FloatArray,
        pairs: PairList,
        shared: bool = False,
        slack: FloatArray = _NO_SLACK,
    ) -> None:
        """Take Γ from centres and radii.

        Parameters
        ----------
        rows : (n, 5)
            Centre and radius of each cell in the first four columns, µm.
        pairs
            Every pair that may touch.
        shared
            Whether chunks are shared among threads, here and in what follows; same bits.
        slack
            Part of the overlap of each pair of the list that makes no contact, µm; empty for none.
        """
        if self._pairs is not pairs:
            self._near = np.empty((len(pairs.first), 2), dtype=np.int32)
            self._across = np.empty(len(pairs.first))
            self._link = np.empty((len(pairs.first) if self._sign else 0, 4))
            self._ends = np.empty((len(pairs.start), 2), dtype=np.int64)
            self._pairs = pairs
        self._shared = shared
        run = measure_parallel if shared else measure
        run(
            self.chunk, rows, pairs.first, pairs.second, pairs.start, pairs.inner_end,
            pairs.outer_end, self.friction.normal, self.friction.tangential, self.drag,
            slack, self._near, self._link, self._across, self._ends, self._stokes, self._inverse,
        )  # fmt: skip

    @property
    def stokes_share(self) -> FloatArray:
        """Stokes drag of each cell over its mean diagonal entry of Γ, (n,)."""
        return np.asarray(self._stokes * self._inverse)

    def apply(self, vector: FloatArray, out: FloatArray) -> None:
        """Write Γ v, nN, for ``vector`` in µm/s."""
        apply(
            self.chunk, self._stokes, self._sign, self._list().start, self._near, self._link,
            self._across, self._ends, vector, out,
        )  # fmt: skip

    def solve(
        self,
        force: FloatArray,
        velocity: FloatArray,
        tolerance: float | None = None,
        warm: bool = True,
    ) -> int:
        """Solve Γ v = F and return the number of iterations.

        Parameters
        ----------
        force
            F, nN.
        velocity
            The guess that the iteration starts from, replaced by the solution, µm/s. The
            last velocity of the same cells is a good one; the result depends on it within
            the tolerance.
        tolerance
            Relative tolerance, if not that of the parameters.
        warm
            Whether ``velocity`` holds a guess; if not, the iteration starts from rest.

        Raises
        ------
        FrictionNotSolvedError
            If the tolerance is not reached; ``velocity`` then has no meaning.
        """
        wanted = self.friction.tolerance if tolerance is None else tolerance
        run: Any = conjugate_gradients_parallel if self._shared else conjugate_gradients
        steps, left, scale = run(
            self.chunk, self._stokes, self._sign, self._list().start, self._near, self._link,
            self._across, self._ends, self._inverse, force, wanted, self.friction.most_iterations,
            warm, *self._work, velocity,
        )  # fmt: skip
        if not left <= wanted**2 * scale:
            reached = math.sqrt(left / scale) if scale > 0.0 else math.nan
            raise FrictionNotSolvedError(
                f"after {steps} iterations the friction between cells is balanced to "
                f"{reached:.2g} of the forces, not to {wanted:.2g}"
            )
        return int(steps)

    def add_blocks(self, out: FloatArray) -> None:
        """Add the 3 x 3 diagonal blocks of Γ to ``out``, (n, 6): xx, yy, zz, xy, xz, yz."""
        diagonal_blocks(
            self.friction.normal, self.friction.tangential, self._stokes, self._list().start,
            self._near, self._link, self._across, self._ends, out,
        )  # fmt: skip

    def _list(self) -> PairList:
        if self._pairs is None:
            raise RuntimeError("measure() must come first")
        return self._pairs


_INNER = 0.1
"""Relative tolerance of Γ⁻¹ in a Jacobian product: a tighter one changed no step of CVODE."""


@final
class Rubbing:
    """Γ at the present state and at the linearisation, and the last velocity as first guess.

    One object serves one coupling step, so that nothing outlives it but the state.

    Parameters
    ----------
    coefficients
        Friction per contact area along the line of centres and across it, nN s/µm³.
    n, drag, chunk
        Number of cells, 6πη in kPa·s, and cells in a chunk.
    """

    failure = FrictionNotSolvedError

    def __init__(self, coefficients: tuple[float, float], n: int, drag: float, chunk: int) -> None:
        friction = Friction(*coefficients)
        self._present = friction.matrix(n, drag, chunk)
        self._linearised = friction.matrix(n, drag, chunk)
        self._last = np.zeros((n, 3))
        self._product = np.empty((n, 3))
        self.force = np.empty((n, 3))

    def velocity(
        self, rows: FloatArray, pairs: PairList, shared: bool, slack: FloatArray, out: FloatArray
    ) -> int:
        """Write the solution of Γ v = ``force``, µm/s; return the iterations it took.

        ``slack`` is the part of each listed pair's overlap that makes no contact; empty for none.
        """
        self._present.measure(rows, pairs, shared, slack)
        try:
            iterations = self._present.solve(self.force, self._last)
        except FrictionNotSolvedError:
            self._last[:] = 0.0
            raise
        out[:] = self._last
        return int(iterations)

    def linearise(self, rows: FloatArray, pairs: PairList, shared: bool, slack: FloatArray) -> None:
        """Keep Γ at a state for :meth:`divide`."""
        self._linearised.measure(rows, pairs, shared, slack)

    @property
    def stokes_share(self) -> FloatArray:
        """Stokes drag of each cell over its mean diagonal entry of Γ at the linearisation, (n,)."""
        return self._linearised.stokes_share

    def divide(self, out: FloatArray) -> int:
        """Replace forces by Γ⁻¹ times them, roughly; return the iterations it took.

        The derivative of Γ itself is left out: it changed no more than one step in twenty.
        """
        iterations = self._linearised.solve(out, self._product, tolerance=_INNER, warm=False)
        out[:] = self._product
        return int(iterations)
