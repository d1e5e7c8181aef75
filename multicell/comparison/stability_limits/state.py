"""Where stability is measured: a state of the cells, its largest decay rate, its true course.

Nothing but contacts (and walls) acts, and radii are constant unless the state is that of a growing
tissue, so that the energy can only fall: a method under which it rises is wrong.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, field, replace
from typing import Any, Final, final

import numpy as np

from multicell.cells import FloatArray, IntArray
from multicell.comparison.stability_limits.modes import Unstable, largest_decay
from multicell.errors import SceneError, StepFailed
from multicell.integrators.cvode import Cvode
from multicell.mechanics.motion import Motion, Work
from multicell.mechanics.system import Mechanics
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

PUSH: Final = 0.005
"""Displacement along the stiffest mode from which a settled cluster starts, over the overlap of
the contact that this mode strains most."""

MIN_NOTICED: Final = 0.035  # motion that counts as instability, over the same overlap

MAX_UNNOTICED: Final = 0.02
"""Displacement of cells that have divided that must not matter, in radii."""

_TWINS = 3
_HALVINGS = 15  # of the length of a trial, to the first moment at which it is looked at

_AT_REST = 1e-10  # speed of a cluster at rest, in radii times the largest decay rate
_DOUBLINGS = 16
_RTOL, _ATOL = 1e-11, 1e-9  # of the reference; the second in mean radii
_MAX_STEPS = 50_000  # steps of the reference


@final
@dataclass(frozen=True, eq=False)
class State:
    """Cells at the start of a trial.

    - ``scene``, Scene
    - ``template``, Mechanics: each trial works on a copy
    - ``motion``, Motion: radii, which are constant, and moduli; its times mean nothing
    - ``start``, (n, 3) float64, µm: positions at time 0
    - ``rate``, float, 1/s: largest decay rate λ_max of the Jacobian at the state (before the push,
      if there is one)
    - ``noticed``, float, µm: motion of a cell that counts as instability
    - ``share``, float: rise of the energy that is noticed, over the energy that the reference
      releases
    - ``twins``, tuple of State: states that differ a little. Where cells are pressed apart they may
      end in one pocket or another: what differs among the true courses of twins is no failure of a
      method.
    - ``known``, list of (time, positions): what has been computed of the true course, by CVODE at a
      tight tolerance
    - ``kind``, str: a key of :data:`multicell.comparison.stability_limits.moving_states.STATES`
    - ``length``, float, s: length of a trial of a moving state; NaN where it follows from the
      setting of the method, for states that are close to rest
    - ``unstable``, Unstable or None: the unstable modes at the start of a moving state
    - ``end_rate``, float, 1/s: largest decay rate at the end of the trial of such a state; ``rate``
      is then the largest on the way
    - ``rise``, float, fJ: largest rise of the energy along the true course, which is none while
      radii are constant
    """

    scene: Scene
    template: Mechanics
    motion: Motion
    start: FloatArray
    rate: float
    noticed: float
    share: float
    twins: tuple[State, ...] = ()
    known: list[tuple[float, FloatArray]] = field(default_factory=list)
    kind: str = "settled"
    length: float = math.nan
    unstable: Unstable | None = None
    end_rate: float = math.nan
    rise: float = 0.0

    @property
    def settled(self) -> bool:
        """Whether the cells start near rest, and a trial is as long as its steps ask for."""
        return math.isnan(self.length)

    @property
    def observation_times(self) -> list[float]:
        """Times in s at which the true course of a moving state is computed: halves of halves."""
        return [self.length * 0.5**k for k in range(_HALVINGS, -1, -1)]

    @property
    def radius(self) -> float:
        """Mean radius, µm: the unit of length of all displacements."""
        return float(self.motion.radius.mean())

    @property
    def stiff_limit(self) -> float:
        """Euler's limit 2/λ_max, s."""
        return 2.0 / self.rate

    @property
    def energy_unit(self) -> float:
        """Σ E r³, fJ: the energy of cells that are squeezed out of shape."""
        return float((self.motion.young * self.motion.radius**3).sum())

    def system(self, begin: float, end: float) -> Mechanics:
        """Return mechanics of its own, ready for the time between two moments."""
        system = replace(self.template, work=Work())
        self.ready(system, begin, end)
        return system

    def ready(
        self, system: Mechanics, begin: float, end: float, touching: IntArray | None = None
    ) -> None:
        """Make mechanics ready for the time between two moments.

        ``touching`` are the pairs in contact at the first, where the law asks for them.
        """
        motion = replace(self.motion, begin=begin, end=end)
        if not self.settled:
            # a trial is one coupling step: contacts are remembered from its start
            touching = None
            motion = motion_at(motion, begin)
        if motion.touching is not None and touching is not None:
            motion = replace(motion, touching=touching)
        system.begin(motion)

    def energy(self, time: float, position: FloatArray) -> float:
        """Return the contact energy of cells at some place and time, fJ."""
        return self.system(time, time + 1.0).energy(time, position)

    def at(self, time: float) -> FloatArray:
        """Return the true positions at a time, (n, 3) µm.

        Raises StepFailed if the reference cannot be computed.
        """
        if not self.known:
            self.known.append((0.0, self.start))
        place = bisect.bisect_right(self.known, time, key=lambda entry: entry[0]) - 1
        before, position = self.known[place]
        if time > before:
            system = self.system(before, time)
            if self.motion.touching is not None:
                self.ready(system, before, time, system.contacts(before, position))
            position = _advance(system, position)
            self.known.insert(place + 1, (time, position))
        return position


