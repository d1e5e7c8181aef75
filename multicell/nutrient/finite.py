"""A finite volume of stirred medium, which the cells of a field use up.

All the medium of a field is its grid and, beyond that, a part of volume V that is stirred and has
one concentration C. It exchanges with the grid what flows over the sides and what a perfusion
brings, J, and decays as the field does:

    V dC/dt = -J - k_d V C,

with C the boundary value of the field. Where the field is transient, its nodes and C are one state,
which :class:`WithMedia` brings forward; where it is steady, the state is the amount in both, and
the field at each moment the steady one of the C with which field and stirred part together hold
that (:class:`AtRestWithMedia`). In each implicit step C is the root of a function that rises with
C, since more flows in where there is more outside. Fields that react may each have a medium.

When the grid follows the tissue, it takes medium in or gives it back: V changes too, and C does not
where the field has the same concentration there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient.balance import COLUMNS, SIGNS, Exchange, WellMixed, beyond

if TYPE_CHECKING:
    from multicell.nutrient.group import Demand, FieldGroup
    from multicell.nutrient.steady import SolveReport

_FADED: Final = 1e-3
"""Part of the highest concentration below which a medium that is used up is not followed with an
error relative to itself any more, but to this."""

_MOST: Final = 100
"""Evaluations in which a concentration of the medium must be found; two to four are usual."""

_EXACT: Final = (1e-9, 1e-7)
"""Part of what field and medium hold that may be missing when the medium's concentration is
accepted: the boundary value of the field is so near to it. The second after ``_PATIENCE``
evaluations: what the field's solver leaves over may be as much."""

_PATIENCE: Final = 15


def advance(
    group: FieldGroup,
    position: FloatArray,
    demand: Demand,
    radius: FloatArray | None,
    begin: float,
    end: float,
) -> dict[str, Exchange]:
    """Bring fields with their finite media from ``begin`` to ``end`` (s).

    Parameters as for :meth:`FieldGroup.advance`; changes of the media up to and at ``end`` that
    have not been done are done at their times. A steady field counts as ``relaid`` what its content
    has changed by.
    """
    exchange = _Exchange(group, position, demand, radius, begin)
    for time, name, level in exchange.changes(end):
        exchange.march(max(time, exchange.now))
        exchange.change(name, level)
    exchange.march(end)
    return exchange.finish()


