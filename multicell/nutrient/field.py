"""One field: owner of its layout and of its last solution."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient import grid as layouts
from multicell.nutrient.cartesian import mesh, round_enough
from multicell.nutrient.grid import BoxLayout, Layout, ShellLayout
from multicell.nutrient.tissue import Tissue, drawn_in, drawn_to_ball, reaching
from multicell.nutrient.uptake import uptake
from multicell.scene.formulas import formula_values
from multicell.scene.oxygen import check_dissolves, is_oxygen

if TYPE_CHECKING:
    from multicell.nutrient.balance import FieldExchange, WellMixed
    from multicell.nutrient.equations.substance import Schedule
    from multicell.nutrient.group import FieldGroup
    from multicell.nutrient.parameters import FieldParameters
    from multicell.results.frame import Field


@final
class Solution(NamedTuple):
    """The last solution of a field, which is all that it holds from step to step.

    - ``layout``: None before the first solve
    - ``values``, mM: at its nodes
    - ``conditions``: on its sides
    - ``medium``: the stirred part of a finite one, once it is attached
    """

    layout: Layout | None
    values: FloatArray
    conditions: dict[str, Any]
    medium: WellMixed | None

    def field(self, name: str) -> Field:
        """Return it as a field of that name; its values are read-only."""
        assert self.layout is not None
        return self.layout.field(name, self.values)


@final
class NutrientField:
    """One substance that diffuses, is taken up and secreted by cells, and decays.

    The faces of its grid lie at ``margin`` from the outermost centres of the tissue: a layer of
    medium without convection lies round it, always as thick as that there. Towards the corners it
    ends inside of the grid where the parameters' ``margin_shape`` is that of the tissue
    (:mod:`multicell.nutrient.layer`). Cells that have left the
    tissue (:mod:`multicell.nutrient.tissue`) do not move the faces; beyond them they find the
    medium, and take up and give off at the nearest point of the grid, whose account has it. With a
    ``domain`` the faces lie on its sides, and stay there.

    - ``name``: the field's name in the scene
    - ``parameters``: see :class:`multicell.nutrient.parameters.FieldParameters`
    - ``threads``: how many may share the loops over many nodes; it changes no result

    - ``values``, mM: the last solution at the nodes of its layout
    """

    def __init__(self, name: str, parameters: FieldParameters, threads: int = 1) -> None:
        self.name = name
        self.parameters = parameters
        self.threads = threads
        self.well_mixed: WellMixed | None = None  # of a finite medium, once it is attached
        self.values: FloatArray = np.empty((0, 0, 0))
        self._layout: Layout | None = None
        self._conditions: dict[str, Any] = {}
        self._group: FieldGroup | None = None

    @property
    def layout(self) -> Layout:
        """Where the field's nodes are; raises ValueError before the first solve."""
        if self._layout is None:
            raise ValueError(f"{self.name} has no grid before the first solve")
        return self._layout

    @property
    def laid(self) -> bool:
        """Whether it has a grid, which is so from the first solve on."""
        return self._layout is not None

    def solve(
        self,
        position: FloatArray,
        capacity: FloatArray,
        *,
        production: FloatArray | None = None,
        radius: FloatArray | None = None,
        time: float = 0.0,
    ) -> FieldExchange:
        """Solve for the steady field that the cells' uptake and secretion leave.

        Cell i takes up ``capacity_i * sum_g w_ig c_g / (K + c_g)``, with the weights w_ig of its
        ball at the nodes g (:mod:`multicell.nutrient.balls`). The last solution is the first guess.

        - ``capacity``, (n,), amol/s: largest uptake of each cell, not negative
        - ``production``, (n,), amol/s, optional: secretion of each cell, not negative
        - ``radius``, (n,), µm, optional: of the cells, which are points without; needed where
          diffusion differs outside tissue, and for shells
        """
        demand = {self.name: (capacity, production)}
        # a caller may write into its arrays; what is kept of a tissue goes by which arrays it has
        tissue = Tissue(np.array(position), None if radius is None else np.array(radius))
        return self.group.solve(tissue, demand, time=time)[self.name]

    @property
    def group(self) -> FieldGroup:
        """The field as a group of one: what lays its grid and brings it forward."""
        if self._group is None:
            from multicell.nutrient.group import FieldGroup

            self._group = FieldGroup({self.name: self})
        return self._group

    def attach_medium(self) -> None:
        """Let a finite medium lie round the grid, as it is at the start."""
        from multicell.nutrient.balance import WellMixed, volume_beyond_grid

        nutrient = self.parameters.nutrient
        volume, level = (
            volume_beyond_grid(self.name, nutrient, self.layout.whole),
            nutrient.medium(0.0),
        )
        done = sum(time <= 0.0 for time, _ in nutrient.media or ())
        self.well_mixed = WellMixed(level * volume, volume, level * volume, changes=done)

    @property
    def schedule(self) -> Schedule:
        """The medium over time, of a finite one as it is now."""
        if self.well_mixed is None:
            return self.parameters.schedule
        from multicell.nutrient.equations.substance import Schedule

        return Schedule.steady(self.well_mixed.concentration)

    def level(self, time: float) -> float:
        """Return the concentration of the medium at a time in s, of a finite one now, mM."""
        if self.well_mixed is not None:
            return self.well_mixed.concentration
        return self.parameters.nutrient.medium(time)

    def sample(self, position: FloatArray, radius: FloatArray | None = None) -> FloatArray:
        """Return the concentration in mM at positions (n, 3) in µm, interpolated linearly.

        Its mean over cells there with a ``radius``, (n,) µm. Between the last nodes and the faces
        by the conditions there: on a face with a value it is that value. Outside the grid, where it
        lies in stirred medium, by the nearest face.
        """
        return self.read(*self._reached(position, radius))

    def sample_tissue(self, cells: Tissue) -> FloatArray:
        """Do the same for cells that several fields read."""
        reached = cells.position
        if self.parameters.open_medium:
            reached = cells.once(self.layout.nearest, reached)
        radius = cells.once(reaching, cells.position, reached, cells.extent)
        self.layout.keep(reached, radius)
        return self.read(reached, radius)

    def read(self, reached: FloatArray, radius: FloatArray | None = None) -> FloatArray:
        """Do the same at positions on the grid, where cells reach it."""
        return self.layout.read(reached, self.values, self._conditions, radius)

    def gradient(self, position: FloatArray) -> FloatArray:
        """Return the gradient at positions (n, 3) in µm, (n, 3) mM/µm.

        Differences of the interpolated field over one spacing, along the axes of a box or the
        radius of shells; exact for parabolas, up to the faces. In stirred medium it is zero.
        """
        reached, _ = self._reached(position)
        found = self.layout.gradient(reached, self.values)
        if reached is not position:
            found[(reached != position).any(axis=1)] = 0.0
        return found

    def uptake(
        self, position: FloatArray, capacity: FloatArray, radius: FloatArray | None = None
    ) -> FloatArray:
        """Return the uptake of each cell, (n,) amol/s; see :meth:`solve`."""
        reached, extent = self._reached(position, radius)
        return self.uptake_reached(reached, capacity, extent)

    def uptake_reached(
        self, reached: FloatArray, capacity: FloatArray, radius: FloatArray | None = None
    ) -> FloatArray:
        """Do the same at positions on the grid, where cells reach it."""
        rate = uptake(1.0, self.values, self.parameters.nutrient.half_saturation)
        return np.asarray(capacity * self.layout.gather(reached, rate, radius))

    def first_values(self, layout: Layout, time: float) -> float | FloatArray:
        """Return the first values on a layout, mM: of the medium, of a formula or a file.

        Raises NutrientFailed for values below zero or that are not finite, SceneError for more
        oxygen than water dissolves.
        """
        p = self.parameters
        formula, file = p.nutrient.initial_formula, p.nutrient.initial_file
        if not formula and file is None:
            return self.level(time)
        assert isinstance(layout, BoxLayout)
        if file is not None:
            from multicell.nutrient.resampling import resampled

            grid = file.grid(self.name)
            corners = None if p.domain is None else p.domain.corners()
            ends = file.ends(grid.ends, p.dimensions, corners)
            return resampled(grid.values * file.scale, ends, layout.box, self.level(time))
        places = mesh(layout.box.axes())
        values = formula_values(formula, places, "initial_formula")
        wrong = np.flatnonzero(~((values >= 0.0) & (values < np.inf)))
        if len(wrong):
            where = ", ".join(f"{x:g}" for x in places[wrong[0]])
            problem = f"initial_formula of {self.name} is {values[wrong[0]]:g} mM at ({where}) um"
            raise NutrientFailed(problem, "A concentration is finite and not below zero")
        if is_oxygen(self.name):
            path = f"nutrients.{self.name}.initial_formula"
            check_dissolves(float(values.max()), self.parameters.nutrient.temperature, path)
        return values.reshape(layout.shape)

    def put(
        self, reached: FloatArray, amount: FloatArray, radius: FloatArray | None = None
    ) -> float:
        """Add amounts of the cells (n,), amol, at positions on the grid; return the sum of all."""
        before = self.stored()
        density = self.layout.scatter(reached, amount, radius)
        values = self.values + density.reshape(self.values.shape)
        self.take(self.layout, values, self._conditions)
        return self.stored() - before

    def stored(self) -> float:
        """Return the content of the field, amol."""
        return float((self.layout.volumes * self.values).sum())

    def field(self) -> Field:
        """Return the last solution; its values are read-only."""
        return self.layout.field(self.name, self.values)

    def restore(self, field: Field, time: float = 0.0) -> None:
        """Take layout and values of a field from a frame of a time in s."""
        self._layout, values = layouts.restored(field, self.threads)
        values.flags.writeable = False
        self.values = values
        self._conditions = self.parameters.conditions(self._layout, self.level(time))

    @property
    def solution(self) -> Solution:
        """The last solution; a solve makes the next one, and leaves this as it is."""
        return Solution(self._layout, self.values, self._conditions, self.well_mixed)

    @solution.setter
    def solution(self, solution: Solution) -> None:
        self._layout, self.values, self._conditions, self.well_mixed = solution

    def _reached(
        self, position: FloatArray, radius: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return where on the grid cells exchange with the field, and their radii there."""
        if not self.parameters.open_medium:
            return position, radius
        reached = self.layout.nearest(position)
        return reached, None if radius is None else reaching(position, reached, radius)

    def lay(self, cells: Tissue, *, strays: bool = True) -> tuple[Layout, FloatArray]:
        """Return the layout round the tissue, the last one if it is the same, and where cells are.

        That is where on the grid they exchange with it. Without ``strays`` every cell is tissue.
        """
        p, position, radius = self.parameters, cells.position, cells.radius
        tissue, strays = position, strays and p.open_medium
        if strays:
            tissue = cells.once(drawn_in, position, radius)
        radial = p.geometry == "radial"
        if p.geometry == "auto":
            now = isinstance(self._layout, ShellLayout)
            radial = cells.once(round_enough, tissue, radius, now)
        if radial:
            if strays:
                tissue = cells.once(drawn_to_ball, tissue, radius)
            widths = p.nutrient.margin, p.spacing, p.nutrient.layer, p.follows_tissue
            shells = cells.once(ShellLayout.round, tissue, radius, *widths)
            outside = tissue is not position
            return shells, cells.once(shells.nearest, position) if outside else position
        height = p.height if p.dimensions == 2 else None
        if p.domain is None:
            margin = p.nutrient.margin
            if p.follows_tissue:
                from multicell.nutrient.layer import farthest_end

                margin = farthest_end(radius, margin)
            found = BoxLayout.round(tissue, margin, p.spacing, height, self.threads)
        else:
            found = BoxLayout.within(p.domain, p.spacing, height, self.threads)
        same = self._layout is not None and found == self._layout
        reached = position if tissue is position else found.nearest(position)
        return self.layout if same else found, reached

    def exchange(self, layout: Layout, cells: Tissue) -> FloatArray | None:
        """Return the rates of exchange with the medium by which the layer round the tissue ends.

        None where it ends at the sides of the grid, as on shells. See
        :func:`multicell.nutrient.layer.exchange_beyond`.
        """
        if not self.parameters.follows_tissue or not isinstance(layout, BoxLayout):
            return None
        from multicell.nutrient.layer import exchange_beyond

        position, radius = cells.position, cells.radius
        tissue = cells.once(drawn_in, position, radius)
        margin = self.parameters.nutrient.margin
        found = cells.once(exchange_beyond, layout.box, tissue, position, radius, margin)
        return np.asarray(found)

    def take(self, layout: Layout, values: FloatArray, conditions: dict[str, Any]) -> None:
        """Take a solution with the conditions on its sides."""
        values.flags.writeable = False
        self._layout, self._conditions, self.values = layout, conditions, values
