"""One field: owner of its layout and of its last solution."""

from __future__ import annotations

import itertools
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.nutrient import grid as layouts
from multicell.nutrient.cartesian import Box, round_enough
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.grid import BoxLayout, Layout, Operator, ShellLayout
from multicell.nutrient.regions import coefficients
from multicell.nutrient.steady import SolveReport
from multicell.nutrient.tissue import drawn_in, drawn_to_ball
from multicell.nutrient.transient import Amounts, March, TransientReport, march
from multicell.nutrient.uptake import uptake

if TYPE_CHECKING:
    from multicell.nutrient.finite import Stirred
    from multicell.nutrient.parameters import FieldParameters
    from multicell.results.frame import Field


GONE = 1e-6
"""Part of the medium's highest concentration below which a field that fades is not followed any
more with an error relative to itself: steps would stay as short as ever down to nothing."""


@final
@dataclass(frozen=True)
class FieldReport:
    """What a steady solve took and how well it balances; rates in amol/s.

    ``inflow + produced - uptake - decayed`` is zero up to ``residual``. ``inflow`` includes what a
    perfusion brings and is net; ``outflow`` is what leaves through the faces, ``washed`` what a
    perfusion takes. A field that takes part in reactions gains ``made`` besides and loses ``used``;
    for others these are None.
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
    made: float | None = None
    used: float | None = None

    def kept(self) -> dict[str, float]:
        """Return what another report can be made from."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@final
