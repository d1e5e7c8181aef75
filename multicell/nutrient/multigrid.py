"""Linear systems of the steady field on many nodes: cycles of multigrid.

The systems are those of :mod:`multicell.nutrient.steady`, (-D L0 + d) x = r. On a few ten thousand
nodes and more V-cycles of geometric multigrid take the place of sine transforms: they know at which
nodes uptake is fast, so that each leaves a fifteenth of the imbalance over.

A node of the next coarser level is made of two along each axis, of one at the end of an axis with
an odd number: a grid of boxes of unequal width, on which finite volumes give the operator again
(so any number of nodes will do). Residuals and rates are averaged, corrections interpolated
linearly and, between faces that all have values, made larger by 6 %. The smoother comes after them
alone: the Chebyshev polynomial of fourth degree in the Jacobi-scaled operator for the upper 85 % of
its spectrum, four damped Jacobi steps in one pass over memory. The last level is one node. (Briggs,
Henson & McCormick 2000, A Multigrid Tutorial; Adams et al. 2003, J. Comput. Phys. 188:593, on
polynomial smoothers.)

Where that is slow (the coefficient of diffusion jumps far, or few nodes take up so fast that means
say little of them) a cycle from zero is the preconditioner of conjugate gradients. It is not
symmetric: the directions are made conjugate by the formula of Polak and Ribiere, which does not ask
for that (Notay 2000, SIAM J. Sci. Comput. 22:1444).

All of it is in single precision, half the memory to go through. Newton's method around it
evaluates the imbalance in double precision and so removes what rounding leaves here.

Where the coefficient of diffusion differs from place to place, a coarser node has the mean of its
nodes' coefficients, and a face the harmonic mean of its two nodes', as on the finest level.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.compiling.threads import Team
from multicell.nutrient import multigrid_kernels as kernels
from multicell.nutrient import stencil
from multicell.nutrient.stencil import MAX_CG, Floats, face_means

if TYPE_CHECKING:
    from multicell.nutrient.diffusion import Diffusion

Float32Array = NDArray[np.float32]
Triple = tuple[Any, Any, Any]

FINEST = 1e-5
"""Least part of the imbalance that is asked to be left over: single precision allows no less."""

_ARRAYS = 8  # of the nodes of a level
_SPARE = 1.2
"""Memory taken over what is needed: a grid that grows with its tissue then fits in it. Pages that
nobody writes to cost nothing, and new ones of the system take as long as a solve."""

_MIDDLE, _HALF = 1.15, 0.85  # of the spectrum that the smoother damps: 0.3 to 2
_SMOOTHER = tuple(
    np.float32(1.0 / (_MIDDLE + _HALF * math.cos(math.pi * (2 * k + 1) / 8))) for k in (0, 3, 1, 2)
)
"""Inverse roots of the Chebyshev polynomial: the weights of four damped Jacobi steps."""

_POOR = 0.03  # of the imbalance may be left over where rounding slows cycles down

_LIFT = np.float32(1.06)
"""Factor of corrections between faces that all have values: means and interpolation make them a
little too small. Long waves between walls would be made too large by it once a level."""

_SLOW = 0.25
"""Part of the imbalance that a cycle leaves over where conjugate gradients are taken instead."""


_Axis = tuple[Float32Array, Float32Array, Float32Array]
"""Coefficients of a level along an axis, see :func:`_axis`."""


@final
class _Level:
    """The operator, the transfer to the next level, and the arrays of one level.

    - ``axes``, three of _Axis
    - ``team``: threads that share the loops, as many as there is work for (:data:`.stencil.PART`)
    - ``light``: those that share loops in which nodes do not see each other
    - ``room``, (8 nodes,): memory to work in
    - ``lift``: factor of corrections

    - ``parts``, (2, nx): products of planes of the solution with ``b`` and with ``work[2]``
    """

    def __init__(self, axes: list[_Axis], team: Team, room: Float32Array, lift: np.float32) -> None:
        self.along, self.shares, (nearness, *others) = map(_triple, zip(*axes, strict=True))
        self.nearness = (lift * nearness, *others)
        nx, ny, nz = map(len, self.shares)
        self.shape = (nx, ny, nz)
        self.weights: Triple | None = None
        self.team, self.light = stencil.teams(team, nx * ny * nz)
        arrays = room.reshape(_ARRAYS, nx, ny, nz)
        self.rate, self.inverse, self.b, self.x, self.spare, *self.work = arrays
        self.parts = np.zeros((2, nx))

    def share(self, kernel: Callable[..., Any], *arguments: Any) -> None:
        """Run a kernel over the planes of this level."""
        self.team.share(kernel, self.shape[0], *arguments)

    def share_light(self, kernel: Callable[..., Any], *arguments: Any) -> None:
        """Run a kernel over the planes of this level in which nodes do not see each other."""
        self.light.share(kernel, self.shape[0], *arguments)

    def invert_diagonal(self) -> None:
        """Bring ``inverse`` up to date with the rates."""
        self.share_light(kernels.invert_diagonal, self.rate, self.along, self.weights, self.inverse)

    def leave(self, coarse: _Level) -> float:
        """Give what ``x`` leaves of ``b`` to the next level; return its norm."""
        own = self.b, self.x, self.rate, self.along, self.weights, self.shares
        self.team.share(kernels.restrict_left, coarse.shape[0], *own, coarse.b, self.parts[0])
        return math.sqrt(float(self.parts[0].sum()))

    def average(self, values: Float32Array, out: Float32Array) -> None:
        """Write means over the nodes in each node of the next level."""
        self.light.share(kernels.average, len(out), values, self.shares, out)

    def correct(self, coarse: _Level, start: Float32Array, parts: FloatArray) -> None:
        """Add the solution of the next level to ``start``, and take damped Jacobi steps."""
        self.share(
            kernels.up,
            coarse.x,
            self.nearness,
            start,
            self.b,
            self.inverse,
            self.along,
            self.weights,
            _SMOOTHER,
            self.work[2],
            self.spare,
            parts,
        )
        self.x, self.spare = self.spare, self.x

    def solve(self) -> None:
        """Solve exactly for a single node."""
        along = sum(axis[2, 0] + axis[3, 0] for axis in self.along)
        if self.weights is not None:  # one node has one coefficient
            along = along * self.weights[0][0, 0, 0]
        np.divide(self.b, along + self.rate, out=self.x)


@final
class Hierarchy:
    """Levels from the grid of a field down to one node.

    - ``shape``, (3,) int: nodes of the finest level
    - ``ghost``, (6,): factors of the ghost values; see :mod:`multicell.nutrient.stencil`
    - ``team``: threads that share the loops; they do not change the result
    - ``varied``, (nx, ny, nz), optional: relative coefficient of diffusion at the nodes
    - ``room``, (any,), optional: memory to work in, if it is enough; ``room`` is then the same
    """

    def __init__(
        self,
        shape: tuple[int, int, int],
        ghost: FloatArray,
        team: Team,
        varied: FloatArray | None = None,
        room: Float32Array | None = None,
    ) -> None:
        sides = (ghost < 0.0).reshape(3, 2).tolist()
        axes = [_axis(n, *values) for n, values in zip(shape, sides, strict=True)]
        lift = _LIFT if min(shape) > 1 and all(map(all, sides)) else np.float32(1.0)
        depth = max(map(len, axes))
        levels = [[axis[min(k, len(axis) - 1)] for axis in axes] for k in range(depth)]
        # each (4, n) table of an axis has a column a node
        ends = np.cumsum([_ARRAYS * math.prod(a[0].shape[1] for a in level) for level in levels])
        if room is None or len(room) < ends[-1]:
            room = np.zeros(int(_SPARE * ends[-1]), np.float32)
        self.room = room
        parts = np.split(room[: ends[-1]], ends[:-1])
        self.levels = [_Level(level, team, p, lift) for level, p in zip(levels, parts, strict=True)]
        self._pairs = list(pairwise(self.levels))
        if varied is not None:
            self._vary(_single(varied))

    def _vary(self, varied: Float32Array) -> None:
        """Give all levels the coefficients at their faces."""
        self.levels[0].weights = _triple(face_means(varied, axis) for axis in range(3))
        for fine, coarse in self._pairs:
            finer, varied = varied, np.empty(coarse.shape, np.float32)
            fine.average(finer, varied)
            coarse.weights = _triple(face_means(varied, axis) for axis in range(3))

    def set_rate(self) -> None:
        """Bring the rates of all levels up to date with those of the finest, ``rate``."""
        for fine, coarse in self._pairs:
            fine.invert_diagonal()
            fine.average(fine.rate, coarse.rate)

    def cycle(self, *, onward: bool = False, products: bool = False) -> Float32Array:
        """Solve A x = b approximately on the finest level; the result lives until the next call.

        - ``onward``: improve the last result, of which the next level has what it leaves over
        - ``products``: of the result with ``b`` and with ``work[2]``, to ``parts``
        """
        finest = self.levels[0]
        for level, coarse in self._pairs[int(onward) :]:
            level.average(level.b, coarse.b)
        self.levels[-1].solve()
        for level, coarse in reversed(self._pairs):
            first = level is finest
            start = level.x if onward and first else level.x[:0]
            level.correct(coarse, start, level.parts if products and first else level.parts[:, :0])
        if not self._pairs:
            for part, other in zip(finest.parts, (finest.b, finest.work[2]), strict=True):
                np.sum(finest.x * other, axis=(1, 2), out=part)
        return finest.x

    def iterate(self, goal: float, most: int) -> tuple[int, bool]:
        """Take cycles until a part ``goal`` of ``b``, whose norm is one, is left over.

        Return their number, and whether none was slow before rounding was all that is left.
        """
        left = 1.0
        for count in range(1, most):
            self.cycle(onward=count > 1)
            before, left = left, self.levels[0].leave(self.levels[1])
            if left <= goal or left > _SLOW * before:
                return count, left <= max(goal, _POOR)
            if 2.0 * left**2 <= goal * before:  # the next one will do; nobody need look
                self.cycle(onward=True)
                return count + 1, True
        return most, False


@final
class MultigridSolver:
    """V-cycles, or conjugate gradients preconditioned by them, with the arrays they work in.

    - ``operator``: diffusion with its conditions, whose ``room`` it works in
    - ``team``: see :class:`Hierarchy`

    - ``newton``, ``cg``, int: systems solved and iterations, of cycles as of conjugate gradients
    """

    def __init__(self, operator: Diffusion, team: Team) -> None:
        self.operator = operator
        self.newton = self.cg = 0
        # rows along the last axis are what is fast: a plane is turned so that it has some
        self._flat = operator.shape[2] == 1
        shape, ghost = operator.shape, operator.ghost
        if self._flat:
            shape, ghost = (1, *operator.shape[:2]), np.roll(operator.ghost, 2)
        varied = None if operator.varied is None else self._turned(operator.varied)
        self._hierarchy = Hierarchy(shape, ghost, team, varied, operator.room)
        operator.room = self._hierarchy.room
        self._finest = self._hierarchy.levels[0]
        self._x, self._p, self._q = self._finest.work
        self._fast = len(self._hierarchy.levels) > 1
        self._r = self._finest.b

    def solve(self, rate: Floats, residual: Floats, size: float, goal: float) -> Floats:
        """Solve (-D L0 + rate) x = residual to ``goal``, a share of ``size``, the residual's norm.

        To :data:`FINEST` at best, in the precision of ``residual``. The result lives until the next
        solve.
        """
        self._begin(rate, residual, size)
        goal = max(goal, FINEST)
        if self._fast:
            count, self._fast = self._hierarchy.iterate(goal, MAX_CG)
            self.cg += count
        x = self._finest.x if self._fast else self._conjugate(goal)
        self.newton += 1
        shape, scale = self.operator.shape, size / self.operator.stiffness
        if residual.dtype == np.float64:  # nor has a correction that is far below one
            return np.asarray(x.reshape(shape), dtype=np.float64) * scale
        x *= np.float32(scale)
        return x.reshape(shape)

    def _conjugate(self, goal: float) -> Float32Array:
        """Solve the system by conjugate gradients."""
        x, r, p, q = self._x, self._r, self._p, self._q
        x[...], p[...] = 0.0, 0.0
        level, parts = self._finest, np.empty(len(r))
        z = self._hierarchy.cycle(products=True)
        rho = float(level.parts[0].sum())
        beta = 0.0
        for _ in range(MAX_CG):
            way = p, z, np.float32(beta), level.rate, level.along, level.weights
            level.share(kernels.apply_direction, *way, level.spare, q, parts)
            p, level.spare = level.spare, p  # the cycle's solution is elsewhere
            curvature = float(parts.sum())
            # single precision has no smaller numbers, or the cycle is none that CG can use
            if not (curvature > 0.0 and rho > 0.0):
                break
            alpha = rho / curvature
            level.share_light(kernels.update_residual_planes, np.float32(alpha), x, p, r, q, parts)
            self.cg += 1
            if not float(parts.sum()) > goal**2:
                break
            z = self._hierarchy.cycle(products=True)
            following, change = level.parts.sum(axis=1).tolist()
            beta, rho = -alpha * change / rho, following
        self._p = p
        return x

    def _begin(self, rate: Floats, residual: Floats, size: float) -> None:
        """Take a system, divided by D/h² and by the size of its right-hand side."""
        self._finest.share_light(
            kernels.load,
            self._turned(rate),
            self.operator.stiffness,
            self._turned(residual),
            size,
            self._finest.rate,
            self._r,
        )
        self._hierarchy.set_rate()

    def _turned(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values with the third axis of a plane in front."""
        return np.ascontiguousarray(np.moveaxis(values, 2, 0)) if self._flat else values


