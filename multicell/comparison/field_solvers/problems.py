"""The problems that solvers of fields are compared on, made from the fields of a frame.

Each field is taken alone, with the cells of the frame as they are. Its grids are nested: every
node of one is 8 (squares 4, shells 2) whole nodes of the next, so that solutions are compared by
means over nodes, which converge although cells are points.
"""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, NamedTuple, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.cartesian import Box, round_enough
from multicell.nutrient.choosing.estimate import on_grid
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.equations.schedule import Schedule
from multicell.nutrient.field import NutrientField
from multicell.nutrient.grid import BoxLayout, Layout, ShellLayout
from multicell.nutrient.parameters import FieldParameters
from multicell.nutrient.problem import field_problem
from multicell.scene.coupling import usual_step

if TYPE_CHECKING:
    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene

STEADY, TRANSIENT, SWITCH = "steady", "transient", "switching medium"
KINDS: Final = (STEADY, TRANSIENT, SWITCH)
"""What is solved for: the state at rest; the medium's concentration everywhere, let go; the same
over a coupling step, shortly before whose end the medium falls to half."""

CUBES, SQUARES, SHELLS = "cubes", "squares", "shells"

SPAN: Final = 2.0
"""Length of a transient in times in which the slowest deviation falls to 1/e; a medium switches
half of that before the end."""

FEWEST: Final = 6
"""Nodes along the longest axis of the coarsest grid, at least."""

_LINEAR = 1e-3  # of the scale: a difference over which rates are linear
_ITERATIONS = 150


class Piece(NamedTuple):
    """A time in s over which an equation's medium stays as it is."""

    equation: FieldEquation
    begin: float
    end: float


@final
@dataclass(frozen=True, eq=False)
class Case:
    """One problem on one grid.

    Attributes
    ----------
    field, kind, geometry
        Name of the field; one of :data:`KINDS`; cubes, squares or shells.
    layout, nodes
        The grid, and how many nodes it has.
    whole : FieldEquation
        With a medium that changes where the problem says so.
    pieces
        The same as equations of media that stay: py-pde knows nothing of jumps. Of a steady
        problem one without an end (infinite).
    start : FloatArray, mM
        Data of the state that solvers start from.
    scale : float, mM
        What errors are divided by: the highest concentration of medium and steady field.
    slowest : float, s
        In which the slowest deviation from rest falls to 1/e.
    limit : float, s
        Largest stable step of explicit Euler, where uptake is fastest.
    quiet : float, s
        Time before the medium switches; 0 where it does not.
    assembly : float, s
        Processor time to make the equations.
    """

    field: str
    kind: str
    geometry: str
    layout: Layout
    nodes: int
    whole: FieldEquation
    pieces: tuple[Piece, ...]
    start: FloatArray
    scale: float
    slowest: float
    limit: float
    quiet: float
    assembly: float

    @property
    def end(self) -> float:
        """End of the problem in s; infinite for a steady one."""
        return self.pieces[-1].end

    @property
    def name(self) -> str:
        """What the problem is, in words."""
        return f"{self.field}, {self.kind}, {self.geometry} of {self.layout.spacing:.3g} um"


def geometries(scene: Scene, frame: Frame, field: str) -> list[str]:
    """Return the geometries of grids that fit a field of a frame: its own first."""
    if scene.dimensions == 2:
        return [SQUARES]
    nutrient, cells = scene.nutrients[field], frame.cells
    radial = frame.fields[field].kind == "radial"
    uniform = all(face in ("*", "r+") for face in nutrient.sides) and not nutrient.sources
    ball = radial or (
        scene.domain is None
        and uniform
        and round_enough(cells.position, cells.radius, nutrient.roundness_limit, now_radial=True)
    )
    found = [SHELLS] if ball else []
    if scene.domain is not None or "r+" not in nutrient.sides:
        found.append(CUBES)
    return found if radial else found[::-1]


def grids(scene: Scene, frame: Frame, field: str, geometry: str, count: int) -> list[Layout]:
    """Return nested grids round the cells of a frame, from coarse to fine.

    The first has about twice the field's own spacing, each later one half of the one before.

    Raises
    ------
    NutrientFailed
        If no grid can be laid.
    """
    parameters, cells = FieldParameters.of(scene, field), frame.cells
    shape = "radial" if geometry == SHELLS else "box"
    alone = NutrientField(field, on_grid(parameters, shape, parameters.spacing))
    first = halved(alone.lay(cells.position, cells.radius)[0])
    return [refined(first, 2**k) for k in range(count)]


