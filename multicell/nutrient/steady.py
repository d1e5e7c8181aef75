"""Quasi-steady diffusion with Michaelis-Menten uptake, by Newton and conjugate gradients.

On the nodes of a cell-centred grid, with the Laplacian L (seven points, the conditions on the faces
entering through ghost values: py-pde's, by a test), the steady state solves

    F(c) = -D L c + m c + q c / (K + c) - s = 0

with the largest uptake per volume q >= 0 and a supply s >= 0 at each node, and a rate m >= 0:
decay, exchange with a flow, and the 1/dt of an implicit step in time. Where the layer of medium
round a tissue ends (:mod:`multicell.nutrient.layer`) m is larger, from node to node, and s too.

**No concentration is negative.** -D L is an M-matrix (for values
and slopes that supply alike), uptake is diagonal and vanishes with c: the solution satisfies
(-D L0 + m + q / (K + c)) c = s + boundary terms >= 0 with an inverse that has no negative entry.
Where the exact value is far below the solver's tolerance (the depth of a starved core, a hundred
decay lengths from a source) and a node is left at about -1e-13 times the medium's value,
Gauss-Seidel sweeps over such nodes alone bring each to its own balance. Their equations are an
M-matrix with a positive right-hand side too, so the sweeps end above zero. Signs are judged by what
the accepted imbalance may make of a concentration (:meth:`_State.uncertainty`: rounding, for a
field without uptake): a node that is below zero by no more is empty, and the sweeps begin with it
at zero; others keep their values, and where the sweeps leave one below zero the solve fails.

**Newton converges from any start.** With the law continued below zero along its tangent (there the
solution never is) F is the gradient of a strictly convex energy, so a line search on its slope is
safe whatever the linear solver leaves over. F is concave too, and its Jacobian an M-matrix: once
below the solution, exact steps rise monotonically to it (Ortega & Rheinboldt 1970, theorem 13.3.4),
and the search accepts them in full.

**The linear systems** (-D L0 + d) x = r, with d = m + q K / (K + c)^2, go to conjugate gradients
with the preconditioner S (-D L0 + d0)^-1 S: sine and cosine transforms invert the middle exactly,
and the diagonal S = (w + d h^2 / 2 D)^-1/2 takes care of nodes where uptake is faster than
diffusion, and of a coefficient w D that differs from place to place. On :data:`MULTIGRID_NODES`
nodes and more, and where a layer of medium ends inside of the grid, which transforms know nothing
of, V-cycles of multigrid take their place (:mod:`multicell.nutrient.multigrid`).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, final

import numpy as np

from multicell.cells import FloatArray
from multicell.compiling.threads import Team
from multicell.errors import NutrientFailed
from multicell.nutrient import stencil

if TYPE_CHECKING:
    from multicell.nutrient.dense import Inverse
    from multicell.nutrient.diffusion import Diffusion
    from multicell.nutrient.multigrid import MultigridSolver

    Solver: TypeAlias = "_Linear | _Few | MultigridSolver"

BALANCE_TOLERANCE = 1e-9
"""Bound on the sum of all nodes' imbalances, relative to the total uptake."""

ENOUGH = 1e-5
"""The same bound on many nodes for a field of a run, which is not to be more exact than its grid.

A field solved to it was off by 1e-7 of the medium's value, a ten-thousandth of what the spacing
made. What the balance still lacks is taken out by a factor on all concentrations
(:meth:`_State.close`).
"""

ROUGH = 1e-3
"""The same bound for intermediate solutions with a larger half saturation."""

MAX_NEWTON = 20  # twice what a start far from the solution takes; then K is lowered step by step
FORCING = 0.03
"""Largest part of the imbalance that the linear solver may leave over."""

NEAR_FORCING = 1e-3
"""The same for the first step from the last solution: there the law is nearly linear, and a good
solution saves a Newton step."""

MAX_BACKTRACKS = 30  # halvings of a Newton step: below 10^-9 of it nothing is left to gain

MAX_SWEEPS = 1000  # over the nodes below zero; one to three are usual

MULTIGRID_NODES = 50_000
"""Nodes from which on multigrid takes the place of transforms; see :mod:`.multigrid`."""

