"""Norms of the distance of a trajectory from the reference.

Positions of single cells are the sharpest measure, but in a cluster where contacts form and
break single cells diverge below any tolerance. Energy and size still show whether the population
is right. The median over time does not depend on one cell that settles elsewhere
shortly before the end. The root mean square over the cells hides a single stray cell, so the error
of the worst cell is given as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, final

import numpy as np

from multicell.cells import FloatArray
from multicell.comparison.replay import ReplayProblem, Trajectory
from multicell.errors import SceneError

Metric = Callable[[FloatArray], float]
"""A quantity of the user's own: positions of all cells, (n, 3) µm -> a number in any unit."""

_ENERGIES = 100  # common times at which the energy is taken
_MOMENTS: Final = {
    "worst": ("largest over the common times", "largest over the steps"),
    "median": ("median over the common times", "median over the steps"),
    "last": ("at the end", "after the last step"),
}
"""Moment of a norm -> its words for a whole run, and for single steps."""


@final
@dataclass(frozen=True, eq=False)
class Observed:
    """Quantities of a trajectory that are compared.

    - ``positions``, list of (n, 3) float64, µm: at every common time
    - ``energy``, (k,) float64, fJ: contact energy at up to 100 common times, the last one among
      them
    - ``gyration``, (m,) float64, µm: radius of gyration at every common time
    """

    positions: list[FloatArray]
    energy: FloatArray
    gyration: FloatArray


@final
@dataclass(frozen=True)
class Norm:
    """One measure of the distance between two trajectories, dimensionless.

    - ``name``, str: name in tables (``error_<name>``)
    - ``quantity``, str: what is compared
    - ``moment``, str: where: ``"worst"``, ``"median"`` or ``"last"`` of the common times or steps
    - ``scale``, str: what the difference is divided by; empty: nothing
    - ``measure``, callable: observed, exact, mean radius in µm -> error
    """

    name: str
    quantity: str
    moment: str
    scale: str
    measure: Callable[[Observed, Observed, float], float]

    def words(self, stepwise: bool = False) -> str:
        """Return the name of the norm, of a whole run or of single coupling steps."""
        where = f"{self.quantity}, {_MOMENTS[self.moment][stepwise]}"
        return f"{where} / {self.scale}" if self.scale else where


def observe(problem: ReplayProblem, trajectory: Trajectory) -> Observed:
    """Return the quantities of a trajectory that reached the end."""
    positions = trajectory.positions
    sizes = np.array([gyration(position) for position in positions])
    return Observed(positions, _energies(problem, positions), sizes)


def errors(
    problem: ReplayProblem,
    found: Observed,
    exact: Observed,
    norms: Mapping[str, Norm] | None = None,
) -> dict[str, float]:
    """Return the error of ``found`` in every norm, by default in all of :data:`NORMS`."""
    radius = problem.mean_radius
    return {name: norm.measure(found, exact, radius) for name, norm in (norms or NORMS).items()}


def norms_with(metrics: Mapping[str, Metric] | None) -> dict[str, Norm]:
    """Return :data:`NORMS`, and one of the user's own for each metric.

    Raises SceneError for a name that is no identifier or that a norm has.
    """
    own = {}
    for name, metric in (metrics or {}).items():
        if not name.isidentifier() or name in NORMS:
            problem = "is the name of a norm" if name in NORMS else "is no identifier"
            raise SceneError(f"metrics.{name}", problem)
        own[name] = described(name, metric)
    return NORMS | own


def described(name: str, metric: Metric | None = None) -> Norm:
    """Return the norm of a user's own metric; without the metric it only has words."""

    def measure(found: Observed, exact: Observed, radius: float) -> float:
        assert metric is not None
        pairs = zip(found.positions, exact.positions, strict=True)
        return max(abs(float(metric(a)) - float(metric(b))) for a, b in pairs)

    return Norm(name, name.replace("_", " "), "worst", "", measure)


def gyration(position: FloatArray) -> float:
    """Return the root mean square distance of the centres from their centroid, µm."""
    return float(_rms(position, position.mean(axis=0)))


def _energies(problem: ReplayProblem, positions: list[FloatArray]) -> FloatArray:
    """Return the contact energy at evenly chosen common times, (k,) fJ."""
    system = problem.system()
    count = len(positions)
    chosen = np.unique(np.linspace(0, count - 1, min(count, _ENERGIES)).round().astype(int))
    values = []
    for k in chosen:
        motion = problem.steps[k].motion
        system.begin(motion)
        values.append(system.energy(motion.end, positions[k]))
    return np.array(values)


def _rms(position: FloatArray, other: FloatArray) -> float:
    """Return the root mean square distance of cells from other places, µm."""
    return float(np.sqrt(np.square(position - other).sum(axis=1).mean()))


def worst_distance(position: FloatArray, other: FloatArray) -> float:
    """Return the largest distance of a cell between two states, µm."""
    return float(np.sqrt(np.square(position - other).sum(axis=1).max()))


def displacements(
    positions: Sequence[FloatArray], others: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return how far cells are from other places at each of m times.

    Returns (m,) µm: root mean square over the cells; (m,) µm: the worst cell.
    """
    pairs = list(zip(positions, others, strict=True))
    worst = np.array([worst_distance(a, b) for a, b in pairs])
    return np.array([_rms(a, b) for a, b in pairs]), worst


def _position(
    over: Callable[[FloatArray], float], of: Callable[[FloatArray, FloatArray], float] = _rms
) -> Callable[[Observed, Observed, float], float]:
    """Return the error of positions: ``of`` the cells of one time, then ``over`` the times."""

    def measure(found: Observed, exact: Observed, radius: float) -> float:
        pairs = zip(found.positions, exact.positions, strict=True)
        return float(over(np.array([of(a, b) for a, b in pairs]))) / radius

    return measure


_worst_cell = partial(_position, of=worst_distance)


def _energy(found: Observed, exact: Observed, radius: float) -> float:
    scale = float(np.abs(exact.energy).max())
    # cells that do not touch have no scale
    return float(np.abs(found.energy - exact.energy).max()) / (scale if scale > 0.0 else 1.0)


def _gyration(found: Observed, exact: Observed, radius: float) -> float:
    # a single cell has no radius of gyration
    size = np.where(exact.gyration > 0.0, exact.gyration, radius)
    return float((np.abs(found.gyration - exact.gyration) / size).max())


NORMS: Final[dict[str, Norm]] = {
    norm.name: norm
    for norm in (
        Norm("position", "positions", "worst", "mean radius", _position(np.max)),
        Norm("position_median", "positions", "median", "mean radius", _position(np.median)),
        Norm("position_final", "positions", "last", "mean radius", _position(lambda x: x[-1])),
        Norm("worst_cell", "worst cell", "worst", "mean radius", _worst_cell(np.max)),
        Norm("worst_cell_median", "worst cell", "median", "mean radius", _worst_cell(np.median)),
        Norm("energy", "contact energy", "worst", "its largest value", _energy),
        Norm("gyration", "radius of gyration", "worst", "itself", _gyration),
    )
}
"""Name of each norm -> the norm. Of positions: root mean square over the cells."""

WORST_CELL: Final = {"worst_cell": "worst_cell_um", "worst_cell_median": "worst_cell_median_um"}
"""Norm of the worst cell -> the column that holds it in µm."""
