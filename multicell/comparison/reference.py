"""The reference solution, how far it can be trusted, and its cache on disk.

The solution is computed twice, by two methods or with two tolerances. The difference of the two,
in every norm, is the uncertainty of the reference: what a method is off by less than that says
nothing about the method.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from multicell.cells import Cells
from multicell.comparison import cache as reference_cache
from multicell.comparison.ladders import Method, named
from multicell.comparison.norms import Observed, errors, observe
from multicell.comparison.replay import Problem, Trajectory, record, replay
from multicell.comparison.stepwise import sample
from multicell.errors import StepFailed
from multicell.integrators.registry import METHODS
from multicell.integrators.runge_kutta import Euler
from multicell.results.folder import package_version, versions
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

Pair = tuple[tuple[Method, float], tuple[Method, float]]
"""Method and setting of the reference, and of the one that it is checked against."""

_FEW, _FEW_AT_REST = 500, 2000  # cells up to which CVODE is fast at the tightest tolerance
_TIGHT, _LESS_TIGHT, _TIGHT_STEP = 1e-12, 1e-9, 1e-11
_RECORDED = ("cvode", 1e-2)  # method and tolerance that lead from one state of a sample to the next
_PRESENTATION: Final = ("cli", "drawing", "plots", "report", "section", "progress", "explain")
_PRESENTATION_HERE: Final = (
    "chart",
    "page",
    "result",
    "measure",
    "workprecision",
    "stability",
    "stability_chart",
    "stability_page",
    "stability_result",
    "stability_state",
    "stability_trial",
)


@final
@dataclass(frozen=True, eq=False)
class Reference:
    """A problem with its solution.

    Attributes
    ----------
    problem : Problem
    trajectory : Trajectory
    observed : Observed
    uncertainty : norm -> float
        Difference from the second solution, in the norms of :data:`multicell.comparison.norms`.
    wall : float, s
        What it cost when it was computed.
    words : str
        How the two were computed.
    cached : bool
        Whether it comes from the cache.
    """

    problem: Problem
    trajectory: Trajectory
    observed: Observed
    uncertainty: dict[str, float]
    wall: float
    words: str
    cached: bool


def reference(
    scene: Scene,
    *,
    pair: Pair | None = None,
    stepwise: int | None = None,
    cells: Cells | None = None,
    cache: str | Path | bool = True,
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Reference:
    """Return the reference solution of a scene, from the cache if it is there.

    Parameters
    ----------
    scene
        The scene; its integrator is not used.
    pair
        Two methods with their settings, by default :func:`default_pairs`. The first one records
        the events and gives the reference, the second one replays them. Step-wise both solve
        every step from its recorded state.
    stepwise
        Number of coupling steps to compare, each from its own recorded state
        (:mod:`multicell.comparison.stepwise`); None for the whole run. The states are those that
        ``cvode`` leads to with a tolerance of a hundredth of a cell radius.
    cells
        Cells to start from instead of the scene's initial ones.
    cache
        Folder of the cache; True for that of the user (:func:`cache_folder`), False for none.
    threads
        See :class:`multicell.simulation.Simulation`.
    progress
        Called with a few words about what is being done.

    Raises
    ------
    StepFailed
        If one of the two cannot be computed.
    OutputError
        If the cache cannot be written.
    """
    tell = progress or (lambda _: None)
    unsolved = blank(scene, cells, threads)
    pairs = default_pairs(scene, unsolved, stepwise) if pair is None else [pair]
    options = {"cells": cells, "threads": threads}
    sampled: tuple[Problem, float] | None = None
    for k, chosen in enumerate(pairs):
        path = _path(cache, scene, cells, chosen, stepwise)
        held = None if path is None else reference_cache.load(path, unsolved)
        if held is not None:
            problem, trajectory, facts = held
            tell("reference: from the cache")
            return Reference(
                problem, trajectory, observe(problem, trajectory), **facts, cached=True
            )
        try:
            if stepwise is not None and sampled is None:
                sampled = _sampled(unsolved, stepwise, options, tell)
            solved = _solve(scene, chosen, sampled, options, tell)
        except StepFailed as error:
            if k + 1 == len(pairs):
                raise
            tell(f"reference: {error}")
            continue
        _keep(solved, path, tell)
        return solved
    raise AssertionError("there is always a pair")


def default_pairs(scene: Scene, unsolved: Problem, stepwise: int | None = None) -> list[Pair]:
    """Return the tightest methods that a scene of its size can afford, the best first.

    SciPy's DOP853 of order 8 needs least evaluations for twelve digits. It is checked by CVODE,
    or, where that would take long, by the embedded pair of order 5. Where these cannot hold the
    scene CVODE is used with two tolerances. Single steps are solved by the embedded pair of
    order 5 and checked by CVODE: no error grows there, and both meet within 1e-7 of a radius.
    """
    few = _expected(scene, len(unsolved.start)) <= (_FEW if scene.growth else _FEW_AT_REST)
    tolerance = _TIGHT if few else _LESS_TIGHT
    radius = unsolved.mean_radius
    cvode = named("cvode", scene, radius)
    pairs: list[Pair] = [((cvode, tolerance), (cvode, 10.0 * tolerance))]
    if stepwise is not None and "dopri5" in METHODS:
        exact = named("dopri5", scene, radius)
        return [((exact, _TIGHT_STEP), (cvode, 10.0 * _TIGHT_STEP)), *pairs]
    if "scipy-dop853" in METHODS:
        exact = named("scipy-dop853", scene, radius)
        check = (cvode, _TIGHT)
        if not few:
            other = "dopri5" if "dopri5" in METHODS else "scipy-dop853"
            check = (named(other, scene, radius), 10.0 * _TIGHT)
        pairs.insert(0, ((exact, _TIGHT), check))
    return pairs


def _expected(scene: Scene, count: int) -> float:
    """Return about how many cells there will be at the end of a run that starts with ``count``."""
    if scene.growth is None:
        return count
    cycles: float = min(scene.duration / scene.growth.mean_cycle, 60.0)
    grown: float = count * 2.0**cycles
    return min(grown, scene.stop_cells or math.inf)


def cache_folder() -> Path:
    """Return the folder of the user's cache: ``$MULTICELL_CACHE``, or below ``~/.cache``."""
    own = os.environ.get("MULTICELL_CACHE")
    if own:
        return Path(own)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "multicell" / "references"


