"""The reference solution, and how far it can be trusted.

The solution is computed twice, by two methods or with two tolerances. The difference of the two,
in every norm, is the uncertainty of the reference: smaller errors of a method mean nothing. For
single coupling steps the conditioning is part of the reference
(:mod:`multicell.comparison.conditioning`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, final

from multicell.comparison.conditioning import Conditioning, conditioning_of, shift_starts
from multicell.comparison.ladders import Method, find_method
from multicell.comparison.norms import NORMS, Norm, Observed, errors, observe
from multicell.comparison.record import record
from multicell.comparison.replay import ReplayProblem, Trajectory, replay
from multicell.errors import StepFailed
from multicell.integrators.runge_kutta import Euler
from multicell.integrators.shift import SHIFT
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

Pair = tuple[tuple[Method, float], tuple[Method, float]]
"""Method and setting of the reference, and of the one that it is checked against."""

_FEW, _FEW_AT_REST = 500, 2000  # cells up to which CVODE is fast at the tightest tolerance
# relative tolerances of references, and of one for coupling steps: near rounding, yet reached
_TIGHT, _LESS_TIGHT, _TIGHT_STEP = 1e-12, 1e-9, 1e-11
_RECORDED: Final = ("cvode", 1e-2)  # method and tolerance that lead through a sampled run


@final
@dataclass(frozen=True, eq=False)
class Reference:
    """A problem with its solution.

    - ``problem``, Problem
    - ``trajectory``, Trajectory
    - ``observed``, Observed
    - ``uncertainty``, norm -> float: difference from the second solution, in the norms of
      :data:`multicell.comparison.norms`
    - ``wall``, float, s: wall time of its computation
    - ``words``, str: how the two were computed
    - ``conditioning``, Conditioning or None: what a shift at the beginning of each coupling step
      does to its end; None of a whole run, or if it was not asked for
    - ``norms``, name -> Norm: in which errors are measured
    """

    problem: ReplayProblem
    trajectory: Trajectory
    observed: Observed
    uncertainty: dict[str, float]
    wall: float
    words: str
    conditioning: Conditioning | None = None
    norms: Mapping[str, Norm] = field(default_factory=lambda: NORMS)


def reference(
    scene: Scene,
    *,
    pair: Pair | None = None,
    stepwise: int | None = None,
    shift: float = SHIFT,
    norms: Mapping[str, Norm] = NORMS,
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Reference:
    """Return the reference solution of a scene.

    - ``pair``: two methods with their settings, by default :func:`default_pairs`. The first one
      records the events and gives the reference, the second one replays them. Step-wise both solve
      every step from its recorded state.
    - ``stepwise``: number of coupling steps to compare, each from its own recorded state
      (:mod:`multicell.comparison.record`); None for the whole run. The states are those that
      ``cvode`` leads to with a tolerance of a hundredth of a cell radius.
    - ``shift``: size in µm of the shift that shows the conditioning of single steps, root mean
      square of each coordinate; 0 to leave it out
    - ``norms``: in which errors are measured

    Raises StepFailed if one of the two cannot be computed.
    """
    note = progress or (lambda _: None)
    unsolved = unsolved_problem(scene, threads)
    shift = 0.0 if stepwise is None else shift
    recording = {"samples": stepwise, "threads": threads}
    sampled: tuple[ReplayProblem, Trajectory] | None = None
    pairs = default_pairs(scene, unsolved, stepwise) if pair is None else [pair]
    for k, chosen in enumerate(pairs):
        try:
            if stepwise is not None and sampled is None:
                name, tolerance = _RECORDED
                leading = find_method(name, scene, unsolved.mean_radius)
                sampled = _record(unsolved, leading, tolerance, recording, note)
            return _solve(unsolved, chosen, sampled, shift, norms, recording, note)
        except StepFailed as error:
            if k + 1 == len(pairs):
                raise
            note(f"reference: {error}")
    raise AssertionError("there is always a pair")


def default_pairs(scene: Scene, unsolved: ReplayProblem, stepwise: int | None = None) -> list[Pair]:
    """Return the tightest methods that a scene of its size can afford, the best first.

    SciPy's DOP853 of order 8 needs least evaluations for twelve digits. It is checked by CVODE,
    or, where that would take long, by the embedded pair of order 5. Where these cannot hold the
    scene CVODE is used with two tolerances. Single steps are solved by the embedded pair of
    order 5 and checked by CVODE: no error grows there, and both meet within 1e-7 of a radius.
    """
    few = _expected_cells(scene, len(unsolved.start)) <= (_FEW if scene.growth else _FEW_AT_REST)
    tolerance = _TIGHT if few else _LESS_TIGHT
    radius = unsolved.mean_radius
    cvode = find_method("cvode", scene, radius)
    pairs: list[Pair] = [((cvode, tolerance), (cvode, 10.0 * tolerance))]
    dopri5 = find_method("dopri5", scene, radius)
    if stepwise is not None:
        return [((dopri5, _TIGHT_STEP), (cvode, 10.0 * _TIGHT_STEP)), *pairs]
    check = (cvode, _TIGHT) if few else (dopri5, 10.0 * _TIGHT)
    return [((find_method("scipy-dop853", scene, radius), _TIGHT), check), *pairs]


def method_pair(
    methods: Sequence[tuple[str, float] | tuple[Method, float]], scene: Scene, radius: float
) -> Pair:
    """Return two methods with settings; a method may be given by its name."""
    first, second = (
        (m if isinstance(m, Method) else find_method(m, scene, radius), float(s))
        for m, s in methods
    )
    return first, second


def unsolved_problem(scene: Scene, threads: int | None) -> ReplayProblem:
    """Return the problem before anything has moved: it has no steps yet."""
    # the scene's own method moves nothing here, and may be one that is not at hand
    simulation = Simulation(scene, threads=threads, integrator=Euler(1.0))
    cells = simulation.cells
    return ReplayProblem(scene, simulation.prepared(), cells.position, cells.radius)


def _expected_cells(scene: Scene, count: int) -> float:
    """Return about how many cells there will be at the end of a run that starts with ``count``."""
    if scene.growth is None:
        return count
    cycles: float = min(scene.duration / scene.growth.mean_cycle, 60.0)
    grown: float = count * 2.0**cycles
    return min(grown, scene.stop_cells or math.inf)


def _solve(
    unsolved: ReplayProblem,
    pair: Pair,
    sampled: tuple[ReplayProblem, Trajectory] | None,
    shift: float,
    norms: Mapping[str, Norm],
    recording: dict[str, Any],
    note: Callable[[str], None],
) -> Reference:
    """Solve by the first method and check by the second; without a sample record the run."""
    (method, setting), (checking, other) = pair
    if sampled is None:
        problem, found = _record(unsolved, method, setting, recording, note)
        wall = found.wall
    else:
        problem, run = sampled
        found = _replay(problem, method, setting, "reference", note)
        wall = run.wall + found.wall
    observed = observe(problem, found)
    check = _replay(problem, checking, other, "check of the reference", note)
    uncertainty = errors(problem, observe(problem, check), observed, norms)
    conditioning = None
    if shift > 0.0:
        moved = shift_starts(problem, shift)
        ends = _replay(moved, method, setting, f"reference after a shift of {shift:g} um", note)
        conditioning = conditioning_of(problem, shift, observe(problem, ends), observed, norms)
    text = f"{method.name} at {setting:g}, checked by {checking.name} at {other:g}"
    return Reference(problem, found, observed, uncertainty, wall, text, conditioning, norms)


def _record(
    unsolved: ReplayProblem,
    method: Method,
    setting: float,
    recording: dict[str, Any],
    note: Callable[[str], None],
) -> tuple[ReplayProblem, Trajectory]:
    """Return the run, or a sample of it, by a method; report every tenth of it."""
    states = "" if recording["samples"] is None else "states by "
    note(f"reference: {states}{method.name} at {setting:g}")
    reported = 0

    def share(part: float) -> None:
        nonlocal reported
        if int(10.0 * part) > reported:
            reported = int(10.0 * part)
            note(f"reference: {10 * reported} % of the scene")

    return record(unsolved.scene, method.make(setting), progress=share, **recording)


def _replay(
    problem: ReplayProblem, method: Method, setting: float, what: str, note: Callable[[str], None]
) -> Trajectory:
    """Return the solution by a method, which must succeed."""
    note(f"{what}: {method.name} at {setting:g}")
    found = replay(problem, method.make(setting))
    if not found.done:
        raise StepFailed(
            float(problem.times[len(found.positions)]),
            f"the {what} by {method.name} failed: {found.problem}",
            "Choose other methods for the reference",
        )
    return found
