"""The fields of a scene as a run sees them: all that the loop calls of ``nutrient``.

A scene without fields loads none of it; every question then has an empty answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.biology.responding import value_of
from multicell.errors import SceneError
from multicell.results.observables import viable_volume
from multicell.scene.checks import followed

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import Cells, FloatArray
    from multicell.nutrient.balance import Ledger
    from multicell.nutrient.fields import FieldSystem
    from multicell.nutrient.reactions.own import OwnReaction
    from multicell.results.frame import Field, Frame
    from multicell.scene.scene import Scene


@final
class SceneFields:
    """The fields of a scene, or none.

    - ``system``, FieldSystem or None: what solves them

    Raises SceneError for reactions that do not fit the fields.
    """

    def __init__(
        self,
        scene: Scene,
        reactions: Mapping[str, OwnReaction] | None,
        threads: int,
        plan: BiologyPlan,
    ) -> None:
        self._scene, self._followed = scene, followed(scene)
        self.system: FieldSystem | None = None
        if scene.nutrients:
            from multicell.nutrient.fields import FieldSystem

            def respond(
                behaviour: str, cells: Cells, found: Mapping[str, FloatArray]
            ) -> FloatArray | None:
                return value_of(plan, behaviour, 1.0, found, cells, early=True)

            self.system = FieldSystem(scene, reactions, threads, respond)
        elif reactions:
            raise SceneError("reactions", "are given, but the scene has no fields that could react")

    @property
    def nodes(self) -> int:
        """Number of nodes of the largest field in a box; zero without any."""
        return 0 if self.system is None else self.system.nodes

    @property
    def concentrations(self) -> dict[str, FloatArray]:
        """Concentration of each field at the cells, name -> (n,) mM."""
        return {} if self.system is None else self.system.concentrations

    @property
    def ledger(self) -> dict[str, Ledger]:
        """What has come in, been taken up, secreted, stored ... of each field."""
        return {} if self.system is None else self.system.ledger

    @property
    def last(self) -> dict[str, Field]:
        """The fields as they were last solved."""
        return {} if self.system is None else self.system.solved()

    def begin(self, cells: Cells, time: float, *, again: bool = False) -> None:
        """Lay the fields and solve for them at the start, or once more for other cells."""
        if self.system is not None:
            self.system.begin(cells, time, again=again)

    def advance(self, cells: Cells, before: Cells, begin: float, end: float) -> None:
        """Solve for the fields of new cells; ``before`` are those of the step's beginning."""
        if self.system is not None:
            self.system.advance(cells, begin, end, before=before)

    def gradients(self, cells: Cells) -> dict[str, FloatArray]:
        """Return the gradients that cells follow, name -> (n, 3) mM/µm."""
        if self.system is None or not self._followed:
            return {}
        if not self.system.concentrations:
            # contacts are looked for before there is a field, and need no forces
            return {name: np.zeros((len(cells), 3)) for name in self._followed}
        return self.system.gradients(cells.position, self._followed)

    def departure(self, cells: Cells) -> dict[str, float]:
        """Return how far the tissue departs from a ball, for the history of fields on shells."""
        shells = any(part.layout != "box" for part in self._scene.nutrients.values())
        if not shells or self._scene.dimensions != 3:
            return {}
        from multicell.nutrient.cartesian import departure

        return {"departure_from_a_ball": departure(cells.position, cells.radius)}

    def columns(self, cells: Cells) -> dict[str, float]:
        """Return the columns of the history: media and uptake."""
        if self.system is None:
            return {}
        media = {f"medium_{name}": level for name, level in self.system.media.items()}
        rates = {name: self.system.uptake_rate(name, cells) for name in self.system.fields}
        found = media | {f"uptake_{name}": rate for name, rate in rates.items()}
        if self._scene.dimensions == 3:
            rim = viable_volume(cells)
            found |= {f"rim_uptake_{name}": rate / rim for name, rate in rates.items()}
        return found

    def fitness(self, cells: Cells, time: float) -> tuple[dict[str, dict[str, Any]], list[str]]:
        """Return how well the grids fit the cells, by field, and remarks."""
        if self.system is None:
            return {}, []
        from multicell.nutrient.fitness import fitness

        return fitness(self.system, cells, time)

    def progress(self) -> dict[str, Any]:
        """Return what a frame needs so that the fields can be resumed from it."""
        if self.system is None:
            return {"ledger": {}, "rates": {}, "grids": {}}
        return {
            "ledger": {name: account.entries() for name, account in self.system.ledger.items()},
            "rates": {name: report.entries() for name, report in self.system.reports.items()},
            "grids": self.system.grids_snapshot(),
        }

    def resume(self, frame: Frame) -> None:
        """Take the fields from a frame."""
        if self.system is not None:
            self.system.restore(frame)

    def snapshot(self) -> Any:
        """Return what :meth:`restore` needs to undo a step."""
        return None if self.system is None else self.system.snapshot()

    def restore(self, snapshot: Any) -> None:
        """Make the fields what they were."""
        if self.system is not None:
            self.system.undo(snapshot)
