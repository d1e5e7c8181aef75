"""Motion in one coupling step: the integrator on the mechanics, and checks of what it found."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np

from multicell.errors import StepFailed
from multicell.integrators import registry, stability
from multicell.integrators.shift import SHIFT, Replays, replay_step, shifted_positions
from multicell.integrators.stability import Stability
from multicell.scene.dependences import counts_contacts
from multicell.scene.domain import check_inside
from multicell.scene.sizes import brownian_paths
from multicell.simulation.assembly import mechanics_of

if TYPE_CHECKING:
    from multicell.cells import Cells, FloatArray, IntArray
    from multicell.integrators.base import Integrator
    from multicell.mechanics.motion import Motion
    from multicell.scene.scene import Scene


@final
class Moved(NamedTuple):
    """Moved cells at the end of a step.

    - ``position``, ``pressure``, (n, 3) µm and (n,) kPa
    - ``contacts``, (m, 2) or None: indices of the pairs in contact; None where nobody counts them,
      and of cells at rest
    - ``replays``, ``stability``: as in :class:`multicell.simulation.run_state.RunState`
    """

    position: FloatArray
    pressure: FloatArray
    contacts: IntArray | None
    replays: Replays | None
    stability: Stability | None


@final
class Mover:
    """Moves the cells of a scene.

    - ``system``, Mechanics
    - ``integrator``, Integrator
    - ``limit``, float: largest product of step and rate at which a method with a fixed step is
      stable, else 0
    """

    def __init__(self, scene: Scene, threads: int, integrator: Integrator | None) -> None:
        self.system = mechanics_of(scene, threads)
        self.integrator = integrator or registry.from_options(scene.integrator)
        self.limit = stability.limit_of(self.integrator)
        self._seed, self._dimensions, self._domain = scene.seed, scene.dimensions, scene.domain
        self._counts = counts_contacts(scene)
        self._is_free = not scene.contact.acts and self.system.walls is None
        self._paths: Any = brownian_paths(scene)
        self._gel: Any = self.system.walls if getattr(self.system.walls, "shear", None) else None

    @property
    def cavity(self) -> float | None:
        """Radius of the gel round the cells at the last state, µm; None without a gel."""
        return None if self._gel is None else self._gel.radius

    @cavity.setter
    def cavity(self, radius: float) -> None:
        if self._gel is not None:
            self._gel.radius = radius

    def move(
        self,
        cells: Cells,
        motion: Motion,
        step_index: int,
        replays: Replays | None,
        known: Stability | None,
    ) -> Moved:
        """Integrate the positions through a coupling step.

        - ``replays``, ``known``: results of earlier steps

        Raises StepFailed if the integrator fails, a cell leaves the domain, or the method's step is
        too long.
        """
        if len(cells) == 0 or self._is_alone(motion):
            return Moved(cells.position.copy(), np.zeros(len(cells)), None, replays, known)
        if self._is_free:
            return self._drifted(cells, motion, replays, known)
        if motion.diffusion is not None:
            return self._shake(cells, motion, motion.diffusion, replays, known)
        moved, reached, cost = self._integrate(cells.id, cells.position, motion, known)
        replays = self._replay(cells, reached, cost, step_index, replays)
        return moved._replace(replays=replays)

    def _integrate(
        self,
        ids: IntArray,
        position: FloatArray,
        motion: Motion,
        known: Stability | None,
        *,
        is_last: bool = True,
    ) -> tuple[Moved, FloatArray, float]:
        """Integrate a motion; return it without replays, where the method got, and its cost.

        - ``is_last``: else another one follows in the coupling step, and nobody reads the pressure,
          nor contacts but for laws that ask who touched
        """
        system, end = self.system, motion.end
        system.begin(motion)
        known = self._check_begin(position, known)
        before = system.work.effort
        outcome = self.integrator.integrate(system, position)
        if not outcome.done:
            cell = None if outcome.cell is None else int(ids[outcome.cell])
            raise StepFailed(outcome.time, outcome.problem, outcome.hint, cell)
        placed = system.at_end(outcome.position)
        check_inside(self._domain, ids, placed, end)
        pressure = system.pressure(end, outcome.position) if is_last else np.zeros(len(ids))
        counts = self._counts and (is_last or motion.touching is not None)
        contacts = system.contacts(end, outcome.position) if counts else None
        cost = float((system.work.effort - before) * len(ids))
        known = self._check_end(outcome.position, cost, known)
        return Moved(placed, pressure, contacts, None, known), outcome.position, cost

    def _shake(
        self,
        cells: Cells,
        motion: Motion,
        diffusion: FloatArray,
        replays: Replays | None,
        known: Stability | None,
    ) -> Moved:
        """Integrate a motion with diffusion: internal steps, with one random force in each.

        Nothing is taken again from another start: another path changes more.
        """
        position, touching = cells.position, motion.touching
        times = self._paths.times(motion.begin, motion.end)
        moves = self._paths.moves(times, cells.id)
        scale = np.sqrt(2.0 * diffusion)[:, None]
        for begin, end in pairwise(times):
            part = motion.part(begin, end, self.system.drag, scale * next(moves), touching)
            moved, _, _ = self._integrate(
                cells.id, position, part, known, is_last=end == motion.end
            )
            position, known, touching = moved.position, moved.stability, moved.contacts
        return moved._replace(replays=replays)

    def _drifted(
        self, cells: Cells, motion: Motion, replays: Replays | None, known: Stability | None
    ) -> Moved:
        """Return cells that nothing but forces of their own and from outside moves: exactly."""
        position = cells.position + motion.drift(self.system.drag)
        if motion.diffusion is not None:
            (move,) = self._paths.moves([motion.begin, motion.end], cells.id)
            position += np.sqrt(2.0 * motion.diffusion)[:, None] * move
        contacts = None
        if self._counts:
            self.system.begin(motion)
            contacts = self.system.contacts(motion.end, position)
        return Moved(position, np.zeros(len(cells)), contacts, replays, known)

    def contacts(self, cells: Cells, motion: Motion) -> IntArray | None:
        """Return indices of the pairs that overlap, (m, 2), before any of them has touched."""
        if not len(cells):
            return None
        self.system.begin(motion)
        return self.system.contacts(motion.begin, cells.position) if self._counts else None

    def _is_alone(self, motion: Motion) -> bool:
        """Return whether there is one cell that nothing acts on: it stays where it is."""
        moves = not (motion.push is motion.held is motion.diffusion is None)
        return len(motion.radius) == 1 and not moves and self.system.walls is None

    def _check_begin(self, position: FloatArray, known: Stability | None) -> Stability | None:
        """Measure, if that is due, how far a fixed step is from its limit before a step."""
        if known is None:
            return None
        n, product = len(position), self.limit / self._fixed_step()
        if not stability.is_due(known, n, product):
            return known
        rate = stability.rate_at(self.system, self.system.motion.begin, position, self._dimensions)
        return stability.add_measurement(known, rate, product, n)

    def _check_end(
        self, position: FloatArray, cost: float, known: Stability | None
    ) -> Stability | None:
        """Refuse a fixed step that is beyond its limit after a coupling step as it was before."""
        if known is None:
            return None
        system, n, end = self.system, len(position), self.system.motion.end
        known = known._replace(total=known.total + cost)
        dt = self._fixed_step()
        product = self.limit / dt
        was_beyond, suspect = known.rate > product, False
        if not was_beyond and stability.may_glance(known, n):
            known = stability.add_glance(known, n)
            suspect = stability.glance(system, end, position) > stability.NEAR_LIMIT * product
        if not was_beyond and not suspect:
            return known
        rate = stability.rate_at(system, end, position, self._dimensions)
        if was_beyond and rate > product:
            words = stability.refusal_words(self.integrator, dt, self.limit, rate)
            raise StepFailed(system.motion.begin, *words)
        return stability.add_measurement(known, rate, product, n)

    def _fixed_step(self) -> float:
        """Return how long the equal steps of the coupling step are, s."""
        motion = self.system.motion
        return stability.actual_step(self.integrator, motion.end - motion.begin)

    def _replay(
        self, cells: Cells, end: FloatArray, cost: float, step_index: int, replays: Replays | None
    ) -> Replays | None:
        """Take the step again from shifted positions where that is due, and note the effect."""
        if replays is None:
            return None
        effect, spent = None, 0.0
        if replays.due:
            begin = cells.position
            shifted = shifted_positions(
                begin, SHIFT, self._seed, step_index, cells.id, self._dimensions
            )
            effect, spent = replay_step(self.integrator, self.system, begin, end, shifted)
        return replays.after(cost, spent, effect)
