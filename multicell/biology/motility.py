"""Active motion: a force of constant size whose direction is drawn anew at intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from multicell import streams
from multicell.cells import Cells, FloatArray, State
from multicell.streams import Purpose

if TYPE_CHECKING:
    from multicell.scene import Scene

_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def active_force(scene: Scene, cells: Cells, time: float) -> FloatArray:
    """Return the active force of each cell at a time, (n, 3) nN.

    A living cell keeps its direction for the polarisation time and then takes another one at
    random. The moments differ from cell to cell. The direction is a function of seed, cell and
    number of the interval, so that no state has to be kept.

    Parameters
    ----------
    scene
        With ``motility``.
    cells
        The population, n cells.
    time
        Simulated time, s.
    """
    assert scene.motility is not None
    shift = (cells.id + 1) * _GOLDEN % 1.0
    interval = np.floor(time / scene.motility.persistence + shift).astype(np.int64)
    force = np.zeros((len(cells), 3))
    for number in np.unique(interval):
        now = interval == number
        force[now] = streams.directions(
            scene.seed, Purpose.MOTILITY, int(number), cells.id[now], scene.dimensions
        )
    force[cells.state == State.NECROTIC] = 0.0
    return force * scene.motility.force


def pulling_force(scene: Scene, cells: Cells, time: float) -> FloatArray:
    """Return the external force on each cell at a time and its rate, (n, 6) nN and nN/s.

    It points away from the centroid of all cells; a cell that lies there is not pulled.
    """
    assert scene.pull is not None
    away = cells.position - cells.position.mean(axis=0)
    length = np.linalg.norm(away, axis=1, keepdims=True)
    direction = away / np.where(length > 0.0, length, 1.0)
    size = scene.pull.force + scene.pull.rate * time
    return np.hstack([size * direction, scene.pull.rate * direction])


def push(scene: Scene, cells: Cells, time: float) -> FloatArray | None:
    """Return all forces that are no contact forces, with their rates, (n, 6), or None."""
    if scene.motility is None and scene.pull is None:
        return None
    total = np.zeros((len(cells), 6))
    if scene.motility is not None:
        total[:, :3] += active_force(scene, cells, time)
    if scene.pull is not None:
        total += pulling_force(scene, cells, time)
    return total
