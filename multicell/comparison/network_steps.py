"""Coupling steps of a network as a run has them, by which its methods are compared.

Of each step the cells that live through it undivided are noted: what their networks begin with, the
inputs at both ends, and how fast the cells grow. Every method starts from the same states and meets
the same inputs. In a run each cell remembers its last step; so here the coupling step before each
of them is solved first, which does not count but for what cells remember of it.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, NamedTuple, final

import numpy as np

from multicell.cells import Cells, FloatArray, IntArray
from multicell.errors import SceneError
from multicell.networks.loop import REMEMBERED
from multicell.networks.methods import METHODS, NetworkMethod
from multicell.networks.solver import Inside, NetworkFailed, NetworkSolver
from multicell.schema import near_miss
from multicell.simulation import Simulation

if TYPE_CHECKING:
    from multicell.biology.inside import PlacedNetwork
    from multicell.scene.scene import Scene

MOST_CELLS: Final = 100
"""Cells of a coupling step that are compared at most; the same ones in all as long as they live."""

_MIXING: Final = 2654435761  # Knuth's: cells of near identities are as good as drawn

SURE: Final = 1e-10
"""Tolerance of the reference."""


@final
class NetworkStep(NamedTuple):
    """A network in some cells through one coupling step, in its own unit of time.

    - ``time``, s: when it begins; ``ids``, (n,): of the cells
    - ``inside``: n cells at the beginning; ``before``, ``after``, (n, m): inputs at both ends
    - ``start``, ``span``, ``growth``, (n,): as :meth:`NetworkSolver.advance` takes them
    """

    time: float
    ids: IntArray
    inside: Inside
    before: FloatArray
    after: FloatArray
    start: float
    span: float
    growth: FloatArray


@final
@dataclass(frozen=True, eq=False)
class NetworkProblem:
    """The steps that are compared.

    - ``part``: the network, as the scene has it
    - ``steps``; ``before``: the one before each of them, None where the run begins
    - ``total``: how many the run has
    """

    part: PlacedNetwork
    steps: list[NetworkStep]
    before: list[NetworkStep | None]
    total: int

    def parts(self) -> list[NetworkProblem]:
        """Return each of the steps as a problem of its own."""
        pairs = zip(self.steps, self.before, strict=True)
        return [replace(self, steps=[step], before=[before]) for step, before in pairs]

    @property
    def mode(self) -> str:
        """How many of the run's steps they are, in words."""
        return f"{len(self.steps)} of {self.total} coupling steps"

    @property
    def cells(self) -> list[int]:
        """Fewest and most cells of a step."""
        counts = [len(step.before) for step in self.steps]
        return [min(counts), max(counts)]

    @property
    def span(self) -> float:
        """The longest step, s."""
        return max(step.span for step in self.steps) * self.part.seconds

    @property
    def scale(self) -> FloatArray:
        """Size of each state below which it counts as nothing, (s,), in its unit."""
        solver = self.part.solver
        return solver.absolute / solver.relative

    def solver(self, method: str, setting: float) -> NetworkSolver:
        """Return a solver with a relative tolerance, or a step in s."""
        length, relative = 0.0, setting
        if METHODS[method].fixed:
            length, relative = setting / self.part.seconds, SURE
        return NetworkSolver(
            self.part.model,
            method=method,
            relative=relative,
            absolute=relative * self.scale,
            length=length,
        )

    def errors(self, ends: list[FloatArray], exact: list[FloatArray]) -> list[FloatArray]:
        """Return the distance of states from others over their size, (n, s) for each step."""
        return [
            np.abs(one - other) / (np.abs(other) + self.scale)
            for one, other in zip(ends, exact, strict=True)
        ]


def which_network(scene: Scene, name: str) -> str:
    """Return a network of a scene by name; empty: the only one. Raises SceneError."""
    if not scene.networks:
        raise SceneError("networks", "are none in this scene", "Compare one with [networks.NAME].")
    if name in scene.networks:
        return name
    if not name and len(scene.networks) == 1:
        return next(iter(scene.networks))
    problem = f"has no {name!r}" if name else f"are {len(scene.networks)}: one must be named"
    hint = near_miss(name, scene.networks) if name else f"One of {', '.join(scene.networks)}."
    raise SceneError("networks", problem, hint)


def methods_of_networks(names: Sequence[str] | None) -> list[NetworkMethod]:
    """Return methods of networks by name; absent: all. Raises SceneError."""
    found = []
    for name in dict.fromkeys(METHODS if names is None else names):
        if name not in METHODS:
            raise SceneError("methods", f"has no {name!r}", near_miss(str(name), METHODS))
        found.append(METHODS[name])
    return found


