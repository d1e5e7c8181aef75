"""The state of a run: what a coupling step changes, what a frame saves, and how it is undone."""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping
from dataclasses import asdict, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell.biology.responding import other_signals, value_of
from multicell.coupling.timeline import PHASES, Phase, Timeline
from multicell.errors import SceneError
from multicell.host.interrupts import UNCUT
from multicell.integrators.shift import Replays
from multicell.integrators.stability import Stability
from multicell.nutrient.fields import FieldSystem
from multicell.results.frame import Frame, Progress
from multicell.results.lineage import Lineage
from multicell.scene.domain import check_start
from multicell.scene.steps import step_plan

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import Cells, FloatArray, IntArray
    from multicell.coupling.mover import Mover
    from multicell.mechanics.system import Mechanics
    from multicell.nutrient.balance import Ledger
    from multicell.nutrient.reactions.own import OwnReaction
    from multicell.results.frame import Field
    from multicell.scene.scene import Scene


_NOTED: Final = (
    "divisions", "removals", "released", "separation", "next_id", "unsorted", "first_states",
    "exposures",
)  # fmt: skip
"""What a run notes beside its cells; a frame's progress has entries of the same names."""

_STATE: Final = (
    "cells", "timeline", "contacts", "named", "replays", "stability", *_NOTED,
)  # fmt: skip
"""What a coupling step changes, beside fields, logs and counts of work."""
_state_of: Final = attrgetter(*_STATE)


def fields_of(
    scene: Scene, reactions: Mapping[str, OwnReaction] | None, threads: int, plan: BiologyPlan
) -> FieldSystem:
    """Return the fields of a scene, to which its cells respond."""

    def respond(behaviour: str, cells: Cells, found: Mapping[str, FloatArray]) -> FloatArray | None:
        return value_of(plan, behaviour, 1.0, found, cells, early=True)

    networks = plan.networks
    fluxes = None if networks is None or not networks.exchanges else networks.fluxes
    return FieldSystem(scene, reactions, threads, respond, fluxes)


