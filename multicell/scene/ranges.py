"""Check whether the numbers of a scene can be computed with together.

Each number has a range of its own (:func:`multicell.schema.bounds.reader`). Bounds are orders of
magnitude beyond any use: they keep out what would hang, overflow or end in nonsense, not what is
merely unusual.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from multicell.cells import HALF
from multicell.contact.law import PairLaw, effective_modulus, effective_radius
from multicell.errors import SceneError
from multicell.host.memory import physical_memory
from multicell.integrators.registry import METHODS
from multicell.scene.pairs import largest_adhesion, law_by_types
from multicell.scene.sizes import division_radii

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


MAX_STEPS: Final = 1e9
"""Most coupling steps of a run: at a microsecond each a quarter of an hour, at a millisecond weeks;
the index of a step is a key of the random number streams, and the time a product with it."""

MAX_FIXED_STEPS: Final = 1e7
"""Most steps of a fixed length in one coupling step, between which nothing can interrupt a run."""

MAX_CONTRAST: Final = 1e5
"""Largest ratio of diffusion outside tissue and inside; known ones are below ten. Balances are
differences of flows, which lose one digit for every factor of ten."""

BYTES_PER_CELL: Final = 1000
"""What a running simulation holds for each cell at least: state, lists, solver vectors."""


_CROWD: Final = (1000, 8e6)
"""Pairs in reach for each cell, and beyond them in all: twice what a list of neighbours holds."""


def check_sizes(scene: Scene) -> None:
    """Raise ``SceneError`` for numbers that nothing can be computed with together."""
    _check_steps(scene)
    _check_crowd(scene)
    check_overlap(scene)
    _check_diffusion(scene)


def _check_steps(scene: Scene) -> None:
    """Raise ``SceneError`` for steps so short or so long that no run could use them."""
    coupling_step = scene.coupling_step
    if scene.duration / coupling_step > MAX_STEPS:
        problem = f"is {coupling_step:g} s, must be at least {scene.duration / MAX_STEPS:g} s"
        hint = f"The run would take more than {MAX_STEPS:g} coupling steps."
        raise SceneError("coupling_step", problem, hint)
    fixed = scene.integrator
    info = METHODS.get(fixed.method)
    steps = min(coupling_step, scene.duration) / fixed.step
    if info is not None and info.control == "step" and steps > MAX_FIXED_STEPS:
        problem = f"is {fixed.step:g} s, must be at least {coupling_step / MAX_FIXED_STEPS:g} s"
        hint = f"A coupling step would take more than {MAX_FIXED_STEPS:g} steps."
        raise SceneError("integrator.step", problem, hint)
    if scene.growth is None or scene.coupling_tolerance is not None:  # steps are short enough
        return
    # a cell divides once in a coupling step at most: a shorter cycle would only make it larger
    quickest = min((kind.cycle_scale for kind in scene.types.values()), default=1.0)
    cycle = quickest * scene.growth.mean_cycle
    if min(coupling_step, scene.duration) > cycle:
        mean = scene.growth.mean_cycle
        if mean < 1000.0:
            problem = f"is {mean:g} s, shorter than a coupling step of {coupling_step:g} s"
            hint = f"A number without a unit is in seconds: write '{mean:g} h' for hours."
            raise SceneError("growth.cycle_time", problem, hint)
        problem = f"is {coupling_step:g} s, must be at most a cycle of the cells, {cycle:g} s"
        hint = "Cells divide between coupling steps; take about a twentieth of the cycle."
        raise SceneError("coupling_step", problem, hint)


def _check_crowd(scene: Scene) -> None:
    """Raise ``SceneError`` for cells so dense at the start that they are on top of each other.

    In the closest packing of points √2/d³ of them are in a unit of space, 2/(√3 d²) in one of a
    plane; counted are those within a diameter of each.
    """
    start, n = scene.initial, scene.initial.count
    if start.cells is not None or not scene.contact.acts:
        return
    axes = 1 if start.shape == "row" else scene.dimensions
    within = (2.0, 2.0 * math.pi / math.sqrt(3.0), 4.0 * math.pi * math.sqrt(2.0) / 3.0)[axes - 1]
    near = min(n - 1.0, within / max(start.spacing, 1e-6) ** axes)  # no power underflows
    if 0.5 * n * near > _CROWD[0] * n + _CROWD[1]:
        problem = f"is {start.spacing:g}: each of {n:,} cells would overlap {near:,.0f} others"
        raise SceneError("initial.spacing", problem, "At 1 neighbours touch.")


def check_overlap(scene: Scene, factor: float = 1.0, key: str = "contact.surface_energy") -> None:
    """Raise ``SceneError`` for cells so sticky that they would be drawn into one another.

    - ``factor``: on surface energies
    - ``key``: that has made it so large

    Two cells must repel each other before their centres meet, at birth and before division, under
    their surface energy and the most bonds that occur.
    """
    if not scene.contact.acts:
        return
    kinds, usual = scene.types, scene.cells.young
    moduli = [kind.young or usual for kind in kinds.values()]
    softest = min(moduli, default=usual)
    error = _drawn(scene, largest_adhesion(scene, factor), softest, softest, key)
    law, entries = law_by_types(scene)
    if error is not None and entries is not None:
        pairs = {
            (float(entries[i, j]), min(moduli[i], moduli[j]), max(moduli[i], moduli[j]))
            for i in range(len(moduli))
            for j in range(i + 1)
        }
        found = (_drawn(scene, law.for_pair(factor * x), a, b, key) for x, a, b in pairs)
        error = next(filter(None, found), None)
    if error is not None:
        raise error


def _drawn(scene: Scene, law: PairLaw, young: float, other: float, key: str) -> SceneError | None:
    """Return an error for two cells that do not repel each other where their centres meet."""
    poisson = scene.cells.poisson
    modulus, bonds = effective_modulus(young, poisson, other, poisson), _most_bonds(scene)
    for radius in (part * own for own in division_radii(scene) for part in (HALF, 1.0)):
        pair, deep = effective_radius(radius, radius), 1.99 * radius
        force = float(law.evaluate(deep, modulus, pair, rest=2.0 * radius, touching=True)[0])
        if force > math.pi * float(pair) * bonds * deep:
            continue
        if force <= 0.0 and not law.is_sticky:
            problem = f"gives a force of {force:.3g} nN to cells that overlap by {deep:.3g} um"
            hint = "A force is positive where cells repel each other: change the sign of the law."
            return SceneError("contact.law", problem, hint)
        path = "adhesion.strength" if force > 0.0 else key
        problem = f"draws cells of radius {radius:.3g} um into one another, centre upon centre"
        return SceneError(path, problem, "Let cells stick less, or take a larger cells.young.")
    return None


def _most_bonds(scene: Scene) -> float:
    """Return the largest adhesive force per contact area of receptors without responses, kPa."""
    if scene.adhesion is None:
        return 0.0
    most = [
        tuple(max(value for _, value in course) for course in (kind.receptor, kind.ligand))
        for kind in scene.types.values()
    ]
    pairs = ((a, b) for a in most for b in most)
    both = (0.5 * (a[0] * b[1] + a[1] * b[0]) for a, b in pairs)
    return scene.adhesion.strength * max(both, default=0.0)


def _check_diffusion(scene: Scene) -> None:
    """Raise ``SceneError`` for tissue and medium so unlike that a solver loses one of them."""
    for name, field in scene.nutrients.items():
        other = field.diffusion_medium or field.diffusion
        ratio = other / field.diffusion
        if not 1.0 / MAX_CONTRAST <= ratio <= MAX_CONTRAST:
            problem = (
                f"is {other:g} um^2/s, {ratio:.3g} times that of tissue; must be "
                f"within a factor of {MAX_CONTRAST:g}"
            )
            raise SceneError(f"nutrients.{name}.diffusion_medium", problem)


def check_memory(scene: Scene) -> None:
    """Raise ``SceneError`` if this machine could not even hold the cells of the start.

    Nothing is allocated for them before.
    """
    needed, present = BYTES_PER_CELL * scene.initial.count, physical_memory()
    if present is not None and needed > present:
        problem = (
            f"is {scene.initial.count:,}: so many cells need about {needed / 1e9:.3g} GB, this "
            f"machine has {present / 1e9:.3g} GB"
        )
        raise SceneError("initial.count", problem, "Start with fewer cells.")
