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
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from pde.fields.collection import FieldCollection
from pde.fields.scalar import ScalarField
from pde.grids.cartesian import UnitGrid
from pde.pdes.base import PDEBase
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient.balance import COLUMNS, SIGNS, Exchange
from multicell.nutrient.course import Course, Demand
from multicell.nutrient.medium import WellMixed, beyond

if TYPE_CHECKING:
    from multicell.nutrient.equations.equation import FieldEquation
    from multicell.nutrient.group import FieldGroup
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
    """Fields and their media on the way through one coupling step."""

    def __init__(
        self, group: FieldGroup, position: FloatArray, demand: Demand, radius: FloatArray | None,
        begin: float,
    ) -> None:  # fmt: skip
        self.group, self.now = group, begin
        self.steady = group.first.parameters.regime == "steady"
        self.before = [field.stored() for field in group.fields.values()]
        self.course = course = Course(group, position, demand, radius, begin, carry=not self.steady)
        self.relaid = course.masses() - np.array(self.before)
        self.media: dict[str, WellMixed] = {}
        for field, gained in zip(group.fields.values(), self.relaid.tolist(), strict=True):
            if field.well_mixed is not None:
                volume = beyond(field.name, field.parameters.nutrient, course.layout.whole)
                lost = 0.0 if self.steady else gained
                amount = field.well_mixed.amount - lost
                _refuse_overdrawn(field.name, amount)
                self.media[field.name] = replace(field.well_mixed, volume=volume, amount=amount)
        # of a steady field with its medium
        self.totals = {
            field.name: old + field.well_mixed.amount
            for field, old in zip(group.fields.values(), self.before, strict=True)
            if field.well_mixed is not None
        }
        self.guess = {name: medium.concentration for name, medium in self.media.items()}
        self.info = {"steps": 0, "rejections": 0, "first_order": 0, "error": 0.0}
        self.amounts = np.zeros((len(group.names), len(COLUMNS)))

    def changes(self, end: float) -> list[tuple[float, str, float]]:
        """Return time, field and concentration of what fresh medium comes up to ``end``."""
        found = []
        for name, medium in self.media.items():
            media = self.group.fields[name].parameters.nutrient.media or ()
            found += [(t, name, level) for t, level in media[medium.changes :] if t <= end]
        return sorted(found)

    def change(self, name: str, level: float) -> None:
        """Replace medium by fresh one of a concentration in mM."""
        finite = self.group.fields[name].parameters.nutrient.finite_medium
        assert finite is not None
        self.media[name] = self.media[name].changed(level, finite.replaced)
        if self.steady:
            self.totals[name] = self._content(name) + self.media[name].amount
            self.guess[name] = self.media[name].concentration

    def _content(self, name: str) -> float:
        return float(self.course.masses()[self.group.names.index(name)])

    def march(self, end: float) -> None:
        """Bring all to ``end`` (s) by a solver of py-pde's registry; the account goes along."""
        if end > self.now:
            state, equation = self._problem()
            nutrients = [f.parameters.nutrient for f in self.group.fields.values()]
            solver = SolverBase.from_name(
                "multicell-march", equation, tolerance=min(n.time_tolerance for n in nutrients)
            )
            first = end - self.now if self.steady else None
            solver.make_stepper(state, first)(state, self.now, end)
            self.group.info = solver.info
            self._enter(solver.info)
            self._take(state, equation)
            self.now = end
        if self.steady:
            self._settle()

    def _problem(self) -> tuple[Any, WithMedia | AtRestWithMedia]:
        """Return state and equation of the fields with their media."""
        course, volumes = self.course, {name: x.volume for name, x in self.media.items()}
        highest = {f.name: f.parameters.nutrient.highest for f in self.group.fields.values()}
        if self.steady:
            slow = AtRestWithMedia(course.equation, course.state, volumes, highest, self.guess)
            grid = UnitGrid([1])
            totals = [ScalarField(grid, [total]) for total in self.totals.values()]
            return FieldCollection(totals, labels=list(self.media)), slow
        equation, fields = WithMedia(course.equation, volumes, highest), course.state
        each = [fields] if isinstance(fields, ScalarField) else list(fields)
        media = [
            ScalarField(fields.grid, x.concentration, label=f"medium of {name}")
            for name, x in self.media.items()
        ]
        return FieldCollection([*each, *media]), equation

    def _enter(self, info: dict[str, Any]) -> None:
        """Enter what a solver has done, and what decayed in the media."""
        for key in ("steps", "rejections", "first_order"):
            self.info[key] += info[key]
        self.info["error"] = max(self.info["error"], info["error"])
        self.amounts = self.amounts + info["amounts"]
        for name, medium in self.media.items():
            row = info["amounts"][self.group.names.index(name)]
            decay = self.group.fields[name].parameters.nutrient.decay
            decayed = decay * medium.volume * float(row[COLUMNS.index("level")])
            self.media[name] = replace(medium, decayed=medium.decayed + decayed)

    def _take(self, state: Any, equation: WithMedia | AtRestWithMedia) -> None:
        """Take over what a solver has found."""
        if isinstance(equation, AtRestWithMedia):
            totals = np.ravel(state.data).tolist()
            self.totals = dict(zip(self.media, totals, strict=True))
            self.guess = dict(zip(self.media, equation.levels.tolist(), strict=True))
            return
        m, data = len(self.group.names), np.array(state.data)
        self.course.state.data[...] = data[:m].reshape(self.course.state.data.shape)
        for (name, medium), values in zip(self.media.items(), data[m:], strict=True):
            self.media[name] = replace(medium, amount=medium.volume * float(values.flat[0]))

    def _settle(self) -> None:
        """Bring steady fields to rest with their media: both hold what is there in all."""
        _, slow = self._problem()
        assert isinstance(slow, AtRestWithMedia)
        slow.settle(np.array(list(self.totals.values())), self.now)
        self.guess = dict(zip(self.media, slow.levels.tolist(), strict=True))
        for name, medium in self.media.items():
            # what the balance says, but for rounding beside an empty medium
            amount = self.totals[name] - self._content(name)
            self.media[name] = replace(medium, amount=amount if amount > 0.0 else 0.0)

    def finish(self) -> dict[str, Exchange]:
        """Give the fields what has been found, and return the account of the step."""
        for name, medium in self.media.items():
            self.group.fields[name].well_mixed = medium
        self.course.finish(self.now)
        gained = self.course.masses() - np.array(self.before) if self.steady else self.relaid
        return self.course.march({**self.info, "amounts": self.amounts}, gained)


