"""Reference for the methods of a network: two tolerances of RODAS, and CVODE on single cells."""

from __future__ import annotations

from typing import Any, Final, NamedTuple, final

import numpy as np

from multicell.cells import FloatArray
from multicell.comparison.network_steps import SURE, NetworkProblem, NetworkStep, solve_steps
from multicell.errors import StepFailed
from multicell.networks.solver import Inside

_AGAIN: Final = 10.0  # times the reference's tolerance, of the solve that it is compared with
_MOST: Final = 1_000_000  # steps of CVODE


@final
class NetworkReference(NamedTuple):
    """States at the end of each step, and how sure they are.

    - ``states``, (n, s) for each step
    - ``errors``, (n, s) for each step: distance from the solve at another tolerance, over size
    - ``cvode``: largest distance from CVODE on one cell of each step; NaN: it was not asked
    - ``wall``, s: of the solve
    """

    states: list[FloatArray]
    errors: list[FloatArray]
    cvode: float
    wall: float

    @property
    def words(self) -> str:
        """Method, tolerance and agreement with CVODE."""
        own = f"rodas4 at {SURE:g}"
        if np.isnan(self.cvode):
            return f"{own} (CVODE knows no events)"
        return f"{own}, off by at most {self.cvode:.1g} from CVODE on one cell of each step"


def network_reference(problem: NetworkProblem) -> NetworkReference:
    """Return the reference; raises StepFailed if it cannot be computed."""
    found, _ = solve_steps(problem, "rodas4", SURE)
    other, _ = solve_steps(problem, "rodas4", _AGAIN * SURE)
    if found.problem or other.problem:
        trouble = f"network {problem.part.name}: {found.problem or other.problem}"
        raise StepFailed(problem.steps[len(found.ends)].time, trouble, "", None)
    errors, worst = problem.errors(other.states, found.states), np.nan
    if not problem.part.model.events:
        ends = []
        for step, exact in zip(problem.steps, found.states, strict=True):
            row = len(exact) // 2
            end = exact.copy()
            end[row] = cvode_end(problem, step, row)
            ends.append(end)
        apart = problem.errors(ends, found.states)
        errors = [np.maximum(a, b) for a, b in zip(errors, apart, strict=True)]
        worst = max(float(x.max()) for x in apart)
    return NetworkReference(found.states, errors, worst, found.wall)


def cvode_end(
    problem: NetworkProblem, step: NetworkStep, row: int, tolerance: float = SURE
) -> FloatArray:
    """Return the states of one cell at the end of a step by CVODE, (s,).

    Its equations are made of the rates of the network alone. Raises RuntimeError if it fails.
    """
    from sksundae.cvode import CVODE

    part, solver = problem.part, problem.solver("rodas4", SURE)
    cell = Inside(*(x[[row]] for x in (step.inside.y, step.inside.p, step.inside.memory)))
    before, change = step.before[[row]], step.after[[row]] - step.before[[row]]
    fall = step.growth[row] * part.diluted

    def rates(t: float, y: FloatArray, out: FloatArray) -> None:
        here, inputs = Inside(np.array([y]), cell.p, cell.memory), before + t / step.span * change
        out[:] = solver.rates(here, inputs, step.start + t)[0] - fall * y

    cvode: Any = CVODE(
        rates,
        method="BDF",
        rtol=tolerance,
        atol=tolerance * problem.scale,
        max_num_steps=_MOST,
    )
    found = cvode.solve(np.array([0.0, step.span]), cell.y[0])
    if not found.success:
        raise RuntimeError(f"CVODE stopped: {found.message}")
    return np.array(found.y[-1])


def largest_rates(problem: NetworkProblem) -> list[float]:
    """Return the largest |λ| of the Jacobians of all cells at the beginning of each step, 1/s."""
    solver = problem.solver("rodas4", SURE)
    found = []
    for step in problem.steps:
        y, base = step.inside.y, solver.rates(step.inside, step.before, step.start)
        jacobian = np.empty((*y.shape, y.shape[1]))
        for place in range(y.shape[1]):
            moved = y.copy()
            moved[:, place] += np.sqrt(np.finfo(float).eps) * (np.abs(y) + problem.scale)[:, place]
            rates = solver.rates(
                Inside(moved, step.inside.p, step.inside.memory), step.before, step.start
            )
            jacobian[:, :, place] = (rates - base) / (moved - y)[:, [place]]
        fastest = np.abs(np.linalg.eigvals(jacobian)).max(initial=0.0)
        found.append(float(fastest) / problem.part.seconds)
    return found
