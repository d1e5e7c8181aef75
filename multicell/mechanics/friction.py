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
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from multicell.compiling import INNER, KERNEL
from multicell.compiling.threads import two_drivers
from multicell.mechanics.forces import nearest_image
from multicell.mechanics.motion import StateRejected
from multicell.mechanics.neighbours import PairList
from multicell.mechanics.rows import RADIUS, SHORTEST

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.neighbours import IndexArray, OffsetArray
    from multicell.mechanics.prescribed import Prescribed

_OWN, _OTHER = range(2)  # columns of ``near``
_ACROSS, _X, _Y, _Z = range(4)  # columns of ``link``
_MOST = 2000  # iterations after which a solution is given up


class Gamma(NamedTuple):
    """Γ at one state, for kernels.

    - ``chunk``, int: cells in a chunk
    - ``sign``, float: of γ_n - γ_t
    - ``start``, (k,) int64: first place of each chunk's pairs
    - ``ends``, (k, 2) int64: ends of its inner and of its outer pairs, which follow them
    - ``near``, (m, 2) int32: cells of each touching pair, the chunk's own first
    - ``link``, (m, 1) or (m, 4): a γ_t of each pair, nN s/µm, and where γ_n is another n √(A |γ_n -
      γ_t|): B_ij is the first times the unit matrix, plus ``sign`` times the square of the rest
    - ``stokes``, (n,), nN s/µm: Stokes drag of each cell
    - ``inverse``, (n,), µm/(nN s): one over the mean of each cell's three diagonal entries
    - ``held``, (n,) bool, or None: cells whose velocity is given: the rows of Γ for them are zero
    """

    chunk: int
    sign: float
    start: OffsetArray
    ends: OffsetArray
    near: IndexArray
    link: FloatArray
    stokes: FloatArray
    inverse: FloatArray
    held: NDArray[np.bool_] | None = None


class Vectors(NamedTuple):
    """Work arrays of conjugate gradients, each (n, 3): u = M⁻¹ r, w = Γ u, s = Γ p."""

    r: FloatArray
    u: FloatArray
    w: FloatArray
    p: FloatArray
    s: FloatArray


@njit(**INNER)
def _touching(begin, end, at, rows, first, second, period, normal, tangential, near, link):
    """Append the touching pairs of ``begin:end`` at place ``at``; return the next place.

    The write is unconditional and only the count depends on the test: no branch to
    mispredict. There is room, since the kept pairs are never ahead of the ones read.
    """
    spread = abs(normal - tangential)
    for p in range(begin, end):
        i, j = np.uint32(first[p]), np.uint32(second[p])
        dx = rows[j, 0] - rows[i, 0]
        dy = rows[j, 1] - rows[i, 1]
        dz = rows[j, 2] - rows[i, 2]
        dx, dy, dz = nearest_image(period, dx, dy, dz)
        gap = rows[i, RADIUS] + rows[j, RADIUS]
        d = math.sqrt(dx * dx + dy * dy + dz * dz + SHORTEST)
        w = 1.0 / (d * gap)
        h = gap - d
        area = math.pi * (rows[i, RADIUS] * rows[j, RADIUS]) * (w * d) * max(h, 0.0)
        near[at, _OWN] = first[p]
        near[at, _OTHER] = second[p]
        link[at, _ACROSS] = area * tangential
        if spread > 0.0:
            root = math.sqrt(area * spread) * (w * gap)
            link[at, _X] = dx * root
            link[at, _Y] = dy * root
            link[at, _Z] = dz * root
        at += np.int64(h > 0.0)
    return at


@njit(**INNER)
def _measure_chunk(
    c, gamma, first, second, inner_end, outer_end, period, rows, normal, tangential, drag
):
    """Store the touching pairs of one chunk and 1 / mean diagonal of Γ of its cells."""
    start, ends, near, link = gamma.start[c], gamma.ends, gamma.near, gamma.link
    inverse = gamma.inverse
    at = start
    for side in range(2):
        begin = start if side == 0 else inner_end[c]
        end = inner_end[c] if side == 0 else outer_end[c]
        at = _touching(begin, end, at, rows, first, second, period, normal, tangential, near, link)
        ends[c, side] = at
    low, high = c * gamma.chunk, min((c + 1) * gamma.chunk, rows.shape[0])
    for i in range(low, high):
        gamma.stokes[i] = drag * rows[i, RADIUS]
        inverse[i] = gamma.stokes[i]
    for p in range(start, at):
        mean = link[p, _ACROSS]
        if gamma.sign != 0.0:
            x, y, z = link[p, _X], link[p, _Y], link[p, _Z]
            mean += (gamma.sign / 3.0) * (x * x + y * y + z * z)
        inverse[np.uint32(near[p, _OWN])] += mean
        if p < ends[c, 0]:
            inverse[np.uint32(near[p, _OTHER])] += mean
    for i in range(low, high):
        inverse[i] = 1.0 / inverse[i]


