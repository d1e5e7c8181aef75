"""One substance of a field equation: what it is, and its balance on the nodes of a grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.equations.grid import conditions_on
from multicell.nutrient.equations.schedule import Schedule
from multicell.nutrient.grid import BoxLayout, Layout
from multicell.nutrient.operators import brought, imbalance
from multicell.nutrient.spherical import Shells
from multicell.nutrient.steady import SolveReport
from multicell.nutrient.uptake import uptake_and_slope

Conditions = Mapping[str, Any]

_ROUNDING = 1e-9


@final
@dataclass(frozen=True, eq=False)
class Substance:
    """What diffuses, decays, and is taken up and secreted by cells.

    Parameters
    ----------
    diffusion : float, µm²/s
    conditions
        On the sides of the grid, in py-pde's terms (``{"x-": {"value": 0.1}, "*":
        {"derivative": 0}}``; of shells ``"r+"`` or one condition), a concentration in mM on all
        sides, or a function of the medium's concentration (mM) that returns them. Values, slopes
        and mixed conditions are known; what one brings must be linear in that concentration.
        Never pass text from users: py-pde executes it.
    half_saturation : float, mM
    decay, perfusion : float, 1/s
    medium
        What a perfusion brings and ``conditions`` is called with: mM, or a :class:`Schedule`.
    capacity, production : (n,), amol/s, optional
        Largest uptake and secretion of each cell.
    varied : shape of the grid, optional
        Coefficient of diffusion at the nodes over ``diffusion``.
    supply : shape of the grid, mM/s, optional
        What nodes gain besides, whatever the cells do: from points and planes that stand still.

    Raises
    ------
    SceneError
        For a number that makes no sense.
    """

    diffusion: float
    conditions: float | Conditions | Callable[[float], Conditions]
    half_saturation: float = 1.0
    decay: float = 0.0
    perfusion: float = 0.0
    medium: float | Schedule = 0.0
    capacity: FloatArray | None = None
    production: FloatArray | None = None
    varied: FloatArray | None = None
    supply: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("diffusion", "half_saturation", "decay", "perfusion"):
            value = getattr(self, name)
            positive = name in ("diffusion", "half_saturation")
            if not (np.isfinite(value) and (value > 0.0 or (value == 0.0 and not positive))):
                bound = "above zero" if positive else "zero or more"
                raise SceneError(name, f"is {value!r}, must be a finite number, {bound}")
        for name in ("capacity", "production"):
            amounts = getattr(self, name)
            if (
                amounts is not None
                and not (np.isfinite(amounts) & (np.asarray(amounts) >= 0)).all()
            ):
                raise SceneError(name, "of some cell is negative or not finite")
        if self.supply is not None and not np.isfinite(self.supply).all():
            raise SceneError("supply", "of some node is not finite")

    @property
    def schedule(self) -> Schedule:
        """The medium over time."""
        return self.medium if isinstance(self.medium, Schedule) else Schedule.steady(self.medium)


@final
class Term:
    """A substance on a grid.

    Attributes
    ----------
    sink : mM/s
        Largest uptake per volume at each node; nodes as solvers have them, with three axes in a
        box and one on shells.
    base : mM/s
        What nodes gain by secretion, supply, over the sides and by perfusion, at a medium of 0 mM
        where that changes.
    per_level : 1/s or None
        What they gain besides for each mM in a medium that changes.
    """

    def __init__(
        self, name: str, substance: Substance, layout: Layout, grid: Any, position: FloatArray
    ) -> None:
        self.name, self.substance, self.layout, self.grid = name, substance, layout, grid
        self.schedule = substance.schedule
        self.linear = substance.decay + substance.perfusion
        self.shape = layout.filled(0.0).shape
        constant = self.schedule.constant
        self._reference = self.schedule.at(0.0) if constant else 0.0
        self.operator = self.operator_at(self._reference)
        self.faces = brought(self.operator)
        self.per_level: FloatArray | None = None
        if not constant:
            per_level = brought(self.operator_at(1.0)) - self.faces + substance.perfusion
            self.per_level = np.ascontiguousarray(per_level)
        self.supplied = self._supplied()
        self.brought = self.supplied + substance.perfusion * self._reference
        none = np.zeros(len(position))
        self.sink = self.spread(
            position, none if substance.capacity is None else substance.capacity
        )
        given = substance.production
        self.secreted = self.spread(position, none if given is None else given)
        self.base = np.ascontiguousarray(self.faces + self.secreted + self.brought)
        self._refuse_other_conditions()

    def conditions_at(self, level: float) -> Conditions:
        """Return the conditions at a concentration of the medium in mM, for every side."""
        given = self.substance.conditions
        return conditions_on(self.layout, given(level) if callable(given) else given)

    def _supplied(self) -> FloatArray:
        """Return what nodes gain from what stands still, mM/s."""
        supply = self.substance.supply
        if supply is None:
            return np.zeros(self.shape)
        if np.size(supply) != np.prod(self.shape):
            problem = f"has the shape {np.shape(supply)}, the grid has {self.grid.shape}"
            raise SceneError(f"substances.{self.name}.supply", problem)
        return np.asarray(supply, dtype=float).reshape(self.shape)

    def _refuse_other_conditions(self) -> None:
        """Refuse conditions that the solvers' kernels would take for others."""
        rng = np.random.default_rng(0)
        c = 1.0 + rng.random(self.shape)
        ours, _ = self.rate(c, 0.0, self.sink)
        theirs = self.reference_rate(c, 0.0, self.sink, self.secreted)
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

    def operator_at(self, level: float) -> Diffusion | Shells:
        """Return diffusion with the conditions at a concentration of the medium in mM."""
        p, layout = self.substance, self.layout
        conditions = self.conditions_at(level)
        varied = None if p.varied is None else np.asarray(p.varied).reshape(self.shape)
        if isinstance(layout, BoxLayout):
            return Diffusion(
                self.grid, p.diffusion, conditions, height=layout.box.height, varied=varied
            )
        count = self.shape[0]
        return Shells(layout.spacing * count, count, p.diffusion, conditions, varied=varied)

    def source(self, t: float, secreted: FloatArray | None = None) -> FloatArray:
        """Return what nodes gain at a time in s, mM/s; ``secreted`` in place of what cells do."""
        base = self.base if secreted is None else self.faces + secreted + self.brought
        return base if self.per_level is None else base + self.schedule.at(t) * self.per_level

    def rate(
        self, c: FloatArray, t: float, sink: FloatArray, secreted: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return dc/dt (mM/s) and what uptake and decay add to it for each mM less (1/s).

        By the kernels of the solvers.
        """
        c = np.ascontiguousarray(c, dtype=float).reshape(self.shape)
        half, source = self.substance.half_saturation, self.source(t, secreted)
        return imbalance(self.operator, c, sink, source, half, self.linear)

    def reference_rate(
        self, c: FloatArray, t: float, sink: FloatArray, secreted: FloatArray
    ) -> FloatArray:
        """Return dc/dt (mM/s) by py-pde's own Laplacian where it has one that fits."""
        c = np.ascontiguousarray(c, dtype=float).reshape(self.shape)
        op = self.operator
        spreads = op.divergence(c) if isinstance(op, Diffusion) else op.gain(c) / op.volumes
        taken, _ = uptake_and_slope(sink, c, self.substance.half_saturation)
        gained = spreads + secreted + self.brought
        if self.per_level is not None:
            gained = gained + self.schedule.at(t) * self.per_level
        return np.asarray(gained - taken - self.linear * c)

    def steady(
        self, c: FloatArray, t: float, sink: FloatArray, secreted: FloatArray
    ) -> tuple[FloatArray, SolveReport]:
        """Solve for the steady state at a time in s.

        Raises
        ------
        NutrientFailed
        """
        level = self.schedule.at(t)
        operator = self.operator if level == self._reference else self.operator_at(level)
        return operator.solve(
            sink,
            self.substance.half_saturation,
            np.ascontiguousarray(c, dtype=float).reshape(self.shape),
            linear=self.linear,
            supply=secreted + self.supplied + self.substance.perfusion * level,
        )

    def inverse(self, r: FloatArray, shift: FloatArray) -> FloatArray:
        """Return about (shift - D L)⁻¹ r with ``shift`` (1/s) at the nodes, exactly on shells."""
        op, r = self.operator, np.array(r, dtype=float).reshape(self.shape)
        if isinstance(op, Diffusion):
            return np.asarray(op.invert(r, float(shift.mean()))[0])
        return op.solve_linear(shift * op.volumes, r * op.volumes)