class NutrientField:
    """One substance that diffuses, is taken up and secreted by cells, and decays.

    The faces of its grid lie at ``margin`` from the outermost centres of the tissue: a layer of
    medium without convection lies round it, always as thick as that. Cells that have left the
    tissue (:mod:`multicell.nutrient.tissue`) do not move the faces; beyond them they find the
    medium, and take up and give off at the nearest point of the grid, whose account has it. With a
    ``domain`` the faces lie on its sides, and stay there.

    Parameters
    ----------
    name
        The field's name in the scene.
    parameters
        See :class:`multicell.nutrient.parameters.FieldParameters`.
    threads
        How many may share the loops over many nodes; it changes no result.
    """

    def __init__(self, name: str, parameters: FieldParameters, threads: int = 1) -> None:
        self.name = name
        self.parameters = parameters
        self.threads = threads
        self.layings = 0
        self.stirred: Stirred | None = None  # of a finite medium, once poured
        self._layout: Layout | None = None
        self._operator: Operator | None = None
        self._conditions: dict[str, Any] = {}
        self._last_sides: tuple[Any, dict[str, Any]] = (None, {})
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
    def laid(self) -> bool:
        """Whether it has a grid, which is so from the first solve on."""
        return self._layout is not None

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
        position, radius = checked(position, capacity, production, radius)
        layout, kept, position = self.lay(position, radius)
        operator, conditions = self._operator_on(layout, kept, position, radius, time)
        p, medium = self.parameters, self.level(time)
        if kept:
            start = self._values
        elif self._layout is None:
            start = layout.filled(medium)
        else:
            start = layout.guess(self._values, self._layout, medium)
        supply = self._supply(layout, position, production, medium)
        linear = p.nutrient.decay + p.nutrient.perfusion
        values, report = operator.solve(
            layout.scatter(position, capacity), p.nutrient.half_saturation, start,
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
        position, radius = checked(position, capacity, production, radius)
        if self.stirred is not None:
            from multicell.nutrient import finite

            return finite.advance(self, position, capacity, production, radius, begin, end)
        layout, kept, position = self.lay(position, radius)
        before = self.stored()
        c = self._values
        if not kept:
            c = layout.carried(self._values, self.layout, self.parameters.nutrient.medium(begin))
        relaid = float(np.sum(layout.volumes * c)) - before
        sink = layout.scatter(position, capacity)
        done, p = March(Amounts()), self.parameters
        operator, conditions = self._operator_on(layout, kept, position, radius, begin)
        for start, stop in itertools.pairwise([begin, *p.nutrient.switches(begin, end), end]):

            def step(
                c: FloatArray, dt: float, time: float, last: float = stop
            ) -> tuple[FloatArray, SolveReport, float]:
                nonlocal conditions
                # at the moment of a switch the medium still is the old one
                moment = min(time, np.nextafter(last, -np.inf))
                wanted = self._sides(layout, moment)
                if wanted != conditions:
                    operator.set_boundary(wanted)
                    conditions = wanted
                medium = p.nutrient.medium(moment)
                supply = c / dt
                fixed = self._supply(layout, position, production, medium)
                if fixed is not None:
                    supply = supply + fixed
                values, report = operator.solve(
                    sink, p.nutrient.half_saturation, c,
                    linear=p.nutrient.decay + p.nutrient.perfusion + 1.0 / dt, supply=supply,
                )  # fmt: skip
                return values, report, medium

            scale = max(p.nutrient.medium(start), GONE * p.nutrient.highest)
            c = march(
                step, layout.volumes, c, start, stop,
                tolerance=p.nutrient.time_tolerance, scale=scale, done=done,
            )  # fmt: skip
        self._take(layout, operator, conditions, c, kept)
        return self._summed(done, production, end - begin, relaid)

    def leap(
        self,
        position: FloatArray,
        capacity: FloatArray,
        *,
        production: FloatArray | None = None,
        radius: FloatArray | None = None,
        begin: float,
        end: float,
    ) -> SolveReport:
        """Take one step of backward Euler from ``begin`` to ``end`` (s), without control of errors.

        For estimates on other grids; a finite medium stays as it is. Parameters as for
        :meth:`solve`.

        Raises
        ------
        NutrientFailed, ValueError
            As for :meth:`solve`; the field then still is the last one.
        """
        position, radius = checked(position, capacity, production, radius)
        layout, kept, position = self.lay(position, radius)
        p, medium = self.parameters, self.level(end)
        c = self._values if kept else layout.carried(self._values, self.layout, medium)
        operator, conditions = self._operator_on(layout, kept, position, radius, end)
        fixed = self._supply(layout, position, production, medium)
        supply = c / (end - begin)
        values, report = operator.solve(
            layout.scatter(position, capacity), p.nutrient.half_saturation, c,
            linear=p.nutrient.decay + p.nutrient.perfusion + 1.0 / (end - begin),
            supply=supply if fixed is None else supply + fixed,
        )  # fmt: skip
        self._take(layout, operator, conditions, values, kept)
        return report

    def fill(self, position: FloatArray, *, radius: FloatArray | None, time: float) -> None:
        """Begin with the medium's concentration everywhere."""
        position, radius = checked(position, np.zeros(len(position)), None, radius)
        layout, _, position = self.lay(position, radius)
        operator, conditions = self._operator_on(layout, False, position, radius, time)
        values = layout.filled(self.level(time))
        self._take(layout, operator, conditions, values, False)

    def pour(self) -> None:
        """Let a finite medium lie round the grid, as it is at the start.

        Raises
        ------
        NutrientFailed
            If the grid covers all of it.
        """
        from multicell.nutrient.finite import poured, whole

        covered = whole(self.layout, self._values)
        self.stirred = poured(self.name, self.parameters.nutrient, covered)

    def level(self, time: float) -> float:
        """Return the concentration of the medium at a time in s, of a finite one now, mM."""
        if self.stirred is not None:
            return self.stirred.concentration
        return self.parameters.nutrient.medium(time)

    def sample(self, position: FloatArray) -> FloatArray:
        """Return the concentration in mM at positions (n, 3) in µm, interpolated linearly.

        Between the last nodes and the faces by the conditions there: on a face with a value it is
        that value. Outside the grid, where it lies in stirred medium, by the nearest face.

        Raises
        ------
        ValueError
            Before the first solve, and for positions outside a grid that is not all round in
            stirred medium.
        """
        return self.layout.read(self._reached(position), self._values, self._conditions)

    def gradient(self, position: FloatArray) -> FloatArray:
        """Return the gradient at positions (n, 3) in µm, (n, 3) mM/µm.

        Differences of the interpolated field over one spacing, along the axes of a box or the
        radius of shells; exact for parabolas, up to the faces. In stirred medium it is zero.

        Raises
        ------
        ValueError
            As for :meth:`sample`.
        """
        reached = self._reached(position)
        found = self.layout.gradient(reached, self._values)
        if reached is not position:
            found[(reached != position).any(axis=1)] = 0.0
        return found

    def uptake(self, position: FloatArray, capacity: FloatArray) -> FloatArray:
        """Return what each cell takes up, (n,) amol/s."""
        c = self._values
        share = self.layout.gather(
            self._reached(position), uptake(1.0, c, self.parameters.nutrient.half_saturation)
        )
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
        self._conditions = self._sides(self._layout, time)

    def kept(self) -> tuple[Any, ...]:
        """Return what :meth:`take_back` needs to undo a solve."""
        return self._layout, self._values, self.layings, self.stirred, self.parameters

    def take_back(self, kept: tuple[Any, ...]) -> None:
        """Make a solution that was kept the last one again."""
        self._layout, self._values, self.layings, self.stirred, self.parameters = kept
        # whose conditions may have been changed on the way
        self._operator, self._conditions = None, {}

    def _reached(self, position: FloatArray) -> FloatArray:
        """Return where on the grid cells exchange with the field: strays at its surface."""
        return self.layout.nearest(position) if self.parameters.open_medium else position

    def lay(
        self, position: FloatArray, radius: FloatArray, *, strays: bool = True
    ) -> tuple[Layout, bool, FloatArray]:
        """Return the layout round the tissue, whether it is the last one, and where cells reach it.

        Without ``strays`` every cell is tissue.
        """
        p = self.parameters
        tissue, strays = position, strays and p.open_medium
        if strays:
            tissue = drawn_in(position, radius)
        radial = p.geometry == "radial"
        if p.geometry == "auto":
            now = isinstance(self._layout, ShellLayout)
            radial = round_enough(tissue, radius, p.nutrient.roundness_limit, now_radial=now)
        if radial:
            if strays:
                tissue = drawn_to_ball(tissue, radius)
            shells = ShellLayout.round(
                tissue, radius, p.nutrient.margin, p.spacing, p.nutrient.layer
            )
            return shells, False, position if tissue is position else shells.nearest(position)
        height = p.height if p.dimensions == 2 else None
        if p.domain is None:
            found = BoxLayout.round(tissue, p.nutrient.margin, p.spacing, height)
        else:
            found = BoxLayout.within(p.domain, p.spacing, height)
        same = self._layout is not None and found == self._layout
        reached = position if tissue is position else found.nearest(position)
        return (self.layout, True, reached) if same else (found, False, reached)

    def _sides(self, layout: Layout, time: float) -> dict[str, Any]:
        """Return the conditions on the faces of a layout at a time in s, in py-pde's terms."""
        key = (self.parameters, isinstance(layout, ShellLayout), self.level(time))
        if key != self._last_sides[0]:
            self._last_sides = key, layout.conditions(self.parameters.sides(time, key[2]))
        return self._last_sides[1]

    def _operator_on(
        self, layout: Layout, kept: bool, position: FloatArray, radius: FloatArray, time: float
    ) -> tuple[Operator, dict[str, Any]]:
        """Return the operator on a layout at a time, the last one if it still holds."""
        p = self.parameters
        conditions = self._sides(layout, time)
        if kept and self._operator is not None and p.nutrient.diffusion_medium is None:
            if conditions != self._conditions:
                self._operator.set_boundary(conditions)
            return self._operator, conditions
        varied = coefficients(layout, position, radius, p.nutrient)
        operator = layout.operator(p.nutrient.diffusion, conditions, varied)
        if isinstance(operator, Diffusion):
            operator.threads = self.threads
        return operator, conditions

    def _supply(
        self,
        layout: Layout,
        position: FloatArray,
        production: FloatArray | None,
        medium: float,
    ) -> FloatArray | None:
        """Return what the nodes gain by secretion and perfusion, mM/s, or None."""
        brought = self.parameters.nutrient.perfusion * medium
        if self.parameters.nutrient.sources:
            from multicell.nutrient.sources import injected

            fixed = injected(layout, self.parameters.nutrient.sources) + brought
            return fixed if production is None else fixed + layout.scatter(position, production)
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
        p, mass, brought = self.parameters, 0.0, 0.0
        if p.nutrient.decay > 0.0 or p.nutrient.perfusion > 0.0:
            mass = self.stored()
        if p.nutrient.perfusion > 0.0:
            whole = float(np.sum(np.broadcast_to(self.layout.volumes, self._values.shape)))
            brought = p.nutrient.perfusion * medium * whole
        return FieldReport(
            report.newton,
            report.cg,
            report.residual,
            report.inflow + brought - p.nutrient.perfusion * mass,
            report.uptake,
            report.supplied - brought,
            p.nutrient.decay * mass,
            report.outflow,
            p.nutrient.perfusion * mass,
        )

    def _summed(
        self, done: March[Amounts], production: FloatArray | None, length: float, relaid: float
    ) -> TransientReport:
        """Return the balance of a march by what it was for."""
        p, amounts = self.parameters, done.amounts
        whole = float(np.sum(np.broadcast_to(self.layout.volumes, self._values.shape)))
        brought = p.nutrient.perfusion * (amounts.level * whole - amounts.mass)
        produced = 0.0 if production is None else float(np.sum(production)) * length
        return TransientReport(
            amounts.inflow + brought,
            amounts.uptake,
            produced,
            p.nutrient.decay * amounts.mass,
            relaid,
            done.steps,
            done.rejections,
            done.first_order,
            done.error,
            p.nutrient.perfusion * amounts.mass,
        )


def checked(
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
        values = np.asarray(values)
        if values.shape != (n,):
            raise ValueError(f"{name} has shape {values.shape}, expected ({n},)")
        # not so of what is no number either
        if not (values.min(initial=0.0) >= 0.0 and values.max(initial=0.0) < np.inf):
            what = "capacity of uptake" if name == "capacity" else name
            raise ValueError(f"a cell's {what} is negative or not finite")
    radius = np.ones(n) if radius is None else np.asarray(radius, dtype=np.float64)
    if radius.shape != (n,):
        raise ValueError(f"radius has shape {radius.shape}, expected ({n},)")
    return position, radius
