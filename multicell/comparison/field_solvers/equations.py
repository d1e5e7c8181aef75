"""The only door from this room to the fields of runs: grids, equations, and the march of runs.

Grids of one ladder are nested: every node of one is 8 (squares 4, shells 2) whole nodes of the
next, so that solutions are compared by means over nodes, which converge although cells are points.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from pde.pdes.base import PDEBase

from multicell.cells import FloatArray
from multicell.nutrient.cartesian import Box, round_enough
from multicell.nutrient.choosing.estimate import on_grid
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.equations.schedule import Schedule
from multicell.nutrient.field import NutrientField
from multicell.nutrient.grid import BoxLayout, Layout, ShellLayout
from multicell.nutrient.parameters import FieldParameters
from multicell.nutrient.problem import field_problem
from multicell.nutrient.steady import SolveReport
from multicell.nutrient.transient import Amounts, March, march

if TYPE_CHECKING:
    from multicell.nutrient.equations.solving import Inverse
    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene

__all__ = ["FieldEquation", "Layout"]

CUBES, SQUARES, SHELLS = "cubes", "squares", "shells"

MIN_NODES: Final = 6
"""Nodes along the longest axis of the coarsest grid, at least."""

BACKENDS: Final = {
    "kernels": "py-pde's solvers in Python, the rates by our compiled kernels",
    "numpy": "py-pde's solvers in Python, the rates by its own Laplacian",
    "numba": "py-pde's solvers and the rates compiled by numba, without the time for that",
}
"""How the rates are evaluated for py-pde's solvers -> what that means."""


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


def geometry_of(layout: Layout) -> str:
    """Return the geometry of a grid."""
    if isinstance(layout, ShellLayout):
        return SHELLS
    assert isinstance(layout, BoxLayout)
    return CUBES if layout.box.height is None else SQUARES


def own_spacing(scene: Scene, field: str) -> float:
    """Return the spacing that runs give a field, µm."""
    return FieldParameters.of(scene, field).spacing


def grids(scene: Scene, frame: Frame, field: str, geometry: str, count: int) -> list[Layout]:
    """Return nested grids round the cells of a frame, from coarse to fine.

    The first has about twice the field's own spacing, unless that are less than
    :data:`MIN_NODES` along its longest axis; each later one half of the one before.

    Raises
    ------
    NutrientFailed
        If no grid can be laid.
    """
    parameters, cells = FieldParameters.of(scene, field), frame.cells
    shape = "radial" if geometry == SHELLS else "box"

    def laid(spacing: float) -> Layout:
        alone = NutrientField(field, on_grid(parameters, shape, spacing))
        return alone.lay(cells.position, cells.radius)[0]

    first = laid(2.0 * parameters.spacing)
    if max(first.filled(0.0).shape) < MIN_NODES:
        first = laid(parameters.spacing)
    return [refine(first, 2**k) for k in range(count)]


def refine(layout: Layout, factor: int) -> Layout:
    """Return a grid of which ``factor`` nodes make one of another along each axis."""
    if isinstance(layout, ShellLayout):
        return ShellLayout(layout.centre, layout.spacing / factor, factor * layout.count)
    assert isinstance(layout, BoxLayout)
    box, h = layout.box, layout.box.spacing / factor
    (x, y, z), (nx, ny, nz) = box.origin, (factor * n for n in box.shape)
    if box.height is not None:  # a single layer stays one
        z, nz = -0.5 * h, 1
    return BoxLayout(Box((x, y, z), (nx, ny, nz), h, box.height))


