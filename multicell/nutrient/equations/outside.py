"""Fields of a run by any solver of py-pde's registry, with the account that runs keep.

A solver of py-pde's adds up rates by a rule of its own. So the account of a field is one more field
beside it (:class:`AccountedEquation`): whatever the rule is, it adds up what cells take and what
comes over the sides with the same weights as the contents, and the account closes to rounding (with
CVODE, which solves its equations to its tolerance, to that).

Fixed steps are as long as :func:`multicell.scene.field_solvers.longest_step` says.
"""

from __future__ import annotations

import inspect
import itertools
import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple, final

import numpy as np
from pde.fields.collection import FieldCollection
from pde.fields.scalar import ScalarField
from pde.pdes.base import PDEBase
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient.balance import BALANCE_COLUMNS
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.steady import BALANCE_TOLERANCE, SolveReport
from multicell.scene.field_solvers import MOST_FIELD_STEPS, longest_step

_FORMER: Final = {"explicit": "euler"}
"""Names that py-pde keeps of solvers that have another one now."""

_TIGHTER: Final = 0.1
"""Relative tolerance of solvers that choose their steps over ``time_tolerance``.

They bound a mean over nodes, and ``time_tolerance`` the largest error of any."""

_PARTS: Final = 16  # of a coupling step, at whose ends somebody looks
_BELOW: Final = 1e-6  # part of the field's scale below zero at which a solver has failed
_FIXED_POINT: Final = 1e-6  # part of the scale to which py-pde's iterations are carried
_RESTING: Final = 1e-9
"""Tolerance with which fields are marched to rest: the noise of looser steps does not settle."""

_MOST_SPANS: Final = 40
"""Times, each twice as long as the one before, in which a field may come to rest."""


class Brought(NamedTuple):
    """Fields that a solver has brought to another time.

    - ``data``, (m, ...) mM
    - ``amounts``, (m, columns): what happened, by :data:`BALANCE_COLUMNS`
    - ``lifted``, (m,) amol: what setting rounding below zero to zero has added
    - ``steps``: of the solver
    """

    data: FloatArray
    amounts: FloatArray
    lifted: FloatArray
    steps: int