def _refuse_overdrawn(name: str, amount: float) -> None:
    if not amount >= 0.0:
        raise NutrientFailed(
            f"the grid of {name} came to enclose more than its finite medium holds",
            "Give finite_medium a larger volume, or let the field live on a domain",
        )


@final
class WithMedia(PDEBase):  # type: ignore[no-untyped-call]
    """Transient fields and the finite media round them as one equation.

    The state is that of ``equation`` with one more field for each medium, which is uniform.

    - ``equation``: of the fields alone
    - ``volumes``: of the well-mixed media by name of the field, µm³
    - ``highest``: largest concentration of all fields, mM
    """

    def __init__(
        self, equation: FieldEquation, volumes: dict[str, float], highest: dict[str, float]
    ) -> None:
        super().__init__()
        self.equation, self.names = equation, equation.names
        self._media = [self.names.index(name) for name in volumes]
        self._volumes = np.array(list(volumes.values()))
        self._placed = [equation.substances[name] for name in volumes]
        self._highest = np.array([highest[name] for name in self.names])
        self.decay = np.array([each.substance.decay for each in self._placed])
        self._root = _Root(list(volumes))

    def _parts(self, data: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the fields' values and the media's concentrations."""
        m = len(self.names)
        return data[:m], data[m:].reshape(len(data) - m, -1)[:, 0].copy()

    def _at(self, levels: FloatArray) -> None:
        for each, level in zip(self._placed, levels.tolist(), strict=True):
            each.follow(level)

    def implicit_step(self, data: FloatArray, dt: float, t: float) -> tuple[FloatArray, FloatArray]:
        """Take a step of backward Euler of ``dt`` s that ends at ``t``."""
        eq, volume = self.equation, self._volumes
        before, levels = self._parts(data)
        share = 1.0 + self.decay * dt
        found, taken, rows = before, levels, np.empty(0)

        def excess(trial: FloatArray) -> tuple[FloatArray, FloatArray]:
            nonlocal found, taken, rows
            self._at(trial)
            found, reports = eq.solution(found, t, dt, before)
            rows = dt * eq.exchanges(found, t, reports)
            taken = rows[self._media, COLUMNS.index("inflow")]
            return volume * (share * trial - levels) + taken, self._contents(found)

        new = self._root.find(excess, levels, volume * share, volume, dt)
        after = (volume * levels - taken) / (volume * share)
        # the balance's own value, unless rounding puts it below zero
        after = np.where(after >= 0.0, after, new)
        uniform = np.broadcast_to(
            after.reshape(-1, *[1] * (data.ndim - 1)), data[len(before) :].shape
        )
        return np.concatenate([found.reshape(before.shape), uniform]), rows

    def _contents(self, nodes: FloatArray) -> FloatArray:
        """Return what the fields that have a medium hold, (k,) amol."""
        nodes = nodes.reshape(-1, *self.equation.layout.shape)
        volumes = self.equation.layout.volumes
        return np.array([float(np.sum(volumes * nodes[i])) for i in self._media])

    def scales(self, data: FloatArray, begin: float, end: float) -> FloatArray:
        """Return the concentration of each field and medium that errors are small beside, mM."""
        before, levels = self._parts(data)
        self._at(levels)
        found = self.equation.scales(before, begin, end)
        found = np.maximum(found, _FADED * self._highest)
        return np.concatenate([found, found[self._media]])

    def growing(self, data: FloatArray) -> str:
        """Return in words which substance grows without bound; empty if none does."""
        return self.equation.growing(data[: len(self.names)])

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two at which a medium that is not finite jumps, s."""
        return self.equation.switches(begin, end)

    def evolution_rate(self, state: Any, t: float = 0.0) -> Any:
        """Return ∂c/∂t of fields and media, mM/s."""
        result = state.copy()
        result.data[...], _ = self.rates(np.array(state.data), t)
        return result

    def rates(self, data: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
        """Return ∂c/∂t (mM/s) and the derivative of all sinks (1/s)."""
        eq = self.equation
        nodes, levels = self._parts(data)
        self._at(levels)
        out, slope = (np.zeros_like(data) for _ in range(2))
        m = len(nodes)
        out[:m], slope[:m] = eq.rates(nodes, t)
        taken = eq.exchanges(nodes, t)[self._media, COLUMNS.index("inflow")]
        for k, level in enumerate(levels.tolist()):
            out[m + k] = -taken[k] / self._volumes[k] - self.decay[k] * level
            slope[m + k] = self.decay[k]
        return out, slope


_OTHERS: Final = np.array([
    0.0 if name in ("inflow", "decayed") else SIGNS.get(name, 0.0) for name in COLUMNS
])  # fmt: skip
"""What entries of an account add to field and medium together, but for what decays in both."""


@final
class AtRestWithMedia(PDEBase):  # type: ignore[no-untyped-call]
    """Fields that rest at each moment, and the finite media round them.

    The state is what each field that has a medium and that medium hold together, amol, on one node.

    - ``equation``, ``volumes``, ``highest``: see :class:`WithMedia`
    - ``state``: of the fields; it is brought to rest along with the media
    - ``levels``: first guess of the media's concentrations, mM
    """

    def __init__(
        self, equation: FieldEquation, state: Any, volumes: dict[str, float],
        highest: dict[str, float], levels: dict[str, float],
    ) -> None:  # fmt: skip
        super().__init__()
        self.equation, self.state, self.names = equation, state, equation.names
        self._with = WithMedia(equation, volumes, highest)
        self._volumes = np.array(list(volumes.values()))
        self._highest = np.array([highest[name] for name in volumes])
        self._rows = [self.names.index(name) for name in volumes]
        self.levels = np.array(list(levels.values()))

    def _solve(self, levels: FloatArray, t: float) -> dict[str, SolveReport]:
        self._with._at(levels)
        data = np.array(self.state.data)
        self.state.data[...], reports = self.equation.steady_state(data, t)
        return reports

    def _contents(self) -> FloatArray:
        return self._with._contents(np.array(self.state.data))

    def implicit_step(self, data: FloatArray, dt: float, t: float) -> tuple[FloatArray, FloatArray]:
        """Take a step of backward Euler of ``dt`` s that ends at ``t``; see :class:`WithMedia`."""
        before, volume, layout = np.ravel(data), self._volumes, self.equation.layout
        decay = self._with.decay
        after, rows = before, np.empty(0)

        def excess(trial: FloatArray) -> tuple[FloatArray, FloatArray]:
            nonlocal after, rows
            reports = self._solve(trial, t)
            content = self._contents()
            there = content + volume * trial
            rows = self.equation.exchanges(np.array(self.state.data), t, reports)
            after = before + dt * (rows[self._rows] @ _OTHERS - decay * there)
            return there - after, content

        fixed = (volume + layout.whole) * (1.0 + decay * dt)
        self.levels = self._with._root.find(excess, self.levels, fixed, volume, dt)
        after = np.where(after >= 0.0, after, self._contents() + volume * self.levels)
        return after.reshape(data.shape), dt * rows

    def settle(self, totals: FloatArray, t: float) -> None:
        """Find the concentrations with which fields at rest and media hold so much, amol."""
        volume = self._volumes

        def excess(trial: FloatArray) -> tuple[FloatArray, FloatArray]:
            self._solve(trial, t)
            content = self._contents()
            return content + volume * trial - totals, content

        slope = volume + self.equation.layout.whole
        self.levels = self._with._root.find(excess, self.levels, slope, volume, 0.0)

    def scales(self, data: FloatArray, begin: float, end: float) -> FloatArray:
        """Return what errors of each total are small beside, amol."""
        level = np.maximum(self.levels, _FADED * self._highest)
        return np.asarray(level * self._volumes)

    def growing(self, data: FloatArray) -> str:
        """Return in words which substance grows without bound; empty if none does."""
        return self.equation.growing(np.array(self.state.data))

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two at which a medium that is not finite jumps, s."""
        return self.equation.switches(begin, end)

    def evolution_rate(self, state: Any, t: float = 0.0) -> Any:
        """Refuse: what rests has no rate."""
        raise NotImplementedError("fields at rest with finite media know steps only")


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