@njit(**INNER)
def _pair_sums(begin, end, inner, sign, near, link, v, out):
    """Add Σ_j B_ij (v_i - v_j) of the pairs ``begin:end``; to both cells of ``inner`` pairs."""
    p = begin
    # pairs with the same first cell follow each other: its sum stays in registers
    while p < end:
        own = near[p, _OWN]
        i = np.uint32(own)
        vx, vy, vz = v[i, 0], v[i, 1], v[i, 2]
        sx, sy, sz = 0.0, 0.0, 0.0
        while p < end and near[p, _OWN] == own:
            j = np.uint32(near[p, _OTHER])
            ux, uy, uz = vx - v[j, 0], vy - v[j, 1], vz - v[j, 2]
            w = link[p, _ACROSS]
            if sign == 0.0:
                fx, fy, fz = w * ux, w * uy, w * uz
            else:
                x, y, z = link[p, _X], link[p, _Y], link[p, _Z]
                along = sign * (x * ux + y * uy + z * uz)
                fx, fy, fz = w * ux + along * x, w * uy + along * y, w * uz + along * z
            sx += fx
            sy += fy
            sz += fz
            if inner:
                out[j, 0] -= fx
                out[j, 1] -= fy
                out[j, 2] -= fz
            p += 1
        out[i, 0] += sx
        out[i, 1] += sy
        out[i, 2] += sz


@njit(**INNER)
def _clear_held(held, low, high, out):
    """Clear the rows of the held cells of one chunk."""
    if held is None:
        return
    for i in range(low, high):
        if held[i]:
            out[i, 0] = out[i, 1] = out[i, 2] = 0.0


@njit(**INNER)
def _apply_chunk(c, gamma, v, out):
    """Write Γ v for the cells of one chunk; return their share of v · Γ v."""
    low, high = c * gamma.chunk, min((c + 1) * gamma.chunk, v.shape[0])
    for i in range(low, high):
        for k in range(3):
            out[i, k] = gamma.stokes[i] * v[i, k]
    begin = gamma.start[c]
    for side in range(2):
        end = gamma.ends[c, side]
        _pair_sums(begin, end, side == 0, gamma.sign, gamma.near, gamma.link, v, out)
        begin = end
    _clear_held(gamma.held, low, high, out)
    tx, ty, tz = 0.0, 0.0, 0.0
    for i in range(low, high):
        tx += v[i, 0] * out[i, 0]
        ty += v[i, 1] * out[i, 1]
        tz += v[i, 2] * out[i, 2]
    return tx + ty + tz


@njit(**INNER)
def _begin_chunk(c, gamma, force, work, part):
    """Start from x, with ``w`` = Γ x: r = F - Γ x, u = M⁻¹ r; store r·u, r·r, F·F."""
    r, u, w, p, s = work
    ru, rr, ff = 0.0, 0.0, 0.0
    for i in range(c * gamma.chunk, min((c + 1) * gamma.chunk, r.shape[0])):
        for k in range(3):
            r[i, k] = force[i, k] - w[i, k]
            u[i, k] = gamma.inverse[i] * r[i, k]
            p[i, k] = 0.0
            s[i, k] = 0.0
            ru += r[i, k] * u[i, k]
            rr += r[i, k] * r[i, k]
            ff += force[i, k] * force[i, k]
    part[c, 0], part[c, 1], part[c, 2] = ru, rr, ff


@njit(**INNER)
def _advance_chunk(c, gamma, alpha, beta, work, x, part):
    """Take one step in one chunk; store r·u and r·r.

    ``w`` holds Γ u; p and s = Γ p are the direction and its image. Each axis has its own
    sums, which shortens the chain of dependent additions.
    """
    r, u, w, p, s = work
    ax, ay, az, bx, by, bz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(c * gamma.chunk, min((c + 1) * gamma.chunk, x.shape[0])):
        for k in range(3):
            p[i, k] = u[i, k] + beta * p[i, k]
            s[i, k] = w[i, k] + beta * s[i, k]
            x[i, k] += alpha * p[i, k]
            r[i, k] -= alpha * s[i, k]
            u[i, k] = gamma.inverse[i] * r[i, k]
        ax += r[i, 0] * u[i, 0]
        ay += r[i, 1] * u[i, 1]
        az += r[i, 2] * u[i, 2]
        bx += r[i, 0] * r[i, 0]
        by += r[i, 1] * r[i, 1]
        bz += r[i, 2] * r[i, 2]
    part[c, 0], part[c, 1] = ax + ay + az, bx + by + bz