def coarse_means(values: FloatArray, layout: Layout, factor: int) -> FloatArray:
    """Return the means over the nodes of a grid ``factor`` times as coarse; amounts stay."""
    if isinstance(layout, ShellLayout):
        parts = layout.volumes.reshape(-1, factor)
        return np.asarray((values.reshape(-1, factor) * parts).sum(axis=1) / parts.sum(axis=1))
    assert isinstance(layout, BoxLayout)
    shape: list[int] = []
    for n in (n for n in layout.box.shape if n > 1 or layout.box.height is None):
        shape += [n // factor, factor]
    return np.asarray(values.reshape(shape).mean(axis=tuple(range(1, len(shape), 2))))


def node_count(layout: Layout) -> int:
    """Return how many nodes a grid has."""
    return int(layout.filled(0.0).size)


def equation_on(
    scene: Scene, frame: Frame, field: str, layout: Layout
) -> tuple[FieldEquation, float]:
    """Return the equation of one field on a grid, and its medium's constant level, mM."""
    placed = layout.field(field, layout.filled(0.0))
    moved = replace(frame, fields={**frame.fields, field: placed})
    found = field_problem(scene, moved, [field]).equation
    level = found.terms[field].schedule.at(frame.time)
    return with_medium(found, [(0.0, level)]), level


def with_medium(equation: FieldEquation, levels: list[tuple[float, float]]) -> FieldEquation:
    """Return an equation of the same cells in a medium of stepwise (time in s, mM)."""
    return _with(equation, medium=Schedule.steps(levels))


def with_uptake(equation: FieldEquation, factor: float) -> FieldEquation:
    """Return an equation whose cells take up so many times as much at most."""
    (term,) = equation.terms.values()
    return _with(equation, capacity=factor * np.asarray(term.substance.capacity))


def _with(equation: FieldEquation, **changes: Any) -> FieldEquation:
    substances = {name: replace(term.substance, **changes) for name, term in equation.terms.items()}
    return FieldEquation(equation.grid, substances, equation.position, layout=equation.layout)


@final
class TooSlow(Exception):  # noqa: N818 - it names what happened
    """A solve that took longer than it may."""


@final
class CountedEquation(PDEBase):  # type: ignore[no-untyped-call]
    """A field equation that counts its evaluations and ends solves that take too long.

    Parameters
    ----------
    equation
    backend
        One of :data:`BACKENDS`.
    patience : float, s
        Wall time from :meth:`begin` on after which an evaluation raises :class:`TooSlow`; compiled
        solvers do not ask for one.
    """

    def __init__(self, equation: FieldEquation, backend: str, patience: float) -> None:
        super().__init__()
        self.equation, self.kernels, self.patience = equation, backend == "kernels", patience
        self.explicit_time_dependence = equation.explicit_time_dependence
        self.evaluations = 0
        # what solvers ask an equation for beside its rates
        self.make_evolution_rate: Any = equation.make_evolution_rate
        self.shifted_inverse: Callable[[FloatArray, float], Inverse] = equation.shifted_inverse
        self.switches, self.steady_state = equation.switches, equation.steady_state
        self.check = equation.check
        self.begin()

    def begin(self) -> None:
        """Let the clock run from now on."""
        self.deadline = clock.perf_counter() + self.patience

    def count(self, evaluations: int = 1) -> None:
        """Count evaluations.

        Raises
        ------
        TooSlow
        """
        self.evaluations += evaluations
        if clock.perf_counter() > self.deadline:
            raise TooSlow(f"took longer than {self.patience:g} s")

    def evolution_rate(self, state: Any, t: float = 0.0) -> Any:
        """Return the rates for py-pde's solvers in Python."""
        self.count()
        if not self.kernels:
            return self.equation.evolution_rate(state, t)
        return state.__class__(state.grid, self.equation.rates(state.data, t)[0])

    def rates(self, data: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
        """Return the rates and the slopes of the sinks, for our solvers."""
        self.count()
        return self.equation.rates(data, t)


def march_of_runs(
    counted: CountedEquation, data: FloatArray, begin: float, end: float, *, tolerance: float,
    scale: float,
) -> tuple[FloatArray, int]:  # fmt: skip
    """March one field as runs do; return its data at the end and the number of steps."""
    (term,) = counted.equation.terms.values()
    substance, level = term.substance, term.schedule.at(0.0)
    fixed = term.secreted + term.supplied + substance.perfusion * level
    done = March(Amounts())

    def step(c: FloatArray, dt: float, time: float) -> tuple[FloatArray, SolveReport, float]:
        counted.count(0)
        found, report = term.operator.solve(
            term.sink, substance.half_saturation, c, linear=term.linear + 1.0 / dt,
            supply=fixed + c / dt,
        )  # fmt: skip
        counted.count(report.newton)
        return found, report, level

    found = march(
        step, counted.equation.layout.volumes, data.reshape(term.shape), begin, end,
        tolerance=tolerance, scale=scale, done=done,
    )  # fmt: skip
    return found.reshape(data.shape), done.steps


def thiele_modulus(equation: FieldEquation) -> float:
    """Return the tissue's radius over the depth to which it is fed where uptake is linear.

    R sqrt(q / (K D)) with the mean largest uptake q per volume of the nodes that take up at all.
    """
    (term,) = equation.terms.values()
    substance, volumes = term.substance, np.broadcast_to(equation.layout.volumes, term.shape)
    takes = term.sink > 0.0
    if not takes.any():
        return 0.0
    volume = float(volumes[takes].sum())
    demand = float((volumes * term.sink)[takes].sum()) / volume
    radius = (0.75 * volume / np.pi) ** (1.0 / 3.0)
    return float(radius * np.sqrt(demand / (substance.half_saturation * substance.diffusion)))