def record_network(
    scene: Scene, name: str, samples: int, threads: int | None, tell: Callable[[str], None]
) -> NetworkProblem:
    """Run a scene and return some of the coupling steps of a network, spread evenly.

    Raises SceneError if in no step a cell has it, StepFailed if the scene cannot be run.
    """
    tell("recording the run")
    simulation = Simulation(scene, threads=threads)
    networks = simulation.plan.networks
    assert networks is not None
    part, last = networks.parts[name], None
    steps: list[tuple[NetworkStep | None, NetworkStep]] = []
    while not simulation.finished:
        begin, time = simulation.cells, simulation.time
        simulation.step()
        found = _step(part, begin, simulation.cells, time, simulation.time)
        if found is not None:
            steps.append((last, found))
        last = found
    if not steps:
        problem = f"has {name!r} in no cell that lives through a coupling step"
        raise SceneError("networks", problem, "Look at its cells, and at the duration.")
    # from the middles of equal parts of the run
    count = min(samples, len(steps))
    chosen = [steps[int((k + 0.5) * len(steps) / count)] for k in range(count)]
    return NetworkProblem(part, [x for _, x in chosen], [x for x, _ in chosen], len(steps))


def _step(
    part: PlacedNetwork, begin: Cells, end: Cells, time: float, until: float
) -> NetworkStep | None:
    """Return a step of the cells that have a network at both of its ends, None without any."""
    there = part.rows_with(begin)
    last = end.rows_of(begin.id[there])
    assert end.inside is not None
    assert begin.inside is not None
    stays = (last >= 0) & ~begin.dead[there]
    there, last = there[stays], last[stays]
    stays = np.isin(last, part.rows_with(end)) & ~end.dead[last]
    there, last = there[stays], last[stays]
    if not len(there):
        return None
    mixed = begin.id[there].astype(np.uint64) * np.uint64(_MIXING) % np.uint64(2**32)
    some = np.sort(np.argsort(mixed, kind="stable")[:MOST_CELLS])
    there, last = there[some], last[some]
    inside, before = part.read(begin.inside[there], begin.id[there])
    _, after = part.read(end.inside[last], end.id[last])
    inside.memory[:, :REMEMBERED] = 0.0
    span = (until - time) / part.seconds
    growth = 3.0 * np.log(end.radius[last] / begin.radius[there]) / span
    return NetworkStep(
        time, begin.id[there], inside, before, after, time / part.seconds, span, growth
    )


@final
class NetworkRun(NamedTuple):
    """Solution of all steps by a method.

    - ``ends``: cells at the end of each step; ``work``: what is counted of them together
    - ``wall``, ``cpu``, s; ``problem``: why it ended early, in words
    """

    ends: list[Inside]
    work: IntArray
    wall: float
    cpu: float
    problem: str = ""

    @property
    def states(self) -> list[FloatArray]:
        """States at the end of each step, (n, s)."""
        return [inside.y for inside in self.ends]


def solve_steps(
    problem: NetworkProblem, method: str, setting: float, patience: float = math.inf
) -> tuple[NetworkRun, Callable[[], NetworkRun]]:
    """Solve all steps; return what was found, and a function that solves them again.

    - ``setting``: relative tolerance, or a step in s
    - ``patience``: wall time in s after which it ends before the next step
    """

    def run(steps: Sequence[NetworkStep], patience: float) -> NetworkRun:
        return _run(problem.part, steps, problem.solver(method, setting), patience)

    if METHODS[method].fixed:
        return run(problem.steps, patience), lambda: run(problem.steps, math.inf)
    earlier = [step for step in problem.before if step is not None]
    first = run(earlier, patience)
    if first.problem:
        return first, lambda: first
    ends, steps = iter(first.ends), []
    for step, before in zip(problem.steps, problem.before, strict=True):
        known = step if before is None else _remembering(step, before.ids, next(ends))
        steps.append(known)
    return run(steps, patience), lambda: run(steps, math.inf)


def _remembering(step: NetworkStep, ids: IntArray, end: Inside) -> NetworkStep:
    """Return a step whose cells remember what those of the step before knew at its end."""
    memory = step.inside.memory.copy()
    _, own, other = np.intersect1d(step.ids, ids, return_indices=True)
    memory[own, :REMEMBERED] = end.memory[other, :REMEMBERED]
    return step._replace(inside=replace(step.inside, memory=memory))


def _run(
    part: PlacedNetwork, steps: Sequence[NetworkStep], solver: NetworkSolver, patience: float
) -> NetworkRun:
    begin, begin_cpu, ends, problem = clock.perf_counter(), clock.process_time(), [], ""
    for step in steps:
        if clock.perf_counter() - begin > patience:
            problem = f"takes more than {patience:g} s"
            break
        try:
            end = solver.advance(
                step.inside,
                step.before,
                step.after,
                step.start,
                step.span,
                growth=step.growth,
                diluted=part.diluted,
            )
        except NetworkFailed as failure:
            problem = f"{failure.problem}, at {failure.time * part.seconds:.6g} s"
            break
        ends.append(end)
    wall, cpu = clock.perf_counter() - begin, clock.process_time() - begin_cpu
    return NetworkRun(ends, solver.work, wall, cpu, problem)
