"""Fields of a run brought forward by a solver that the scene names, in place of the run's own."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from pde.solvers.base import SolverBase

from multicell.errors import NutrientFailed
from multicell.nutrient.balance import COLUMNS
from multicell.nutrient.equations.accounts import AccountedEquation
from multicell.scene.nutrient import STEPPING

if TYPE_CHECKING:
    from multicell.nutrient.equations.equation import FieldEquation
    from multicell.scene.nutrient import Nutrient

MAX_STEPS = 20_000_000
"""Steps between two exchanges with the cells beyond which a run would never end."""

_ITERATED = 1e-3
"""Where fixed-point iterations end, over the error of a step that is allowed."""


def advance(
    equation: FieldEquation, state: Any, nutrients: Sequence[Nutrient], begin: float, end: float
) -> dict[str, Any]:
    """Bring the state of an equation from ``begin`` to ``end`` (s) by the nutrients' solver.

    Returns steps, rejections, first_order, error, amounts: as
    :class:`~multicell.nutrient.equations.march_solver.MarchFieldSolver` says of a march; what a
    solver does not say is zero.

    Raises NutrientFailed if the solver gives up, needs too many steps, or leaves a concentration
    that is not finite or below zero by more than its tolerance.
    """
    name, steps = nutrients[0].solver, 0
    assert name is not None
    tolerance = min(nutrient.time_tolerance for nutrient in nutrients)
    amounts = np.zeros((len(equation.substances), len(COLUMNS)))
    m = len(equation.substances)
    for start, stop in itertools.pairwise([begin, *equation.switches(begin, end), end]):
        accounted = AccountedEquation(equation, until=stop)
        whole = accounted.state(state)
        scale = _scale(equation, state, start)
        options = _options(name, tolerance, scale)
        solver = SolverBase.from_name(
            {"explicit": "euler"}.get(name, name), accounted, **options
        )  # fmt: skip
        length = _step(name, equation.limit(), stop - start)
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                solver.make_stepper(whole, length)(whole, start, stop)
        except (RuntimeError, FloatingPointError) as failure:
            problem = f"the solver '{name}' of py-pde gave up: {failure}"
            hint = "A shorter coupling_step or a coarser spacing may help, or the run's own solver."
            raise NutrientFailed(problem, hint) from failure
        data = np.array(whole.data, dtype=float)
        _refuse_lost(name, data[:m], tolerance * scale)
        state.data[...] = data[:m].reshape(state.data.shape)
        amounts += accounted.account(data)
        steps += int(solver.info["steps"])
    told = {"steps": steps, "rejections": 0, "first_order": 0, "error": 0.0, "amounts": amounts}
    return {**solver.info, **told}


def _scale(equation: FieldEquation, state: Any, time: float) -> float:
    """Return the largest concentration in fields and media, mM."""
    media = [each.schedule.at(time) for each in equation.substances.values()]
    return max(float(np.max(state.data, initial=0.0)), *media, 0.0)


def _options(name: str, tolerance: float, scale: float) -> dict[str, Any]:
    """Return what a solver is told of the error that is allowed."""
    small = _ITERATED * tolerance * (scale or 1.0)
    if name == "multicell-implicit":
        return {"rtol": tolerance}
    if name == "scipy":
        return {"backend": "numpy", "rtol": tolerance, "atol": small}
    if name in ("implicit", "crank-nicolson"):
        return {"backend": "numpy", "maxerror": small}
    return {"backend": "numpy"}


def _step(name: str, limit: float, length: float) -> float | None:
    """Return the length of the solver's steps in s, so that they end where they should.

    Raises NutrientFailed if there would be too many.
    """
    share = STEPPING.get(name)
    if share is None:
        return None
    steps = math.ceil(length / (share * limit))
    if steps > MAX_STEPS:
        raise NutrientFailed(
            f"the solver '{name}' is stable with steps up to {share * limit:.3g} s: "
            f"{steps:,} of them would lie between two exchanges with the cells",
            "Take a coarser spacing, or the run's own solver.",
        )
    return length / steps


def _refuse_lost(name: str, data: Any, least: float) -> None:
    """Refuse a state that has left what a solution can be."""
    if not np.isfinite(data).all():
        problem = f"the solver '{name}' left concentrations that are not finite"
        raise NutrientFailed(problem, "Take the run's own solver, which has no limit of stability.")
    if float(data.min(initial=0.0)) < -least:
        problem = f"the solver '{name}' left concentrations down to {data.min():.3g} mM"
        hint = "Lower time_tolerance, or take the run's own solver, which stays above zero."
        raise NutrientFailed(problem, hint)
