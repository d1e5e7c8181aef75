"""States that are not settled: growing, compressed, just divided, at the snap of exact JKR.

A trial lasts one coupling step of the scene, or 200 over the largest decay rate on the way if that
is longer: a hundred steps at Euler's limit. What the contacts of exact JKR remember is what it was
at the start. How stiff the motion is changes on the way: the theory takes the largest decay rate
λ_max of the true course, at its start and at L, L/2, L/4 ... of the trial's length L.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from multicell.cells import HALF, FloatArray
from multicell.comparison.conditioning import SHIFT
from multicell.comparison.stability_limits.modes import largest_decay, unstable_modes
from multicell.comparison.stability_limits.state import (
    MAX_UNNOTICED,
    State,
    first_cells,
    innermost,
    rest_positions,
    select_cells,
    settled_state,
    twins_of,
)
from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.law import effective_modulus, effective_radius
from multicell.errors import SceneError
from multicell.integrators.auto import Auto
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.random import Purpose, directions
from multicell.scene.scene import Scene
from multicell.schema import near_miss
from multicell.simulation import Simulation

COMPRESSED: Final = 0.9
"""What the positions of settled cells are multiplied by before they are released."""

SNAP: Final = 0.1
"""Distance of the contact that is stretched most from its turning point, over 3 k, the distance of
the turning point from first contact."""

_CELLS_PER_DIVISION = 10  # one cell of so many divides
_GROWTH_FACTOR = 1.25  # of the number of cells, until a coupling step is taken
_MIN_LENGTH = 200.0  # length of a trial at least, times the largest decay rate
_MARGIN = 0.1  # what twins are shifted by at the snap, over what is left to it


def state_of(kind: str, scene: Scene, threads: int | None = None) -> State:
    """Return the cells of a scene in one of the :data:`STATES`; only contacts and walls act.

    Raises SceneError if there is no such state, or the scene cannot have it; StepFailed if the
    cells cannot be settled or grown, or the true course cannot be computed.
    """
    check(kind, scene)
    return _MAKERS[kind](scene, threads)


def check(kind: str, scene: Scene) -> None:
    """Raise ``SceneError`` if there is no such state, or the scene cannot have it."""
    if kind not in STATES:
        raise SceneError("state", f"is {kind!r}, which is no state", near_miss(kind, STATES))
    if kind == "snap" and not isinstance(scene.contact, ExactJKR):
        raise SceneError(
            "contact.law",
            "is not exact-jkr: only under exact JKR contacts snap at a turning point",
            "Use --set contact.law=exact-jkr, or another state",
        )
    if kind == "growing" and scene.growth is None:
        raise SceneError(
            "growth", "is missing: cells that do not grow have no growing state", "Add [growth]"
        )


def growing_state(scene: Scene, threads: int | None = None) -> State:
    """Return a coupling step of the growing scene, right after a division.

    The scene runs, by the method ``auto``, until its cells are a quarter more than at first; then
    the next coupling step is taken that begins just after a division. If the run ends before, it
    is the last such step. Radii and bonds go on to change in the trial as they do in the run.

    Raises SceneError if no cell divides; StepFailed if the scene cannot be run.
    """
    simulation = Simulation(scene, threads=threads, integrator=Auto())
    enough = _GROWTH_FACTOR * len(simulation.cells)
    found: tuple[Motion, FloatArray] | None = None
    while not simulation.finished and (found is None or len(found[1]) < enough):
        before = simulation.divisions
        simulation.step()
        if simulation.divisions > before and len(simulation.cells) > 1:
            motion = simulation.prepared().motion
            found = replace(motion, push=None), simulation.cells.position
    if found is None:
        raise SceneError("duration", "is over before a cell divides", "Raise it")
    motion, start = found
    state = State(scene, simulation.mechanics, motion, start, math.nan, math.nan, MAX_UNNOTICED)
    return complete_state(replace(state, kind="growing"), motion.end - motion.begin)


def compressed_state(scene: Scene, threads: int | None = None) -> State:
    """Return the settled first cells of a scene with positions scaled by 0.9, then released.

    They are scaled about their centroid.
    """
    rest = _rest(scene, threads)
    middle = rest.start.mean(axis=0)
    start = middle + COMPRESSED * (rest.start - middle)
    return complete_state(
        _with_contacts(replace(rest, start=start, kind="compressed")), scene.coupling_step
    )


def freshly_divided_state(scene: Scene, threads: int | None = None) -> State:
    """Return the settled first cells of a scene just after every tenth of them has divided.

    Counted by distance from the centroid, the innermost first. Daughters lie as in a run: at
    ± r (1 - 2^(-1/3)) from their mother's centre, r her radius, along a random axis.
    """
    rest = _rest(scene, threads)
    mothers = innermost(rest.start)[::_CELLS_PER_DIVISION]
    n = len(rest.start)
    source = np.concatenate([np.arange(n), mothers])
    radius, start = rest.motion.radius[source], rest.start[source]
    axis = directions(scene.seed, Purpose.AXIS, 0, mothers, scene.dimensions)
    offset = (rest.motion.radius[mothers] * (1.0 - HALF))[:, None] * axis
    for daughters, sign in ((mothers, 1.0), (np.arange(n, len(source)), -1.0)):
        radius[daughters] *= HALF
        start[daughters] += sign * offset
    motion = select_cells(rest.motion, source, radius)
    state = replace(rest, motion=motion, start=start, kind="divided")
    return complete_state(_with_contacts(state), scene.coupling_step)


def snapping_state(scene: Scene, threads: int | None = None) -> State:
    """Return the settled first cells of a scene, pulled apart until a contact nearly breaks.

    Positions are scaled about the centroid until the overlap of the contact that is nearest to
    its turning point -3 k is -3 k (1 - 0.1); then the cells are released. There dF/dh is
    negative: the nearer a contact is to its turning point, the faster it opens or closes.
    """
    rest = _rest(scene, threads)
    law = scene.contact
    assert isinstance(law, ExactJKR)
    motion, position = rest.motion, rest.start
    i, j = rest.system(0.0, 1.0).contacts(0.0, position).T
    modulus = effective_modulus(
        motion.young[i], motion.poisson[i], motion.young[j], motion.poisson[j]
    )
    turning = -law.breaking_overlap(modulus, effective_radius(motion.radius[i], motion.radius[j]))
    distance = np.linalg.norm(position[i] - position[j], axis=1)
    allowed = motion.radius[i] + motion.radius[j] + (1.0 - SNAP) * turning
    middle = position.mean(axis=0)
    start = middle + float((allowed / distance).min()) * (position - middle)
    state = replace(rest, start=start, kind="snap")
    return complete_state(state, scene.coupling_step, _MARGIN * SNAP * float(turning.min()))


def complete_state(state: State, length: float, shift: float | None = None) -> State:
    """Return a state with what its true course tells: decay rate, unstable modes, twins.

    - ``length``: shortest length of a trial, s
    - ``shift``: what the cells of twins are displaced by, µm, root mean square over the cells; by
      default each coordinate by :data:`multicell.comparison.conditioning.SHIFT`
    """
    flat = state.scene.dimensions == 2
    state = replace(state, length=length, noticed=MAX_UNNOTICED * state.radius, known=[])
    rates = _rates(state, flat)
    if length * max(rates) < _MIN_LENGTH:
        state = replace(state, length=_MIN_LENGTH / max(rates))
        rates = _rates(state, flat)
    times = [0.0, *state.observation_times]
    energy = np.array([state.energy(time, state.at(time)) for time in times])
    state = replace(
        state,
        rate=max(rates),
        end_rate=rates[-1],
        rise=float((energy - np.minimum.accumulate(energy)).max()),
        unstable=unstable_modes(state.system(0.0, 1.0), state.start, flat, 1.0 / state.length),
    )
    return replace(state, twins=twins_of(state, math.sqrt(3.0) * SHIFT if shift is None else shift))


def _rates(state: State, flat: bool) -> list[float]:
    """Return the largest decay rates at the start and at the observation times of a state, 1/s."""
    return [
        _rate(state.system(t, t + 1.0), state.at(t), flat) for t in (0.0, *state.observation_times)
    ]


def _rate(system: Mechanics, position: FloatArray, flat: bool) -> float:
    """Return the largest decay rate, zero where no cells touch any more."""
    if not system.stiffness_bound(system.motion.begin, position) > 0.0:
        return 0.0
    return largest_decay(system, position, flat)[0]


def _rest(scene: Scene, threads: int | None) -> State:
    """Return the first cells of a scene where they come to rest."""
    template, motion, position = first_cells(scene, threads)
    state = State(scene, template, motion, position, math.nan, math.nan, MAX_UNNOTICED)
    return _with_contacts(replace(state, start=rest_positions(state), known=[]))


def _with_contacts(state: State) -> State:
    """Return a state whose law remembers the contacts of its start, if it remembers any."""
    if state.motion.touching is None:
        return state
    pairs = state.system(0.0, 1.0).contacts(0.0, state.start)
    return replace(state, motion=replace(state.motion, touching=pairs))


STATES: Final = {
    "settled": "The cells settle, are pushed a little along their stiffest mode, and must come to "
    "rest again.",
    "growing": "A coupling step of the growing tissue, right after a division.",
    "compressed": "The cells settle, are pressed together to 0.9 times their distances and "
    "released.",
    "divided": "The cells settle, and every tenth of them has just divided.",
    "snap": "The cells settle and are pulled apart until a contact is near its turning point.",
}
"""Name of a state -> how it is made, in words."""

_MAKERS: Final[dict[str, Callable[[Scene, int | None], State]]] = {
    "settled": settled_state,
    "growing": growing_state,
    "compressed": compressed_state,
    "divided": freshly_divided_state,
    "snap": snapping_state,
}
