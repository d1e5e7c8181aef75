"""One field: owner of its layout and of its last solution."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, final

import numpy as np

from multicell.cells import FloatArray
from multicell.nutrient import grid as layouts
from multicell.nutrient.cartesian import Box, round_enough
from multicell.nutrient.grid import BoxLayout, Layout, Operator, ShellLayout
from multicell.nutrient.steady import SolveReport
from multicell.nutrient.transient import Amounts, March, TransientReport, march

if TYPE_CHECKING:
    from multicell.results.frame import Field
    from multicell.scene.nutrient import Side
    from multicell.scene.parts import Domain


_GONE = 1e-6
"""Part of the medium's highest concentration below which a field that fades is not followed any
more with an error relative to itself: steps would stay as short as ever down to nothing."""


class NutrientParameters(Protocol):
    """What a field is made from; see :class:`multicell.nutrient.parameters.FieldParameters`."""

    @property
    def diffusion(self) -> float:
        """Diffusion coefficient in tissue, µm²/s."""

    @property
    def diffusion_medium(self) -> float | None:
        """Diffusion coefficient outside tissue, µm²/s; None: as inside."""

    @property
    def half_saturation(self) -> float:
        """Michaelis constant of uptake, mM."""

    @property
    def spacing(self) -> float:
        """Largest grid spacing, µm."""

    @property
    def margin(self) -> float:
        """Least distance from a cell's centre to the faces, µm."""

    @property
    def layer(self) -> float | None:
        """Distance of the shells' surface from the tissue's, µm; None: by the margin."""

    @property
    def domain(self) -> Domain | None:
        """The box that the field lives on; None: it follows the cells."""

    @property
    def height(self) -> float:
        """Height of the layer in two dimensions, µm."""

    @property
    def dimensions(self) -> int:
        """2 or 3."""

    @property
    def decay(self) -> float:
        """Rate of decay, 1/s."""

    @property
    def perfusion(self) -> float:
        """Rate of exchange with the medium, 1/s."""

    @property
    def geometry(self) -> str:
        """``"box"``, ``"radial"`` or ``"auto"``."""

    @property
    def roundness_limit(self) -> float:
        """Departure from a ball up to which shells are enough."""

    @property
    def time_tolerance(self) -> float:
        """Error of a transient step over the concentration."""

    @property
    def highest(self) -> float:
        """The highest concentration that medium and sides ever have, mM."""

    def medium(self, time: float) -> float:
        """Return the concentration of the medium at a time in s, mM."""

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two times at which the medium is changed, s."""

    def sides(self, time: float) -> Mapping[str, Side]:
        """Return the condition on every face at a time."""


@final
@dataclass(frozen=True)
class FieldReport:
    """What a steady solve took and how well it balances; rates in amol/s.

    ``inflow + produced - uptake - decayed`` is zero up to ``residual``. ``inflow`` includes what a
    perfusion brings and is net; ``outflow`` is what leaves through the faces, ``washed`` what a
    perfusion takes.
    """

    newton: int
    cg: int
    residual: float
    inflow: float
    uptake: float
    produced: float
    decayed: float
    outflow: float = 0.0
    washed: float = 0.0


@final
class NutrientField:
    """One substance that diffuses, is taken up and secreted by cells, and decays.

    The faces of its grid lie at ``margin`` from the outermost centres: a layer of medium without
    convection lies round the cells, always as thick as that. With a ``domain`` they lie on its
    sides, and stay there.

    Parameters
    ----------
    name
        The field's name in the scene.
    parameters
        See :class:`NutrientParameters`.
    """

    def __init__(self, name: str, parameters: NutrientParameters) -> None:
        self.name = name
        self.parameters = parameters
        self.layings = 0
        self._layout: Layout | None = None
        self._operator: Operator | None = None
        self._conditions: dict[str, Any] = {}
        self._values: FloatArray = np.empty((0, 0, 0))

    @property
    def layout(self) -> Layout:
        """Where the field's nodes are.

        Raises
        ------
        ValueError
            Before the first solve.
        """
        if self._layout is None:
            raise ValueError(f"{self.name} has no grid before the first solve")
        return self._layout

    @property
    def box(self) -> Box:
        """The grid of cubes or squares.

        Raises
        ------
        ValueError
            Before the first solve, and for a radial field.
        """
        if isinstance(self.layout, BoxLayout):
            return self.layout.box
        raise ValueError(f"{self.name} lives on shells, not in a box")

    def solve(
        self,
        position: FloatArray,
        capacity: FloatArray,
        *,
        production: FloatArray | None = None,
        radius: FloatArray | None = None,
        time: float = 0.0,
    ) -> FieldReport:
        """Solve for the steady field that the cells' uptake and secretion leave.

        Cell i takes up ``capacity_i * sum_g w_ig c_g / (K + c_g)``, with the linear weights w_ig
        of the nodes g around it. The last solution is the first guess.

        Parameters
        ----------
        position : (n, 3), µm
        capacity : (n,), amol/s
            Largest uptake of each cell, not negative.
        production : (n,), amol/s, optional
            Secretion of each cell, not negative.
        radius : (n,), µm, optional
            Of the cells; needed where diffusion differs outside tissue, and for shells.
        time : float, s

        Raises
        ------
        NutrientFailed
            If the grid would become too large, a position is not finite, or the solver fails;
            the field then still is the last one.
        ValueError
            If shapes do not match or a capacity is negative or not finite.
        """
        position, radius = _checked(position, capacity, production, radius)
        layout, kept = self._lay(position, radius)
        operator, conditions = self._operator_on(layout, kept, position, radius, time)
        p, medium = self.parameters, self.parameters.medium(time)
        if kept:
            start = self._values
        elif self._layout is None:
            start = layout.filled(medium)
        else:
            start = layout.guess(self._values, self._layout, medium)
        supply = self._supply(layout, position, production, medium)
        linear = p.decay + p.perfusion
        values, report = operator.solve(
            layout.scatter(position, capacity), p.half_saturation, start,
            linear=linear, supply=supply,
        )  # fmt: skip
        self._take(layout, operator, conditions, values, kept)
        return self._described(report, medium)

    def advance(
        self,
        position: FloatArray,
        capacity: FloatArray,
        *,
        production: FloatArray | None = None,
        radius: FloatArray | None = None,
        begin: float,
        end: float,
    ) -> TransientReport:
        """March the field from ``begin`` to ``end`` (s); parameters as for :meth:`solve`.

        The grid is laid round the cells first. What it encloses then and did not before is the
        medium of the moment, counted as ``relaid``.

        Raises
        ------
        NutrientFailed, ValueError
            As for :meth:`solve`; the field then still is the last one.
        """
        position, radius = _checked(position, capacity, production, radius)
        layout, kept = self._lay(position, radius)
        before = self.stored()
        c = self._values
        if not kept:
            c = layout.carried(self._values, self.layout, self.parameters.medium(begin))
        relaid = float(np.sum(layout.volumes * c)) - before
        sink = layout.scatter(position, capacity)
        done, p = March(Amounts()), self.parameters
        operator, conditions = self._operator_on(layout, kept, position, radius, begin)
        for start, stop in _segments(begin, end, p.switches(begin, end)):

            def step(
                c: FloatArray, dt: float, time: float, last: float = stop
            ) -> tuple[FloatArray, SolveReport, float]:
                nonlocal conditions
                # at the moment of a switch the medium still is the old one
                moment = min(time, np.nextafter(last, -np.inf))
                wanted = layout.conditions(p.sides(moment))
                if wanted != conditions:
                    operator.set_boundary(wanted)
                    conditions = wanted
                medium = p.medium(moment)
                supply = c / dt
                fixed = self._supply(layout, position, production, medium)
                if fixed is not None:
                    supply = supply + fixed
                values, report = operator.solve(
                    sink, p.half_saturation, c,
                    linear=p.decay + p.perfusion + 1.0 / dt, supply=supply,
                )  # fmt: skip
                return values, report, medium

            scale = max(p.medium(start), _GONE * p.highest)
            c = march(
                step, layout.volumes, c, start, stop,
                tolerance=p.time_tolerance, scale=scale, done=done,
            )  # fmt: skip
        self._take(layout, operator, conditions, c, kept)
        return self._summed(done, production, end - begin, relaid)

    def fill(self, position: FloatArray, *, radius: FloatArray | None, time: float) -> None:
        """Begin with the medium's concentration everywhere."""
        position, radius = _checked(position, np.zeros(len(position)), None, radius)
        layout, _ = self._lay(position, radius)
        operator, conditions = self._operator_on(layout, False, position, radius, time)
        values = layout.filled(self.parameters.medium(time))
        self._take(layout, operator, conditions, values, False)

    def sample(self, position: FloatArray) -> FloatArray:
        """Return the concentration in mM at positions (n, 3) in µm, interpolated linearly.

        Between the last nodes and the faces by the conditions there: on a face with a value it is
        that value.

        Raises
        ------
        ValueError
            Before the first solve, and for positions outside the grid.
        """
        return self.layout.read(position, self._values, self._conditions)

    def gradient(self, position: FloatArray) -> FloatArray:
        """Return the gradient at positions (n, 3) in µm, (n, 3) mM/µm.

        Differences of the interpolated field over one spacing, along the axes of a box or the
        radius of shells; exact for parabolas, up to the faces.

        Raises
        ------
        ValueError
            Before the first solve, and for positions outside the grid.
        """
        return self.layout.gradient(position, self._values)

    def uptake(self, position: FloatArray, capacity: FloatArray) -> FloatArray:
        """Return what each cell takes up, (n,) amol/s."""
        c = self._values
        share = self.layout.gather(position, c / (self.parameters.half_saturation + c))
        return np.asarray(capacity * share)

    def stored(self) -> float:
        """Return what the field holds, amol."""
        return float(np.sum(self.layout.volumes * self._values))

    def field(self) -> Field:
        """Return the last solution; its values are read-only."""
        return self.layout.field(self.name, self._values)

    def restore(self, field: Field, time: float = 0.0) -> None:
        """Take layout and values of a field from a frame of a time in s."""
        self._layout, values = layouts.restored(field)
        values.flags.writeable = False
        self._values = values
        self._operator = None
        self._conditions = self._layout.conditions(self.parameters.sides(time))

    def kept(self) -> tuple[Any, ...]:
        """Return what :meth:`take_back` needs to undo a solve."""
        return self._layout, self._values, self.layings

    def take_back(self, kept: tuple[Any, ...]) -> None:
        """Make a solution that was kept the last one again."""
        self._layout, self._values, self.layings = kept
        # whose conditions may have been changed on the way
        self._operator, self._conditions = None, {}

    def _lay(self, position: FloatArray, radius: FloatArray) -> tuple[Layout, bool]:
        """Return the layout round the cells, and whether it is the last one."""
        p = self.parameters
        radial = p.geometry == "radial"
        if p.geometry == "auto":
            now = isinstance(self._layout, ShellLayout)
            radial = round_enough(position, radius, p.roundness_limit, now_radial=now)
        if radial:
            return ShellLayout.round(position, radius, p.margin, p.spacing, p.layer), False
        height = p.height if p.dimensions == 2 else None
        if p.domain is None:
            found = BoxLayout.round(position, p.margin, p.spacing, height)
        else:
            found = BoxLayout.within(p.domain, p.spacing, height)
        same = self._layout is not None and found == self._layout
        return (self.layout, True) if same else (found, False)

    def _operator_on(
        self, layout: Layout, kept: bool, position: FloatArray, radius: FloatArray, time: float
    ) -> tuple[Operator, dict[str, Any]]:
        """Return the operator on a layout at a time, the last one if it still holds."""
        p = self.parameters
        conditions = layout.conditions(p.sides(time))
        medium = p.diffusion_medium
        if kept and self._operator is not None and medium is None:
            if conditions != self._conditions:
                self._operator.set_boundary(conditions)
            return self._operator, conditions
        varied = None
        if medium is not None and medium != p.diffusion:
            varied = layouts.relative_diffusion(layout, position, radius, medium, p.diffusion)
        return layout.operator(p.diffusion, conditions, varied), conditions

    def _supply(
        self,
        layout: Layout,
        position: FloatArray,
        production: FloatArray | None,
        medium: float,
    ) -> FloatArray | None:
        """Return what the nodes gain by secretion and perfusion, mM/s, or None."""
        brought = self.parameters.perfusion * medium
        if production is None:
            return layout.filled(brought) if brought > 0.0 else None
        return layout.scatter(position, production) + brought

    def _take(
        self,
        layout: Layout,
        operator: Operator,
        conditions: dict[str, Any],
        values: FloatArray,
        kept: bool,
    ) -> None:
        values.flags.writeable = False
        self.layings += not kept
        self._layout, self._operator = layout, operator
        self._conditions, self._values = conditions, values

    def _described(self, report: SolveReport, medium: float) -> FieldReport:
        """Return the balance of a steady solve by what it was for."""
        p = self.parameters
        mass = self.stored()
        whole = float(np.sum(np.broadcast_to(self.layout.volumes, self._values.shape)))
        brought = p.perfusion * medium * whole
        return FieldReport(
            report.newton,
            report.cg,
            report.residual,
            report.inflow + brought - p.perfusion * mass,
            report.uptake,
            report.supplied - brought,
            p.decay * mass,
            report.outflow,
            p.perfusion * mass,
        )

    def _summed(
        self, done: March, production: FloatArray | None, length: float, relaid: float
    ) -> TransientReport:
        """Return the balance of a march by what it was for."""
        p, amounts = self.parameters, done.amounts
        whole = float(np.sum(np.broadcast_to(self.layout.volumes, self._values.shape)))
        brought = p.perfusion * (amounts.level * whole - amounts.mass)
        produced = 0.0 if production is None else float(np.sum(production)) * length
        return TransientReport(
            amounts.inflow + brought,
            amounts.uptake,
            produced,
            p.decay * amounts.mass,
            relaid,
            done.steps,
            done.rejections,
            done.first_order,
            done.error,
            p.perfusion * amounts.mass,
        )


