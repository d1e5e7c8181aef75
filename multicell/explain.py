"""What a scene uses and why, with the numbers that follow from it before anything is run."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.cells import SPHERE, Cells
from multicell.contact import JKR, effective_modulus, effective_radius
from multicell.integrators.names import METHODS

if TYPE_CHECKING:
    from multicell.scene import Nutrient, Scene

_GRID_ARRAYS: Final = 12  # arrays of the size of the grid that a solve holds at once
_NEIGHBOURS: Final = 12  # of a cell in dense packing


@final
@dataclass(frozen=True)
class Part:
    """A part of a scene: whether it is used, and what that means."""

    part: str
    used: bool
    what: str


@final
@dataclass(frozen=True)
class Number:
    """A derived number with its unit and its meaning."""

    name: str
    value: float
    unit: str
    meaning: str


def explain(scene: Scene) -> dict[str, Any]:
    """Return what a scene uses and the numbers that follow from it.

    Returns
    -------
    dict
        ``title``; ``parts``: list of ``part``, ``used``, ``what``; ``numbers``: list of
        ``name``, ``value``, ``unit``, ``meaning``; ``notes``: list of remarks on settings that
        do not fit together. Only plain values, so that it can be written as JSON.
    """
    numbers = [*_run(scene), *_contact(scene), *_growth(scene), *_memory(scene)]
    for name, nutrient in scene.nutrients.items():
        numbers += _nutrient(scene, name, nutrient)
    return {
        "title": scene.title,
        "parts": [asdict(part) for part in _parts(scene)],
        "numbers": [asdict(number) for number in numbers],
        "notes": _notes(scene),
    }


def birth_radius(scene: Scene) -> float:
    """Return the radius of a cell of half the division volume, µm."""
    return float(scene.cells.division_radius / np.cbrt(2.0))


def typical_radius(scene: Scene) -> float:
    """Return the radius half-way (geometrically) between birth and division, µm."""
    return math.sqrt(birth_radius(scene) * scene.cells.division_radius)


def drag(scene: Scene, radius: float) -> float:
    """Return the Stokes drag 6πηr of a cell in nN·s/µm."""
    return 6.0 * math.pi * scene.drag.viscosity * radius


def daughters_stiffness(scene: Scene) -> float:
    """Return dF/dh in nN/µm of two daughters that have just separated.

    They stand at ±r(1 - 2^(-1/3)) about the centre of their mother of radius r.
    """
    mother, daughter = scene.cells.division_radius, birth_radius(scene)
    overlap = 2.0 * daughter - 2.0 * (mother - daughter)
    return _stiffness(scene, overlap, daughter)


def _stiffness(scene: Scene, overlap: float, radius: float) -> float:
    """Return dF/dh in nN/µm for two equal cells of mean stiffness."""
    return float(
        scene.contact.stiffness(overlap, _modulus(scene), effective_radius(radius, radius))
    )


def _modulus(scene: Scene) -> float:
    young, poisson = scene.cells.young, scene.cells.poisson
    return float(effective_modulus(young, poisson, young, poisson))


def _parts(scene: Scene) -> list[Part]:
    """Return every part a scene can have, with the consequence of its presence or absence."""
    start = scene.initial
    growth = (
        f"cells double their volume in {_hours(scene.growth.cycle_time)} and divide"
        if scene.growth
        else "absent: the number of cells stays, no growth and no division is computed"
    )
    death = (
        f"necrotic cells lose their volume in about {_hours(scene.death.lysis_time)}"
        if scene.death
        else "absent: necrotic cells keep their place and volume"
    )
    method = scene.integrator.method
    return [
        Part("initial", True, f"{start.count:,} cell(s) in a {start.arrangement}"),
        Part("contact", True, _law(scene)),
        Part("drag", True, f"Stokes drag in a medium of {scene.drag.viscosity:g} kPa s"),
        Part("growth", scene.growth is not None, growth),
        Part("death", scene.death is not None, death),
        *_nutrient_parts(scene),
        Part("integrator", True, f"{method}: {METHODS[method]}"),
        Part("output", True, f"a frame every {_hours(scene.output.every)}"),
    ]


def _nutrient_parts(scene: Scene) -> list[Part]:
    if not scene.nutrients:
        return [Part("nutrients", False, "absent: no field is solved, no cell starves")]
    what = "steady field on a grid of {:g} um that follows the cells, {:g} mM in the medium"
    return [
        Part(f"nutrients.{name}", True, what.format(n.spacing, n.boundary))
        for name, n in scene.nutrients.items()
    ]


def _law(scene: Scene) -> str:
    if isinstance(scene.contact, JKR):
        return f"JKR: elastic and sticky, surface energy {scene.contact.surface_energy:g} nN/um"
    return "Hertz: elastic, nothing sticks"


def _run(scene: Scene) -> list[Number]:
    """Return the numbers of coupling steps and frames."""
    steps = math.ceil(scene.duration / scene.coupling_step * (1.0 - 1e-12))
    frames = math.floor(scene.duration / scene.output.every * (1.0 + 1e-12)) + 1
    return [
        Number("duration", scene.duration, "s", f"simulated time: {_hours(scene.duration)}"),
        Number("coupling steps", steps, "", f"of {scene.coupling_step:g} s each"),
        Number("frames", frames, "", "saved in a full run, the first and the last included"),
    ]


def _contact(scene: Scene) -> list[Number]:
    """Return what two equal cells of typical size do."""
    radius = typical_radius(scene)
    pair = float(effective_radius(radius, radius))
    rest = float(scene.contact.equilibrium_overlap(_modulus(scene), pair))
    # spheres that do not stick are not stiff at first contact: take a tenth of the radius
    overlap = rest if rest > 0.0 else 0.1 * radius
    where = "at rest" if rest > 0.0 else "at an overlap of a tenth of the radius"
    friction = drag(scene, radius)
    settle = friction / (2.0 * _stiffness(scene, overlap, radius))
    limit = drag(scene, birth_radius(scene)) / daughters_stiffness(scene)
    numbers = [
        Number("birth radius", birth_radius(scene), "um", "of half the division volume"),
        Number("typical radius", radius, "um", "half-way between birth and division"),
        Number("drag", friction, "nN s/um", "6 pi eta r of a typical cell"),
        Number("equilibrium distance", 2.0 * radius - rest, "um", "of two typical cells"),
        Number("relaxation time", settle, "s", f"of two typical cells {where}"),
        Number(
            "explicit step limit",
            limit,
            "s",
            "for two fresh daughters alone; several times less in tissue",
        ),
    ]
    if isinstance(scene.contact, JKR):
        force = 1.5 * math.pi * scene.contact.surface_energy * pair
        numbers.append(Number("pull-off force", force, "nN", "of two typical cells"))
    return numbers


def _growth(scene: Scene) -> list[Number]:
    """Return cycle time and the largest possible number of cells."""
    if scene.growth is None:
        return []
    cycle = scene.growth.cycle_time
    generations = scene.duration / cycle
    numbers = [
        Number("cycle time", cycle, "s", f"{_hours(cycle)} where nothing limits growth"),
        Number("generations", generations, "", "in the whole run where nothing limits growth"),
    ]
    if generations < 60.0:
        most = scene.initial.count * 2.0**generations
        numbers.append(Number("cells at most", most, "", "if nothing limited growth"))
    return numbers


def _nutrient(scene: Scene, name: str, nutrient: Nutrient) -> list[Number]:
    """Return the sizes at which a nutrient runs short.

    With the uptake q of full strength everywhere (zeroth order), a ball of radius R and surface
    concentration c has c - q R² / (6 D) at its centre, and a thick layer is fed to the depth
    √(2 D c / q).
    """
    supply = nutrient.diffusion * nutrient.boundary
    demand = nutrient.uptake / (SPHERE * typical_radius(scene) ** 3)
    numbers = [
        Number(f"{name}: largest uptake", demand, "mM/s", "of tissue of typical cells, no gaps")
    ]
    if supply > 0.0 and demand > 0.0:
        critical, depth = math.sqrt(6.0 * supply / demand), math.sqrt(2.0 * supply / demand)
        settle = critical**2 / nutrient.diffusion
        points = math.ceil(2.0 * (critical + nutrient.margin) / nutrient.spacing) ** 3
        memory = 8e-6 * _GRID_ARRAYS * points
        numbers += [
            Number(f"{name}: starving radius", critical, "um", "of a ball starved at its centre"),
            Number(f"{name}: diffusion length", depth, "um", "the depth to which a wall is fed"),
            Number(f"{name}: settling time", settle, "s", "of the field: the steady state holds"),
            Number(f"{name}: grid memory", memory, "MB", f"about, at that size: {points:,} points"),
        ]
    return numbers


def _memory(scene: Scene) -> list[Number]:
    """Return memory and file size for every 1000 cells."""
    columns = [(np.dtype(s["dtype"]).itemsize, s["width"] or 1) for s in Cells.schema().values()]
    state = sum(size * width for size, width in columns) + 8 * len(scene.nutrients)
    # state, a sorted copy, five vectors of the integrator's order, and half a list of pairs
    running = 2 * state + 5 * 3 * 8 * 5 + 8 * _NEIGHBOURS
    return [
        Number("memory", running / 1000.0, "MB", "about, for every 1000 cells, without fields"),
        Number("file size", state / 1000.0, "MB", "for every 1000 cells of a frame, plus fields"),
    ]


def _notes(scene: Scene) -> list[str]:
    """Return remarks on settings that are allowed but may not be meant."""
    notes = []
    if scene.death is not None and not scene.nutrients:
        notes.append("Without a nutrient no cell becomes necrotic: [death] has no effect.")
    if isinstance(scene.contact, JKR) and scene.contact.surface_energy == 0.0:
        notes.append("A surface energy of zero makes JKR the same as Hertz.")
    if scene.growth is not None and scene.coupling_step > 0.05 * scene.growth.cycle_time:
        notes.append(
            "The coupling step is above a twentieth of the cycle time: divisions come late. "
            "Take a smaller coupling_step."
        )
    limit = drag(scene, birth_radius(scene)) / daughters_stiffness(scene)
    if scene.integrator.method == "euler" and scene.integrator.step > limit / 3.0:
        notes.append(
            f"Euler's step of {scene.integrator.step:g} s is near or above its limit of stability "
            f"(about {limit / 3.0:.2g} s in tissue). Take a smaller integrator.step or cvode."
        )
    for name, n in scene.nutrients.items():
        if n.boundary < n.quiescence:
            notes.append(f"The medium has too little {name} for growth: all cells are quiescent.")
    return notes


def _hours(seconds: float) -> str:
    """Return a simulated time in a unit that is easy to read."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= (3.0 if unit == "d" else 1.0) * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"