@njit(**INNER)
def _sum(part, k):
    """Add the chunks' parts in their order: the same bits for any number of threads."""
    total = 0.0
    for c in range(part.shape[0]):
        total += part[c, k]
    return total


def _measure(gamma, first, second, inner_end, outer_end, period, rows, normal, tangential, drag):
    """Store Γ at the state in ``rows``: touching pairs, Stokes drag, inverse diagonal."""
    for c in prange(gamma.start.size):
        _measure_chunk(
            c, gamma, first, second, inner_end, outer_end, period, rows, normal, tangential, drag
        )


def _conjugate_gradients(gamma, force, tolerance, most, warm, work, part, x):
    """Solve Γ x = F from the guess in ``x``, or if not ``warm`` from zeros there and in ``w``.

    Return iterations, |r|² and |F|².
    """
    for c in prange(gamma.start.size):
        if warm:
            _apply_chunk(c, gamma, x, work.w)
        _begin_chunk(c, gamma, force, work, part)
    rho, rr, ff = _sum(part, 0), _sum(part, 1), _sum(part, 2)
    alpha, beta = 1.0, 0.0
    iteration = 0
    # written so that a number that is not one ends the loop
    while rr > tolerance * tolerance * ff and iteration < most and ff > 0.0:
        for c in prange(gamma.start.size):
            part[c, 0] = _apply_chunk(c, gamma, work.u, work.w)
        alpha = rho / (_sum(part, 0) - beta * rho / alpha)
        old = rho
        for c in prange(gamma.start.size):
            _advance_chunk(c, gamma, alpha, beta, work, x, part)
        rho, rr = _sum(part, 0), _sum(part, 1)
        beta = rho / old
        iteration += 1
    return iteration, rr, ff


measure, measure_parallel = two_drivers(_measure)
conjugate_gradients, conjugate_gradients_parallel = two_drivers(_conjugate_gradients)


@njit(**KERNEL)
def apply_friction(gamma, v, out):
    """Write Γ v, nN."""
    for c in range(gamma.start.size):
        _apply_chunk(c, gamma, v, out)


@final
class FrictionMatrix:
    """Γ at one state of the cells, with the work arrays of its solution.

    Call :meth:`measure` first; all vectors are (n, 3).

    - ``coefficients``: γ_n and γ_t against approach and against sliding of touching cells, in
      proportion to the contact area, nN s/µm³, not negative
    - ``n``, ``drag``, ``chunk``: number of cells, Stokes drag over radius (6πη, kPa s), and cells
      in a chunk
    - ``tolerance``: Γ v = F is solved to |F - Γ v| <= tolerance |F| (Euclidean norms over all
      cells)
    - ``period``: see :class:`.forces.PairData`
    """

    def __init__(
        self,
        coefficients: tuple[float, float],
        n: int,
        drag: float,
        chunk: int,
        *,
        tolerance: float = 1e-6,
        period: FloatArray | None = None,
    ) -> None:
        self.coefficients, self.drag, self.chunk = coefficients, drag, chunk
        self.tolerance, self._period = tolerance, period
        self._stokes, self._inverse = np.empty(n), np.empty(n)
        self._work = Vectors(*(np.empty((n, 3)) for _ in range(5)))
        self._pairs: PairList | None = None
        self.gamma: Gamma
        self._shared = False

    def measure(self, rows: FloatArray, pairs: PairList, shared: bool = False) -> None:
        """Take Γ from centres and radii.

        - ``rows``, (n, 4 or more): centre and radius of each cell in the first four columns, µm
        - ``shared``: whether chunks are shared among threads, here and in what follows; same bits
        """
        normal, tangential = self.coefficients
        if self._pairs is not pairs:
            sign = float(np.sign(normal - tangential))
            room, chunks = len(pairs.first), len(pairs.start)
            self.gamma = Gamma(
                self.chunk,
                sign,
                pairs.start,
                np.empty((chunks, 2), dtype=np.int64),
                np.empty((room, 2), dtype=np.int32),
                np.empty((room, 4 if sign else 1)),
                self._stokes,
                self._inverse,
            )
            self._part = np.empty((chunks, 3))
            self._pairs = pairs
        self._shared = shared
        run = measure_parallel if shared else measure
        ends = pairs.inner_end, pairs.outer_end
        run(
            self.gamma,
            pairs.first,
            pairs.second,
            *ends,
            self._period,
            rows,
            normal,
            tangential,
            self.drag,
        )

    def apply(self, vector: FloatArray, out: FloatArray) -> None:
        """Write Γ v, nN, for ``vector`` in µm/s."""
        apply_friction(self.gamma, vector, out)

    def solve(
        self,
        force: FloatArray,
        velocity: FloatArray,
        tolerance: float | None = None,
        warm: bool = True,
        held: NDArray[np.bool_] | None = None,
    ) -> int:
        """Solve Γ v = F and return the number of iterations.

        - ``velocity``: the guess that the iteration starts from, replaced by the solution, µm/s.
          The last velocity of the same cells is a good one; the result depends on it within the
          tolerance.
        - ``warm``: whether ``velocity`` holds a guess; if not, the iteration starts from rest
        - ``held``: cells that stand still: theirs are no unknowns, and have zero force and velocity
        """
        gamma = self.gamma if held is None else self.gamma._replace(held=held)
        wanted = self.tolerance if tolerance is None else tolerance
        if not warm:
            velocity[:] = 0.0
            self._work.w[:] = 0.0
        elif not force[:, 2].any():
            # cells of a plane stay in it, whatever a guess from beside it left within the tolerance
            velocity[:, 2] = 0.0
        run: Any = conjugate_gradients_parallel if self._shared else conjugate_gradients
        steps, left, scale = run(
            gamma,
            force,
            wanted,
            _MOST,
            warm,
            self._work,
            self._part,
            velocity,
        )
        if scale == 0.0:
            # nothing pushes: no relative tolerance could be met from a guess that moves
            velocity[:] = 0.0
            return 0
        if not left <= wanted**2 * scale:
            reached = math.sqrt(left / scale) if scale > 0.0 else math.nan
            raise StateRejected(
                f"after {steps} iterations the friction between cells is balanced to "
                f"{reached:.2g} of the forces, not to {wanted:.2g}"
            )
        return int(steps)


