"""The expected cost of a study, before any of it runs."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from multicell.errors import OutputError
from multicell.results.documents import read_document, write_table

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.studies.plan import Plan

EXPECTED_FILE: Final = "expected.json"
"""File in the folder of a study: what its runs are expected to take, by their names."""
_MAX_PREDICTED: Final = 300  # points of a study; a prediction takes 15 to 400 ms


@final
@dataclass(frozen=True)
class Cost:
    """Expected cost of a run.

    - ``seconds``: wall time on one core, without compilation
    - ``memory``, ``disk``, bytes: of the process at its largest; of the run's folder
    """

    seconds: float
    memory: float
    disk: float


@final
@dataclass(frozen=True)
class StudyCost:
    """Expected cost of several runs together.

    - ``runs``: how many there are
    - ``core_seconds``: sum of their wall times on one core, s
    - ``seconds``: wall time on so many cores, s; not below that of the longest run
    - ``memory``, ``disk``, bytes: of as many of the largest runs as there are cores; of all runs
    """

    runs: int
    core_seconds: float
    seconds: float
    memory: float
    disk: float


def cost_of(scene: Scene) -> Cost:
    """Return the expected cost of a run of a scene."""
    from multicell.report.explain.cost import predict

    found = predict(scene)
    return Cost(found.seconds, found.memory, found.file)


def total_cost(costs: Iterable[Cost], cores: int) -> StudyCost:
    """Return the expected cost of runs together on a number of cores."""
    costs = list(costs)
    total = sum(cost.seconds for cost in costs)
    longest = max((cost.seconds for cost in costs), default=0.0)
    return StudyCost(
        runs=len(costs),
        core_seconds=total,
        seconds=max(total / cores, longest),
        memory=sum(heapq.nlargest(cores, (cost.memory for cost in costs))),
        disk=sum(cost.disk for cost in costs),
    )


def costs_of(plan: Plan, folder: Path) -> list[Cost]:
    """Return the expected cost of a run of each point of a plan.

    It is predicted for some hundred points at most; others are expected to take what one beside
    them does.

    - ``folder``: of the study; what is found is kept there for the next time
    """
    known = _read_known(folder / EXPECTED_FILE)
    names = plan.names[:: plan.seeds]
    costs = [known.get(name) for name in names]
    stride = -(-len(costs) // _MAX_PREDICTED)
    found: list[Cost] = []
    for number, (cost, scene) in enumerate(zip(costs, plan.scenes, strict=True)):
        if cost is None:
            cost = found[-1] if number % stride else cost_of(scene)
        found.append(cost)
    if None in costs and folder.is_dir():
        _store(folder / EXPECTED_FILE, names, found)
    return found


def _read_known(path: Path) -> dict[str, Cost]:
    """Return the costs found before; none where they cannot be read: they are found again."""
    try:
        entries: Mapping[str, Any] = read_document(path) or {}
        return {name: Cost(**{k: float(v) for k, v in e.items()}) for name, e in entries.items()}
    except (OutputError, ValueError, TypeError, AttributeError):
        return {}


def _store(path: Path, names: Sequence[str], costs: Sequence[Cost]) -> None:
    entries: Mapping[str, Any] = {n: asdict(c) for n, c in zip(names, costs, strict=True)}
    try:
        write_table(path, entries)
    except OutputError:
        return  # it only saves time