class RunState(ABC):
    """The state of a run, which :class:`multicell.Simulation` advances.

    - ``cells``, Cells: the state at ``time``
    - ``divisions``, ``removals``, int: events so far
    - ``next_id``, ``unsorted``, int: first identity that is free, and new cells since all were last
      sorted in space
    - ``released``, float, µm³: volume that dead cells have lost, their remains at removal included
    - ``contacts``, (m, 2): identities of the pairs in contact: what exact JKR remembers, and others
      count
    - ``replays``, Replays or None: what small shifts have done to the ends of steps that were taken
      twice; None to take none
    - ``stability``, Stability: how far a fixed step was from its limit, where it has one
    - ``first_states``, name -> int: cells that rested and were dead at the start, as it found them,
      and whose state does not fit the field
    - ``exposures``: how many events are too many by the length of steps, and what that is estimated
      from (:func:`multicell.biology.exposure.remainders`)
    - ``named``, table of the scene -> (k,) identities: cells that are driven from outside because
      of who or where they were at the start
    - ``plan``, BiologyPlan: what biology needs of the scene
    - ``timeline``, Timeline: where the run is in time
    - ``mover``, Mover: mechanics and the integrator
    - ``field_system``, FieldSystem: what solves for the fields
    - ``wall``, phase -> s: wall time of each phase of the loop
    """

    cells: Cells
    next_id: int
    unsorted: int

    def __init__(
        self,
        scene: Scene,
        *,
        plan: BiologyPlan,
        mover: Mover,
        fields: FieldSystem,
        lineage: Lineage | None,
    ) -> None:
        self.scene, self.mover, self.field_system = scene, mover, fields
        self.plan = plan
        self.wall = dict.fromkeys(PHASES, 0.0)
        self.timeline = Timeline(step_plan(scene))
        self.divisions = self.removals = 0
        self.released = 0.0
        self.replays: Replays | None = Replays()
        self.stability = Stability()
        self.first_states: Mapping[str, int] = {}
        self.exposures: Mapping[str, float] = {}
        self.contacts = np.empty((0, 2), dtype=np.int64)
        self.separation: Mapping[str, float] | None = None
        self.named: dict[str, IntArray] = {}
        self.lineage = Lineage() if lineage is None else lineage

    def resume(self, frame: Frame) -> None:
        """Take the state from a frame."""
        known = frame.progress
        if known is None:
            raise ValueError("this frame does not hold what a run needs to go on")
        if frame.time > self.scene.duration:
            raise SceneError(
                "duration",
                f"is {self.scene.duration:g} s, which ends before the frame at {frame.time:g} s",
                "Name a later end, or resume from an earlier frame.",
            )
        self.timeline = Timeline.at_frame(self.timeline.plan, frame)
        self.cells = frame.cells.copy()
        check_start(self.scene, self.cells)
        self.contacts = np.array(frame.contacts)
        self.named = {path: np.array(ids, np.int64) for path, ids in known.driven.items()}
        for name in _NOTED:
            setattr(self, name, getattr(known, name))
        self.replays = Replays(**known.replays)
        self.stability = Stability(**known.stability)
        self._count(known.work)
        self.field_system.restore(frame)

    def _progress(self) -> Progress:
        """Return what a frame needs so that the run can be resumed from it."""
        return Progress(
            **{name: getattr(self, name) for name in _NOTED},
            **self.field_system.progress(),
            work=asdict(self.mechanics.work),
            driven={path: ids.tolist() for path, ids in self.named.items()},
            replays={} if self.replays is None else self.replays._asdict(),
            stability=self.stability._asdict() if self.mover.limit > 0.0 else {},
            inside=() if self.plan.networks is None else self.plan.networks.columns,
        )

    def _count(self, work: Mapping[str, int]) -> None:
        """Set what the integration has cost so far."""
        for name, count in work.items():
            setattr(self.mechanics.work, name, count)

    @property
    def mechanics(self) -> Mechanics:
        """The forces between the cells, and what finds neighbours."""
        return self.mover.system

    @property
    def nodes(self) -> int:
        """Number of nodes of the largest field in a box; zero without any."""
        return self.field_system.nodes

    @property
    def concentrations(self) -> dict[str, FloatArray]:
        """Concentration of each nutrient at the cells, name -> (n,) mM."""
        return self.field_system.concentrations

    @property
    def signals(self) -> dict[str, FloatArray]:
        """All that cells find and do not carry themselves: fields, time, neighbours; name -> (n,).

        Fields are in mM; there are no more than responses need.
        """
        return self._signals_at(self.cells) if self.plan.elsewhere else self.concentrations

    def _signals_at(self, cells: Cells) -> dict[str, FloatArray]:
        if not self.plan.elsewhere:
            return self.concentrations
        others = other_signals(self.plan, cells, self.contacts, self.time)
        return {**self.concentrations, **others}

    @property
    def ledger(self) -> dict[str, Ledger]:
        """What has come in, been taken up, secreted, stored ... of each nutrient."""
        return self.field_system.ledger

    @property
    def fields(self) -> dict[str, Field]:
        """The nutrient fields as they were last solved."""
        return self.field_system.solved()

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self.timeline.time

    @property
    def step_index(self) -> int:
        """Number of coupling steps done."""
        return self.timeline.step

    @property
    def steps(self) -> int:
        """Number of coupling steps to the scene's end."""
        return self.timeline.steps

    @property
    def finished(self) -> bool:
        """Whether the duration or the number of cells is reached, or all are pulled apart."""
        enough = self.scene.stop_cells
        grown = enough is not None and len(self.cells) >= enough
        return self.timeline.is_over or grown or self.separation is not None

    def phase(self, name: str) -> Phase:
        """Return a context that adds the wall time of its block to one of :data:`PHASES`."""
        return Phase(self.wall, name)

    def snapshot(self) -> dict[str, Any]:
        """Return what :meth:`restore` needs to undo a step.

        A step makes new arrays and does not write into those that are there: to keep them is
        to remember them. Logs and accounts only grow.
        """
        return {
            "lineage": self.lineage.counts(),
            "work": vars(self.mechanics.work).copy(),
            "fields": self.field_system.snapshot(),
            "rest": _state_of(self),
        }

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Make the state of a snapshot the state again."""
        with UNCUT:
            self.lineage.cut(snapshot["lineage"])
            self._count(snapshot["work"])
            self.field_system.undo(snapshot["fields"])
            for name, value in zip(_STATE, snapshot["rest"], strict=True):
                setattr(self, name, value)

    def frame(self, *, shared: bool = False) -> Frame:
        """Return the state as a frame that later steps do not change.

        One that is ``shared`` has the arrays of the state itself: a step makes new ones, but who
        writes into those of ``cells`` writes into the frame.
        """
        cells, found = self.cells, dict(self.concentrations)
        if not shared:
            cells, found = cells.copy(), {name: values.copy() for name, values in found.items()}
        return replace(self._view(), cells=cells, concentrations=found, fields=self.fields)

    def _view(self, *, whole: bool = True) -> Frame:
        """Return the state, without fields, as a frame that shares its arrays.

        Where it is not ``whole`` it lacks what only those need who go on from it.
        """
        return Frame(
            self.time, self.step_index, self.cells, self.concentrations,
            contacts=self.contacts, progress=self._progress() if whole else None,
        )  # fmt: skip
