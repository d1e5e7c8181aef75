"""A finite volume of stirred medium, which the cells of a field use up.

All the medium of a field is its grid and, beyond that, a part of volume V that is stirred and has
one concentration C. It exchanges with the grid what flows over the sides and what a perfusion
brings, J, and decays as the field does:

    V dC/dt = -J - k_d V C,

with C the boundary value of the field. Where the field is transient, its nodes and C are one state,
which :class:`WithMedium` brings forward; where it is steady, the state is the amount in both, and
the field at each moment the steady one of the C with which field and stirred part together hold
that (:class:`AtRestWithMedium`). In each implicit step C is the root of a function that rises with
C, since more flows in where there is more outside. Of fields that react one may have a medium.

When the grid follows the tissue, it takes medium in or gives it back: V changes too, and C does not
where the field has the same concentration there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from pde.fields.scalar import ScalarField
from pde.grids.cartesian import UnitGrid
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient.balance import (
    BALANCE_COLUMNS,
    SIGNS,
    FieldExchange,
    WellMixed,
    volume_beyond_grid,
)
from multicell.results.pde_fields import FieldsView

if TYPE_CHECKING:
    from multicell.nutrient.group import Demand, FieldGroup, Leaving
    from multicell.nutrient.steady import SolveReport
    from multicell.nutrient.tissue import Tissue

_FADED: Final = 1e-3
"""Part of the highest concentration below which a medium that is used up is not followed with an
error relative to itself any more, but to this."""

_MOST: Final = 100
"""Evaluations in which a concentration of the medium must be found; two to four are usual."""

_EXACT: Final = (1e-9, 1e-7)
"""Part of what field and medium hold that may be missing when the medium's concentration is
accepted: the boundary value of the field is so near to it. The second after ``_PATIENCE``
evaluations: what the field's solver leaves over may be as much."""

_PATIENCE: Final = 15  # iterations after which a looser accuracy is accepted, see above

_ROUNDING: Final = 1e-12
"""Part of a field's content below which content newly enclosed by its grid is rounding."""


def advance_finite_fields(
    group: FieldGroup,
    tissue: Tissue,
    demand: Demand,
    begin: float,
    end: float,
    first: Demand | None = None,
    leaving: Leaving | None = None,
) -> dict[str, FieldExchange]:
    """Bring fields, one of them with a finite medium, from ``begin`` to ``end`` (s).

    Parameters as for :meth:`FieldGroup.advance`; changes of the medium up to and at ``end`` that
    have not been done are done at their times. A steady field counts the change of its content as
    ``relaid``.
    """
    exchange = _Exchange(group, tissue, demand, begin)
    group.change_demand(first, begin, end, leaving)
    for time, level in (exchange.nutrient.media or ())[exchange.medium.changes :]:
        if time <= end:
            exchange.march(max(time, exchange.now))
            exchange.change(level)
    exchange.march(end)
    return exchange.finish()


