"""The plan of a sensitivity analysis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.studies.axes import Range
    from multicell.studies.plan import Plan


@final
@dataclass(frozen=True)
class SensitivityPlan:
    """An analysis that was checked and has not run.

    - ``scene``, ``ranges``, ``size``, ``observables``, ``method``: as in
      :func:`multicell.sensitivity`
    - ``study``: the plan of its runs: the points that differ, as a list
    - ``rows``, (n,): the number of each point of the sample in the study
    """

    scene: Scene
    ranges: tuple[Range, ...]
    size: int
    observables: tuple[str, ...]
    study: Plan
    rows: tuple[int, ...]
    method: str = "morris"

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds of the runs at each point."""
        return tuple(range(self.scene.seed, self.scene.seed + self.study.seeds))