@lru_cache(maxsize=64)
def _axis(n: int, low: bool, high: bool) -> tuple[_Axis, ...]:
    """Return the data of all levels along an axis, from ``n`` nodes of width one to one node.

    That is its :func:`_along`, the nodes' widths over those of the ones of the next level that they
    lie in, (n,), and :func:`_between`.

    ``low`` and ``high`` state whether a face at its ends has a value; others let nothing through. A
    grid that follows the cells asks for it again.
    """
    width, found = np.ones(n), []
    while True:
        coarser = np.add.reduceat(width, np.arange(0, len(width), 2))
        share = _single(width / np.repeat(coarser, 2)[: len(width)])
        found.append((_along(width, low, high), share, _between(width, coarser, low, high)))
        if len(width) == 1:
            return tuple(found)
        width = coarser


def _along(width: FloatArray, low: bool, high: bool) -> Float32Array:
    """Return the coefficients of minus the second difference along an axis, (4, n).

    Of the lower and of the upper neighbour, and of the node by its lower and by its upper face.
    ``width`` (n,) are the nodes' widths.
    """
    table = np.zeros((4, len(width)))
    distance = 0.5 * (width[1:] + width[:-1])
    table[0, 1:], table[1, :-1] = 1.0 / distance, 1.0 / distance
    table[2:] = table[:2]
    table[2, 0] = 1.0 / (0.5 * width[0]) if low else 0.0
    table[3, -1] = 1.0 / (0.5 * width[-1]) if high else 0.0
    return _single(table / width)


def _between(width: FloatArray, coarser: FloatArray, low: bool, high: bool) -> Float32Array:
    """Return the weights of the two coarse nodes that each node lies between, (2, n).

    Between the last coarse node and a face the correction is taken as constant, or falls to zero
    where that has a value.
    """
    middle, coarse = np.cumsum(width) - 0.5 * width, np.cumsum(coarser) - 0.5 * coarser
    parent = np.arange(len(width)) // 2
    away = middle - coarse[parent]
    other = np.clip(parent + np.sign(away).astype(np.int64), 0, len(coarse) - 1)
    inner = other != parent
    distance = np.where(inner, coarse[other] - coarse[parent], 0.5 * coarser[parent])
    part = np.abs(away / distance)
    ends = np.where(away < 0.0, low, high)  # a node in the middle of its coarse one has none
    return _single(np.array([1.0 - part * (inner | ends), part * inner]))


def _single(values: FloatArray) -> Float32Array:
    return np.ascontiguousarray(values, dtype=np.float32)


def _triple(values: Iterable[Any]) -> Triple:
    x, y, z = values
    return (x, y, z)
