"""One substance on the nodes of a grid: what adds to it and takes it, for all solvers."""

from __future__ import annotations

from typing import Any, cast, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.nutrient.balance import BALANCE_COLUMNS
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.equations.grid import conditions_on
from multicell.nutrient.equations.substance import Conditions, Schedule, Substance
from multicell.nutrient.grid import BoxLayout, Layout
from multicell.nutrient.operators import AnyOperator, source_imbalance
from multicell.nutrient.spherical import Shells
from multicell.nutrient.steady import BALANCE_TOLERANCE, SolveReport
from multicell.nutrient.uptake import uptake_and_slope

_Spread = tuple[FloatArray, FloatArray, float]
_Course = tuple[float, float, _Spread, _Spread]
_Leaving = tuple[_Spread, FloatArray, FloatArray | None, FloatArray, FloatArray | None, FloatArray]


@final
class PlacedSubstance:
    """A substance on a grid.

    - ``name``, ``substance``, ``layout``: see :class:`multicell.FieldEquation`
    - ``position``, (n, 3), ``radius``, (n,), µm: of the cells; absent: they are points
    - ``threads``: how many may share the loops over many nodes; it changes no result

    - ``sink``, ``secreted``, mM/s: largest uptake per volume at each node, and what cells add;
      nodes as solvers have them, with three axes in a box and one on shells
    - ``operator``: diffusion, with the sides of the concentration that was asked for last
    - ``tolerance``: of what is at rest in a box, see :func:`.steady.solve_steady`
    """

    tolerance = BALANCE_TOLERANCE

    def __init__(
        self,
        name: str,
        substance: Substance,
        layout: Layout,
        position: FloatArray,
        radius: FloatArray | None = None,
        threads: int = 1,
    ) -> None:
        self.name, self.substance, self._threads = name, substance, threads
        self.layout, self.shape = layout, layout.shape
        self.schedule = substance.schedule
        self.linear = substance.decay + substance.perfusion
        self._conditions: Any = None
        self._exchange = substance.exchange
        self._scale()
        self.place(layout, position, radius, substance.capacity, substance.production)

    def place(
        self,
        layout: Layout,
        position: FloatArray,
        radius: FloatArray | None,
        capacity: FloatArray | None,
        production: FloatArray | None,
        exchange: FloatArray | None = None,
    ) -> None:
        """Take cells elsewhere, with other largest uptake and secretion (n,) in amol/s.

        ``layout`` may lie elsewhere too, and have other nodes of the same kind, which then have
        another ``exchange`` with the medium.
        """
        self.layout, self.shape = layout, layout.shape
        self._exchange = self._exchange if exchange is None else exchange
        if self._scaled != (layout.shape, layout.spacing):
            self._scale()
        elif exchange is not None and isinstance(self.operator, Diffusion):
            self.operator.set_exchange(exchange)
        self.sink, self.secreted, self._production = self._spread(
            position, radius, capacity, production
        )
        self._gained: tuple[float, FloatArray] | None = None
        self._course: _Course | None = None
        self._leaving: _Leaving | None = None

    def _spread(
        self,
        position: FloatArray,
        radius: FloatArray | None,
        capacity: FloatArray | None,
        production: FloatArray | None,
    ) -> _Spread:
        """Return largest uptake and secretion at nodes, mM/s, and all secretion, amol/s."""
        cells = position, radius
        capacity = np.zeros(len(position)) if capacity is None else capacity
        sink = self.spread(*cells, capacity, "capacity")
        if production is None:
            return sink, np.zeros(self.shape), 0.0
        return sink, self.spread(*cells, production, "production"), float(np.sum(production))

    def change_demand(
        self,
        position: FloatArray,
        radius: FloatArray | None,
        capacity: FloatArray,
        production: FloatArray | None,
        begin: float,
        end: float,
    ) -> None:
        """Let demand go linearly from this one at ``begin`` to what it is at ``end`` (s)."""
        first = self._spread(position, radius, capacity, production)
        self._course = begin, end, first, (self.sink, self.secreted, self._production)

    def let_leave(
        self,
        position: FloatArray,
        radius: FloatArray | None,
        capacity: FloatArray,
        production: FloatArray | None,
        leave: FloatArray,
    ) -> None:
        """Add cells that exchange until they leave, at times (k,) in s, and not thereafter."""
        stay = self.sink, self.secreted, self._production
        self._leaving = stay, position, radius, capacity, production, leave

    def set_time(self, t: float, dt: float = np.inf) -> None:
        """Take the demand of a time in s, where it changes.

        Cells that leave count by the part of the last ``dt`` s for which they are there; where that
        is infinite, as they are at ``t``.
        """
        if self._course is None and self._leaving is None:
            return
        if self._course is not None:
            begin, end, first, last = self._course
            part = (t - begin) / (end - begin)
            self.sink = (1.0 - part) * first[0] + part * last[0]
            self.secreted = (1.0 - part) * first[1] + part * last[1]
            self._production = (1.0 - part) * first[2] + part * last[2]
        if self._leaving is not None:
            stay, position, radius, capacity, production, leave = self._leaving
            if self._course is None:
                self.sink, self.secreted, self._production = stay
            share = (leave >= t) * 1.0
            if np.isfinite(dt):
                share = np.clip((leave - t) / dt + 1.0, 0.0, 1.0)
            product = None if production is None else share * production
            sink, secreted, made = self._spread(position, radius, share * capacity, product)
            self.sink, self.secreted = self.sink + sink, self.secreted + secreted
            self._production = self._production + made
        self._gained = None

    def _scale(self) -> None:
        """Renew what depends on the number of nodes and their distance."""
        p, layout, level = self.substance, self.layout, self.schedule.at(0.0)
        varied = None if p.varied is None else np.asarray(p.varied, float).reshape(self.shape)
        conditions = self.conditions_at(level)
        operator: AnyOperator
        before = getattr(self, "operator", None)
        if isinstance(layout, BoxLayout):
            exchange = self._exchange
            if exchange is not None:
                exchange = np.asarray(exchange, float).reshape(self.shape)
            known = before if isinstance(before, Diffusion) else None
            if known is not None and known.shape == layout.shape and varied is exchange is None:
                operator = known.resized(layout.box, conditions)
                operator.level = level
            else:
                operator = Diffusion(
                    layout.box,
                    p.diffusion,
                    conditions,
                    varied=varied,
                    exchange=exchange,
                    level=level,
                )
                operator.threads = self._threads
                operator.room = None if known is None else known.room
        else:
            operator = Shells(layout.radius, layout.count, p.diffusion, conditions, varied=varied)
        # at once: what is interrupted must not leave one beside the others
        self.operator, self._level, self._scaled = operator, level, (layout.shape, layout.spacing)

    @property
    def quickest_exchange(self) -> float:
        """Largest rate of exchange with a medium beyond the layer, 1/s."""
        operator = self.operator
        return operator.largest_exchange if isinstance(operator, Diffusion) else 0.0

    def follow(self, level: float) -> None:
        """Take another concentration of a medium that does not change by itself, mM."""
        self.schedule, self._gained = Schedule.steady(level), None

    def conditions_at(self, level: float) -> Conditions:
        """Return the conditions at a concentration of the medium in mM, for every side."""
        given = self.substance.conditions
        given = given(level) if callable(given) else given
        if given != self._conditions:  # those of the last time have been found to be right
            self._conditions = conditions_on(self.layout, given)
        return cast("Conditions", self._conditions)

    def spread(
        self, position: FloatArray, radius: FloatArray | None, amount: FloatArray, what: str
    ) -> FloatArray:
        """Return amounts of the cells, (n,) amol/s, as densities of the nodes, mM/s."""
        amount, path = np.asarray(amount), f"substances.{self.name}.{what}"
        if amount.shape != (len(position),):
            raise SceneError(path, f"has shape {amount.shape}, expected ({len(position)},)")
        # not so of what is no number either
        if np.count_nonzero((amount >= 0.0) & (amount < np.inf)) < len(amount):
            raise SceneError(path, "of some cell is negative or not finite")
        try:
            return self.layout.scatter(position, amount, radius)
        except ValueError as trouble:
            raise SceneError("position", str(trouble), "Lay the grid round all cells.") from None

    def at(self, level: float) -> AnyOperator:
        """Return the operator with the sides at a concentration of the medium in mM."""
        if level != self._level:
            if callable(self.substance.conditions):
                self.operator.set_boundary(self.conditions_at(level))
            if isinstance(self.operator, Diffusion):
                self.operator.level = level
            self._level = level
        return self.operator

    def supply(self, level: float) -> FloatArray:
        """Return the gain of nodes but over the sides, mM/s."""
        gain = self.substance.perfusion * level
        return self.secreted if gain == 0.0 else gain + self.secreted

    def gain(self, t: float) -> FloatArray:
        """Return all that nodes gain at a time in s, over the sides too, mM/s."""
        self.set_time(t)
        level = self.schedule.at(t)
        return np.asarray(self.at(level).brought() + self.supply(level))

    @property
    def gains_linearly(self) -> bool:
        """Whether nobody takes it up, and all that nodes gain changes linearly in time."""
        sinks = [self.sink] if self._course is None else [self.sink, self._course[2][0]]
        if self._leaving is not None:
            _, _, _, capacity, production, _ = self._leaving
            sinks += [capacity] if production is None else [capacity, production]
        return not any(sink.any() for sink in sinks)

    def rate(self, c: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
        """Return dc/dt (mM/s) and what uptake and decay add to it for each mM less (1/s)."""
        level = self.schedule.at(t)
        op, c = self.at(level), np.ascontiguousarray(c, dtype=float).reshape(self.shape)
        if self._gained is None or self._gained[0] != level:
            self._gained = level, np.ascontiguousarray(op.brought() + self.supply(level))
        half = self.substance.half_saturation
        return source_imbalance(op, c, self.sink, self._gained[1], half, self.linear)

    def solve(
        self,
        start: FloatArray,
        level: float,
        *,
        dt: float = np.inf,
        before: FloatArray | None = None,
    ) -> tuple[FloatArray, SolveReport]:
        """Solve for the state a step of backward Euler later, or at rest after an infinite one.

        - ``level``, float, mM: concentration of the medium at the end
        """
        linear, operator = self.linear, self.at(level)
        given = self.sink, self.substance.half_saturation, start
        if before is not None:
            supply, linear = before / dt + self.supply(level), linear + 1.0 / dt
            return operator.solve(*given, linear=linear, supply=supply)
        # to add zeros to many nodes takes as long as a loop
        none = self._production == 0.0 == self.substance.perfusion * level
        gained = None if none else self.supply(level)
        if isinstance(operator, Diffusion):
            return operator.solve(*given, linear=linear, supply=gained, tolerance=self.tolerance)
        return operator.solve(*given, linear=linear, supply=gained)

    def flows(self, c: FloatArray, level: float, made: FloatArray | None = None) -> SolveReport:
        """Return the exchange of a state (mM) with sides, cells, reactions (``made``, mM/s)."""
        volumes, operator = self.layout.volumes, self.at(level)
        if isinstance(operator, Diffusion):
            inward, outward = operator.flows(c)
        else:
            net = operator.inflow(c)
            inward, outward = max(net, 0.0), max(-net, 0.0)
        uptake = 0.0
        if self.sink.any():
            taken, _ = uptake_and_slope(self.sink, c, self.substance.half_saturation)
            uptake = float(np.sum(volumes * taken))
        gained = lost = 0.0
        if made is not None:
            gained = float(np.sum(volumes * np.maximum(made, 0.0)))
            lost = float(np.sum(volumes * np.maximum(-made, 0.0)))
        return SolveReport(
            0, 0, 0.0, inward - outward, uptake, outflow=outward, made=gained, used=lost
        )

    def account(self, c: FloatArray, level: float, flows: SolveReport) -> list[float]:
        """Return all that happens to a state (mM), amol/s: the columns :data:`BALANCE_COLUMNS`."""
        decayed = washed = came = 0.0
        if self.linear > 0.0:
            content, perfusion = float(np.sum(self.layout.volumes * c)), self.substance.perfusion
            decayed, washed = self.substance.decay * content, perfusion * content
            came = perfusion * (level * self.layout.whole - content)
        found = {
            "inflow": flows.inflow + came,
            "outflow": flows.outflow,
            "uptake": flows.uptake,
            "secreted": self._production,
            "made": flows.made,
            "used": flows.used,
            "level": level,
            "decayed": decayed,
            "washed": washed,
        }
        return [found[name] for name in BALANCE_COLUMNS]

    def inverse(self, r: FloatArray, shift: FloatArray) -> FloatArray:
        """Return about (shift - D L)⁻¹ r with ``shift`` (1/s) at the nodes, exactly on shells."""
        op, r = self.operator, np.array(r, dtype=float).reshape(self.shape)
        if isinstance(op, Diffusion):
            return op.near_inverse(r, shift)
        return op.solve_linear(shift * op.volumes, r * op.volumes)