@final
class _Exchange:
    """Fields and the medium of one of them on the way through one coupling step.

    - ``total``, amol: of a steady field with its medium
    - ``guess``, mM: concentration of the medium; of a steady field a first guess
    """

    def __init__(self, group: FieldGroup, tissue: Tissue, demand: Demand, begin: float) -> None:
        self.group, self.now = group, begin
        fields = list(group.fields.values())
        self.row = next(i for i, field in enumerate(fields) if field.well_mixed is not None)
        self.field = fields[self.row]
        self.nutrient = self.field.parameters.nutrient
        self.steady = group.first.parameters.regime == "steady"
        self.before = np.array([field.stored() for field in fields])
        group.begin(tissue, demand, begin, carry=not self.steady)
        self.relaid = group.masses() - self.before
        medium = self.field.well_mixed
        assert medium is not None
        volume = volume_beyond_grid(self.field.name, self.nutrient, group.layout.whole)
        amount = medium.amount - (0.0 if self.steady else float(self.relaid[self.row]))
        if abs(amount) <= _ROUNDING * float(self.before[self.row]):
            amount = max(amount, 0.0)  # of an empty medium rounding of the grid's content is left
        if not amount >= 0.0:
            name = self.field.name
            problem = f"the grid of {name} came to enclose more than its finite medium holds"
            hint = "Give finite_medium a larger volume, or let the field live on a domain"
            raise NutrientFailed(problem, hint)
        self.medium = replace(medium, volume=volume, amount=amount)
        self.total = float(self.before[self.row]) + medium.amount
        self.guess = self.medium.concentration
        self.amounts = np.zeros((len(fields), len(BALANCE_COLUMNS)))

    def change(self, level: float) -> None:
        """Replace medium by fresh one of a concentration in mM."""
        finite = self.nutrient.finite_medium
        assert finite is not None
        self.medium = self.medium.changed(level, finite.replaced)
        if self.steady:
            self.total = self._content() + self.medium.amount
        self.guess = self.medium.concentration

    def _content(self) -> float:
        return float(self.group.masses()[self.row])

    def march(self, end: float) -> None:
        """Bring all to ``end`` (s) by a solver of py-pde's registry; the account goes along."""
        if end > self.now:
            kind = AtRestWithMedium if self.steady else WithMedium
            equation = kind(self.group, self.row, self.medium, self.guess)
            state: Any = equation.state(self.total)
            nutrients = [field.parameters.nutrient for field in self.group.fields.values()]
            solver: Any = SolverBase.from_name(
                "multicell-march",
                equation,  # type: ignore[arg-type]
                tolerance=min(n.time_tolerance for n in nutrients),
            )
            first = end - self.now if self.steady else None
            solver.watch = self._watch if self.group.watch is not None else None
            solver.make_stepper(state, first)(state, self.now, end)
            self.group.info = solver.info
            self._enter(solver.info)
            self._take(state.data, equation)
            self.now = end
        if self.steady:
            self._settle()

    def _watch(self, time: float, data: FloatArray) -> None:
        """Hand on the values of the nodes on the way, of steady fields those of the last solve."""
        assert self.group.watch is not None
        nodes = self.group.nodes
        self.group.watch(time, nodes if self.steady else data[:-1].reshape(nodes.shape))

    def _enter(self, info: dict[str, Any]) -> None:
        """Enter what happened to the fields, and what decayed in the medium."""
        self.amounts = self.amounts + info["amounts"]
        level = float(info["amounts"][self.row][BALANCE_COLUMNS.index("level")])
        decayed = self.nutrient.decay * self.medium.volume * level
        self.medium = replace(self.medium, decayed=self.medium.decayed + decayed)

    def _take(self, data: FloatArray, equation: WithMedium | AtRestWithMedium) -> None:
        """Take over the solution of a solver."""
        if isinstance(equation, AtRestWithMedium):
            self.total, self.guess = float(data[0]), equation.level
            return
        nodes = self.group.nodes
        nodes[...] = data[:-1].reshape(nodes.shape)
        self.medium = replace(self.medium, amount=self.medium.volume * float(data[-1].flat[0]))
        self.guess = self.medium.concentration

    def _settle(self) -> None:
        """Bring steady fields to rest with the medium: both hold what is there in all."""
        slow = AtRestWithMedium(self.group, self.row, self.medium, self.guess)
        slow.settle(self.total, self.now)
        self.guess = slow.level
        # what the balance says, but for rounding beside an empty medium
        self.medium = replace(self.medium, amount=max(self.total - self._content(), 0.0))

    def finish(self) -> dict[str, FieldExchange]:
        """Give the fields what has been found, and return the account of the step."""
        self.field.well_mixed = self.medium
        self.group.finish(self.now)
        gained = self.group.masses() - self.before if self.steady else self.relaid
        return self.group.exchanges(self.amounts, gained)


_ONE: Final = UnitGrid([1])
"""A grid for a number."""

Excess = Callable[[float], tuple[float, float]]
"""Concentration of the medium, mM -> excess, and content of the field, amol."""


class _Medium:
    """Fields and the finite medium round one of them, for steps of backward Euler.

    - ``group``: the fields' equation and nodes
    - ``row``: of the field with the medium
    - ``level``: first guess of the concentration, mM
    """

    def __init__(self, group: FieldGroup, row: int, medium: WellMixed, level: float) -> None:
        self.equation, self.nodes = group.equation, group.nodes
        self.names, self.switches = self.equation.names, self.equation.switches
        self.row, self.level, self._volume = row, level, medium.volume
        self._placed = self.equation.substances[self.names[row]]
        self._decay = self._placed.substance.decay
        nutrients = [field.parameters.nutrient for field in group.fields.values()]
        self._faded = np.array([_FADED * nutrient.highest for nutrient in nutrients])
        self._slope = 0.0  # of what the field takes over the concentration, µm³/s

    def _content(self, nodes: FloatArray) -> float:
        """Return the content of the field that has the medium, amol."""
        layout = self.equation.layout
        return float(np.sum(layout.volumes * nodes.reshape(-1, *layout.shape)[self.row]))

    def _root(self, excess: Excess, guess: float, fixed: float, dt: float) -> float:
        """Return the concentration, not below zero, at which nothing is there too much.

        By secants, kept between what is known to be too little and too much. The last evaluation
        is that of the result.

        - ``fixed``, µm³: the part of its derivative that is known
        - ``dt``, s: what the slope of the exchange is multiplied with
        """
        low, high, x, slope = 0.0, math.inf, guess, fixed + dt * self._slope
        last: tuple[float, float] | None = None
        for count in range(_MOST):
            y, content = excess(x)
            exact, outside = _EXACT[count > _PATIENCE], self._volume * x
            # what the balance says is then not below zero either
            if abs(y) <= exact * (outside + content) and y <= outside:
                if dt > 0.0:
                    self._slope = max((slope - fixed) / dt, 0.0)
                return x
            low, high = (low, x) if y > 0.0 else (x, high)
            if last is not None and (y - last[1]) * (x - last[0]) > 0.0:
                slope = (y - last[1]) / (x - last[0])
            last = (x, y)
            x -= y / slope
            if not low <= x <= high or x == last[0]:
                x = 0.5 * (low + high) if low > 0.0 and high < math.inf else 0.1 * high
            if not math.isfinite(x) or (x == 0.0 and high == 0.0):
                break
        raise NutrientFailed(
            f"the concentration of the finite medium of {self.names[self.row]} was not found: "
            "no value agrees with what flows between it and the field",
            "A field that cells fill faster than it settles needs regime = 'transient'",
        )


