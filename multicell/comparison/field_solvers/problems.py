"""The problems that solvers of fields are compared on, made from the fields of a frame.

Each field is taken alone, with the cells of the frame as they are.
"""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple, final

import numpy as np

from multicell.cells import FloatArray
from multicell.comparison.field_solvers.equations import (
    FieldEquation,
    Layout,
    equation_on,
    geometry_of,
    node_count,
    with_medium,
)
from multicell.errors import NutrientFailed, SceneError
from multicell.scene.coupling import usual_step

if TYPE_CHECKING:
    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene

STEADY, TRANSIENT, SWITCH = "steady", "transient", "switching medium"
KINDS: Final = (STEADY, TRANSIENT, SWITCH)
"""What is solved for: the state at rest; the medium's concentration everywhere, let go; the same
over a coupling step, shortly before whose end the medium falls to half."""

SPAN: Final = 2.0
"""Length of a transient in times in which the slowest deviation falls to 1/e; a medium switches
half of that before the end."""

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
    field, kind
        Name of the field; one of :data:`KINDS`.
    layout : Layout
        The grid.
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
    assembly : float, s
        Processor time to make the equations.
    """

    field: str
    kind: str
    layout: Layout
    whole: FieldEquation
    pieces: tuple[Piece, ...]
    start: FloatArray
    scale: float
    slowest: float
    limit: float
    assembly: float

    @property
    def end(self) -> float:
        """End of the problem in s; infinite for a steady one."""
        return self.pieces[-1].end

    @property
    def quiet(self) -> float:
        """Time in s before the medium switches; 0 where it does not."""
        return self.pieces[-1].begin

    @property
    def geometry(self) -> str:
        """Cubes, squares or shells."""
        return geometry_of(self.layout)

    @property
    def nodes(self) -> int:
        """Number of nodes of the grid."""
        return node_count(self.layout)

    @property
    def name(self) -> str:
        """What the problem is, in words."""
        return f"{self.field}, {self.kind}, {self.geometry} of {self.layout.spacing:.3g} um"


def case(scene: Scene, frame: Frame, field: str, kind: str, layout: Layout) -> Case:
    """Return a problem with the cells of a frame.

    Raises
    ------
    SceneError
        If the field is zero everywhere, or the medium does not reach it where that is to switch.
    NutrientFailed
        If there is no steady state.
    """
    equation_on(scene, frame, field, layout)  # compiles the kernels
    begun = clock.process_time()
    equation, level = equation_on(scene, frame, field, layout)
    assembly = clock.process_time() - begun
    start = np.full(equation.grid.shape, level)
    scale = _scale(equation, start, level, kind)
    slowest = _slowest_time(equation, start)
    limit = 2.0 / fastest_rate(equation, scale, start)
    whole = equation
    pieces: tuple[Piece, ...] = (Piece(equation, 0.0, np.inf),)
    if kind == TRANSIENT:
        pieces = (Piece(equation, 0.0, SPAN * slowest),)
    elif kind == SWITCH:
        length = max(usual_step(scene), 2.0 * SPAN * slowest)
        quiet = length - 0.5 * SPAN * slowest
        whole = with_medium(equation, [(0.0, level), (quiet, 0.5 * level)])
        _refuse_unreached(whole, field, level)
        half = with_medium(equation, [(0.0, 0.5 * level)])
        pieces = (Piece(equation, 0.0, quiet), Piece(half, quiet, length))
    return Case(
        field, kind, layout, whole, pieces, start, scale, slowest, limit, len(pieces) * assembly
    )


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


def _refuse_unreached(equation: FieldEquation, field: str, level: float) -> None:
    """Refuse a medium that brings nothing into the field."""
    per_level = equation.terms[field].per_level
    if per_level is None or not np.any(per_level) or level == 0.0:
        problem = "does not feel its medium, so that it cannot switch"
        raise SceneError(f"nutrients.{field}", problem)


def _slowest_time(equation: FieldEquation, start: FloatArray) -> float:
    """Return the time in s in which the slowest deviation falls to 1/e, by inverse iteration.

    Between walls, where it never does, that of the longest wave.
    """
    lengths = [high - low for low, high in equation.grid.axes_bounds]
    (term,) = equation.terms.values()
    longest = float(max(lengths) / np.pi) ** 2 / term.substance.diffusion
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
    (term,) = equation.terms.values()
    step, none = _LINEAR * min(scale, term.substance.half_saturation), np.zeros_like(start)
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
