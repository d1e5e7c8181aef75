"""The expected cost of a run: time, memory, and room on the disk.

The population is that of :mod:`multicell.report.explain.course`; what a cell, a node and a step
cost was measured on one core of a 2.5 GHz Xeon, with everything compiled. ``python
tests/benchmarks/predictions.py`` holds the numbers below against runs of the built-in scenes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from multicell.cells import FloatArray
from multicell.integrators.base import MethodInfo
from multicell.integrators.runge_kutta import Euler, Heun, RungeKutta4
from multicell.nutrient.parameters import FieldParameters
from multicell.report.explain.course import Course, expected_course
from multicell.report.explain.items import Number, hours
from multicell.scene import domain as box
from multicell.scene.field_solvers import expected_steps
from multicell.scene.nutrient import OWN_SOLVERS
from multicell.scene.pairs import explicit_limit
from multicell.scene.reactions import group_of
from multicell.scene.scales import MAX_NODES, MAX_UNEVEN, regime
from multicell.scene.scene import Scene
from multicell.scene.sizes import typical_radius
from multicell.scene.steps import usual_coupling_step

_PROCESS: Final = 190e6  # bytes that Python, its packages and compiled code take
_COMPILING: Final = 140e6  # and what numba and LLVM take at most in a run that compiles
_FIELD_PACKAGES: Final = 40e6  # and more where there are fields
_CELL: Final = 850.0  # bytes of a cell: state, lists, vectors, lineage, and gaps between them
_NODE: Final = 100.0  # bytes of a node of a field on cubes
_REACTING: Final = 170.0  # and more of one that takes part in reactions: bases of Krylov spaces
_TOGETHER: Final = 24.0  # and more for each field with which it is solved

_CELL_FRAME: Final = 62.0  # bytes of a cell in a frame on the disk
_NODE_FRAME: Final = 2.5  # bytes of a node in a frame on the disk, compressed
_STEP_ROW: Final = 100.0  # of a row of the history
_FILE: Final = 70e3  # of the structure of the file, and what is the same for all frames

_START: Final = 0.7  # s until there is a first cell, once all is compiled
_CELL_START: Final = 1.2e-5  # s of placing a cell
_STEP: Final = 7e-4  # s of a coupling step whatever it holds
_EVALUATION: Final = 5e-6  # s of an evaluation of all forces
_CELL_EVALUATION: Final = 2.1e-7  # and for each cell: forces, lists, and a share of everything else
_FRICTION: Final = 5.0  # times as much where cells rub: velocities are solved for
_NETWORK: Final = 1e-7  # s of a network in a cell and step
_NETWORK_RATE: Final = 5e-9  # and for each evaluation and state, and one more, with linear algebra
_STAGES: Final = 4.0  # evaluations of a step of a fixed length
_FIELD: Final = 4e-4  # s of a field in a step
_NODE_STEP: Final = 1.7e-7  # and for each node

_SOLUTION: Final = 1.2e-4  # s of one of the solutions that a transient field takes
_NODE_SOLUTION: Final = 1.4e-7  # and for each node
_NODE_EXACT: Final = 1.5e-7  # s of a node in a coupling step of a field that is linear
_UPTAKE: Final = 2.0  # times as much with uptake, whose law is not linear
_FIRST: Final = 2.6  # over the root of the tolerance: steps of a field that comes to rest
_USUAL: Final = 3.3  # steps of a transient field in a coupling step that changes little
_KICK: Final = 5.0  # times n^(-2/3): part of a field that moves with one of n cells that divides
_KICKED: Final = 6.5  # times the logarithm of that over the tolerance: steps until it has settled
_RELAID: Final = 6.0  # times that a field in a finite medium is solved for in a step

_RATE: Final = 1e-4  # s of the rates of a field and their account, for solvers of py-pde's
_NODE_RATE: Final = 2e-8  # and for each node

_NOTED_SHARE: Final = 0.01  # part of the tissue whose death at the start is worth a note


@final
@dataclass(frozen=True)
class Prediction:
    """Predicted cost of a run."""

    course: Course  # of the population
    seconds: float  # wall time on one core, without compilation
    memory: float  # bytes of the process at its largest
    file: float  # bytes of frames.h5


def predict(scene: Scene) -> Prediction:
    """Predict the cost of a run of a scene with an output folder."""
    found = expected_course(scene)
    end = float(found.times[-1])
    steps = max(1.0, end / usual_coupling_step(scene))
    frames = min(math.ceil(end / scene.output.every), steps) + 1.0
    cells = _mean(found, found.cells)
    seconds, memory, file = _fields(scene, found, steps, frames)
    alone, cell = cost_of_step(scene)
    return Prediction(
        course=found,
        seconds=_START
        + _CELL_START * scene.initial.count
        + steps * (alone + cell * cells)
        + seconds,
        memory=_PROCESS + _CELL * float(found.cells.max()) + memory,
        file=_FILE + _STEP_ROW * steps + _CELL_FRAME * frames * cells + file,
    )


def _mean(found: Course, values: FloatArray) -> float:
    return float(np.trapezoid(values, found.times) / found.times[-1])


def cost_of_step(scene: Scene) -> tuple[float, float]:
    """Return the cost of a coupling step without its fields: for itself, and for each cell, s."""
    count = evaluations(scene)
    rubbing = _FRICTION if scene.friction is not None else 1.0
    inside = sum(network_cost(scene, name)[1] for name in scene.networks)
    return _STEP + count * _EVALUATION, count * _CELL_EVALUATION * rubbing + inside


def network_cost(scene: Scene, name: str) -> tuple[float, float]:
    """Return the evaluations of a network in a cell and coupling step, and their cost, s.

    The cost is that of a mean cell of the scene: some types may have no such network. It is 0
    where nothing is known.
    """
    from multicell.networks.expected import network_evaluations

    part, step = scene.networks[name], usual_coupling_step(scene)
    if part.step is not None:
        count = _STAGES * step / part.step
    else:
        count = network_evaluations(part.model, step / part.seconds(), part.tolerance)
    if math.isnan(count):
        return count, 0.0
    each = _NETWORK_RATE * (1 + len(part.model.states))
    return count, (_NETWORK + each * count) * _share(scene, part.cells)


def _share(scene: Scene, cells: str | None) -> float:
    """Return the part of the cells at the start that are of some types."""
    if cells is None:
        return 1.0
    fractions = {kind: part.fraction for kind, part in scene.types.items()}
    named = [name.strip() for name in cells.split(",")]
    return sum(fractions[name] for name in named) / (sum(fractions.values()) or 1.0)


def evaluations(scene: Scene) -> float:
    """Return how many evaluations of all forces a coupling step is expected to take.

    Explicit methods take about two for each time that the step of two fresh daughters goes into it,
    more where the tolerance is tight (their order is two); where that is many, stabilised and
    implicit ones take over. Fixed steps are counted.
    """
    options, coupling_step = scene.integrator, usual_coupling_step(scene)
    fixed = {m.info.name: m for m in (Euler, Heun, RungeKutta4)}
    if options.method in fixed:
        return len(fixed[options.method].tableau.b) * coupling_step / options.step
    limit = explicit_limit(scene)
    ratio, tight = coupling_step / limit, math.sqrt(max(MethodInfo.atol / options.tolerance, 0.1))
    return max(8.0, min(2.0 * tight * ratio, 40.0 * tight + ratio, 1000.0 * tight))


def _fields(scene: Scene, found: Course, steps: float, frames: float) -> tuple[float, float, float]:
    most = mean = seconds = 0.0
    for name in scene.nutrients:
        nodes = _nodes(scene, name, found.radius)
        size = _NODE
        if together := len(group_of(name, scene.reactions)):
            size += _REACTING + _TOGETHER * together
        most, mean = most + size * float(nodes.max()), mean + _mean(found, nodes)
        seconds += _field_seconds(scene, name, found, steps, _mean(found, nodes))
    packages = _FIELD_PACKAGES if scene.nutrients else 0.0
    return seconds, packages + most, _NODE_FRAME * frames * mean


def _field_seconds(scene: Scene, name: str, found: Course, steps: float, nodes: float) -> float:
    if scene.nutrients[name].solver not in OWN_SOLVERS:
        number = expected_steps(scene, name)
        if number:
            return steps * (_FIELD + number * (_RATE + _NODE_RATE * nodes))
    if regime(scene, name) == "steady":
        return steps * (_FIELD + _NODE_STEP * nodes)
    nutrient = scene.nutrients[name]
    if _is_linear(scene, name):
        return steps * (_FIELD + _NODE_EXACT * nodes)
    each = _SOLUTION + _NODE_SOLUTION * nodes * (_UPTAKE if nutrient.takes_up else 1.0)
    again = _RELAID if nutrient.finite_medium is not None else 1.0
    return steps * _FIELD + again * each * solutions(scene, name, found, steps)


def _is_linear(scene: Scene, name: str) -> bool:
    """Whether a transient field is followed without steps of its own: on cubes, untouched."""
    nutrient = scene.nutrients[name]
    plain = nutrient.diffusion_medium is None and nutrient.finite_medium is None
    cubes = nutrient.layout == "box" or scene.dimensions == 2
    by_network = any(name in (part.fluxes or {}) for part in scene.networks.values())
    used = nutrient.takes_up or by_network or group_of(name, scene.reactions)
    return plain and cubes and not used


def solutions(scene: Scene, name: str, found: Course, steps: float) -> float:
    """Return how many systems of equations a transient field solves in so many coupling steps.

    Each of its own steps takes three, one in full and two halves. Their number follows from the
    tolerance: many while the field forms, few where it only follows the tissue, and some dozens
    after a division, of which the first of them, a tenth of the coupling step, sees too much.
    """
    nutrient, spacing = scene.nutrients[name], FieldParameters.of(scene, name).spacing
    tolerance, number = nutrient.time_tolerance, max(1.0, _mean(found, found.cells))
    kick = _KICK * number ** (-2.0 / 3.0)
    seen = kick / (1.0 + 0.1 * usual_coupling_step(scene) * nutrient.diffusion / spacing**2)
    dividing = -math.expm1(-max(0.0, float(found.cells[-1] - found.cells[0])) / steps)
    later = _USUAL + dividing * _KICKED * max(0.0, math.log(seen / tolerance))
    return 3.0 * (_FIRST / math.sqrt(tolerance) + later * max(0.0, steps - 1.0))


def _nodes(scene: Scene, name: str, radius: FloatArray) -> FloatArray:
    """Return the number of nodes of a field round tissue of each radius, as far as runs allow."""
    nutrient, p = scene.nutrients[name], FieldParameters.of(scene, name)
    if scene.box is not None:
        counts = box.filling(box.sides(scene.box), p.spacing)
        return np.full(len(radius), float(math.prod(counts or (1,))))
    reach = np.maximum(radius - typical_radius(scene), 0.0) + nutrient.margin
    if scene.dimensions == 3 and nutrient.layout != "box":
        nodes = (reach if nutrient.layer is None else radius + nutrient.layer) / p.spacing
    else:
        nodes = (2.0 * reach / p.spacing) ** scene.dimensions
    return np.clip(np.ceil(nodes), 1.0, MAX_NODES)


def cost_numbers(scene: Scene, expected: Prediction) -> list[Number]:
    """Return the numbers that are reported of it."""
    end, cells = float(expected.course.times[-1]), expected.course.cells
    ends = "at the end" if end >= scene.duration else f"after {hours(end)}, where the run stops"
    most = "" if cells[-1] >= cells.max() else f"; {cells.max():.3g} at most"
    return [
        Number("expected cells", float(cells[-1]), "", f"{ends}{most}, dead ones included"),
        Number(
            "expected time",
            expected.seconds,
            "s",
            f"of the whole run on one core of 2.5 GHz, without compilation: "
            f"{hours(expected.seconds)}",
        ),
        Number(
            "expected memory",
            expected.memory / 1e6,
            "MB",
            f"of the process at its largest; {_COMPILING / 1e6:.0f} MB more while it compiles",
        ),
        Number("expected file", expected.file / 1e6, "MB", "all frames and the history"),
    ]


def cost_notes(expected: Prediction) -> list[str]:
    """Return remarks on fields that differ between directions, and tissue that starves at once."""
    notes = [
        f"{name} at the surface of the tissue is expected to differ by up to {uneven:.1%} of the "
        "medium between the axes of its grid and the diagonals, since the medium begins at the "
        f"sides of a box: with nutrients.{name}.margin_shape = 'tissue' (and without a finite "
        "medium) it has no corners."
        for name, uneven in expected.course.uneven.items()
        if uneven > MAX_UNEVEN
    ]
    lost = expected.course.starved
    if lost > _NOTED_SHARE:
        share = f"About {100.0 * lost:.2g} % of the tissue of the start finds too little to live"
        notes.append(f"{share} and would die at once.")
    return notes
