"""One substance on the nodes of a grid: what adds to it and takes it, for all solvers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.nutrient.balance import COLUMNS
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.equations.grid import conditions_on, numbers_only
from multicell.nutrient.equations.schedule import Schedule
from multicell.nutrient.equations.substance import Conditions, Substance
from multicell.nutrient.grid import BoxLayout, Layout
from multicell.nutrient.operators import AnyOperator, brought, imbalance
from multicell.nutrient.spherical import Shells
from multicell.nutrient.steady import SolveReport
from multicell.nutrient.uptake import uptake_and_slope

if TYPE_CHECKING:
    from pde.grids.base import GridBase

_ROUNDING = 1e-9


@final
class Flows(NamedTuple):
    """What a state exchanges, amol/s.

    ``inflow`` over the sides, net; ``outflow``, what leaves over them; ``uptake`` by cells;
    ``made`` and ``used`` by reactions, where in the sum of them one or the other prevails.
    """

    inflow: float
    outflow: float
    uptake: float
    made: float
    used: float


@final
class PlacedSubstance:
    """A substance on a grid.

    - ``name``, ``substance``, ``layout``: see :class:`multicell.FieldEquation`
    - ``grid``: returns py-pde's grid; it is called where py-pde's own Laplacian or conditions are
      wanted
    - ``position``, (n, 3), µm: of the cells
    - ``threads``: how many may share the loops over many nodes; it changes no result

    - ``sink``, mM/s: largest uptake per volume at each node; nodes as solvers have them, with three
      axes in a box and one on shells
    - ``secreted``, ``supplied``, mM/s: what cells add, and what stands still
    - ``operator``: diffusion, with the sides of the concentration that was asked for last
    """

    def __init__(
        self,
        name: str,
        substance: Substance,
        layout: Layout,
        grid: Callable[[], GridBase],
        position: FloatArray,
        threads: int = 1,
    ) -> None:
        self.name, self.substance, self.layout = name, substance, layout
        self._grid, self._threads = grid, threads
        self.schedule = substance.schedule
        self.linear = sum(term.rate for term in substance.linear_terms)
        self.shape = layout.shape
        self._reference = self.schedule.at(0.0) if self.schedule.constant else 0.0
        self._plain = numbers_only(self.conditions_at(self._reference))
        self._level = self._reference
        self._laplace: tuple[float, Callable[[FloatArray], FloatArray]] | None = None
        self.operator = self._operator(self._reference)
        self.supplied = self._supplied()
        self.place(layout, position, substance.capacity, substance.production)
        if not self._plain:
            self._refuse_other_conditions()

    def place(
        self, layout: Layout, position: FloatArray, capacity: FloatArray | None,
        production: FloatArray | None,
    ) -> None:  # fmt: skip
        """Take cells elsewhere, with other largest uptake and secretion (n,) in amol/s.

        ``layout`` may lie elsewhere too, and have other nodes of the same kind.
        """
        if layout is not self.layout:
            scaled = (layout.shape, layout.spacing) != (self.shape, self.layout.spacing)
            self.layout, self.shape, self._laplace = layout, layout.shape, None
            if scaled:
                self._scale()
        none = np.zeros(len(position))
        self.sink = self.spread(position, none if capacity is None else capacity)
        self.secreted = self._none = _nothing(self.shape)
        self._production = 0.0
        if production is not None:
            self.secreted = self.spread(position, production)
            self._production = float(np.sum(production))
        self._base: FloatArray | None = None

    def _scale(self) -> None:
        """Renew what depends on the number of nodes and their distance."""
        self._level = self._reference
        self.operator = self._operator(self._reference)
        self.supplied = self._supplied()
        for derived in ("faces", "per_level", "_injected"):
            self.__dict__.pop(derived, None)

    def follow(self, level: float) -> None:
        """Take another concentration of a medium that does not change by itself, mM."""
        self.schedule = Schedule.steady(level)
        self._base = None
        self._reference = level
        self.__dict__.pop("faces", None)

    def conditions_at(self, level: float) -> Conditions:
        """Return the conditions at a concentration of the medium in mM, for every side."""
        given = self.substance.conditions
        return conditions_on(self.layout, given(level) if callable(given) else given)

    def _supplied(self) -> FloatArray:
        """Return what nodes gain from what stands still, mM/s."""
        supply = self.substance.supply
        if supply is None:
            return _nothing(self.shape)
        if np.size(supply) != np.prod(self.shape):
            problem = f"has the shape {np.shape(supply)}, the grid has {self.shape}"
            raise SceneError(f"substances.{self.name}.supply", problem)
        return np.asarray(supply, dtype=float).reshape(self.shape)

    def _refuse_other_conditions(self) -> None:
        """Refuse conditions that the solvers' kernels would take for others."""
        rng = np.random.default_rng(0)
        c = 1.0 + rng.random(self.shape)
        ours, _ = self.rate(c, 0.0)
        theirs = self.reference_rate(c, 0.0)
        if not np.abs(ours - theirs).max() <= _ROUNDING * np.abs(theirs).max():
            raise SceneError(
                f"substances.{self.name}.conditions",
                "are none that fields know: a value, a derivative or a mixed condition, with one "
                "permeability all over a side",
            )

    def spread(self, position: FloatArray, amount: FloatArray) -> FloatArray:
        """Return amounts of the cells, (n,) amol/s, as densities of the nodes, mM/s."""
        if len(amount) != len(position):
            problem = f"has {len(amount)} cells, but there are positions of {len(position)}"
            raise SceneError(f"substances.{self.name}", problem)
        try:
            return self.layout.scatter(position, amount)
        except ValueError as trouble:
            raise SceneError("position", str(trouble), "Lay the grid round all cells.") from None

    def at(self, level: float) -> AnyOperator:
        """Return the operator with the sides at a concentration of the medium in mM."""
        if level != self._level:
            if callable(self.substance.conditions):
                self.operator.set_boundary(self.conditions_at(level))
            self._level = level
        return self.operator

    def _operator(self, level: float) -> AnyOperator:
        """Return a new operator with the sides at a concentration of the medium in mM."""
        p, layout = self.substance, self.layout
        conditions = self.conditions_at(level)
        varied = None if p.varied is None else np.asarray(p.varied).reshape(self.shape)
        if not isinstance(layout, BoxLayout):
            count = self.shape[0]
            return Shells(layout.spacing * count, count, p.diffusion, conditions, varied=varied)
        height = layout.box.height
        grid: Any = layout.box if self._plain else self._grid()
        found = Diffusion(grid, p.diffusion, conditions, height=height, varied=varied)
        found.threads = self._threads
        return found

    @cached_property
    def faces(self) -> FloatArray:
        """What nodes gain over the sides, mM/s, at a medium of 0 mM where that changes."""
        return brought(self._operator(self._reference))

    @cached_property
    def per_level(self) -> FloatArray | None:
        """What nodes gain for each mM in a medium that changes, 1/s; None where it does not."""
        if self.schedule.constant:
            return None
        found = brought(self._operator(1.0)) - self.faces + (self._gain(1.0) - self._gain(0.0))
        return np.ascontiguousarray(found)

    def _gain(self, level: float) -> float:
        """Return what linear terms bring to each node, mM/s."""
        return sum(term.gain(level) for term in self.substance.linear_terms)

    @property
    def base(self) -> FloatArray:
        """What nodes gain in all, mM/s, at a medium of 0 mM where that changes."""
        if self._base is None:
            self._base = np.ascontiguousarray(self.faces + self.supply(self._reference))
        return self._base

    def supply(self, level: float, secreted: FloatArray | None = None) -> FloatArray:
        """Return what nodes gain but over the sides, mM/s.

        ``secreted`` stands in place of what cells secrete.
        """
        secreted = self.secreted if secreted is None else secreted
        gain = self._gain(level)
        if gain == 0.0 and self.substance.supply is None:
            return secreted
        return self.supplied + gain + secreted

    def source(self, t: float, secreted: FloatArray | None = None) -> FloatArray:
        """Return what nodes gain at a time in s, mM/s; ``secreted`` in place of what cells do."""
        base = self.base
        if secreted is not None:
            base = self.faces + self.supply(self._reference, secreted)
        return base if self.per_level is None else base + self.schedule.at(t) * self.per_level

    def rate(
        self,
        c: FloatArray,
        t: float,
        sink: FloatArray | None = None,
        secreted: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Return dc/dt (mM/s) and what uptake and decay add to it for each mM less (1/s).

        By the kernels of the solvers; ``sink`` and ``secreted`` in place of what cells do.
        """
        c = np.ascontiguousarray(c, dtype=float).reshape(self.shape)
        half, source = self.substance.half_saturation, self.source(t, secreted)
        sink = self.sink if sink is None else sink
        return imbalance(self.operator, c, sink, source, half, self.linear)

    def reference_rate(
        self,
        c: FloatArray,
        t: float,
        sink: FloatArray | None = None,
        secreted: FloatArray | None = None,
    ) -> FloatArray:
        """Return dc/dt (mM/s) by py-pde's own Laplacian where it has one that fits."""
        c = np.ascontiguousarray(c, dtype=float).reshape(self.shape)
        level, sink = self.schedule.at(t), self.sink if sink is None else sink
        taken, _ = uptake_and_slope(sink, c, self.substance.half_saturation)
        gained = self._spread(c, level) + self.supply(level, secreted)
        return np.asarray(gained - taken - self.linear * c)

    def _spread(self, c: FloatArray, level: float) -> FloatArray:
        """Return what diffusion brings to nodes with the sides at a concentration, mM/s."""
        op, grid = self.at(level), self._grid()
        if isinstance(op, Shells):
            return np.asarray(op.gain(c) / op.volumes)
        if not self._plain or op.weights is not None:
            return op.divergence(c)
        if self._laplace is None or self._laplace[0] != level:
            sides = dict(self.conditions_at(level))
            self._laplace = level, grid.make_operator("laplace", bc=sides, backend="scipy")
        spread = self.substance.diffusion * self._laplace[1](c.reshape(grid.shape))
        return np.asarray(spread).reshape(self.shape)

    def solve(
        self,
        start: FloatArray,
        level: float,
        *,
        dt: float = np.inf,
        before: FloatArray | None = None,
        demand: tuple[FloatArray, FloatArray] | None = None,
    ) -> tuple[FloatArray, SolveReport]:
        """Solve for the state a step of backward Euler later, or at rest after an infinite one.

        - ``level``, float, mM: concentration of the medium at the end
        - ``demand``, mM/s: largest uptake and secretion of the nodes, in place of those of the
          term's cells
        """
        sink, secreted = (self.sink, None) if demand is None else demand
        supply: FloatArray | None = self.supply(level, secreted)
        if supply is self._none:
            supply = None
        linear = self.linear
        if before is not None:
            linear += 1.0 / dt
            supply = before / dt if supply is None else before / dt + supply
        return self.at(level).solve(
            sink, self.substance.half_saturation, start, linear=linear, supply=supply
        )

    def flows(
        self, c: FloatArray, level: float, sink: FloatArray, made: FloatArray | None = None
    ) -> Flows:
        """Return what a state (mM) exchanges with sides, cells and reactions (``made``, mM/s)."""
        volumes, operator = self.layout.volumes, self.at(level)
        if isinstance(operator, Diffusion):
            inward, outward = operator.flows(c)
        else:
            net = operator.inflow(c)
            inward, outward = max(net, 0.0), max(-net, 0.0)
        taken, _ = uptake_and_slope(sink, c, self.substance.half_saturation)
        gained = lost = 0.0
        if made is not None:
            gained = float(np.sum(volumes * np.maximum(made, 0.0)))
            lost = float(np.sum(volumes * np.maximum(-made, 0.0)))
        return Flows(inward - outward, outward, float(np.sum(volumes * taken)), gained, lost)

    def account(
        self,
        c: FloatArray,
        level: float,
        flows: Flows | SolveReport,
        secreted: FloatArray | None = None,
    ) -> list[float]:
        """Return all that happens to a state (mM), amol/s: the columns :data:`COLUMNS`.

        ``secreted`` (mM/s) stands in place of what cells secrete.
        """
        volumes = self.layout.volumes
        produced = self._production
        if secreted is not None:
            produced = float(np.sum(volumes * secreted))
        found = {
            "inflow": flows.inflow, "outflow": flows.outflow, "uptake": flows.uptake,
            "secreted": produced, "injected": self._injected, "made": flows.made,
            "used": flows.used, "level": level,
        }  # fmt: skip
        if self.substance.linear_terms:
            content, medium = float(np.sum(volumes * c)), level * self.layout.whole
            for term in self.substance.linear_terms:
                for entry, amount in term.entries(content, medium).items():
                    found[entry] = found.get(entry, 0.0) + amount
        return [found.get(name, 0.0) for name in COLUMNS]

    @cached_property
    def _injected(self) -> float:
        """What stands still gives, amol/s."""
        none = self.substance.supply is None
        return 0.0 if none else float(np.sum(self.layout.volumes * self.supplied))

    def inverse(self, r: FloatArray, shift: FloatArray) -> FloatArray:
        """Return about (shift - D L)⁻¹ r with ``shift`` (1/s) at the nodes, exactly on shells."""
        op, r = self.operator, np.array(r, dtype=float).reshape(self.shape)
        if isinstance(op, Diffusion):
            return np.asarray(op.invert(r, float(shift.mean()))[0])
        return op.solve_linear(shift * op.volumes, r * op.volumes)


@lru_cache(maxsize=4)
def _nothing(shape: tuple[int, ...]) -> FloatArray:
    """Return zeros at the nodes, the same array for all that is not there: read-only."""
    found = np.zeros(shape)
    found.flags.writeable = False
    return found
