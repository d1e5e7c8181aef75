"""What is right: at rest and in time on one grid, and on ever finer ones.

On one grid transients come from SciPy's DOP853 with tight tolerances, and states at rest from
Newton steps of ours that SciPy's GMRES corrects with py-pde's own Laplacian; how far
``multicell-implicit`` ends from the one, and how much the last correction of the other was, is
what the reference leaves open. What a grid itself gets wrong is seen on finer ones, with the
extrapolation of second order between the two finest, by means over the nodes of the coarsest: cells
are points, round which concentrations fall without end as spacings do, but not their means. A start
that a quiet time has forgotten is not followed: there the reference begins with the state at rest.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

import numpy as np

from multicell.cells import FloatArray
from multicell.comparison.field_solvers.equations import (
    FieldEquation,
    Layout,
    coarse_means,
    node_count,
    refine,
)
from multicell.comparison.field_solvers.problems import STEADY, Case, case
from multicell.comparison.field_solvers.solvers import SOLVERS, Attempt
from multicell.errors import NutrientFailed

if TYPE_CHECKING:
    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene

_TIGHT, _SECOND = 1e-10, 1e-11
_SETTLED = 40.0  # slowest times after which nothing is left of a start
_CORRECTIONS = 3
_SPATIAL = 1e-6  # tolerance of transients on finer grids
MAX_NODES: Final = 300_000
"""Largest grid that the error of a coarser one is judged by, unless another is asked for."""


@final
@dataclass(frozen=True, eq=False)
class Exact:
    """The solution on one grid.

    Attributes
    ----------
    data : mM
        Of the state at the end.
    uncertainty
        Over the scale of the problem.
    words
        Where they come from.
    """

    data: FloatArray
    uncertainty: float
    words: str


def on_one_grid(problem: Case) -> Exact:
    """Return the solution of a problem on its own grid.

    Raises
    ------
    NutrientFailed
        If one of the two solvers fails.
    """
    if problem.kind == STEADY:
        return _at_rest(problem, problem.whole)
    from scipy.integrate import solve_ivp

    y, pieces = problem.start.ravel().copy(), problem.pieces
    if problem.quiet > _SETTLED * problem.slowest:
        y, pieces = _at_rest(problem, pieces[0].equation).data.ravel(), pieces[1:]
    for equation, begin, end in pieces:

        def rate(t: float, y: FloatArray, equation: FieldEquation = equation) -> FloatArray:
            return equation.rates(y.reshape(problem.start.shape), 0.0)[0].ravel()

        done = solve_ivp(
            rate, (begin, end), y, method="DOP853", rtol=_TIGHT, atol=_TIGHT * problem.scale,
            t_eval=[end],
        )  # fmt: skip
        if not done.success:
            raise NutrientFailed(f"SciPy's DOP853 failed: {done.message}", "Take a coarser grid")
        y = done.y[:, -1]
    data = y.reshape(problem.start.shape)
    second = _by_ours(problem, _SECOND)
    uncertainty = float(np.abs(second - data).max()) / problem.scale
    words = f"DOP853 at {_TIGHT:g}, beside multicell-implicit at {_SECOND:g}"
    return Exact(data, uncertainty, words)


def _by_ours(problem: Case, rtol: float) -> FloatArray:
    return Attempt(SOLVERS["multicell-implicit"], problem, rtol, "kernels", math.inf).solve()


def _at_rest(problem: Case, equation: FieldEquation) -> Exact:
    """Return the state at rest by Newton corrections on top of our own."""
    from scipy.sparse.linalg import LinearOperator, gmres

    shape = problem.start.shape
    data, _ = equation.steady_state(problem.start, 0.0)
    last = math.inf
    for _ in range(_CORRECTIONS):
        state = equation.state({problem.field: data})
        residual = equation.evolution_rate(state, 0.0).data.ravel()
        inverse = equation.shifted_inverse(data, 0.0)
        step = 1e-6 * problem.scale

        def minus_jacobian(v: FloatArray, data: FloatArray = data, step: float = step) -> Any:
            size = float(np.abs(v).max()) or 1.0
            e = (step / size) * v.reshape(shape)
            change = equation.rates(data - e, 0.0)[0] - equation.rates(data + e, 0.0)[0]
            return (size / (2.0 * step)) * change.ravel()

        n = data.size
        near: Any = LinearOperator(
            (n, n), matvec=lambda r, inverse=inverse: inverse(r.reshape(shape), 0.0).ravel()
        )
        operator: Any = LinearOperator((n, n), matvec=minus_jacobian)
        correction, _ = gmres(operator, residual, M=near, rtol=1e-4, restart=60, maxiter=5)
        last = float(np.abs(correction).max())
        data = data + correction.reshape(shape)
    words = "Newton's method, corrected by GMRES with py-pde's Laplacian"
    return Exact(data, last / problem.scale, words)


class GridError(NamedTuple):
    """What a grid itself gets wrong, over the scale of the problem; NaN where it is not known.

    ``uncertainty`` is what the extrapolation from the finest grids leaves open.
    """

    error: float
    uncertainty: float


def of_grids(
    scene: Scene,
    frame: Frame,
    field: str,
    kind: str,
    grids: Sequence[Layout],
    max_nodes: int = MAX_NODES,
) -> list[GridError]:
    """Return the error of each of some nested grids, from coarse to fine.

    Parameters
    ----------
    scene, frame, field, kind
        See :func:`multicell.comparison.field_solvers.problems.case`.
    grids
        See :func:`multicell.comparison.field_solvers.problems.grids`.
    max_nodes
        Nodes of the finest grid that is solved on for it.

    Raises
    ------
    NutrientFailed, SceneError
        If a problem cannot be posed or solved.
    """
    layouts = list(grids)
    while (
        node_count(finer := refine(layouts[-1], 2)) <= max_nodes and len(layouts) < len(grids) + 2
    ):
        layouts.append(finer)
    solved = [_solution(case(scene, frame, field, kind, layout)) for layout in layouts]
    scale = solved[-1][1]
    # all by means over the coarsest nodes: nearer to a cell there is no limit
    found = [coarse_means(values, layouts[k], 2**k) for k, (values, _) in enumerate(solved)]
    if len(found) == 1:
        return [GridError(math.nan, math.nan)]
    change = [float(np.abs(b - a).max()) / scale for a, b in itertools.pairwise(found)]
    limit = found[-1] + (found[-1] - found[-2]) / 3.0
    uncertainty = change[-1] / (2.0 ** _order(change) - 1.0)
    errors = [float(np.abs(values - limit).max()) / scale for values in found[: len(grids)]]
    return [GridError(error, uncertainty) for error in errors]


def _order(change: Sequence[float]) -> float:
    """Return the order at which grids converge as their last changes show it, 1 to 2."""
    if len(change) < 2 or not change[-1] > 0.0:
        return 1.0
    return min(2.0, max(1.0, math.log2(change[-2] / change[-1])))


def _solution(problem: Case) -> tuple[FloatArray, float]:
    if problem.kind == STEADY:
        return problem.whole.steady_state(problem.start, 0.0)[0], problem.scale
    return _by_ours(problem, _SPATIAL), problem.scale
