"""Solvers of fields that are compared, and how each is turned from coarse to fine.

A transient is turned by the step over the largest stable one of explicit Euler, or by a tolerance
over the scale of the field. Steady states are marched to by all but ours: there the setting is how
long, in times in which the slowest deviation falls to 1/e, and the steps are as long as a solver
can take.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, Final, cast, final

import numpy as np

from multicell.cells import FloatArray
from multicell.comparison.field_solvers.equations import CountedEquation, march_of_runs
from multicell.comparison.field_solvers.problems import STEADY, Case, Piece
from multicell.errors import SceneError
from multicell.schema import near_miss

STEPS, TOLERANCES, TIMES, ONCE = "step", "tolerance", "time", "once"
"""What a setting is: step / explicit Euler's limit, tolerance / scale, time / slowest time, or
nothing that can be turned."""

DIRECT, STEPPING, CONTROLLED = "direct", "stepping", "controlled"
"""How a solver goes: straight to rest, by steps of one length, by steps of its own."""

_TOLERANCES: Final = tuple(10.0**-k for k in range(1, 8))
_TIMES: Final = (3.0, 4.5, 6.0, 8.0, 11.0, 15.0, 20.0)
_ITERATION_ERROR = 1e-6  # of the scale, at which py-pde's fixed-point iterations end
_MAX_DENSE_NODES = 1500  # dense Jacobians of more take longer than anything else
_FIRST_STEP = 0.1  # of adaptive solvers, over explicit Euler's limit

Advance = Callable[[FloatArray], FloatArray]
"""Data at the begin of an interval -> data at its end."""


@final
@dataclass(frozen=True)
class FieldSolver:
    """A solver and what is known of it.

    Attributes
    ----------
    name
        In tables and charts.
    kind
        One of ``"direct"``, ``"stepping"`` and ``"controlled"``.
    ours
        Whether it is one of this package's.
    colour, marker
        In charts; the colour may be empty.
    stable
        Largest step over explicit Euler's limit that should hold; of implicit solvers of py-pde's
        the one at which their iterations still converge.
    pde
        Name and options of py-pde's solver; empty where there is none.
    words
        What it is.
    """

    name: str
    kind: str
    ours: bool
    colour: str
    marker: str
    stable: float
    pde: str
    words: str
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def iterates(self) -> bool:
        """Whether it is one of py-pde's implicit solvers, which are fixed-point iterations."""
        return self.pde in ("implicit", "crank-nicolson")

    def control(self, case: Case) -> str:
        """Return what its setting means in a problem."""
        if self.kind == DIRECT:
            return ONCE
        if case.kind == STEADY:
            return TIMES
        return STEPS if self.kind == STEPPING else TOLERANCES

    def ladder(self, case: Case) -> tuple[float, ...]:
        """Return its settings from coarse to fine."""
        control = self.control(case)
        if control == STEPS:
            return (2.5 * self.stable, *(0.95 * self.stable * 0.5**k for k in range(5)))
        return {ONCE: (0.0,), TIMES: _TIMES, TOLERANCES: _TOLERANCES}[control]

    def refusal(self, case: Case) -> str:
        """Return why it is not tried on a problem; empty where it is."""
        if self.kind == DIRECT and case.kind != STEADY:
            return "finds states at rest only"
        if self.name == "scipy-LSODA" and case.nodes > _MAX_DENSE_NODES:
            gib = 8.0 * case.nodes**2 / 2**30
            return f"its dense Jacobian of {case.nodes:,} nodes would take {gib:.3g} GiB"
        return ""


SOLVERS: Final = {
    solver.name: solver
    for solver in (
        FieldSolver("multicell-steady", DIRECT, True, "#0072b2", "D", math.inf,
                    "multicell-steady", "Newton's method with preconditioned CG; direct on shells"),
        FieldSolver("multicell-implicit", CONTROLLED, True, "#d55e00", "o", math.inf,
                    "multicell-implicit", "BDF of orders 1 to 5 (CVODE), preconditioned GMRES"),
        FieldSolver("multicell-march", CONTROLLED, True, "#009e73", "s", math.inf,
                    "", "the march of runs: backward Euler, extrapolated, under error control"),
        FieldSolver("euler", STEPPING, False, "#e69f00", "v", 1.0, "euler", "explicit Euler"),
        FieldSolver("euler-adaptive", CONTROLLED, False, "", "^", 1.0, "euler",
                    "explicit Euler under error control", {"adaptive": True}),
        FieldSolver("runge-kutta", STEPPING, False, "", "<", 1.39, "runge-kutta",
                    "Runge-Kutta of order 4"),
        FieldSolver("runge-kutta-adaptive", CONTROLLED, False, "#56b4e9", ">", 1.39,
                    "runge-kutta", "Runge-Kutta-Fehlberg 4(5)", {"adaptive": True}),
        FieldSolver("adams-bashforth", STEPPING, False, "", "p", 0.5, "adams-bashforth",
                    "Adams-Bashforth of order 2"),
        FieldSolver("implicit", STEPPING, False, "", "X", 0.5, "implicit",
                    "backward Euler by fixed-point iteration"),
        FieldSolver("crank-nicolson", STEPPING, False, "#4b3a5e", "P", 1.0, "crank-nicolson",
                    "Crank-Nicolson by fixed-point iteration"),
        FieldSolver("scipy-RK45", CONTROLLED, False, "", "h", 1.65, "scipy",
                    "SciPy's Dormand-Prince 5(4)", {"method": "RK45"}),
        FieldSolver("scipy-BDF", CONTROLLED, False, "#8c6d1f", "*", math.inf, "scipy",
                    "SciPy's BDF with a sparse Jacobian by differences", {"method": "BDF"}),
        FieldSolver("scipy-LSODA", CONTROLLED, False, "", "d", math.inf, "scipy",
                    "LSODA with a dense Jacobian by differences", {"method": "LSODA"}),
    )
}  # fmt: skip
"""Name -> solver: ours, then py-pde's, SciPy's through py-pde's last."""


