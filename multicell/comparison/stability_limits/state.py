"""The state at which stability is measured: its largest decay rate, its true course.

Nothing but contacts (and walls) acts, and radii are constant, so that the energy can only fall: a
method under which it rises is wrong.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Final, final

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigs, eigsh

from multicell.cells import FloatArray, IntArray
from multicell.errors import SceneError, StepFailed
from multicell.integrators.auto import ChosenWork
from multicell.integrators.cvode import Cvode
from multicell.mechanics.decay_rate import symmetric_product
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.scene.scene import Scene
from multicell.simulation import Simulation
from multicell.vectors import nearest_differences

PUSH: Final = 0.005
"""Displacement along the stiffest mode from which a settled cluster starts, over the overlap of
the contact that this mode strains most."""

MIN_NOTICED: Final = 0.035  # motion that counts as instability, over the same overlap

_PARTED = 1e-4  # decay rate over that of pressed cells; what is left of contacts that part for ever
_AT_REST = 1e-10  # speed of a cluster at rest, in radii times the largest decay rate
_DOUBLINGS = 16  # a step that is wanted may be so much longer than the first: 2^16
_RTOL, _ATOL = 1e-11, 1e-9  # of the reference; the second in mean radii
_MAX_STEPS = 50_000  # steps of the reference


@final
@dataclass(frozen=True, eq=False)
class TrialState:
    """Cells at the start of a trial.

    - ``scene``, Scene
    - ``template``, Mechanics: each trial works on a copy
    - ``motion``, Motion: radii, which are constant, and moduli; its times mean nothing
    - ``start``, (n, 3) float64, µm: positions at time 0
    - ``rate``, float, 1/s: largest decay rate λ_max of the Jacobian before the push
    - ``noticed``, float, µm: motion of a cell that counts as instability
    - ``known``, list of (time, positions): what has been computed of the true course, by CVODE at a
      tight tolerance
    """

    scene: Scene
    template: Mechanics
    motion: Motion
    start: FloatArray
    rate: float
    noticed: float
    known: list[tuple[float, FloatArray]] = field(default_factory=list)

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
        system = replace(self.template, work=ChosenWork())
        self.ready(system, begin, end)
        return system

    def ready(
        self, system: Mechanics, begin: float, end: float, touching: IntArray | None = None
    ) -> None:
        """Make mechanics ready for the time between two moments.

        ``touching`` are the pairs in contact at the first, where the law asks for them.
        """
        motion = replace(self.motion, begin=begin, end=end)
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


def settled_state(scene: Scene, threads: int | None = None) -> TrialState:
    """Return a scene's first cells at rest, pushed a little along the mode that decays fastest.

    - ``scene``: external forces, prescribed motion and motility are left out, growth stands still

    Raises SceneError if the scene starts with less than two cells, if none of them touch, or if
    nothing holds them together; StepFailed if the reference method cannot settle them.
    """
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
    blank = TrialState(scene, simulation.mechanics, motion, cells.position, np.nan, np.nan)
    rest = rest_positions(blank)
    rate, mode = largest_decay(blank.system(0.0, 1.0), rest, scene.dimensions == 2)
    if not rate > _PARTED * _pressed_bound(blank):
        problem = "nothing holds the cells together: they part, and then any step is stable"
        raise SceneError("", problem, "A contact law with adhesion or a domain holds them.")
    overlap = _strained_overlap(blank, rest, mode)
    mode *= PUSH * overlap / np.sqrt(np.square(mode).sum(axis=1)).max()
    return replace(blank, start=rest + mode, rate=rate, noticed=MIN_NOTICED * overlap, known=[])


def _strained_overlap(state: TrialState, position: FloatArray, mode: FloatArray) -> float:
    """Return the overlap in µm of the pair in contact that a mode strains most."""
    system = state.system(0.0, 1.0)
    pairs = system.contacts(0.0, position)
    if not len(pairs):  # springs at rest
        return 1e-4 * state.radius
    line = nearest_differences(position[pairs[:, 0]], position[pairs[:, 1]], system.period)
    distance = np.linalg.norm(line, axis=1)
    strain = np.einsum("ij,ij->i", mode[pairs[:, 1]] - mode[pairs[:, 0]], line) / distance
    most = int(np.abs(strain).argmax())
    overlap = state.motion.radius[pairs[most]].sum() - distance[most]
    return float(max(overlap, 1e-4 * state.radius))


def rest_positions(state: TrialState) -> FloatArray:
    """Return where the cells of a state come to rest, or where they are after a long time."""
    position = state.start
    _bound(state, position)  # cells that do not touch are refused
    length = 10.0 / _pressed_bound(state)  # their first contacts may be no more than rounding
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


def _bound(state: TrialState, position: FloatArray) -> float:
    bound = state.system(0.0, 1.0).stiffness_bound(0.0, position)
    if not bound > 0.0:
        hint = "A smaller initial.spacing lets them touch."
        raise SceneError("", "no cells touch: there is no motion whose stability can be lost", hint)
    return bound


def _pressed_bound(state: TrialState) -> float:
    """Return a bound on the decay rates, 1/s, of the first cells where they are a tenth nearer."""
    middle = state.start.mean(axis=0)
    pressed = middle + 0.9 * (state.start - middle)  # through a periodic face it draws them apart
    system = state.system(0.0, 1.0)
    return max(system.stiffness_bound(0.0, place) for place in (pressed, state.start))


def _advance(system: Mechanics, position: FloatArray) -> FloatArray:
    """Return the positions at the end of a step by the reference method."""
    atol = _ATOL * float(system.motion.radius.mean())
    outcome = Cvode(_RTOL, atol, _MAX_STEPS).integrate(system, position)
    if not outcome.done:
        raise StepFailed(outcome.time, f"the reference: {outcome.problem}", outcome.hint)
    return outcome.position


def largest_decay(
    system: Mechanics, position: FloatArray, flat: bool = False, dense: int = 150
) -> tuple[float, FloatArray]:
    """Return the largest decay rate of the linearised motion, 1/s, and its mode, (n, 3).

    Without friction between cells Γ^½ J Γ^-½ is symmetric, with the drag coefficients Γ. Below
    ``dense`` cells all its eigenvalues are computed, above the extreme one by Lanczos' method from
    products J v. With friction products are known to 1e-4, and so is the rate.

    - ``system``: mechanics that have been made ready for a step
    - ``position``: positions, (n, 3) µm, at the step's beginning
    - ``flat``: whether motion out of the plane z = 0 is left out
    - ``dense``: number of cells from which only the extreme eigenvalue is computed

    Raises SceneError if nothing decays: no cells touch.
    """
    system.linearise(system.motion.begin, position)
    dimensions = 2 if flat else 3
    growth = symmetric_product(system, dimensions)
    value, vector = _foremost(lambda v: -growth(v), system, dimensions, dense)
    if not value > 0.0:
        raise SceneError("", "no cells touch: there is no motion whose stability can be lost")
    mode = np.zeros_like(position)
    mode[:, :dimensions] = vector.reshape(-1, dimensions)
    return value, mode / np.sqrt(system.motion.radius)[:, None]


def largest_growth(
    system: Mechanics, time: float, position: FloatArray, flat: bool = False, dense: int = 150
) -> float:
    """Return the largest growth rate of the linearised motion, 1/s, as :func:`largest_decay`.

    Positive where a small displacement grows: cells whose contacts are pressed and may turn aside,
    contacts that form, or exact JKR contacts near their end.
    """
    system.linearise(time, position)
    dimensions = 2 if flat else 3
    return _foremost(symmetric_product(system, dimensions), system, dimensions, dense)[0]


def _foremost(
    product: Callable[[FloatArray], FloatArray], system: Mechanics, dimensions: int, dense: int
) -> tuple[float, FloatArray]:
    """Return the largest real eigenvalue of an operator, and its vector."""
    size, symmetric = dimensions * len(system), max(system.friction) == 0.0
    values: Any
    if len(system) >= dense:

        def raveled(vector: FloatArray) -> FloatArray:
            return product(np.ravel(vector))

        operator = LinearOperator((size, size), matvec=raveled, dtype=float)
        # a fixed start: the same state gives the same mode
        start = np.random.default_rng(0).normal(size=size)
        find, which, tol = (eigsh, "LA", 1e-8) if symmetric else (eigs, "LR", 1e-4)
        values, modes = find(operator, k=1, which=which, v0=start, tol=tol)
    else:
        matrix = np.stack([product(column) for column in np.eye(size)], axis=1)
        find = np.linalg.eigh if symmetric else np.linalg.eig
        values, modes = find(0.5 * (matrix + matrix.T) if symmetric else matrix)
    last = int(values.real.argmax())
    return float(values[last].real), np.asarray(modes[:, last].real)