def source_hash(folder: Path | None = None) -> str:
    """Return a hash of all sources that can change a number of a reference.

    Parameters
    ----------
    folder
        Folder of the package, by default that of multicell.
    """
    root = Path(__file__).parent.parent if folder is None else folder
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        here = path.parent.name == "comparison"
        if path.stem in (_PRESENTATION_HERE if here else _PRESENTATION):
            continue
        digest.update(str(path.relative_to(root)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def key(scene: Scene, cells: Cells | None, pair: Pair, stepwise: int | None = None) -> str:
    """Return what a reference depends on as one hash: scene, cells, methods, sources, versions."""
    entries = scene.to_dict()
    entries.pop("output", None)
    entries["integrator"] = {"max_displacement": scene.integrator.max_displacement}
    described: dict[str, Any] = {
        "scene": entries,
        "pair": [(method.name, method.control, setting) for method, setting in pair],
        "stepwise": None if stepwise is None else [stepwise, *_RECORDED],
        "version": package_version(),
        "versions": versions(),
        "source": source_hash(),
    }
    digest = hashlib.sha256(json.dumps(described, sort_keys=True).encode())
    if cells is not None:
        for name, column in cells.columns():
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()[:32]


def blank(scene: Scene, cells: Cells | None, threads: int | None) -> Problem:
    """Return the problem before anything has moved: it has no steps yet."""
    # the scene's own method moves nothing here, and may be one that is not at hand
    simulation = Simulation(scene, threads=threads, cells=cells, integrator=Euler(1.0))
    cells = simulation.cells
    return Problem(scene, simulation._mechanics, cells.position, cells.radius)


def _path(
    cache: str | Path | bool, scene: Scene, cells: Cells | None, pair: Pair, stepwise: int | None
) -> Path | None:
    if cache is False:
        return None
    folder = cache_folder() if cache is True else Path(cache)
    return folder / f"{key(scene, cells, pair, stepwise)}.npz"


def _sampled(
    unsolved: Problem, count: int, options: dict[str, Any], tell: Callable[[str], None]
) -> tuple[Problem, float]:
    """Return the recorded steps of a run, and the wall time that the run took."""
    name, tolerance = _RECORDED
    tell(f"reference: states by {name} at {tolerance:g}")
    begin = clock.perf_counter()
    scene = unsolved.scene
    recorder = named(name, scene, unsolved.mean_radius).make(tolerance)
    problem = sample(scene, recorder, count, progress=_share(tell), **options)
    return problem, clock.perf_counter() - begin


def _solve(
    scene: Scene,
    pair: Pair,
    sampled: tuple[Problem, float] | None,
    options: dict[str, Any],
    tell: Callable[[str], None],
) -> Reference:
    """Solve by the first method and check by the second; without a sample record the run."""
    (method, setting), second = pair
    if sampled is None:
        tell(f"reference: {method.name} at {setting:g}")
        problem, trajectory = record(scene, method.make(setting), progress=_share(tell), **options)
        wall = trajectory.wall
    else:
        problem, wall = sampled
        trajectory = _replayed(problem, (method, setting), "reference", tell)
        wall += trajectory.wall
    observed = observe(problem, trajectory)
    check = _replayed(problem, second, "check of the reference", tell)
    uncertainty = errors(problem, observe(problem, check), observed)
    text = f"{method.name} at {setting:g}, checked by {second[0].name} at {second[1]:g}"
    return Reference(problem, trajectory, observed, uncertainty, wall, text, cached=False)


def _keep(solved: Reference, path: Path | None, tell: Callable[[str], None]) -> None:
    """Write a reference to the cache."""
    if path is None:
        return
    facts = {"uncertainty": solved.uncertainty, "wall": solved.wall, "words": solved.words}
    if not reference_cache.save(path, solved.problem, solved.trajectory, facts):
        tell("reference: this scene has no plain form for the cache")


def _replayed(
    problem: Problem, by: tuple[Method, float], what: str, tell: Callable[[str], None]
) -> Trajectory:
    """Return the solution by a method, which must succeed."""
    method, setting = by
    tell(f"{what}: {method.name} at {setting:g}")
    found = replay(problem, method.make(setting))
    if not found.done:
        raise StepFailed(
            float(problem.times[len(found.positions)]),
            f"the {what} by {method.name} failed: {found.problem}",
            "Choose other methods for the reference",
        )
    return found


def _share(tell: Callable[[str], None]) -> Callable[[float], None]:
    """Return a callback that tells of every tenth of a run."""
    told = [0]

    def share(part: float) -> None:
        if int(10.0 * part) > told[0]:
            told[0] = int(10.0 * part)
            tell(f"reference: {10 * told[0]} % of the scene")

    return share


def paired(
    methods: Sequence[tuple[str, float] | tuple[Method, float]], scene: Scene, radius: float
) -> Pair:
    """Return two methods with settings; a method may be given by its name."""
    first, second = (
        (m if isinstance(m, Method) else named(m, scene, radius), float(s)) for m, s in methods
    )
    return first, second