MAX_SINGLE = 1e5
"""Largest rate of uptake over D/h² at which multigrid, in single precision, is sure to help."""

UPTAKE_SHIFT = 1.0
"""The preconditioner's uniform uptake, relative to the mean of the linearised uptake."""


_Law = tuple[Any, Any, float, float, float, Any, Any, Any, float]
"""Sinks, sources and coefficients, as the loops of :mod:`.stencil` take them."""


class StepRefused(Exception):  # noqa: N818 - a shorter step may do
    """A step in time whose equations were not solved."""


@final
class SolveReport(NamedTuple):
    """Report of a solve: its work and its imbalance.

    - ``newton``, ``cg``, int: Newton steps and, over all of them, conjugate-gradient steps
    - ``residual``, float, amol/s: sum of all nodes' absolute imbalances. It bounds the difference
      of inflow and uptake.
    - ``inflow``, float, amol/s: net diffusion through the faces of the box
    - ``uptake``, float, amol/s: total uptake
    - ``outflow``, float, amol/s: what leaves through the faces; ``inflow`` is net
    - ``made``, ``used``, float, amol/s: gain and loss by reactions at each place
    """

    newton: int
    cg: int
    residual: float
    inflow: float
    uptake: float
    outflow: float = 0.0
    made: float = 0.0
    used: float = 0.0