@final
class _Exchange:
    """Fields and their media on the way through one coupling step.

    - ``totals``, name -> amol: of a steady field with its medium
    - ``guess``, name -> mM: concentration of the medium; of steady fields a first guess
    """

    def __init__(
        self, group: FieldGroup, position: FloatArray, demand: Demand, radius: FloatArray | None,
        begin: float,
    ) -> None:  # fmt: skip
        self.group, self.now = group, begin
        self.nutrients = {name: f.parameters.nutrient for name, f in group.fields.items()}
        self.steady = group.first.parameters.regime == "steady"
        self.before = np.array([field.stored() for field in group.fields.values()])
        group.begin(position, demand, radius, begin, carry=not self.steady)
        self.relaid = group.masses() - self.before
        self.media: dict[str, WellMixed] = {}
        self.totals: dict[str, float] = {}
        self.guess: dict[str, float] = {}
        for i, (name, field) in enumerate(group.fields.items()):
            medium = field.well_mixed
            if medium is None:
                continue
            volume = beyond(name, self.nutrients[name], group.layout.whole)
            amount = medium.amount - (0.0 if self.steady else float(self.relaid[i]))
            if not amount >= 0.0:
                problem = f"the grid of {name} came to enclose more than its finite medium holds"
                hint = "Give finite_medium a larger volume, or let the field live on a domain"
                raise NutrientFailed(problem, hint)
            self.media[name] = replace(medium, volume=volume, amount=amount)
            self.totals[name] = float(self.before[i]) + medium.amount
            self.guess[name] = self.media[name].concentration
        self.amounts = np.zeros((len(group.names), len(COLUMNS)))

    def changes(self, end: float) -> list[tuple[float, str, float]]:
        """Return time, field and concentration of what fresh medium comes up to ``end``."""
        found = []
        for name, medium in self.media.items():
            media = (self.nutrients[name].media or ())[medium.changes :]
            found += [(t, name, level) for t, level in media if t <= end]
        return sorted(found)

    def change(self, name: str, level: float) -> None:
        """Replace medium by fresh one of a concentration in mM."""
        finite = self.nutrients[name].finite_medium
        assert finite is not None
        self.media[name] = self.media[name].changed(level, finite.replaced)
        if self.steady:
            self.totals[name] = self._content(name) + self.media[name].amount
        self.guess[name] = self.media[name].concentration

    def _content(self, name: str) -> float:
        return float(self.group.masses()[self.group.names.index(name)])

    def march(self, end: float) -> None:
        """Bring all to ``end`` (s) by a solver of py-pde's registry; the account goes along."""
        if end > self.now:
            kind = AtRestWithMedia if self.steady else WithMedia
            equation = kind(self.group, self.media, self.guess)
            state: Any = SimpleNamespace(data=equation.data(self.totals))
            solver = SolverBase.from_name(
                "multicell-march", equation,  # type: ignore[arg-type]
                tolerance=min(n.time_tolerance for n in self.nutrients.values()),
            )  # fmt: skip
            first = end - self.now if self.steady else None
            solver.make_stepper(state, first)(state, self.now, end)
            self.group.info = solver.info
            self._enter(solver.info)
            self._take(state.data, equation)
            self.now = end
        if self.steady:
            self._settle()

    def _enter(self, info: dict[str, Any]) -> None:
        """Enter what happened to the fields, and what decayed in the media."""
        self.amounts = self.amounts + info["amounts"]
        for name, medium in self.media.items():
            row = info["amounts"][self.group.names.index(name)]
            level = float(row[COLUMNS.index("level")])
            decayed = self.nutrients[name].decay * medium.volume * level
            self.media[name] = replace(medium, decayed=medium.decayed + decayed)

    def _take(self, data: FloatArray, equation: WithMedia | AtRestWithMedia) -> None:
        """Take over what a solver has found."""
        if isinstance(equation, AtRestWithMedia):
            self.totals = dict(zip(self.media, data.tolist(), strict=True))
            self.guess = dict(zip(self.media, equation.levels.tolist(), strict=True))
            return
        m, nodes = len(self.group.names), self.group.state.data
        nodes[...] = data[:m].reshape(nodes.shape)
        for (name, medium), values in zip(self.media.items(), data[m:], strict=True):
            self.media[name] = replace(medium, amount=medium.volume * float(values[0]))
            self.guess[name] = self.media[name].concentration

    def _settle(self) -> None:
        """Bring steady fields to rest with their media: both hold what is there in all."""
        slow = AtRestWithMedia(self.group, self.media, self.guess)
        slow.settle(slow.data(self.totals), self.now)
        self.guess = dict(zip(self.media, slow.levels.tolist(), strict=True))
        for name, medium in self.media.items():
            # what the balance says, but for rounding beside an empty medium
            amount = self.totals[name] - self._content(name)
            self.media[name] = replace(medium, amount=amount if amount > 0.0 else 0.0)

    def finish(self) -> dict[str, Exchange]:
        """Give the fields what has been found, and return the account of the step."""
        for name, medium in self.media.items():
            self.group.fields[name].well_mixed = medium
        self.group.finish(self.now)
        gained = self.group.masses() - self.before if self.steady else self.relaid
        return self.group.exchanges(self.amounts, gained)


class _Media:
    """Fields and the finite media round them, for steps of backward Euler.

    - ``group``: the fields' equation and state
    - ``media``, ``levels``: by name of the field; first guess of the concentrations, mM
    """

    def __init__(
        self, group: FieldGroup, media: Mapping[str, WellMixed], levels: Mapping[str, float]
    ) -> None:
        self.equation, self.state = group.equation, group.state
        self.names, self.switches = self.equation.names, self.equation.switches
        self.levels = np.array(list(levels.values()))
        self._rows = [self.names.index(name) for name in media]
        self._volumes = np.array([medium.volume for medium in media.values()])
        self._placed = [self.equation.substances[name] for name in media]
        self._decay = np.array([each.substance.decay for each in self._placed])
        nutrients = [field.parameters.nutrient for field in group.fields.values()]
        self._faded = np.array([_FADED * nutrient.highest for nutrient in nutrients])
        self._root = _Root(list(media))

    def _at(self, levels: FloatArray) -> None:
        for each, level in zip(self._placed, levels.tolist(), strict=True):
            each.follow(level)

    def _contents(self, nodes: FloatArray) -> FloatArray:
        """Return what the fields that have a medium hold, (k,) amol."""
        layout = self.equation.layout
        nodes = nodes.reshape(-1, *layout.shape)
        return np.array([float(np.sum(layout.volumes * nodes[i])) for i in self._rows])