def halved(layout: Layout) -> Layout:
    """Return a grid of about twice the spacing in the same place, or the same if that is few."""
    if isinstance(layout, ShellLayout):
        count = -(-layout.count // 2)
        if count < FEWEST:
            return layout
        return ShellLayout(layout.centre, layout.radius / count, count)
    assert isinstance(layout, BoxLayout)
    box, axes = layout.box, 3 if layout.box.height is None else 2
    longest = max(box.shape)
    most = -(-longest // 2)
    if most < FEWEST:
        return layout
    h = longest * box.spacing / most
    counts = [max(1, int(np.ceil(n * box.spacing / h - 1e-9))) for n in box.shape[:axes]]
    # whatever an axis has more than before lies on both sides of it
    low = [
        o - 0.5 * (n * h - m * box.spacing)
        for o, n, m in zip(box.origin, counts, box.shape, strict=False)
    ]
    return BoxLayout(_box(low, counts, h, box.height))


def refined(layout: Layout, factor: int) -> Layout:
    """Return a grid of which ``factor`` nodes make one of another along each axis."""
    if isinstance(layout, ShellLayout):
        return ShellLayout(layout.centre, layout.spacing / factor, factor * layout.count)
    assert isinstance(layout, BoxLayout)
    box = layout.box
    axes = 3 if box.height is None else 2
    counts = [factor * n for n in box.shape[:axes]]
    return BoxLayout(_box(list(box.origin[:axes]), counts, box.spacing / factor, box.height))


def _box(low: Sequence[float], counts: Sequence[int], h: float, height: float | None) -> Box:
    low, counts = list(low), list(counts)
    if height is not None:
        low, counts = [*low, -0.5 * h], [*counts, 1]
    return Box((low[0], low[1], low[2]), (counts[0], counts[1], counts[2]), h, height)


def means(values: FloatArray, layout: Layout, factor: int) -> FloatArray:
    """Return the means over the nodes of a grid ``factor`` times as coarse; amounts stay."""
    if isinstance(layout, ShellLayout):
        parts = layout.volumes.reshape(-1, factor)
        held = values.reshape(-1, factor) * parts
        return np.asarray(held.sum(axis=1) / parts.sum(axis=1))
    assert isinstance(layout, BoxLayout)
    shape: list[int] = []
    for n in (n for n in layout.box.shape if n > 1 or layout.box.height is None):
        shape += [n // factor, factor]
    split = values.reshape(shape)
    return np.asarray(split.mean(axis=tuple(range(1, len(shape), 2))))


def nodes_of(layout: Layout) -> int:
    """Return how many nodes a grid has."""
    return int(layout.filled(0.0).size)


def case(scene: Scene, frame: Frame, field: str, kind: str, layout: Layout) -> Case:
    """Return a problem with the cells of a frame.

    Raises
    ------
    SceneError
        If the field is zero everywhere, or the medium does not reach it where that is to switch.
    NutrientFailed
        If there is no steady state.
    """
    begun = clock.process_time()
    equation, level = equation_on(scene, frame, field, layout)
    assembly = clock.process_time() - begun
    begun = clock.process_time()
    equation, level = equation_on(scene, frame, field, layout)  # the kernels are compiled now
    assembly = min(assembly, clock.process_time() - begun)
    start = np.full(equation.grid.shape, level)
    scale = _scale(equation, start, level, kind)
    slowest = _slowest_time(equation, start)
    limit = 2.0 / fastest_rate(equation, scale, start)
    whole, quiet = equation, 0.0
    pieces: tuple[Piece, ...] = (Piece(equation, 0.0, np.inf),)
    if kind == TRANSIENT:
        pieces = (Piece(equation, 0.0, SPAN * slowest),)
    elif kind == SWITCH:
        length = max(usual_step(scene), 2.0 * SPAN * slowest)
        quiet = length - 0.5 * SPAN * slowest
        whole = _with_medium(equation, Schedule.steps([(0.0, level), (quiet, 0.5 * level)]))
        _refuse_unreached(whole, field)
        half = _with_medium(equation, Schedule.steady(0.5 * level))
        pieces = (Piece(equation, 0.0, quiet), Piece(half, quiet, length))
    geometry = SHELLS if isinstance(layout, ShellLayout) else CUBES
    geometry = SQUARES if len(equation.grid.shape) == 2 else geometry
    return Case(
        field, kind, geometry, layout, nodes_of(layout), whole, pieces, start, scale, slowest,
        limit, quiet, len(pieces) * assembly,
    )  # fmt: skip


def equation_on(
    scene: Scene, frame: Frame, field: str, layout: Layout
) -> tuple[FieldEquation, float]:
    """Return the equation of one field on a grid, and the medium that it stays at, mM."""
    on_grid = layout.field(field, layout.filled(0.0))
    moved = replace(frame, fields={**frame.fields, field: on_grid})
    found = field_problem(scene, moved, [field]).equation
    level = found.terms[field].schedule.at(frame.time)
    return _with_medium(found, Schedule.steady(level)), level


def _with_medium(equation: FieldEquation, medium: Schedule) -> FieldEquation:
    """Return an equation of the same cells in another medium."""
    substances = {
        name: replace(term.substance, medium=medium) for name, term in equation.terms.items()
    }
    return FieldEquation(equation.grid, substances, equation.position, layout=equation.layout)


def scaled(equation: FieldEquation, factor: float) -> FieldEquation:
    """Return an equation whose cells take up so many times as much at most."""
    substances = {
        name: replace(term.substance, capacity=factor * np.asarray(term.substance.capacity))
        for name, term in equation.terms.items()
    }
    return FieldEquation(equation.grid, substances, equation.position, layout=equation.layout)


def _scale(equation: FieldEquation, start: FloatArray, level: float, kind: str) -> float:
    try:
        steady, _ = equation.steady_state(start, 0.0)
    except NutrientFailed:
        if kind == STEADY:
            raise
        steady = start
    scale = max(level, float(steady.max()))
    if not scale > 0.0:
        name = equation.names[0]
        raise SceneError(f"nutrients.{name}", "is zero everywhere: there is nothing to solve")
    return scale


def _refuse_unreached(equation: FieldEquation, field: str) -> None:
    """Refuse a medium that brings nothing into the field."""
    per_level = equation.terms[field].per_level
    schedule = equation.terms[field].schedule
    if per_level is None or not np.any(per_level) or not np.any(schedule.start):
        problem = "does not feel its medium, so that it cannot switch"
        raise SceneError(f"nutrients.{field}", problem)


def _slowest_time(equation: FieldEquation, start: FloatArray) -> float:
    """Return the time in s in which the slowest deviation falls to 1/e, by inverse iteration.

    Between walls, where it never does, that of the longest wave.
    """
    lengths = [high - low for low, high in equation.grid.axes_bounds]
    diffusion = next(iter(equation.terms.values())).substance.diffusion
    longest = float(max(lengths) / np.pi) ** 2 / diffusion
    inverse = equation.shifted_inverse(start, 0.0)
    shift, v = 1e-3 / longest, np.ones_like(start)
    size = longest
    for _ in range(10):
        v = inverse(v / _norm(v), shift)
        size = _norm(v)
    rate = 1.0 / size - shift
    return 1.0 / rate if rate > 1e-3 / longest else longest


def fastest_rate(equation: FieldEquation, scale: float, start: FloatArray) -> float:
    """Return the largest decay rate in 1/s where nothing is left and uptake is fastest."""
    half = min(term.substance.half_saturation for term in equation.terms.values())
    step, none = _LINEAR * min(scale, half), np.zeros_like(start)
    rest, _ = equation.rates(none, 0.0)
    v = np.random.default_rng(0).standard_normal(start.shape)
    rate = 0.0
    for _ in range(_ITERATIONS):
        v *= step / np.abs(v).max()
        found = equation.rates(v, 0.0)[0] - rest
        rate = _norm(found) / _norm(v)
        v = found
    return rate


def _norm(v: FloatArray) -> float:
    # not by BLAS: its threads wait for each other where a machine is busy
    return float(np.sqrt(np.square(v).sum()))
