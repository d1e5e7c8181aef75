"""The quasi-steady field of one nutrient: owner of its grid and of its last solution."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, final

import numpy as np

from multicell.cells import FloatArray
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.grid import Box, extent, lay, moved
from multicell.nutrient.steady import SolveReport, solve_steady
from multicell.nutrient.transfer import gather, scatter

if TYPE_CHECKING:
    from multicell.frame import Field


class NutrientParameters(Protocol):
    """What is read from a scene's nutrient; see :class:`multicell.scene.Nutrient`."""

    @property
    def diffusion(self) -> float:
        """Diffusion coefficient, µm²/s."""

    @property
    def boundary(self) -> float:
        """Concentration on the faces of the grid's box, mM."""

    @property
    def half_saturation(self) -> float:
        """Michaelis constant of uptake, mM."""

    @property
    def spacing(self) -> float:
        """Grid spacing, µm."""

    @property
    def margin(self) -> float:
        """Least distance from a cell's centre to the faces, µm."""


@final
class NutrientField:
    """One nutrient that diffuses, is taken up by the cells and settles at once.

    The medium value stands on the faces of a box round all cells, at ``margin`` from the outermost
    centres: a layer of medium without convection lies round the cells, always as thick as that.

    Parameters
    ----------
    name
        The nutrient's name in the scene.
    parameters
        ``diffusion``, ``boundary``, ``half_saturation``, ``spacing`` and ``margin`` in base units.
    """

    def __init__(self, name: str, parameters: NutrientParameters) -> None:
        self.name = name
        self.parameters = parameters
        self.layings = 0
        self._box: Box | None = None
        self._operator: Diffusion | None = None
        self._values: FloatArray = np.empty((0, 0, 0))

    @property
    def box(self) -> Box:
        """Where the grid lies.

        Raises
        ------
        ValueError
            Before the first solve.
        """
        if self._box is None:
            raise ValueError(f"{self.name} has no grid before the first solve")
        return self._box

    def solve(self, position: FloatArray, capacity: FloatArray) -> SolveReport:
        """Solve for the steady field that the cells' uptake leaves.

        Cell i takes up ``capacity_i * sum_g w_ig c_g / (K + c_g)``, with the trilinear weights
        w_ig of the nodes g around it. The last solution is the first guess.

        Parameters
        ----------
        position : (n, 3), µm
        capacity : (n,), amol/s
            Largest uptake of each cell, not negative.

        Returns
        -------
        SolveReport

        Raises
        ------
        NutrientFailed
            If the grid would become too large, a position is not finite, or the solver fails;
            the field then still is the last one.
        ValueError
            If shapes do not match or a capacity is negative or not finite.
        """
        position = np.asarray(position, dtype=np.float64)
        _check(position, capacity)
        box, operator, start = self._placed(position)
        sink = scatter(position, capacity, box.origin, box.spacing, box.shape)
        values, report = solve_steady(operator, sink, self.parameters.half_saturation, start)
        values.flags.writeable = False
        self.layings += box is not self._box
        self._box, self._operator, self._values = box, operator, values
        return report

    def sample(self, position: FloatArray) -> FloatArray:
        """Return the concentration in mM at positions (n, 3) in µm, interpolated trilinearly.

        Raises
        ------
        ValueError
            Before the first solve, and for positions outside the box.
        """
        return gather(position, self._values, self.box.origin, self.box.spacing)

    def field(self) -> Field:
        """Return the last solution; its values are read-only."""
        from multicell.frame import Field

        box = self.box
        return Field(
            name=self.name,
            unit="mM",
            origin=np.array(box.origin),
            spacing=box.spacing,
            values=self._values,
        )

    def _placed(self, position: FloatArray) -> tuple[Box, Diffusion, FloatArray]:
        """Return the grid round the cells, kept if they have not moved, and the first guess."""
        p = self.parameters
        box = lay(*extent(position, p.margin), p.spacing)
        if self._box is not None and self._operator is not None and box == self._box:
            return self._box, self._operator, self._values
        operator = Diffusion(box.to_pde(), p.diffusion, p.boundary)
        if self._box is None:
            return box, operator, np.full(box.shape, p.boundary)
        return box, operator, moved(self._values, self._box, box, p.boundary)


def _check(position: FloatArray, capacity: FloatArray) -> None:
    if position.ndim != 2 or position.shape[1] != 3:
        raise ValueError(f"position has shape {position.shape}, expected (n, 3)")
    if np.shape(capacity) != position.shape[:1]:
        raise ValueError(f"capacity has shape {np.shape(capacity)}, expected ({len(position)},)")
    if not np.all((np.asarray(capacity) >= 0.0) & np.isfinite(capacity)):
        raise ValueError("a cell's capacity of uptake is negative or not finite")
