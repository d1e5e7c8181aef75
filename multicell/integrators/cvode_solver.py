"""CVODE sessions with a Krylov method, and the callbacks that they need.

scikit-sundae hands every callback read-only views of the solver's memory, and counts only
part of the evaluations; the counts that are reported are those of :class:`Mechanics`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, final

import numpy as np
from sksundae.cvode import CVODE, CVODEJacTimes, CVODEPrecond

from multicell.cells import FloatArray
from multicell.compiling import KERNEL, typed
from multicell.integrators.limits import PACKED_CONTACTS
from multicell.integrators.restarts import (
    IntegrationProgress,
    Predictor,
    Restart,
    StepImpossible,
    Taken,
    one_step,
)
from multicell.mechanics.jacobian import limited
from multicell.mechanics.motion import StateRejected
from multicell.mechanics.rows import SOFTENING

if TYPE_CHECKING:
    from multicell.integrators.cvode import Cvode

_jit = typed(**KERNEL)

_MAX_ORDER = {"BDF": 5, "Adams": 12}
_NEWTON, _KRYLOV = 3, 8  # most Newton iterations in a step, dimension of the Krylov space
_FAR = 0.003
"""Change of a coordinate from which on J is taken anew, in mean radii (further where the step is
mild): SUNDIALS itself asks for it much too seldom (docs/theory/integrators.md)."""
_SLOW_START = 5e-4
"""Share of the interval below which the first two steps of a mild start say that it is stiff."""
_BUSY, _WINDOW = 6, 3
"""Evaluations a step, over how many last steps, above which a mild start has become stiff."""
_LIGHT_KRYLOV = 5  # SUNDIALS' own dimension of Krylov spaces
_FIRST = 1e-6
"""First step of a mild start over the interval. CVODE's own is about as long, and it takes two
evaluations to find it; the second one may be ten thousand times longer."""
_INCREMENT = 1e-5  # largest change of a coordinate in a difference quotient, in mean radii
_MILD, _STIFF = 3.0, 10.0
"""Products γλ up to which there is no preconditioning, and beyond which J is kept fresh."""


@_jit
def _displace(y: FloatArray, v: FloatArray, largest: float, out: FloatArray) -> float:
    """Write ``y + share v`` to ``out``; return the share, 0 where ``v`` is zero."""
    most = 0.0
    for n in range(v.size):
        most = max(most, abs(v[n]))
    share = largest / most if most > 0.0 else 0.0
    for n in range(v.size):
        out[n] = y[n] + share * v[n]
    return share


@_jit
def _divide(out: FloatArray, before: FloatArray, share: float) -> None:
    """Make a difference quotient of the value after a change by ``share``."""
    for n in range(out.size):
        out[n] = (out[n] - before[n]) / share


class _Session:
    """CVODE between two restarts, begun at the last accepted state; abstract."""

    def __init__(self, method: Cvode, run: IntegrationProgress, **options: Any) -> None:
        self.run, self.method = run, method
        self._predictor = Predictor(run)
        self.solver = CVODE(
            self._predictor.velocity,
            method=method.formula,
            rtol=run.share * method.rtol,
            atol=run.share * method.atol,
            max_order=_MAX_ORDER[method.formula],
            max_nonlin_iters=_NEWTON,
            linsolver="gmres",
            **options,
        )
        self.solver.init_step(0.0, run.position.ravel())

    def close(self) -> None:
        """Let go of CVODE, whose callbacks hold this object."""
        del self.solver


@final
class UnpreconditionedCvode(_Session):
    """CVODE as it comes: products by difference quotients, each of which is an evaluation."""

    def __init__(self, method: Cvode, run: IntegrationProgress) -> None:
        self._counts = [run.system.work.evaluations]
        self._others = 0
        self._small = _INCREMENT * float(run.system.motion.radius.mean())
        self._moved = np.empty(3 * len(run.position))
        self._probed: list[Taken] = []
        super().__init__(
            method,
            run,
            krylov_dim=_LIGHT_KRYLOV,
            first_step=_FIRST * run.left,
            jactimes=CVODEJacTimes(None, self.product),
        )

    def take_step(self) -> Taken:
        """Take one step; ask for the full method where the last ones took many evaluations."""
        if self._probed:
            return self._probed.pop(0)
        counts = self._counts
        if len(counts) > _WINDOW and counts[-1] - counts[-1 - _WINDOW] > _BUSY * _WINDOW:
            raise Restart
        return self._advance()

    def begins_slowly(self) -> bool:
        """Return whether the first two steps, which are kept for later, say that it is stiff.

        Error control chooses them. Where they are a tiny part of the interval, so many will
        follow that the full method pays as soon as they lengthen.
        """
        try:
            while len(self._probed) < 2 and (
                not self._probed or self._probed[-1].time < self.run.left
            ):
                self._probed.append(self._advance())
        except (StateRejected, StepImpossible):
            # the full method meets the same state and can recover from it
            return True
        return self._probed[-1].time < _SLOW_START * self.run.length

    def product(
        self, t: float, y: FloatArray, yp: FloatArray, v: FloatArray, jv: FloatArray
    ) -> None:
        """Jacobian times vector by a difference quotient.

        SUNDIALS's own moves cells by about the tolerance: by as much as a contact reaches where
        that is loose, and the steps then end in another equilibrium.
        """
        share = _displace(y, v, self._small, self._moved)
        if share == 0.0:
            jv[:] = 0.0
            return
        self.run.velocity(t, self._moved, jv)
        _divide(jv, yp, share)

    def _advance(self) -> Taken:
        result = one_step(self.solver, self.run.left)
        self._count(result.nfev)
        return self._predictor.taken(result.t, result.y)

    def _count(self, direct: int) -> None:
        """Count the iterations of a step: SUNDIALS reports the evaluations that are no products.

        There is one in each Newton iteration. The first step has some more, to find its length;
        it is so short that Newton's method needs one iteration.
        """
        work = self.run.system.work
        others, self._others = direct - self._others, direct
        work.newton_iterations += others if len(self._counts) > 1 else 1
        work.linear_iterations += work.evaluations - self._counts[-1] - others
        self._counts.append(work.evaluations)


@final
class Krylov(_Session):
    """CVODE with our products and preconditioners, and the callbacks that it needs."""

    def __init__(self, method: Cvode, run: IntegrationProgress, ceiling: float) -> None:
        self.system = run.system
        self._fresh, self._stale = False, True
        self._reference = np.full(3 * len(run.position), np.inf)
        # as long as γ is unknown J is renewed as often as for stiff steps
        self._gamma, self._rate = np.inf, 1.0
        self._used, self._reached = np.inf, 0.0
        self._far = _FAR * float(run.system.motion.radius.mean())
        super().__init__(
            method,
            run,
            krylov_dim=_KRYLOV,
            max_step=ceiling,
            jactimes=CVODEJacTimes(self.linearise, self.product),
            # on the right the Krylov method measures the true residual
            precond=CVODEPrecond(self.setup, self.solve, side="right"),
        )

    def take_step(self) -> Taken:
        """Take one step."""
        result = one_step(self.solver, self.run.left)
        dt, self._reached = float(result.t) - self._reached, float(result.t)
        return self._predictor.taken(result.t, result.y, self._order(dt))

    def _order(self, dt: float) -> int:
        """Return the order of a step of BDF, by its γ: h/γ = 1 + 1/2 + ... + 1/q."""
        if self.method.formula != "BDF" or not self._used < np.inf:
            return 1
        sums = np.cumsum(1.0 / np.arange(1, _MAX_ORDER["BDF"] + 1))
        return 1 + int(np.abs(sums - dt / self._used).argmin())

    def linearise(self, t: float, y: FloatArray, yp: FloatArray) -> None:
        """Get ready for products before a linear solve."""
        self.system.work.newton_iterations += 1
        if self._fresh:
            self._fresh = False
        elif self._moved(y):
            self._take_jacobian(t, y)

    def _take_jacobian(self, t: float, y: FloatArray) -> None:
        self.system.linearise(self.run.clock(t), y.reshape(-1, 3))
        self._linear, stiffest = limited(self.system, SOFTENING)
        self._reference = np.array(y)
        drag = self.system.drag * float(self.system.motion.radius.mean())
        self._rate = PACKED_CONTACTS * stiffest / drag

    def _moved(self, y: FloatArray) -> bool:
        """Return whether some cell has moved too far for the last Jacobian.

        Newton's method with an old J converges like γ times its error: the milder the step,
        the further cells may have moved.
        """
        far = self._far * max(1.0, _STIFF / max(self._gamma * self._rate, 1e-9))
        return not np.abs(y - self._reference).max() <= far

    def product(
        self, t: float, y: FloatArray, yp: FloatArray, v: FloatArray, jv: FloatArray
    ) -> None:
        """Jacobian times vector."""
        self.system.work.linear_iterations += 1
        self.system.jacobian_product(v.reshape(-1, 3), jv.reshape(-1, 3), self._linear)

    def setup(
        self, t: float, y: FloatArray, yp: FloatArray, jok: int, jnew: list[int], gamma: float
    ) -> None:
        """Preconditioner for a new γ."""
        self._gamma = gamma
        if not jok or self._moved(y):
            self._take_jacobian(t, y)
            self._fresh = True
            jnew[0] = 1
        self._stale = True

    def solve(
        self,
        t: float,
        y: FloatArray,
        yp: FloatArray,
        r: FloatArray,
        z: FloatArray,
        gamma: float,
        delta: float,
        lr: int,
    ) -> None:
        """Apply the preconditioner; where the step is mild it would cost more than it saves."""
        self._used = gamma
        if gamma * self._rate < _MILD:
            z[:] = r
            return
        if self._stale:
            self.system.setup_preconditioner(gamma, self._linear)
            self._stale = False
        self.system.precondition(r.reshape(-1, 3), z.reshape(-1, 3))