def _segments(begin: float, end: float, switches: list[float]) -> list[tuple[float, float]]:
    """Return the intervals between the switches."""
    times = [begin, *switches, end]
    return list(itertools.pairwise(times))


def _checked(
    position: FloatArray,
    capacity: FloatArray,
    production: FloatArray | None,
    radius: FloatArray | None,
) -> tuple[FloatArray, FloatArray]:
    """Return positions and radii as arrays; refuse what does not fit."""
    position = np.asarray(position, dtype=np.float64)
    if position.ndim != 2 or position.shape[1] != 3:
        raise ValueError(f"position has shape {position.shape}, expected (n, 3)")
    n = len(position)
    for name, values in (("capacity", capacity), ("production", production)):
        if values is None:
            continue
        if np.shape(values) != (n,):
            raise ValueError(f"{name} has shape {np.shape(values)}, expected ({n},)")
        if not np.all((np.asarray(values) >= 0.0) & np.isfinite(values)):
            what = "capacity of uptake" if name == "capacity" else name
            raise ValueError(f"a cell's {what} is negative or not finite")
    radius = np.ones(n) if radius is None else np.asarray(radius, dtype=np.float64)
    if radius.shape != (n,):
        raise ValueError(f"radius has shape {radius.shape}, expected ({n},)")
    return position, radius