@final
class WithMedia(_Media):
    """Transient fields and the finite media round them as one equation.

    The state is that of the fields with one more field for each medium, which is uniform.
    """

    def data(self, totals: Mapping[str, float]) -> FloatArray:
        """Return the state at the beginning, mM."""
        fields = np.reshape(self.state.data, (len(self.names), -1))
        media = np.repeat(self.levels[:, None], fields.shape[1], axis=1)
        return np.concatenate([fields, media])

    def _parts(self, data: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the fields' values and the media's concentrations."""
        m = len(self.names)
        return data[:m], data[m:, 0].copy()

    def implicit_step(self, data: FloatArray, dt: float, t: float) -> tuple[FloatArray, FloatArray]:
        """Take a step of backward Euler of ``dt`` s that ends at ``t``."""
        eq, volume = self.equation, self._volumes
        before, levels = self._parts(data)
        share = 1.0 + self._decay * dt
        found, taken, rows = before, levels, np.empty(0)

        def excess(trial: FloatArray) -> tuple[FloatArray, FloatArray]:
            nonlocal found, taken, rows
            self._at(trial)
            found, reports = eq.solution(found, t, dt, before)
            rows = dt * eq.exchanges(found, t, reports)
            taken = rows[self._rows, COLUMNS.index("inflow")]
            return volume * (share * trial - levels) + taken, self._contents(found)

        new = self._root.find(excess, levels, volume * share, volume, dt)
        after = (volume * levels - taken) / (volume * share)
        # the balance's own value, unless rounding puts it below zero
        after = np.where(after >= 0.0, after, new)
        uniform = np.repeat(after[:, None], data.shape[1], axis=1)
        return np.concatenate([found.reshape(before.shape), uniform]), rows

    def scales(self, data: FloatArray, begin: float, end: float) -> FloatArray:
        """Return the concentration of each field and medium that errors are small beside, mM."""
        before, levels = self._parts(data)
        self._at(levels)
        found = np.maximum(self.equation.scales(before, begin, end), self._faded)
        return np.concatenate([found, found[self._rows]])


_OTHERS: Final = np.array([
    0.0 if name in ("inflow", "decayed") else SIGNS.get(name, 0.0) for name in COLUMNS
])  # fmt: skip
"""What entries of an account add to field and medium together, but for what decays in both."""


@final
class AtRestWithMedia(_Media):
    """Fields that rest at each moment, and the finite media round them.

    The state is what each field that has a medium and that medium hold together, (k,) amol; the
    fields are brought to rest along with the media.
    """

    def data(self, totals: Mapping[str, float]) -> FloatArray:
        """Return the state at the beginning, amol."""
        return np.array(list(totals.values()))

    def _solve(self, levels: FloatArray, t: float) -> tuple[dict[str, SolveReport], FloatArray]:
        """Bring the fields to rest with media of these concentrations; return what they hold."""
        self._at(levels)
        found, reports = self.equation.steady_state(np.array(self.state.data), t)
        self.state.data[...] = found
        return reports, self._contents(found)

    def implicit_step(self, data: FloatArray, dt: float, t: float) -> tuple[FloatArray, FloatArray]:
        """Take a step of backward Euler of ``dt`` s that ends at ``t``."""
        volume, decay, after, rows = self._volumes, self._decay, data, np.empty(0)

        def excess(trial: FloatArray) -> tuple[FloatArray, FloatArray]:
            nonlocal after, rows
            reports, content = self._solve(trial, t)
            there = content + volume * trial
            rows = self.equation.exchanges(np.array(self.state.data), t, reports)
            after = data + dt * (rows[self._rows] @ _OTHERS - decay * there)
            return there - after, content

        fixed = (volume + self.equation.layout.whole) * (1.0 + decay * dt)
        self.levels = self._root.find(excess, self.levels, fixed, volume, dt)
        there = self._contents(np.array(self.state.data)) + volume * self.levels
        return np.where(after >= 0.0, after, there), dt * rows

    def settle(self, totals: FloatArray, t: float) -> None:
        """Find the concentrations with which fields at rest and media hold so much, amol."""
        volume = self._volumes

        def excess(trial: FloatArray) -> tuple[FloatArray, FloatArray]:
            _, content = self._solve(trial, t)
            return content + volume * trial - totals, content

        slope = volume + self.equation.layout.whole
        self.levels = self._root.find(excess, self.levels, slope, volume, 0.0)

    def scales(self, data: FloatArray, begin: float, end: float) -> FloatArray:
        """Return what errors of each total are small beside, amol."""
        return np.asarray(np.maximum(self.levels, self._faded[self._rows]) * self._volumes)


Excess = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Concentrations of the media (k,) mM -> what is there too much, and what fields hold, amol."""


@final
class _Root:
    """Finds the concentrations of media, not below zero, at which nothing is there too much."""

    def __init__(self, names: list[str]) -> None:
        self.names = names
        self.slope = np.zeros(len(names))  # of what fields take over the concentration, µm³/s

    def find(
        self, excess: Excess, guess: FloatArray, fixed: FloatArray, volume: FloatArray, dt: float
    ) -> FloatArray:
        """Return the concentrations; the last evaluation is that of the result.

        - ``fixed``, (k,) µm³: the part of its derivative that is known
        - ``dt``, float, s: what the slope of the exchange is multiplied with
        """
        first = fixed + dt * self.slope
        if len(guess) == 1:
            found, slope = self._one(excess, guess, first, volume)
        else:
            found, slope = self._several(excess, guess, first, volume)
        if dt > 0.0:
            self.slope = np.maximum((slope - fixed) / dt, 0.0)
        return found

    def _one(
        self, excess: Excess, guess: FloatArray, first: FloatArray, volume: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Go by secants, kept between what is known to be too little and too much."""
        low, high, x, slope = 0.0, math.inf, float(guess[0]), float(first[0])
        last: tuple[float, float] | None = None
        for count in range(_MOST):
            values, content = excess(np.array([x]))
            y, exact = float(values[0]), _EXACT[count > _PATIENCE]
            outside = float(volume[0]) * x
            # what the balance says is then not below zero either
            if abs(y) <= exact * (outside + float(content[0])) and y <= outside:
                return np.array([x]), np.array([slope])
            low, high = (low, x) if y > 0.0 else (x, high)
            if last is not None and (y - last[1]) * (x - last[0]) > 0.0:
                slope = (y - last[1]) / (x - last[0])
            last = (x, y)
            x -= y / slope
            if not low <= x <= high or x == last[0]:
                x = 0.5 * (low + high) if low > 0.0 and high < math.inf else 0.1 * high
            if not math.isfinite(x) or (x == 0.0 and high == 0.0):
                break
        raise self._failure()

    def _several(
        self, excess: Excess, guess: FloatArray, first: FloatArray, volume: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Go by Broyden's method (1965) from a diagonal; no step takes more than nine tenths."""
        x, jacobian = guess.copy(), np.diag(first)
        y, content = excess(x)
        for count in range(_MOST):
            exact, outside = _EXACT[count > _PATIENCE], volume * x
            if (np.abs(y) <= exact * (outside + content)).all() and (y <= outside).all():
                return x, np.diag(jacobian)
            change = np.linalg.solve(jacobian, -y)
            change = np.maximum(change, -0.9 * x)
            length = float(np.sum(change * change))
            if not (math.isfinite(length) and length > 0.0):
                break
            x = x + change
            before = y
            y, content = excess(x)
            missing = y - before - np.sum(jacobian * change, axis=1)
            jacobian = jacobian + np.outer(missing, change) / length
        raise self._failure()

    def _failure(self) -> NutrientFailed:
        return NutrientFailed(
            f"the concentration of the finite medium of {' and '.join(self.names)} was not found: "
            "no value agrees with what flows between it and the field",
            "A field that cells fill faster than it settles needs regime = 'transient'",
        )