def select_names(
    key: str, names: Sequence[str] | None, known: Iterable[str], what: str
) -> list[str]:
    """Return the names that are asked for, by default all that are known.

    Raises
    ------
    SceneError
        For a name that is not known, and where there is none.
    """
    known = list(known)
    if names is None:
        return known
    if isinstance(names, str) or not names:
        raise SceneError(key, f"is {names!r}, expected a list of names")
    for name in names:
        if name not in known:
            raise SceneError(key, f"has {name!r}, which is no {what}", near_miss(name, known))
    return list(dict.fromkeys(names))


@final
class Attempt:
    """One solver with one setting on one problem; made anew for each timed solve.

    Parameters
    ----------
    solver, case, setting
        See :class:`FieldSolver`.
    backend
        Of py-pde's solvers, see :data:`multicell.comparison.field_solvers.equations.BACKENDS`.
    patience : float, s
        Wall time of a solve.

    Attributes
    ----------
    steps
        Number of steps, where the solver reports it.
    """

    def __init__(
        self, solver: FieldSolver, case: Case, setting: float, backend: str, patience: float
    ) -> None:
        self.solver, self.case, self.setting = solver, case, setting
        self.backend = backend
        self.steps = 0
        end = case.end if math.isfinite(case.end) else max(setting, 1.0) * case.slowest
        jumps = solver.ours and solver.pde != ""
        pieces = (Piece(case.whole, 0.0, end),) if jumps else case.pieces
        self.pieces = [piece._replace(end=min(piece.end, end)) for piece in pieces]
        self.counted = [CountedEquation(p.equation, backend, patience) for p in self.pieces]
        make = self._by_pde if solver.pde else self._by_march
        self.parts = list(map(make, self.counted, self.pieces))

    @property
    def evaluations(self) -> int:
        """Evaluations of the rates, of the march: Newton steps."""
        return sum(equation.evaluations for equation in self.counted)

    def solve(self) -> FloatArray:
        """Return the data at the end.

        Raises
        ------
        Exception
            Whatever the solver raises, and
            :class:`multicell.comparison.field_solvers.equations.TooSlow`.
        """
        data = self.case.start.copy()
        for equation in self.counted:
            equation.begin()
        for advance in self.parts:
            data = advance(data)
        return data

    @property
    def tolerance(self) -> float:
        """The tolerance over the scale of an error-controlled solver."""
        if self.solver.control(self.case) == TOLERANCES:
            return self.setting
        # what is left of the start, or a little less
        return max(1e-9, 0.1 * math.exp(-self.setting))

    def _step(self, length: float) -> float:
        """Return the longest step in s, not above what is asked for, that ends where it should."""
        over = self.setting
        if self.solver.control(self.case) == TIMES:
            over = 0.95 * self.solver.stable
        return length / max(1, math.ceil(length / (over * self.case.limit) * (1.0 - 1e-9)))

    def _by_pde(self, counted: CountedEquation, piece: Piece) -> Advance:
        """Return a solver that py-pde knows by its name."""
        from pde.solvers.base import SolverBase

        backend = "numba" if self.backend == "numba" else "numpy"
        solver = SolverBase.from_name(
            self.solver.pde, pde=counted, backend="auto" if self.solver.ours else backend,
            **self._options(),
        )  # fmt: skip
        state = cast(Any, piece.equation.state({self.case.field: self.case.start}))
        stepper = solver.make_stepper(state, self._first_step(piece))

        def advance(data: FloatArray) -> FloatArray:
            state.data[...] = data
            before = solver.info["steps"]
            stepper(state, piece.begin, piece.end)
            self.steps += solver.info["steps"] - before
            return np.array(state.data)

        return advance

    def _first_step(self, piece: Piece) -> float | None:
        """Return the step in s that a solver begins with, or keeps."""
        if self.solver.kind == STEPPING:
            return self._step(piece.end - piece.begin)
        return _FIRST_STEP * self.case.limit if "adaptive" in self.solver.options else None

    def _options(self) -> dict[str, Any]:
        """Return the options of py-pde's solver."""
        solver, scale, options = self.solver, self.case.scale, dict(self.solver.options)
        if solver.iterates:
            return {"maxerror": _ITERATION_ERROR * scale, **options}
        if solver.kind != CONTROLLED:
            return options
        if solver.ours:
            return {"rtol": self.tolerance, **options}
        if solver.pde == "scipy":
            if solver.options["method"] == "BDF":
                options["jac_sparsity"] = neighbours(self.case.start.shape)
            return {"rtol": self.tolerance, "atol": 0.1 * self.tolerance * scale, **options}
        return {"tolerance": self.tolerance * scale, **options}

    def _by_march(self, counted: CountedEquation, piece: Piece) -> Advance:
        """Return the march of runs."""

        def advance(data: FloatArray) -> FloatArray:
            found, steps = march_of_runs(
                counted, data, piece.begin, piece.end, tolerance=self.tolerance,
                scale=self.case.scale,
            )  # fmt: skip
            self.steps += steps
            return found

        return advance


def neighbours(shape: tuple[int, ...]) -> Any:
    """Return which rates depend on which nodes, (n, n), sparse: those next to each other."""
    from scipy import sparse

    chains: list[Any] = [
        sparse.diags_array([1.0, 1.0, 1.0], offsets=[-1, 0, 1], shape=(n, n)) for n in shape
    ]
    return sparse.csr_array(reduce(lambda rest, chain: sparse.kronsum(chain, rest), chains))
