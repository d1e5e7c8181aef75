"""Conditioning of coupling steps: the effect of a small shift of all positions.

Fresh daughters and contacts that form amplify whatever is wrong at the beginning of a coupling
step, which no method can help and no estimate of a single internal step shows. So a run takes some
of its coupling steps twice, the second time from shifted positions, whose end is compared with the
first one and dropped. This takes at most a fiftieth of the integration; which steps are replayed
depends on counted costs, not on clocks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple, final

import numpy as np

from multicell.random import Purpose, normal
from multicell.vectors import lengths

if TYPE_CHECKING:
    from multicell.cells import FloatArray, IntArray
    from multicell.integrators.base import Integrator
    from multicell.mechanics.system import Mechanics

SHIFT: Final = 0.01  # root mean square of the shift of each coordinate, µm

SHARE: Final = 0.02  # part of the cost of the integration that checks may have


@final
class Replays(NamedTuple):
    """Results and cost of the replays of coupling steps from shifted positions.

    - ``done``, float: number of coupling steps that were replayed to their end
    - ``latest``, ``largest``, float, µm: how far the shift moved the end of the worst cell: in the
      last of them, and at most
    - ``total``, ``spent``, float: cost of all coupling steps so far, and of the replays, in
      evaluations of one cell
    - ``step``, float: cost of the last coupling step
    """

    done: float = 0.0
    latest: float = 0.0
    largest: float = 0.0
    total: float = 0.0
    spent: float = 0.0
    step: float = 0.0

    @property
    def due(self) -> bool:
        """Whether the next coupling step can be replayed within :data:`SHARE`.

        The last step predicts its cost, so that expensive steps are not skipped.
        """
        return 0.0 < self.spent + self.step <= SHARE * self.total

    def after(self, cost: float, replay: float = 0.0, effect: float | None = None) -> Replays:
        """Return the replays after a coupling step of some cost, and perhaps its replay."""
        done, latest, largest = self[:3]
        if effect is not None:
            done, latest, largest = done + 1.0, effect, max(effect, largest)
        return Replays(done, latest, largest, self.total + cost, self.spent + replay, cost)


def shifted_positions(
    position: FloatArray, shift: float, seed: int, step_index: int, ids: IntArray, dimensions: int
) -> FloatArray:
    """Return shifted positions, (n, 3) µm.

    Each coordinate is moved by ``shift`` µm times a standard normal number, which depends on the
    seed, the step and the identity alone; cells of a plane stay in it.
    """
    free = np.arange(3) < dimensions
    noise = normal(seed, Purpose.CONDITIONING, step_index, ids, 3)
    return np.asarray(position + shift * free * noise)


def replay_step(
    integrator: Integrator,
    system: Mechanics,
    start: FloatArray,
    end: FloatArray,
    shifted: FloatArray,
) -> tuple[float | None, float]:
    """Repeat the coupling step of ``system`` from another start.

    Counts of work stay as they were; the system is left made ready for the coupling step.

    - ``start``, ``end``: where it began and ended, (n, 3) µm
    - ``shifted``: where it begins now, (n, 3) µm; cells whose motion is prescribed are left at
      ``start``

    Returns float or None: largest distance of a cell from ``end``, µm; None if the end is not
    reached from there; float: its cost, in evaluations of one cell.
    """
    system.begin(system.motion)
    work, counts = system.work, vars(system.work).copy()
    before = work.effort
    held = system.motion.held
    if held is not None:
        shifted = np.where(held[:, None], start, shifted)
    outcome = integrator.integrate(system, shifted)
    cost = float((work.effort - before) * len(system))
    vars(work).update(counts)
    system.begin(system.motion)
    if not outcome.done:
        return None, cost
    away = lengths(outcome.position - end)
    return float((away if held is None else away[~held]).max(initial=0.0)), cost
