"""Forces that cells do not exert on each other: random motion, taxis, an external pull."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from multicell import random
from multicell.cells import Cells, FloatArray
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


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
        force[now] = random.directions(
            scene.seed, Purpose.MOTILITY, int(number), cells.id[now], scene.dimensions
        )
    return force * scene.motility.force


def chemotactic_force(
    scene: Scene, cells: Cells, gradients: Mapping[str, FloatArray]
) -> FloatArray:
    """Return the force along the gradients of fields, (n, 3) nN.

    F = force ∇c / (|∇c| + half): proportional to small gradients, and of constant size in steep
    ones, where receptors are saturated.

    Parameters
    ----------
    gradients : name -> (n, 3), mM/µm
        At the cells.
    """
    total = np.zeros((len(cells), 3))
    for name, law in scene.chemotaxis.items():
        gradient = gradients[name]
        steepness = np.linalg.norm(gradient, axis=1, keepdims=True)
        total += law.force * gradient / (steepness + law.half)
    return total


def haptotactic_force(scene: Scene, cells: Cells) -> FloatArray:
    """Return the force up the scene's landscape of adhesion, (n, 3) nN.

    Its potential is -a(x) with a = x for a gradient, cos(2πx/L) for stripes and
    exp(-|x|²/2L²) for a spot, scaled so that the largest force is the one that the scene gives.
    """
    law = scene.haptotaxis
    assert law is not None
    total = np.zeros((len(cells), 3))
    if law.landscape == "spot":
        away = cells.position / law.length
        square = np.square(away).sum(axis=1, keepdims=True)
        return np.asarray(-law.force * away * np.exp(0.5 - 0.5 * square))
    axis = "xyz".index(law.axis)
    total[:, axis] = law.force
    if law.landscape == "stripes":
        total[:, axis] *= -np.sin(2.0 * np.pi * cells.position[:, axis] / law.length)
    return total


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


def push(
    scene: Scene, cells: Cells, time: float, gradients: Mapping[str, FloatArray]
) -> FloatArray | None:
    """Return all forces that are no contact forces, with their rates, (n, 6), or None.

    Only living cells move by themselves, each type as actively as its ``motility_scale`` says.
    """
    active = scene.motility is not None or bool(scene.chemotaxis) or scene.haptotaxis is not None
    if not active and scene.pull is None:
        return None
    total = np.zeros((len(cells), 6))
    if scene.motility is not None:
        total[:, :3] += active_force(scene, cells, time)
    if scene.chemotaxis:
        total[:, :3] += chemotactic_force(scene, cells, gradients)
    if scene.haptotaxis is not None:
        total[:, :3] += haptotactic_force(scene, cells)
    if scene.types:
        total *= np.array([part.motility_scale for part in scene.types.values()])[cells.kind, None]
    total[cells.dead] = 0.0
    if scene.pull is not None:
        total += pulling_force(scene, cells, time)
    return total
