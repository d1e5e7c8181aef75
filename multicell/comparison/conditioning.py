"""The conditioning of single coupling steps: what a random shift of all positions does to the end.

Fresh daughters and contacts that form are unstable: there a coupling step amplifies any error at
its beginning, by every method, and now and then a cell falls into another pocket. Elsewhere a step
damps a shift. The error of a method is therefore compared with the change that a shift of the
tolerance's size makes to the end, solved by the method of the reference. Smaller errors are
indistinguishable from that noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from multicell.cells import FloatArray
from multicell.comparison.base import Row
from multicell.comparison.norms import Norm, Observed, displacements, errors
from multicell.comparison.replay import ReplayProblem
from multicell.integrators.shift import shifted_positions

_COLUMNS: Final = {"begin_s": "begin", "rms_um": "rms", "worst_cell_um": "worst_cell"}


@final
@dataclass(frozen=True, eq=False)
class Conditioning:
    """How far a random shift of all positions moves the end of each of m coupling steps.

    - ``shift``, float, µm: root mean square of the shift of each coordinate at the beginning
    - ``begin``, (m,) float64, s: when each step begins
    - ``rms``, (m,) float64, µm: displacement at the end of each step, root mean square over the
      cells
    - ``worst_cell``, (m,) float64, µm: the same of the worst cell
    - ``floor``, norm -> float: the change in every norm of
      :data:`multicell.comparison.norms.NORMS`, dimensionless
    """

    shift: float
    begin: FloatArray
    rms: FloatArray
    worst_cell: FloatArray
    floor: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """Return numbers and lists, with the unit in the name of what has one."""
        columns = {name: getattr(self, key).tolist() for name, key in _COLUMNS.items()}
        return {"shift_um": self.shift, **columns, "floor": self.floor}

    @classmethod
    def from_dict(cls, table: Mapping[str, Any] | None) -> Conditioning | None:
        """Read the output of :meth:`to_dict`; None for None.

        Raises KeyError if something is missing.
        """
        if table is None:
            return None
        arrays = {key: np.array(table[name], dtype=float) for name, key in _COLUMNS.items()}
        return cls(table["shift_um"], **arrays, floor=dict(table["floor"]))

    @property
    def amplification(self) -> FloatArray:
        """Displacement of the worst cell at each end over the shift of a coordinate, (m,)."""
        return np.asarray(self.worst_cell / self.shift)

    def rows(self) -> list[Row]:
        """Return the steps as rows of a table; columns of a quantity end in its unit."""
        table = self.to_dict()
        return [
            {"step": k, "shift_um": self.shift, **{name: table[name][k] for name in _COLUMNS}}
            for k in range(len(self.begin))
        ]


def shift_starts(problem: ReplayProblem, shift: float) -> ReplayProblem:
    """Return a step-wise problem whose steps start from shifted positions.

    Each coordinate is moved by ``shift`` µm times a standard normal number, which depends on the
    scene's seed, the step's index and the cell's place in the array alone; cells of a plane stay
    in it.
    """
    if problem.starts is None:
        raise ValueError("only single coupling steps start from positions that can be shifted")
    scene = problem.scene
    starts = [
        shifted_positions(start, shift, scene.seed, k, np.arange(len(start)), scene.dimensions)
        for k, start in enumerate(problem.starts)
    ]
    return replace(problem, starts=starts)


def conditioning_of(
    problem: ReplayProblem,
    shift: float,
    found: Observed,
    exact: Observed,
    norms: Mapping[str, Norm] | None = None,
) -> Conditioning:
    """Return the conditioning of the steps of a problem.

    - ``shift``: see :func:`shift_starts`
    - ``found``, ``exact``: what is compared of the ends from shifted positions, and of those of the
      reference
    - ``norms``: of the floor, by default :data:`multicell.comparison.norms.NORMS`
    """
    begin = np.array([step.motion.begin for step in problem.steps])
    rms, worst = displacements(found.positions, exact.positions)
    return Conditioning(shift, begin, rms, worst, errors(problem, found, exact, norms))
