"""The fields' equation as one of py-pde's, for any solver of py-pde's, and for our own.

    ∂c/∂t = ∇·(D ∇c) + (k_p + κ) (c_medium − c) − k_d c − Q c/(K + c) + S + f

for each substance, on a grid of py-pde's: ``CartesianGrid`` in two and three dimensions with equal
spacings, or ``SphericalSymGrid``. Q and S are what cells take up at most and secrete, spread over
their balls (:mod:`multicell.nutrient.balls`); f is what reactions between substances make. Below
zero, where only a solver's error can bring c, uptake and reactions go on along their tangent. κ is
zero but where the layer of medium round a tissue ends (:mod:`multicell.nutrient.layer`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, final

import numpy as np
from pde.fields.collection import FieldCollection
from pde.fields.scalar import ScalarField
from pde.pdes.base import PDEBase

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.nutrient.balance import BALANCE_COLUMNS
from multicell.nutrient.equations.grid import grid_on, layout_on, nodes_on
from multicell.nutrient.equations.linear import LinearCourse, is_linear
from multicell.nutrient.equations.placed import PlacedSubstance
from multicell.nutrient.equations.solvers import (
    ImplicitFieldSolver,
    MarchFieldSolver,
    SteadyFieldSolver,
)
from multicell.nutrient.equations.substance import Substance
from multicell.nutrient.grid import Layout
from multicell.results.pde_fields import FieldsView

if TYPE_CHECKING:
    from collections.abc import Callable

    from pde.grids.base import GridBase

    from multicell.nutrient.reactions.kinetics import Kinetics
    from multicell.nutrient.steady import SolveReport

    State = ScalarField | FieldCollection

SOLVERS = (ImplicitFieldSolver, MarchFieldSolver, SteadyFieldSolver)
"""Solvers of ours, which py-pde knows by their names once this module is loaded."""


_TRACE = 1e-6
"""Part of the largest concentration of all fields below which the error of one is not followed."""


@final
class FieldEquation(PDEBase):  # type: ignore[no-untyped-call]
    """Diffusion, decay, perfusion, Michaelis-Menten uptake and secretion by cells.

    >>> grid = pde.CartesianGrid([(-100, 100)] * 3, 20)                   # doctest: +SKIP
    >>> oxygen = mc.Substance(2000.0, 0.07, 0.005, capacity=20 * np.ones(5))  # doctest: +SKIP
    >>> equation = mc.FieldEquation(grid, {"oxygen": oxygen}, position)   # doctest: +SKIP
    >>> state = equation.state({"oxygen": 0.07})                          # doctest: +SKIP
    >>> equation.solve(state, 60.0, solver="multicell-implicit")          # doctest: +SKIP

    The state is a ``ScalarField`` for one substance and a ``FieldCollection`` for several, in
    mM; times are in s and lengths in µm. Solvers of py-pde, ``"multicell-implicit"`` and
    ``"multicell-steady"`` solve it. py-pde knows nothing of a medium that jumps: end an interval
    where :meth:`switches` says that it does.

    Parameters
    ----------
    grid
        Not periodic; cubes or squares, or a ball of shells. None: that of the layout.
    substances : name -> Substance
    position : (n, 3), µm
        Of the cells; in the frame of the grid, on shells relative to ``layout``'s centre.
    radius : (n,), µm
        Of the cells, balls over which uptake and secretion are spread, and discs in a plane;
        absent: they are points.
    layout
        Where nodes are for the cells; absent: ``layout_on(grid)``.
    reactions : name -> Reaction
        Between the substances: as a scene has them, as tables of the same keys, or functions of
        the user's own (:func:`multicell.reaction`); or the kinetics of all of them.
    tissue : shape of the grid, optional
        Part of each place that is tissue, 0 to 1, for reactions that ask for it.
    threads
        How many may share the loops over many nodes; it changes no result.

    Raises
    ------
    SceneError
        For a grid, numbers, arrays or conditions that do not fit, and a position outside.
    """

    def __init__(
        self,
        grid: GridBase | None,
        substances: Mapping[str, Substance],
        position: FloatArray | None = None,
        *,
        radius: FloatArray | None = None,
        layout: Layout | None = None,
        reactions: Mapping[str, Any] | Kinetics | None = None,
        tissue: FloatArray | None = None,
        threads: int = 1,
    ) -> None:
        super().__init__()
        if not substances:
            raise SceneError("substances", "are none, but an equation has one or more")
        if layout is None:
            if grid is None:
                raise SceneError("grid", "is missing, and so is a layout")
            layout = layout_on(grid)
        self.layout = layout
        if grid is not None:
            self.grid = grid
        self.position = np.zeros((0, 3)) if position is None else np.asarray(position, dtype=float)
        if self.position.ndim != 2 or self.position.shape[1] != 3:
            raise SceneError("position", f"has the shape {self.position.shape}, expected (n, 3)")
        if radius is not None:
            radius = np.asarray(radius, dtype=float)
            if radius.shape != self.position.shape[:1]:
                expected = f"expected ({len(self.position)},)"
                raise SceneError("radius", f"has the shape {radius.shape}, {expected}")
            if not (radius.min(initial=0.0) >= 0.0 and radius.max(initial=0.0) < np.inf):
                raise SceneError("radius", "of some cell is negative or not finite")
        self.substances = {
            name: PlacedSubstance(name, substance, layout, self.position, radius, threads)
            for name, substance in substances.items()
        }
        self.reactions = None
        if reactions is not None and reactions != {}:
            from multicell.nutrient.equations.reactions import Reactions

            self.reactions = Reactions(list(self.substances.values()), reactions, tissue)
        schedules = [each.schedule for each in self.substances.values()]
        self.explicit_time_dependence = not all(schedule.constant for schedule in schedules)

    @cached_property
    def grid(self) -> GridBase:
        """py-pde's grid."""
        return grid_on(self.layout)

    @property
    def names(self) -> list[str]:
        """Names of the substances in the order of the state's fields."""
        return list(self.substances)

    def state(self, values: Mapping[str, Any]) -> State:
        """Return a state from an array of the grid's nodes or one number for each substance, mM.

        Raises
        ------
        SceneError
            If a substance is missing, unknown, or of another shape.
        """
        if set(values) != set(self.substances):
            problem = f"are of {sorted(values)}, expected {sorted(self.substances)}"
            raise SceneError("values", problem)
        shape = self.grid.shape
        arrays = []
        for name in self.substances:
            array = np.asarray(values[name], dtype=float)
            if array.ndim and array.size != np.prod(shape):
                problem = f"has the shape {array.shape}, the grid has {shape}"
                raise SceneError(f"values.{name}", problem)
            arrays.append(array if array.ndim else np.broadcast_to(array, shape))
        fields = [
            ScalarField(self.grid, array.reshape(shape), label=name)
            for name, array in zip(self.substances, arrays, strict=True)
        ]
        return fields[0] if len(fields) == 1 else FieldCollection(fields, labels=[*self.substances])

    def view(self, nodes: FloatArray) -> FieldsView:
        """Return nodes of all substances, (m, ...) mM, as a state on that array."""
        return FieldsView(self, nodes.reshape(-1, *nodes_on(self.layout)))

    def evolution_rate(self, state: State, t: float = 0.0) -> State:  # type: ignore[override]
        """Return ∂c/∂t of all substances at a time in s, mM/s.

        By finite volumes: the flow between two nodes has the harmonic mean of their coefficients.

        Raises
        ------
        SceneError
            If the state has other fields or another grid.
        """
        self.check(state)
        result = state.copy(label="evolution rate")
        result.data, _ = self.rates(np.asarray(state.data, dtype=np.float64), t)
        return result

    def rates(self, data: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
        """Return ∂c/∂t (mM/s) and the derivative of all sinks (1/s).

        ``data`` are a state's, in mM; the results have its shape.
        """
        nodes = self.nodes(data)
        found = [each.rate(nodes[name], t) for name, each in self.substances.items()]
        out, slope = (np.array(x) for x in zip(*found, strict=True))
        if self.reactions is not None:
            out += self.reactions.made(nodes)
        return out.reshape(data.shape), slope.reshape(data.shape)

    def shifted_inverse(
        self, data: FloatArray, t: float
    ) -> Callable[[FloatArray, float], FloatArray]:
        """Return a function of r and a shift (1/s) that gives about (shift - J)⁻¹ r.

        J is the derivative of the rates.
        """
        _, slope = self.rates(data, t)
        if self.reactions is not None:
            return self.reactions.shifted_inverse(self.nodes(data), self.nodes(slope))
        slopes = self.nodes(slope)

        def inverse(r: FloatArray, shift: float) -> FloatArray:
            parts = self.nodes(r)
            found = [
                each.inverse(parts[name], slopes[name] + shift)
                for name, each in self.substances.items()
            ]
            return np.array(found).reshape(r.shape)

        return inverse

    def steady_state(self, data: FloatArray, t: float) -> tuple[FloatArray, dict[str, Any]]:
        """Return the steady state with the conditions of a time in s, and the work of finding it.

        Raises
        ------
        NutrientFailed
            If a solve does not converge.
        """
        found, reports = self.solution(data, t)
        return found.reshape(data.shape), reports

    def implicit_step(self, data: FloatArray, dt: float, t: float) -> tuple[FloatArray, FloatArray]:
        """Take a step of backward Euler of ``dt`` s that ends at ``t``; nothing is below zero.

        Returns
        -------
        data
            At the end.
        (m, columns)
            What happened to each substance: :data:`multicell.nutrient.balance.BALANCE_COLUMNS`.

        Raises
        ------
        NutrientFailed, StepRefused
            If a solve does not converge.
        """
        found, reports = self.solution(data, t, dt, data)
        return found.reshape(data.shape), dt * self.exchanges(found, t, reports)

    def linear_courses(
        self, data: FloatArray, begin: float, last: float, end: float
    ) -> list[LinearCourse] | None:
        """Return the exact course of each substance from a time to another, s; None: not linear.

        ``last`` is a time just before ``end``: at the moment of a jump the old medium holds.
        """
        substances = self.substances.values()
        if self.reactions is not None or not all(map(is_linear, substances)):
            return None
        nodes = self.nodes(data)
        return [LinearCourse(each, nodes[each.name], begin, last, end) for each in substances]

    def solution(
        self, start: FloatArray, t: float, dt: float = np.inf, before: FloatArray | None = None
    ) -> tuple[FloatArray, dict[str, SolveReport]]:
        """Return the nodes of all substances at rest, or a step of ``dt`` s after ``before``.

        ``start`` is the first guess, and ``t`` the time in s at the end.
        """
        nodes = self.nodes(start)
        for each in self.substances.values():
            each.set_time(t, dt)
        earlier = None if before is None else self.nodes(before)
        if self.reactions is not None:
            found, reports = self.reactions.solution(nodes, t, dt, earlier)
            return found.reshape(-1, *self.layout.shape), reports
        reports = {}
        for name, each in self.substances.items():
            last, level = None if earlier is None else earlier[name], each.schedule.at(t)
            nodes[name], reports[name] = each.solve(nodes[name], level, dt=dt, before=last)
        states = list(nodes.values())
        return states[0][None] if len(states) == 1 else np.array(states), reports

    def scales(self, data: FloatArray, begin: float, end: float) -> FloatArray:
        """Return the concentration of each substance that errors are small beside, (m,) mM."""
        substances = self.substances.values()
        found = np.array([each.schedule.at(begin) for each in substances])
        if self.reactions is None:
            return found
        found = np.maximum(found, self.reactions.ahead(self.nodes(data), begin, end))
        return np.asarray(np.maximum(found, _TRACE * found.max()))

    def fastest(self, data: FloatArray) -> float:
        """Return a bound on the rate in 1/s at which anything settles, for steps of solvers.

        Diffusion, exchange with the medium, what goes in proportion, uptake where there is nothing,
        and reactions as they are at ``data``.
        """
        own = [
            2.0 * each.operator.fastest()
            + each.quickest_exchange
            + each.linear
            + float(each.sink.max(initial=0.0)) / each.substance.half_saturation
            for each in self.substances.values()
        ]
        reacting = 0.0 if self.reactions is None else self.reactions.fastest(self.nodes(data))
        return max(own) + reacting

    def place(
        self,
        layout: Layout,
        position: FloatArray,
        demands: Mapping[str, tuple[FloatArray, FloatArray | None]],
        radius: FloatArray | None = None,
        exchange: FloatArray | None = None,
    ) -> None:
        """Take cells elsewhere, with largest uptake and secretion of each, (n,) amol/s, by name.

        ``layout`` may lie elsewhere too, and have other nodes of the same kind, with another
        ``exchange`` (:class:`multicell.Substance`); nothing else that belongs to nodes (``varied``,
        ``tissue``) may have been given then.
        """
        self.position = position
        if layout is not self.layout:
            self.__dict__.pop("grid", None)
            self.layout = layout
        for name, each in self.substances.items():
            each.place(layout, position, radius, *demands[name], exchange)

    def exchanges(
        self, data: FloatArray, t: float, reports: Mapping[str, SolveReport] | None = None
    ) -> FloatArray:
        """Return the exchange of each substance at a time in s, (m, columns) amol/s.

        The columns are those of :data:`multicell.nutrient.balance.BALANCE_COLUMNS`. ``reports`` are
        what solvers know of this state; absent: it is found here.
        """
        nodes, rows = self.nodes(data), []
        made: dict[str, FloatArray] = {}
        if reports is None and self.reactions is not None:
            made = dict(zip(self.substances, self.reactions.made(nodes), strict=True))
        for name, each in self.substances.items():
            c, level = nodes[name], each.schedule.at(t)
            flows = each.flows(c, level, made.get(name)) if reports is None else reports[name]
            rows.append(each.account(c, level, flows))
        return np.array(rows)

    def balance(self, state: State, t: float = 0.0) -> dict[str, dict[str, float]]:
        """Return the total exchange of each substance, amol/s.

        The entries of :class:`multicell.nutrient.balance.Ledger`, and ``stored``, which is what the
        content gains by all of them.
        """
        self.check(state)
        rows = self.exchanges(np.array(state.data, dtype=float), t)
        rates = np.reshape(self.evolution_rate(state, t).data, (len(rows), *self.layout.shape))
        return {
            name: dict(zip(BALANCE_COLUMNS[:-1], map(float, row), strict=False))
            | {"stored": float(np.sum(self.layout.volumes * rate))}
            for name, row, rate in zip(self.substances, rows, rates, strict=True)
        }

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two at which a medium jumps or bends, s."""
        return sorted(
            {t for x in self.substances.values() for t in x.schedule.switches(begin, end)}
        )

    def check(self, state: State) -> None:
        """Refuse a state that is not one of this equation.

        Raises
        ------
        SceneError
        """
        if getattr(state, "equation", None) is self:  # a view, which follows its equation
            return
        fields = [state] if isinstance(state, ScalarField) else list(state)
        if len(fields) != len(self.substances) or any(
            not isinstance(f, ScalarField) for f in fields
        ):
            problem = f"has {len(fields)} fields, expected one scalar field for each of"
            raise SceneError("state", f"{problem} {', '.join(self.names)}")
        if not state.grid.compatible_with(self.grid):
            raise SceneError("state", f"lives on {state.grid}, the equation on {self.grid}")

    def nodes(self, data: Any) -> dict[str, FloatArray]:
        """Return the values of each substance as solvers have them."""
        shape = self.layout.shape
        parts = np.ascontiguousarray(data, dtype=float).reshape(len(self.substances), *shape)
        return dict(zip(self.substances, parts, strict=True))
