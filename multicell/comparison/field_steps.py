"""The fields of a coupling step as a run has them, by which solvers of fields are compared.

The equation is that of the last coupling step of a run, with its grid, its cells and what they take
up; it begins with what the step before has left. So each solver meets the same cells and the same
media, and nothing of the comparison depends on how the run itself was solved but for its start.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from typing import Any, Final, NamedTuple, final

import numpy as np
from pde.solvers.base import SolverBase

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.balance import FADED
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.equations.outside import bring
from multicell.scene.scene import Scene
from multicell.schema import near_miss
from multicell.simulation import Simulation

_MARCHING: Final = 1e-6  # tolerance with which fields are marched to rest by solvers that have one


@final
class FieldStep(NamedTuple):
    """Fields that are solved together, in one coupling step.

    - ``equation``; ``data``, (m, ...) mM: of all fields at the beginning
    - ``begin``, ``end``, s
    - ``steady``: whether they rest at the end
    - ``scales``, (m,) mM: highest concentration of each, which errors are compared with
    - ``position``, (n, 3) µm, ``radius``, (n,) µm: of the cells where they reach the grid
    """

    equation: FieldEquation
    data: FloatArray
    begin: float
    end: float
    steady: bool
    scales: FloatArray
    position: FloatArray
    radius: FloatArray

    @property
    def names(self) -> list[str]:
        """Names of the fields."""
        return self.equation.names

    def at_nodes(self, found: FloatArray, exact: FloatArray) -> float:
        """Return the largest distance of fields, (m, ...) mM, at any node, over their scales."""
        apart = np.abs(found - exact).reshape(len(self.scales), -1).max(axis=1)
        return float((apart / self.scales).max())

    def at_cells(self, found: FloatArray, exact: FloatArray) -> float:
        """Return the largest distance in the mean over a cell."""
        layout = self.equation.layout
        apart = [
            np.abs(layout.gather(self.position, c, self.radius)).max(initial=0.0) / scale
            for c, scale in zip(found - exact, self.scales, strict=True)
        ]
        return float(max(apart))


@final
class FieldRun(NamedTuple):
    """Solution of a step by a solver.

    - ``data``, (m, ...) mM; ``steps``: of the solver
    - ``wall``, ``cpu``, s; ``problem``: why it ended early, in words
    """

    data: FloatArray
    steps: int
    wall: float
    cpu: float
    problem: str = ""


def which_field(scene: Scene, name: str) -> str:
    """Return a field of a scene by name; empty: the first one. Raises SceneError."""
    if not scene.nutrients:
        raise SceneError(
            "nutrients", "are none in this scene", "Compare one with [nutrients.NAME]."
        )
    if name and name not in scene.nutrients:
        raise SceneError("nutrients", f"has no {name!r}", near_miss(name, scene.nutrients))
    return name or next(iter(scene.nutrients))


def record_fields(
    scene: Scene, name: str, threads: int | None, tell: Callable[[str], None]
) -> FieldStep:
    """Run a scene, and return the last coupling step of a field and those that react with it.

    Raises StepFailed if the scene cannot be run.
    """
    tell("recording the run")
    run = Simulation(scene, threads=threads)
    system = run.field_system
    group = next(group for group in system.groups if name in group.names)
    begin, before = run.time, [system.fields[x].solution for x in group.names]
    while not run.finished:
        begin, before = run.time, [system.fields[x].solution for x in group.names]
        run.step()
    layout, found = group.layout, []
    steady = group.first.parameters.regime == "steady"
    for field, solution in zip(group.fields.values(), before, strict=True):
        assert solution.layout is not None
        take = layout.guess if steady else layout.carried
        found.append(np.maximum(take(solution.values, solution.layout, field.level(begin)), 0.0))
    data = np.array(found)
    return FieldStep(
        group.equation, data, begin, run.time, steady, group.scales(), group.position, group.radius
    )


def solve_fields(step: FieldStep, solver: str, control: str, setting: float) -> FieldRun:
    """Solve a step by a solver, with a tolerance, steps of some s at most, or so long a march, s.

    A failure of the solver is a solution with words.
    """
    wall, cpu = clock.perf_counter(), clock.process_time()
    data, steps, problem = step.data, 0, ""
    try:
        if solver in ("multicell-steady", "multicell-march"):
            data, steps = _by_own(step, solver, setting)
        else:
            found = bring(
                step.equation,
                solver,
                step.data,
                step.end if step.steady else step.begin,
                step.end + setting if control == "time" else step.end,
                tolerance=setting if control == "tolerance" else _MARCHING,
                longest=setting if control == "step" else np.inf,
                scales=step.scales,
            )
            data, steps = found.data, found.steps
    except NutrientFailed as failure:
        problem = str(failure)
    return FieldRun(data, steps, clock.perf_counter() - wall, clock.process_time() - cpu, problem)


def _by_own(step: FieldStep, name: str, setting: float) -> tuple[FloatArray, int]:
    """Solve by a solver of the run's own."""
    nodes = step.data.copy()
    state, options = step.equation.view(nodes), {}
    if not step.steady:
        options = {"tolerance": setting, "scales": FADED * step.scales}
    solver: Any = SolverBase.from_name(name, step.equation, **options)
    solver.make_stepper(state)(state, step.begin, step.end)
    return nodes, int(solver.info["steps"])