def settled_state(scene: Scene, threads: int | None = None) -> State:
    """Return a scene's first cells at rest, pushed a little along the mode that decays fastest.

    - ``scene``: external forces, prescribed motion and motility are left out, growth stands still

    Raises SceneError if the scene starts with less than two cells, or none of them touch;
    StepFailed if the reference method cannot settle them.
    """
    template, motion, position = first_cells(scene, threads)
    share = (MIN_NOTICED / PUSH) ** 2
    blank = State(scene, template, motion, position, math.nan, math.nan, share)
    rest = rest_positions(blank)
    rate, mode = largest_decay(blank.system(0.0, 1.0), rest, scene.dimensions == 2)
    overlap = _strained_overlap(blank, rest, mode)
    mode *= PUSH * overlap / np.sqrt(np.square(mode).sum(axis=1)).max()
    return replace(blank, start=rest + mode, rate=rate, noticed=MIN_NOTICED * overlap, known=[])


def twins_of(state: State, shift: float | None = None) -> tuple[State, ...]:
    """Return states whose cells are displaced at random by what must not matter, or ``shift`` µm.

    That is the root mean square of a cell's displacement.
    """
    random = np.random.default_rng(0)
    free = np.array([1.0, 1.0, float(state.scene.dimensions == 3)])
    shifts = [random.normal(size=state.start.shape) * free for _ in range(_TWINS)]
    size = (state.noticed if shift is None else shift) / math.sqrt(3.0)
    return tuple(replace(state, start=state.start + size * shift, known=[]) for shift in shifts)


def _strained_overlap(state: State, position: FloatArray, mode: FloatArray) -> float:
    """Return the overlap in µm of the pair in contact that a mode strains most."""
    pairs = state.system(0.0, 1.0).contacts(0.0, position)
    line = position[pairs[:, 1]] - position[pairs[:, 0]]
    distance = np.linalg.norm(line, axis=1)
    strain = np.einsum("ij,ij->i", mode[pairs[:, 1]] - mode[pairs[:, 0]], line) / distance
    most = int(np.abs(strain).argmax())
    overlap = state.motion.radius[pairs[most]].sum() - distance[most]
    return float(max(overlap, 1e-4 * state.radius))


def first_cells(scene: Scene, threads: int | None) -> tuple[Mechanics, Motion, FloatArray]:
    """Return mechanics, motion and positions of the cells that a scene starts with."""
    if scene.initial.count < 2:
        raise SceneError(
            "initial.count",
            f"is {scene.initial.count}: the stability of motion needs two cells at least",
            "For example --set initial.count=60 --set initial.spacing=0.85",
        )
    # the scene's own method moves nothing here, and may be one that is not at hand
    simulation = Simulation(scene, threads=threads, integrator=Cvode())
    cells = simulation.cells
    motion = simulation._motion(0.0, 0.0, cells.radius)
    motion = replace(motion, push=None, held=None, velocity=None)
    return simulation.mechanics, motion, cells.position


def innermost(position: FloatArray) -> IntArray:
    """Return the cells by distance from the one that is nearest to the centroid."""
    middle = np.square(position - position.mean(axis=0)).sum(axis=1).argmin()
    return np.argsort(np.square(position - position[middle]).sum(axis=1), kind="stable")


def rest_positions(state: State) -> FloatArray:
    """Return where the cells of a state come to rest, or where they are after a long time."""
    position = state.start
    length = 10.0 / _bound(state, position)
    velocity = np.empty_like(position)
    time = 0.0
    for _ in range(_DOUBLINGS):
        position = _advance(state.system(time, time + length), position)
        time += length
        system = state.system(time, time + 1.0)
        system.velocity(time, position, velocity)
        if np.abs(velocity).max() <= _AT_REST * state.radius * _bound(state, position):
            break
        length *= 2.0
    return position


def _bound(state: State, position: FloatArray) -> float:
    bound = state.system(0.0, 1.0).stiffness_bound(0.0, position)
    if not bound > 0.0:
        hint = "A smaller initial.spacing lets them touch."
        raise SceneError("", "no cells touch: there is no motion whose stability can be lost", hint)
    return bound


def _advance(system: Mechanics, position: FloatArray) -> FloatArray:
    """Return the positions at the end of a step by the reference method."""
    atol = _ATOL * float(system.motion.radius.mean())
    outcome = Cvode(_RTOL, atol, _MAX_STEPS).integrate(system, position)
    if not outcome.done:
        raise StepFailed(outcome.time, f"the reference: {outcome.problem}", outcome.hint)
    return outcome.position


def select_cells(motion: Motion, source: IntArray, radius: FloatArray) -> Motion:
    """Return the motion of cells that descend from those at ``source``."""
    columns = {name: getattr(motion, name) for name in ("young", "poisson", "bonds", "kind")}
    taken: dict[str, Any] = {n: None if x is None else x[source] for n, x in columns.items()}
    return replace(motion, radius=radius, radius_rate=np.zeros(len(radius)), **taken)


def motion_at(motion: Motion, time: float) -> Motion:
    """Return a motion whose values at time 0 are given with those at another time, s."""
    bonds = motion.bonds
    if bonds is not None:
        bonds = np.hstack([bonds[:, :2] + time * bonds[:, 2:], bonds[:, 2:]])
    radius = motion.radius + time * motion.radius_rate
    return replace(motion, radius=radius, bonds=bonds)