_INNER = 0.1
"""Relative tolerance of Γ⁻¹ in a Jacobian product: a tighter one changed no step of CVODE."""


@final
class PairFriction:
    """Γ at the present state and at the linearisation, and the last velocity as first guess.

    One object serves one coupling step, so that nothing outlives it but the state.

    - ``coefficients``: friction per contact area along the line of centres and across it, nN s/µm³
    - ``n``, ``drag``, ``chunk``: number of cells, 6πη in kPa·s, and cells in a chunk
    - ``period``: see :class:`.forces.PairData`
    """

    def __init__(
        self,
        coefficients: tuple[float, float],
        n: int,
        drag: float,
        chunk: int,
        period: FloatArray | None = None,
    ) -> None:
        self._present = FrictionMatrix(coefficients, n, drag, chunk, period=period)
        self._linearised = FrictionMatrix(coefficients, n, drag, chunk, period=period)
        self._last = np.zeros((n, 3))
        self._product = np.empty((n, 3))
        self.force = np.empty((n, 3))

    def velocity(
        self,
        rows: FloatArray,
        pairs: PairList,
        shared: bool,
        out: FloatArray,
        given: Prescribed | None = None,
    ) -> int:
        """Write the solution of Γ v = ``force``, µm/s; return the iterations it took.

        With ``given`` Γ_ff v_f = F_f - Γ_fh v_h is solved; zero is written for held cells.
        """
        self._present.measure(rows, pairs, shared)
        force, held = self.force, None
        if given is not None:
            dragged = np.empty_like(force)
            self._present.apply(given.velocity, dragged)
            force, held = given.released(force - dragged), given.held
        try:
            iterations = self._present.solve(force, self._last, held=held)
        except StateRejected:
            self._last[:] = 0.0
            raise
        out[:] = self._last
        return int(iterations)

    def linearise(self, rows: FloatArray, pairs: PairList, shared: bool) -> None:
        """Keep Γ at a state for :meth:`divide`."""
        self._linearised.measure(rows, pairs, shared)

    def diagonal(self) -> FloatArray:
        """Return the mean of each cell's three diagonal entries of Γ, (n,) nN s/µm.

        At the state last given to :meth:`linearise`, as a preconditioner of Γ - γK needs it.
        """
        return np.asarray(1.0 / self._linearised.gamma.inverse)

    def resistance(self, velocity: FloatArray) -> FloatArray:
        """Return Γ v at the last state of :meth:`velocity`, (n, 3) nN."""
        out = np.empty_like(velocity)
        self._present.apply(velocity, out)
        return out

    def divide(self, out: FloatArray, given: Prescribed | None = None) -> int:
        """Replace forces by Γ⁻¹ times them, roughly; return the iterations it took.

        Of held cells, which are ``given``, the forces are zero, and no unknowns of Γ. The
        derivative of Γ itself is left out: it changed no more than one step in twenty.
        """
        held = None if given is None else given.held
        iterations = self._linearised.solve(
            out, self._product, tolerance=_INNER, warm=False, held=held
        )
        out[:] = self._product
        return int(iterations)