def solve_steady(
    operator: Diffusion,
    sink: FloatArray,
    half_saturation: float,
    start: FloatArray,
    *,
    linear: float = 0.0,
    supply: FloatArray | None = None,
    tolerance: float = BALANCE_TOLERANCE,
) -> tuple[FloatArray, SolveReport]:
    """Solve for the steady concentration.

    - ``sink``, (nx, ny, nz), mM/s: largest uptake per volume at each node, not negative
    - ``start``, (nx, ny, nz), mM: first guess; any finite values do
    - ``linear``, float, 1/s: rate m of all that goes in proportion to c, not negative
    - ``supply``, (nx, ny, nz), mM/s, optional: what the nodes gain besides diffusion, not negative
    - ``tolerance``: on :data:`MULTIGRID_NODES` and more, see :data:`BALANCE_TOLERANCE`
    """
    nodes = math.prod(operator.shape)
    few = nodes < MULTIGRID_NODES
    # the levels of multigrid have ends: where space repeats transforms serve at any size
    repeats = None in operator.kinds
    if few or repeats:
        problem = _Problem(operator, sink, half_saturation, linear, supply, None)
        if operator.exchange is None or repeats:
            return _solve(problem, start, _solver(operator))
        quickest = float(sink.max(initial=0.0)) / (half_saturation * operator.stiffness)
        if quickest > MAX_SINGLE:
            return _solve(problem, start, _solver(operator))
    from multicell.nutrient.multigrid import MultigridSolver

    try:
        if few:  # with imbalances in double precision, which have no least size to speak of
            return _solve(problem, start, MultigridSolver(operator, Team()))
        with Team(max(1, min(operator.threads, nodes // stencil.PART))) as team:
            problem = _Problem(operator, sink, half_saturation, linear, supply, team, tolerance)
            return _solve(problem, start, MultigridSolver(operator, team))
    except NutrientFailed:
        # what single precision loses of small rates between walls transforms have
        problem = _Problem(operator, sink, half_saturation, linear, supply, None)
        return _solve(problem, start, _solver(operator))


def _solver(operator: Diffusion) -> Solver:
    return _Linear(operator) if operator.dense is None else _Few(operator.dense)


def _solve(problem: _Problem, start: FloatArray, solver: Solver) -> tuple[FloatArray, SolveReport]:
    """Solve, first as it is and then, where that fails, over larger half saturations."""
    if not np.count_nonzero(problem.source):
        # nothing comes in: what iterations from elsewhere would leave is rounding, of either sign
        start = np.zeros_like(start, dtype=np.float64)
    first = np.array(start, dtype=np.float64, order="C")
    problem.balance_ends(first)
    state, done = _newton(problem, first, problem.tolerance, solver)
    if not done and np.isfinite(state.size):
        state, done = _descend(problem, start, solver)
    if done and not state.lift():
        raise NutrientFailed(
            f"the steady nutrient field is below zero at some nodes after {MAX_SWEEPS} sweeps",
            "Check uptake, diffusion and half_saturation of the nutrient for sensible values",
        )
    if not done:
        raise NutrientFailed(
            f"the steady nutrient field did not converge: after {solver.newton} Newton steps the "
            f"imbalance is {state.size:.3g} mM/s, "
            f"wanted {state.target(problem.tolerance):.3g} mM/s",
            "Check uptake, diffusion and half_saturation of the nutrient for sensible values",
        )
    if problem.tolerance > BALANCE_TOLERANCE:
        state.close()
    return state.c, state.report(solver)


def _newton(
    problem: _Problem, c: FloatArray, tolerance: float, linear: Solver
) -> tuple[_State, bool]:
    """Iterate from ``c``; return the last state and whether it is within the tolerance."""
    if isinstance(linear, _Few):
        return linear.solve(problem, c, tolerance)
    state = _State(problem, c)
    # far from the solution imbalances are larger than the uptake
    near = state.size * math.sqrt(state.c.size) < state.total
    trial, forcing = None, NEAR_FORCING if near else FORCING
    for _ in range(MAX_NEWTON):
        target = state.target(tolerance)
        if state.size <= target or not math.isfinite(state.size):
            return state, state.size <= target
        trial = trial or state.empty_copy()
        # what single precision leaves over is known less well, and each step costs more
        part = 0.3 if problem.team is None else 0.8
        goal = max(forcing, part * target / state.size)
        correction = linear.solve(state.rate, state.residual, state.size, goal)
        if not _search(state, trial, correction):
            return state, False
        forcing = min(FORCING, (trial.size / state.size) ** 2)
        state, trial = trial, state
    return state, state.size <= state.target(tolerance)


def _descend(problem: _Problem, start: FloatArray, linear: Solver) -> tuple[_State, bool]:
    """Solve with a large constant K first and then with ever smaller ones.

    Uptake that saturates at K far below the medium's value is close to a free-boundary problem:
    from far away Newton would move the edge of the starved core by a node a step.
    """
    c = np.array(start, dtype=np.float64)
    half = float(np.max(np.abs(problem.source))) / problem.operator.stiffness
    while half > 2.0 * problem.half:
        state, _ = _newton(replace(problem, half=half), c, ROUGH, linear)
        c, half = state.c, half / 4.0
    return _newton(problem, c, problem.tolerance, linear)


@final
@dataclass
class _Problem:
    """The equations that are solved; see the module's text."""

    operator: Diffusion
    sink: FloatArray
    half: float
    linear: float
    supply: FloatArray | None
    team: Team | None  # that shares the loops over MANY nodes; sums are then those of planes
    tolerance: float = BALANCE_TOLERANCE

    def __post_init__(self) -> None:
        faces = self.operator.brought()
        self.source = faces if self.supply is None else faces + self.supply
        self.sink, self.source = map(np.ascontiguousarray, (self.sink, self.source))
        op = self.operator
        own = self.sink, self.source, self.half, op.stiffness, self.linear
        self.law: _Law = *own, op.ghost, op.weights, op.exchange, op.level
        most = 1.0 if op.varied is None else float(op.varied.max())
        # a sixth of the largest rate of a node, 1/s, but for the uptake's
        quick = op.stiffness * max(most, 1.0) + self.linear / 6.0 + op.largest_exchange / 6.0
        if math.prod(op.shape) == 1:  # all of its sides are faces: twice the rate
            quick *= 2.0
        # error of the imbalance over the norm of a concentration
        self.rounding = 8.0 * sys.float_info.epsilon * quick

    def balance_ends(self, c: FloatArray) -> None:
        """Improve a guess where a layer of medium ends; see :func:`.stencil.balance_ends`."""
        op = self.operator
        if op.exchange is None:
            return
        given = c, *self.law, op.largest_exchange
        stencil.balance_ends(*given)


@final
class _State:
    """A concentration with its imbalance, the derivative of uptake, and their norms.

    - ``evaluate``: else somebody else brings all up to date
    """

    least: float | None = None  # of the concentrations, and sums of the balance, where known
    sums: Sequence[tuple[float, float]] | None = None

    def __init__(self, problem: _Problem, c: FloatArray, *, evaluate: bool = True) -> None:
        self.problem, self.c = problem, c
        # what the multigrid solver takes on is in single precision
        kind = np.float64 if problem.team is None else np.float32
        self.residual: stencil.Floats = np.empty(c.shape, kind)
        self.rate: stencil.Floats = np.empty(c.shape, kind)
        if evaluate:
            self.evaluate()

    def evaluate(self) -> None:
        """Bring all up to date with ``c``."""
        self.sums = None
        law, team = self.problem.law, self.problem.team
        self.take(stencil.write_imbalance(self.c, *law, self.residual, self.rate, team))

    def move(self, c: FloatArray, correction: stencil.Floats, share: float) -> float:
        """Become ``c`` and a share of a correction; return the imbalance's product with that."""
        team = self.problem.team
        if team is None:
            np.multiply(np.asarray(correction, dtype=np.float64), share, out=self.c)
            self.c += c
            self.evaluate()
            return self.along(correction)
        from multicell.nutrient.multigrid_kernels import move_planes

        own, parts = (self.c, self.residual, self.rate), np.empty((5, len(c)))
        team.share(move_planes, len(c), c, correction, share, self.problem.law, *own, parts)
        self.sums = None
        self.take(parts.sum(axis=1).tolist())
        return self.along(correction)

    def take(self, sums: Sequence[float]) -> None:
        """Take the sums of :func:`.stencil.write_imbalance`."""
        squares, self.total, size, self.net, self.change = sums
        self.size, self.norm = math.sqrt(squares), math.sqrt(size)

    def along(self, correction: stencil.Floats) -> float:
        """Return the product of the imbalance and a correction."""
        if self.problem.team is None:
            return stencil.flat_dot(self.residual.ravel(), correction.ravel())
        from multicell.nutrient.multigrid_kernels import dot_planes

        parts, light = np.empty(len(self.c)), stencil.teams(self.problem.team, self.c.size)[1]
        light.share(dot_planes, len(self.c), self.residual, correction, parts)
        return float(parts.sum())

    def lift(self) -> bool:
        """Bring nodes left below zero to their own balance; return whether none is left."""
        if not (self.c.min(initial=0.0) if self.least is None else self.least) < 0.0:
            return True
        left = stencil.balance_negative(self.c, *self.problem.law, self.uncertainty(), MAX_SWEEPS)
        self.evaluate()
        return bool(left == 0)

    def target(self, tolerance: float) -> float:
        """Return the norm of the imbalance in mM/s at which the solution is accepted.

        By Cauchy's inequality the absolute imbalances then sum to at most ``tolerance`` times the
        uptake; where that is not the finest one, also to no more than a change of all
        concentrations by that part makes of them. Below the rounding error of the imbalance itself
        nothing can be asked.
        """
        total = self.total
        if self.problem.tolerance > BALANCE_TOLERANCE:
            total = min(total, self.change)
        return max(tolerance * total / math.sqrt(self.c.size), self.problem.rounding * self.norm)

    def uncertainty(self) -> float:
        """Return the largest error of a concentration, mM, that the accepted imbalance allows.

        By the maximum principle it is the imbalance times the longest time in which a node is
        emptied: by decay, or by diffusion from one end of the longest axis to the other.
        """
        op = self.problem.operator
        crossing = 0.5 * max(op.shape) ** 2 / op.stiffness
        slowest = min(crossing, 1.0 / self.problem.linear) if self.problem.linear else crossing
        return self.target(self.problem.tolerance) * slowest

    def close(self) -> None:
        """Balance the sum over all nodes by a factor on the concentrations.

        What is left is of the second order in it.
        """
        if self.change > 0.0:
            self.c *= 1.0 + self.net / self.change

    def empty_copy(self) -> _State:
        """Return the same problem at another concentration, not filled yet.

        It overwrites imbalance and derivative: nobody asks for those of two states at a time.
        """
        other = object.__new__(_State)
        vars(other).update(vars(self), c=np.empty_like(self.c))
        return other

    def report(self, linear: Solver) -> SolveReport:
        """Return the balance."""
        problem, op = self.problem, self.problem.operator
        amounts, flows = self.sums or (None, None)
        if amounts is None:
            amounts = stencil.account(self.c, problem.sink, problem.half, self.residual)
        (left, taken), (inward, outward) = amounts, op.flows(self.c, flows)
        v = op.volumes
        return SolveReport(linear.newton, linear.cg, v * left, inward - outward, v * taken, outward)


def _search(state: _State, trial: _State, correction: stencil.Floats) -> bool:
    """Set ``trial`` to a point along the correction where the convex energy is lower.

    F is the gradient of a convex energy, and the correction of a conjugate-gradient solve points
    downhill unless rounding is all that it has; returns whether it does. The slope along it may at
    most turn round to nine tenths; it does at the first step into a starved core, where the tangent
    of the saturated law is far from the law.
    """
    slope = state.along(correction)
    if not slope > 0.0:
        return False
    share = 1.0
    for _ in range(MAX_BACKTRACKS):
        there = trial.move(state.c, correction, share)
        if not there < -0.9 * slope:
            break
        share *= max(slope / (slope - there), 0.25)
    return True


@final
class _Few:
    """Newton's method on few nodes, in one compiled call."""

    def __init__(self, inverse: Inverse) -> None:
        self._inverse, self.newton, self.cg = inverse, 0, 0

    def solve(self, problem: _Problem, c: FloatArray, tolerance: float) -> tuple[_State, bool]:
        """Do what :func:`_newton` does."""
        state, op = _State(problem, c, evaluate=False), problem.operator
        given = c, state.residual, state.rate, op.const, op.varied, tolerance, problem.rounding
        done, newton, cg, sums, state.least, *state.sums = self._inverse.newton(
            *given, *_SETTINGS, *problem.law
        )
        self.newton, self.cg = self.newton + newton, self.cg + cg
        state.take(sums)
        return state, done


_SETTINGS = FORCING, NEAR_FORCING, MAX_NEWTON, MAX_BACKTRACKS, UPTAKE_SHIFT


@final
class _Linear:
    """Preconditioned conjugate gradients, with the arrays that they work in."""

    def __init__(self, operator: Diffusion) -> None:
        self.operator = operator
        self.newton = self.cg = 0

    def solve(
        self, rate: stencil.Floats, residual: stencil.Floats, size: float, goal: float
    ) -> stencil.Floats:
        """Solve (-D L0 + rate) x = residual to ``goal``, a share of ``size``, the residual's norm.

        The preconditioner works in single precision: that is exact enough for a search direction
        and takes half the time. The result lives until the next solve.
        """
        op, shape = self.operator, self.operator.shape
        if self.newton == 0:  # a field that is solved already needs no arrays
            self._work = np.empty((5, math.prod(shape)))
            self._single = np.empty(shape, dtype=np.float32)
        x, r, p, q, scale = self._work
        varied = None if op.varied is None else op.varied.ravel()
        total = stencil.begin(
            rate.ravel(),
            residual.ravel(),
            varied,
            0.5 / op.stiffness,
            size,
            x,
            r,
            p,
            scale,
            self._single.ravel(),
        )
        shift = UPTAKE_SHIFT * total / rate.size
        u, rho = op.invert(self._single, shift)
        beta, direction, image = 0.0, p.reshape(shape), q.reshape(shape)
        for _ in range(stencil.MAX_CG):
            stencil.new_direction(p, u.ravel(), scale, beta)
            curvature = stencil.apply_operator(
                direction, rate, op.stiffness, op.ghost, op.weights, image
            )
            if not curvature > 0.0:  # single precision has no smaller numbers
                break
            left = stencil.update_residual(rho / curvature, x, p, r, q, scale, u.ravel())
            self.cg += 1
            if not left > goal**2:
                break
            u, following = op.invert(u, shift)
            beta, rho = following / rho, following
        x *= size
        self.newton += 1
        return x.reshape(shape)
