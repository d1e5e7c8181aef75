"""Forces that cells do not exert on each other: random motion, chemotaxis, an external pull."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell import random
from multicell.biology.responding import value_of
from multicell.cells import Cells, FloatArray, IntArray, Mask, Signals
from multicell.random import GOLDEN, Purpose

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.scene.parts import Motility


_NONE: Signals = {}
_MOMENTS: Final = 20
"""Moments in a window: the chance of more is below the resolution of a random number."""
_EARLIER: Final = 1 << 20
"""Added to the number of a window, so that those before the start have numbers above zero too."""


def active_force(
    plan: BiologyPlan,
    cells: Cells,
    time: float,
    gradients: Signals = _NONE,
    signals: Signals = _NONE,
) -> FloatArray:
    """Return the active force of each cell at a time, (n, 3) nN.

    A living cell keeps its random direction for the polarisation time and then takes another one
    at random. The moments differ from cell to cell. The direction is a function of seed, cell and
    number of the interval, so that no state has to be kept. A bias along a gradient follows the
    gradient of the moment.

    - ``gradients``, name -> (n, 3), mM/µm: at the cells; of the field that a bias is towards
    - ``signals``, name -> (n,): signals at the cells, to which the bias may respond
    """
    law = plan.motility
    assert law is not None
    if law.renewal == "regular":
        random_part = _regular(plan, law, cells, time)
    else:
        random_part = _renewed(plan, cells.id, time / law.persistence)
    bias = value_of(plan, "bias", law.bias, signals, cells, early=True)
    if bias is not None:
        return law.force * _biased(law, np.clip(bias, -1.0, 1.0)[:, None], random_part, gradients)
    if law.bias:
        return law.force * _biased(law, law.bias, random_part, gradients)
    return random_part * law.force


def _regular(plan: BiologyPlan, law: Motility, cells: Cells, time: float) -> FloatArray:
    """Return the random directions of cells that change them after equal times, (n, 3)."""
    shift = (cells.id + 1) * GOLDEN % 1.0
    interval = np.floor(time / law.persistence + shift).astype(np.int64)
    force = np.zeros((len(cells), 3))
    for number in np.unique(interval):
        now = interval == number
        force[now] = random.directions(
            plan.seed, Purpose.MOTILITY, int(number), cells.id[now], plan.dimensions
        )
    return force


def _renewed(plan: BiologyPlan, ids: IntArray, time: float) -> FloatArray:
    """Return the random directions of cells that change them at random moments, (n, 3).

    A Poisson process without a state: time is cut into windows of one polarisation time. How many
    moments fall into a window (a Poisson number with mean 1) and where (uniformly) are functions of
    seed, cell and window, and so is the direction that is taken at each of them. The direction at a
    ``time`` (in polarisation times) is that of the last moment before: in the same window, or in an
    earlier one if there is none, as in one window of e on average.
    """
    out = np.empty((len(ids), 3))
    window = int(np.floor(time))
    left, before = np.arange(len(ids)), time - window
    while left.size:
        last, found = _last_moment(plan, ids[left], window, before)
        for number in np.unique(last[found]):
            now = left[found & (last == number)]
            out[now] = random.directions(
                plan.seed,
                Purpose.MOTILITY,
                (window + _EARLIER) * _MOMENTS + int(number),
                ids[now],
                plan.dimensions,
            )
        left, window, before = left[~found], window - 1, 1.0
    return out


def _last_moment(
    plan: BiologyPlan, ids: IntArray, window: int, before: float
) -> tuple[IntArray, Mask]:
    """Return the number of the last moment of a window before a part of it, and if there is one."""
    u = random.uniform(plan.seed, Purpose.RENEWAL, window + _EARLIER, ids, 1 + _MOMENTS)
    count = np.searchsorted(_cumulated(), u[:, 0], side="right")
    moments = np.where(np.arange(_MOMENTS) < count[:, None], u[:, 1:], np.inf)
    moments[moments >= before] = -np.inf
    return moments.argmax(axis=1), moments.max(axis=1) > -np.inf


def _cumulated() -> FloatArray:
    """Return the chances of at most 0, 1, ... moments in a window."""
    chances = np.exp(-1.0) / np.cumprod(np.concatenate([[1.0], np.arange(1.0, _MOMENTS)]))
    return np.asarray(np.cumsum(chances))


def _biased(law: Motility, bias: Any, random_part: FloatArray, gradients: Signals) -> FloatArray:
    """Return the directions of b u + (1 - |b|) e, (n, 3); u is zero where there is no gradient."""
    along = np.array(law.direction) if law.direction else gradients.get(law.towards, np.zeros(3))
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    unit = along / np.where(length > 0.0, length, 1.0)
    total = bias * unit + (1.0 - abs(bias)) * random_part
    size = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(size > 0.0, size, 1.0))


def chemotactic_force(plan: BiologyPlan, cells: Cells, gradients: Signals) -> FloatArray:
    """Return the force along the gradients of fields, (n, 3) nN.

    F = force ∇c / (|∇c| + half): proportional to small gradients, and of constant size in steep
    ones, where receptors are saturated; times the factor of the cell's type.
    """
    total = np.zeros((len(cells), 3))
    for name, law in plan.chemotaxis.items():
        gradient = gradients[name]
        steepness = np.linalg.norm(gradient, axis=1, keepdims=True)
        force = law.force * gradient / (steepness + law.half)
        factor = plan.chemotaxis_of.get(name)
        total += force if factor is None else factor[cells.kind, None] * force
    return total


def diffusion_of(plan: BiologyPlan, cells: Cells) -> FloatArray | None:
    """Return the diffusion of each cell by Brownian motion, (n,) µm²/s, or None; dead ones rest."""
    if plan.diffusion is None:
        return None
    return np.where(cells.dead, 0.0, plan.diffusion[cells.kind])


def pulling_force(plan: BiologyPlan, cells: Cells, time: float) -> FloatArray:
    """Return the external force on each cell at a time and its rate, (n, 6) nN and nN/s.

    It points away from the centroid of all cells; a cell that lies there is not pulled.
    """
    assert plan.pull is not None
    away = cells.position - cells.position.sum(axis=0) / max(len(cells), 1)
    length = np.linalg.norm(away, axis=1, keepdims=True)
    direction = away / np.where(length > 0.0, length, 1.0)
    size = plan.pull.force + plan.pull.rate * time
    return np.hstack([size * direction, plan.pull.rate * direction])


def push(
    plan: BiologyPlan,
    cells: Cells,
    time: float,
    gradients: Signals,
    signals: Signals = _NONE,
) -> FloatArray | None:
    """Return all forces that are no contact forces, with their rates, (n, 6), or None.

    Only living cells move by themselves, each type as actively as its ``motility_scale`` and the
    responses of its ``speed`` to the signals ``signals`` say.
    """
    pushes = plan.motility is not None and plan.motility.pushes
    if not pushes and not plan.chemotaxis and plan.pull is None:
        return None
    total = np.zeros((len(cells), 6))
    if pushes:
        total[:, :3] += active_force(plan, cells, time, gradients, signals)
    if plan.chemotaxis:
        total[:, :3] += chemotactic_force(plan, cells, gradients)
    if plan.motility_scale is not None:
        total *= plan.motility_scale[cells.kind, None]
    speed = value_of(plan, "speed", 1.0, signals, cells, early=True)
    if speed is not None:
        total *= speed[:, None]
    total[cells.dead] = 0.0
    if plan.pull is not None:
        total += pulling_force(plan, cells, time)
    return total