@final
class WithMedium(_Medium):
    """Transient fields and the finite medium round one of them as one equation.

    The state is that of the fields with one more for the medium, which is uniform.
    """

    def state(self, _: float) -> FieldsView:
        """Return the state at the beginning, mM."""
        nodes = self.equation.view(self.nodes).data
        data = np.concatenate([nodes, np.full_like(nodes[:1], self.level)])
        return FieldsView(self.equation, data, [*self.names, "medium"])

    def implicit_step(self, data: FloatArray, dt: float, t: float) -> tuple[FloatArray, FloatArray]:
        """Take a step of backward Euler of ``dt`` s that ends at ``t``."""
        eq, volume, before, level = self.equation, self._volume, data[:-1], float(data[-1].flat[0])
        share = 1.0 + self._decay * dt
        found, taken, rows = before, 0.0, np.empty(0)

        def excess(trial: float) -> tuple[float, float]:
            nonlocal found, taken, rows
            self._placed.follow(trial)
            found, reports = eq.solution(found, t, dt, before)
            rows = dt * eq.exchanges(found, t, reports)
            taken = float(rows[self.row, BALANCE_COLUMNS.index("inflow")])
            return volume * (share * trial - level) + taken, self._content(found)

        new = self._root(excess, level, volume * share, dt)
        after = (volume * level - taken) / (volume * share)
        # the balance's own value, unless rounding puts it below zero
        uniform = np.full_like(data[-1:], after if after >= 0.0 else new)
        return np.concatenate([found.reshape(before.shape), uniform]), rows

    def scales(self, data: FloatArray, begin: float, end: float) -> FloatArray:
        """Return the concentration of fields and medium that errors are small beside, mM."""
        self._placed.follow(float(data[-1].flat[0]))
        found = np.maximum(self.equation.scales(data[:-1], begin, end), self._faded)
        return np.append(found, found[self.row])


_OTHERS: Final = np.array(
    [0.0 if name in ("inflow", "decayed") else SIGNS.get(name, 0.0) for name in BALANCE_COLUMNS]
)
"""What entries of an account add to field and medium together, but for what decays in both."""


@final
class AtRestWithMedium(_Medium):
    """Fields that rest at each moment, and the finite medium round one of them.

    The state is what that field and the medium hold together, (1,) amol; the fields are brought to
    rest along with the medium.
    """

    def state(self, total: float) -> ScalarField:
        """Return the state at the beginning, amol: one number."""
        return ScalarField(_ONE, [total])

    def _solve(self, level: float, t: float) -> tuple[dict[str, SolveReport], float]:
        """Bring the fields to rest with a medium of a concentration; return what is held."""
        self._placed.follow(level)
        found, reports = self.equation.steady_state(np.array(self.nodes), t)
        self.nodes[...] = found
        return reports, self._content(found)

    def implicit_step(self, data: FloatArray, dt: float, t: float) -> tuple[FloatArray, FloatArray]:
        """Take a step of backward Euler of ``dt`` s that ends at ``t``."""
        volume, decay, after, rows = self._volume, self._decay, data, np.empty(0)

        def excess(trial: float) -> tuple[float, float]:
            nonlocal after, rows
            reports, content = self._solve(trial, t)
            there = content + volume * trial
            rows = self.equation.exchanges(np.array(self.nodes), t, reports)
            after = data + dt * (rows[[self.row]] @ _OTHERS - decay * there)
            return there - float(after[0]), content

        fixed = (volume + self.equation.layout.whole) * (1.0 + decay * dt)
        self.level = self._root(excess, self.level, fixed, dt)
        there = self._content(np.array(self.nodes)) + volume * self.level
        return np.where(after >= 0.0, after, there), dt * rows

    def settle(self, total: float, t: float) -> None:
        """Find the concentration with which field at rest and medium hold so much, amol."""
        volume = self._volume

        def excess(trial: float) -> tuple[float, float]:
            _, content = self._solve(trial, t)
            return content + volume * trial - total, content

        self.level = self._root(excess, self.level, volume + self.equation.layout.whole, 0.0)

    def scales(self, data: FloatArray, begin: float, end: float) -> FloatArray:
        """Return the scale for errors of the total, (1,) amol."""
        return np.array([max(self.level, float(self._faded[self.row])) * self._volume])
