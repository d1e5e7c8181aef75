"""How far a trajectory is from the reference, in several norms.

Positions of single cells are the sharpest measure, but in a cluster where contacts form and
break single cells diverge below any tolerance; energy, size and pair distances then still tell
whether the population is right. The median over time is not decided by one cell that
settled elsewhere shortly before the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from multicell.cells import FloatArray
from multicell.comparison.replay import Problem, Trajectory

NORMS: Final = {
    "position": "positions, largest over the common times / mean radius",
    "position_median": "positions, median over the common times / mean radius",
    "position_final": "positions at the end / mean radius",
    "energy": "contact energy, largest over time / its largest value",
    "gyration": "radius of gyration, largest over time, relative",
    "pair_distance": "pair distances at the end (Wasserstein) / mean radius",
}
"""Name of each norm -> what it measures. Positions: root mean square over the cells."""

_STEPWISE: Final = {
    "position": "positions, largest over the steps / mean radius",
    "position_median": "positions, median over the steps / mean radius",
    "position_final": "positions after the last step / mean radius",
    "energy": "contact energy, largest over the steps / its largest value",
    "gyration": "radius of gyration, largest over the steps, relative",
    "pair_distance": "pair distances after the last step (Wasserstein) / mean radius",
}

_ENERGIES = 100  # common times at which the energy is taken
_CELLS = 1500  # cells among which distances are taken


@final
@dataclass(frozen=True, eq=False)
class Observed:
    """What is compared of a trajectory.

    Attributes
    ----------
    positions : list of (n, 3) float64, µm
        At every common time.
    energy : (k,) float64, fJ
        Contact energy at up to 100 common times, the last one among them.
    gyration : (m,) float64, µm
        Radius of gyration at every common time.
    distances : (p,) float64, µm
        Sorted distances of pairs at the end, among at most 1,500 cells.
    """

    positions: list[FloatArray]
    energy: FloatArray
    gyration: FloatArray
    distances: FloatArray


def described(stepwise: bool) -> dict[str, str]:
    """Return what each norm measures, of a whole run or of single coupling steps."""
    return dict(_STEPWISE if stepwise else NORMS)


def observe(problem: Problem, trajectory: Trajectory) -> Observed:
    """Return what is compared of a trajectory that reached the end."""
    positions = trajectory.positions
    return Observed(
        positions,
        _energies(problem, positions),
        np.array([gyration(position) for position in positions]),
        pair_distances(positions[-1]),
    )


def errors(problem: Problem, found: Observed, exact: Observed) -> dict[str, float]:
    """Return the error of ``found`` in every norm of :data:`NORMS`, all dimensionless."""
    radius = problem.mean_radius
    rms = np.array(
        [
            np.sqrt(np.square(a - b).sum(axis=1).mean())
            for a, b in zip(found.positions, exact.positions, strict=True)
        ]
    )
    energy_scale = float(np.abs(exact.energy).max())
    distance = np.abs(found.distances - exact.distances)
    return {
        "position": float(rms.max()) / radius,
        "position_median": float(np.median(rms)) / radius,
        "position_final": float(rms[-1]) / radius,
        "energy": _relative(np.abs(found.energy - exact.energy), energy_scale),
        "gyration": float((np.abs(found.gyration - exact.gyration) / _size(exact, radius)).max()),
        # equally many samples: the distance of the distributions is that of the sorted samples
        "pair_distance": float(distance.mean()) / radius if len(distance) else 0.0,
    }


def no_errors() -> dict[str, float]:
    """Return the errors of a solve that failed: NaN in every norm."""
    return dict.fromkeys(NORMS, float("nan"))


def gyration(position: FloatArray) -> float:
    """Return the root mean square distance of the centres from their centroid, µm."""
    return float(np.sqrt(np.square(position - position.mean(axis=0)).sum(axis=1).mean()))


def pair_distances(position: FloatArray) -> FloatArray:
    """Return the sorted distances of all pairs among at most 1,500 cells, (p,) µm.

    The cells are taken evenly from the order of the array, which is spatial.
    """
    from scipy.spatial.distance import pdist

    every = -(-len(position) // _CELLS)
    return np.asarray(np.sort(pdist(position[::every])))


def _energies(problem: Problem, positions: list[FloatArray]) -> FloatArray:
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


def _size(exact: Observed, radius: float) -> FloatArray:
    """Return the radius of gyration, or the mean radius where a single cell has none."""
    return np.where(exact.gyration > 0.0, exact.gyration, radius)


def _relative(difference: FloatArray, scale: float) -> float:
    """Return the largest difference over a scale; cells that do not touch have no scale."""
    return float(difference.max()) / (scale if scale > 0.0 else 1.0)