@final
class AccountedEquation(PDEBase):  # type: ignore[no-untyped-call]
    """Fields together with their account, as one equation of py-pde's.

    The account is as many fields as its numbers fill, over the volume of the grid: mM as the rest.

    - ``equation``: of the fields
    - ``last``: time in s after which nothing changes by itself any more, the end of an interval
    """

    explicit_time_dependence = True

    def __init__(self, equation: FieldEquation) -> None:
        super().__init__()
        self.equation, self.last = equation, math.inf
        self._fields = len(equation.names)
        self._entries = self._fields * len(BALANCE_COLUMNS)
        nodes = math.prod(equation.layout.shape)
        self._more = -(-self._entries // nodes)
        self.names = [*equation.names, *(f"account {i}" for i in range(self._more))]

    def state(self, data: FloatArray) -> FieldCollection:
        """Return the state for fields (m, ...) in mM, to which nothing has happened yet."""
        grid = self.equation.grid
        parts = [*np.reshape(data, (self._fields, *grid.shape))]
        parts += [np.zeros(grid.shape)] * self._more
        return FieldCollection([ScalarField(grid, part) for part in parts])

    def taken(self, state: Any) -> tuple[FloatArray, FloatArray]:
        """Return the fields of a state, (m, ...) mM, and their account, (m, columns)."""
        data = np.asarray(state.data, dtype=float)
        account = data[self._fields :].ravel()[: self._entries] * self.equation.layout.whole
        shape = self._fields, *self.equation.layout.shape
        return data[: self._fields].reshape(shape), account.reshape(self._fields, -1)

    def rates(self, data: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
        """Return ∂/∂t of all, (m + account, ...) mM/s, and the derivative of all sinks, 1/s."""
        found, sinks = np.zeros_like(data), np.zeros_like(data)
        fields, now = np.ascontiguousarray(data[: self._fields]), min(t, self.last)
        found[: self._fields], sinks[: self._fields] = self.equation.rates(fields, now)
        rows = self.equation.exchanges(fields, now) / self.equation.layout.whole
        found[self._fields :].reshape(-1)[: self._entries] = rows.ravel()
        return found, sinks

    def evolution_rate(self, state: Any, t: float = 0.0) -> Any:
        """Return ∂/∂t of a state at a time in s."""
        result = state.copy(label="evolution rate")
        result.data, _ = self.rates(np.asarray(state.data, dtype=float), t)
        return result

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two at which a medium jumps or bends, s."""
        return self.equation.switches(begin, end)

    def shifted_inverse(
        self, data: FloatArray, t: float
    ) -> Callable[[FloatArray, float], FloatArray]:
        """Return a function of r and a shift (1/s) that gives about (shift - J)⁻¹ r."""
        fields = self.equation.shifted_inverse(data[: self._fields], min(t, self.last))

        def inverse(r: FloatArray, shift: float) -> FloatArray:
            out = r / shift
            out[: self._fields] = fields(np.ascontiguousarray(r[: self._fields]), shift)
            return out

        return inverse


def bring(
    equation: FieldEquation,
    name: str,
    data: FloatArray,
    begin: float,
    end: float,
    *,
    tolerance: float,
    scales: FloatArray,
    longest: float = math.inf,
    watch: Callable[[float, FloatArray], None] | None = None,
) -> Brought:
    """Bring fields from one time to another by a solver of py-pde's registry.

    - ``data``, (m, ...) mM: at ``begin`` (s)
    - ``tolerance``: of solvers that have one, over ``scales``, (m,) mM
    - ``longest``, s: of fixed steps, where it is shorter than what the solver could take
    - ``watch``: called with time and data at the beginning, at the end and on the way

    Raises NutrientFailed where it needs too many steps, does not converge, or falls below zero.
    """
    problem, steps = AccountedEquation(equation), 0
    state = problem.state(data)
    if watch is not None:
        watch(begin, problem.taken(state)[0])
    for start, stop in itertools.pairwise([begin, *problem.switches(begin, end), end]):
        problem.last = float(np.nextafter(stop, -np.inf))
        ends = np.linspace(start, stop, 2 if watch is None else _PARTS + 1)
        for one, other in itertools.pairwise(ends):
            for each in equation.substances.values():
                each.set_time(float(other), float(other - one))
            span = float(one), float(other)
            steps += _run(problem, name, state, span, longest, tolerance, scales)
            if watch is not None:
                watch(float(other), problem.taken(state)[0])
    found, amounts = problem.taken(state)
    return Brought(*_above_zero(equation, name, found, amounts, scales), steps)


def settle(
    equation: FieldEquation, name: str, data: FloatArray, time: float, scales: FloatArray
) -> tuple[FloatArray, dict[str, SolveReport]]:
    """March fields by a solver of py-pde's until they rest with what holds at ``time``.

    They rest where the sum of all nodes' rates is below the tolerance of runs beside the turnover.

    Returns
    -------
    data : (m, ...) mM
    reports : name -> SolveReport

    Raises NutrientFailed where that takes too many steps.
    """
    steps, span = 0, 100.0 / equation.fastest(data)
    for _ in range(_MOST_SPANS):
        reports, resting = _reports(equation, data, time, steps)
        if resting:
            return data, reports
        if steps > MOST_FIELD_STEPS:
            break
        end = time + span
        found = bring(equation, name, data, time, end, tolerance=_RESTING, scales=scales)
        data, steps, span = found.data, steps + found.steps, 2.0 * span
    raise NutrientFailed(
        f"{' and '.join(equation.names)} do not rest after {steps:,} steps of {name}",
        "Let the solver of the field be 'auto', or the field transient",
    )


def _reports(
    equation: FieldEquation, data: FloatArray, time: float, steps: int
) -> tuple[dict[str, SolveReport], bool]:
    """Return the exchange of each field, and whether they are at rest."""
    rates, _ = equation.rates(data, time)
    rows, volumes, found = equation.exchanges(data, time), equation.layout.volumes, {}
    resting = True
    for name, rate, row in zip(equation.names, rates, rows, strict=True):
        entry = dict(zip(BALANCE_COLUMNS, map(float, row), strict=True))
        left = float(np.sum(np.abs(rate.reshape(equation.layout.shape)) * volumes))
        turnover = sum(abs(entry[key]) for key in ("inflow", "uptake", "secreted", "decayed"))
        resting &= left <= BALANCE_TOLERANCE * turnover or turnover == left == 0.0
        found[name] = SolveReport(steps, 0, left, entry["inflow"], entry["uptake"])
    return found, resting


def _run(
    problem: AccountedEquation,
    name: str,
    state: Any,
    span: tuple[float, float],
    longest: float,
    tolerance: float,
    scales: FloatArray,
) -> int:
    """Bring a state through a span in place; return the steps that it took."""
    from pde.solvers.base import ConvergenceError

    fields, (begin, end) = problem.taken(state)[0], span
    longest = min(longest, longest_step(name, problem.equation.fastest(fields)))
    number = max(1, math.ceil((end - begin) / longest)) if math.isfinite(longest) else 1
    who = " and ".join(problem.equation.names)
    if number > MOST_FIELD_STEPS:
        raise NutrientFailed(
            f"{who} would need {number:,} steps of {name}, each of {longest:.3g} s at most",
            "Let the solver of the field be 'auto', or shorten the coupling step",
        )
    name = _FORMER.get(name, name)
    solver = SolverBase.from_name(name, problem, **_options(name, tolerance, float(scales.max())))
    try:
        # its own first step is what SciPy's and ours take from none
        dt = (end - begin) / number if math.isfinite(longest) else None
        solver.make_stepper(state, dt)(state, begin, end)
    except (ConvergenceError, RuntimeError, FloatingPointError) as trouble:
        raise NutrientFailed(
            f"{name} failed on {who} at t = {begin:.6g} s: {trouble}",
            "Let the solver of the field be 'auto'",
        ) from trouble
    if not np.isfinite(state.data).all():
        raise NutrientFailed(
            f"{who} became infinite at t = {end:.6g} s by steps of {name}",
            "Let the solver of the field be 'auto'",
        )
    return int(solver.info.get("steps", number))


def _options(name: str, tolerance: float, scale: float) -> dict[str, Any]:
    """Return the settings of a solver, as far as it has them."""
    if name == "scipy":
        rtol = _TIGHTER * tolerance
        return {"backend": "numpy", "rtol": rtol, "atol": 1e-3 * rtol * scale}
    known = inspect.signature(SolverBase._subclasses[name].__init__).parameters
    wanted = {
        "backend": "numpy",
        "rtol": _TIGHTER * tolerance,
        "maxerror": _FIXED_POINT * scale,
    }
    return {key: value for key, value in wanted.items() if key in known}


def _above_zero(
    equation: FieldEquation,
    name: str,
    data: FloatArray,
    amounts: FloatArray,
    scales: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return fields that a solver left below zero by no more than its error at zero there."""
    lifted = np.zeros(len(data))
    for i, (nodes, scale) in enumerate(zip(data, scales, strict=True)):
        least = float(nodes.min())
        if least < -_BELOW * scale:
            raise NutrientFailed(
                f"{name} took {equation.names[i]} below zero, to {least:.3g} mM",
                "Let the solver of the field be 'auto', which never does",
            )
        if least < 0.0:
            lifted[i] = -float(np.sum(equation.layout.volumes * np.minimum(nodes, 0.0)))
    return np.maximum(data, 0.0), amounts, lifted
