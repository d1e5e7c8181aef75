"""The state of a run as a value: what a coupling step makes anew, and what frames are made from.

A state does not change, and neither does an array in it: a step makes the next one, and to undo it
is to take the one before. Each field of :class:`RunState` says where it is stored, so that a run
that is resumed from a frame has all of it; what follows from the rest is declared as derived.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.cells import Cells, State, contact_rows
from multicell.integrators.shift import Replays
from multicell.integrators.stability import Stability
from multicell.results.frame import Frame, Progress

if TYPE_CHECKING:
    from multicell.cells import FloatArray, IntArray
    from multicell.nutrient.fields import FieldsState
    from multicell.results.lineage import Lineage
    from multicell.simulation.timeline import Timeline


_IN_FRAME: Final = {"stored": "frame"}
"""What :meth:`RunState.frame` and :meth:`RunState.of_frame` know a place for."""

_IN_LOGS: Final = {"stored": "logs"}
"""What is stored beside the frames."""

_DERIVED: Final = {"stored": "derived"}
"""What follows from the rest: without it a run finds it again, with the same bits."""


def _entry(
    name: str | None = None,
    write: Callable[[Any], Any] = lambda value: value,
    read: Callable[[Any], Any] = lambda value: value,
) -> dict[str, Any]:
    """Declare an entry of a frame's :class:`multicell.results.frame.Progress`.

    - ``name``: of the entry; absent: that of the field
    - ``write``, ``read``: make what can be stored as JSON, and make the value of it
    """
    return {"stored": "progress", "entry": name, "write": write, "read": read}


def _lists(named: Mapping[str, IntArray]) -> dict[str, list[int]]:
    return {path: ids.tolist() for path, ids in named.items()}


def _arrays(named: Mapping[str, list[int]]) -> dict[str, IntArray]:
    return {path: np.array(ids, np.int64) for path, ids in named.items()}


def _entries(value: Any) -> dict[str, float]:
    return {} if value is None else value._asdict()


def _replays(entries: Mapping[str, float]) -> Replays:
    return Replays(**entries)


def _stability(entries: Mapping[str, float]) -> Stability:
    return Stability(**entries)


@final
@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class RunState:
    """All that a run holds from step to step.

    - ``cells``: at the time of the state
    - ``timeline``: where the run is in time
    - ``fields``: solutions, accounts, and concentrations at cells
    - ``contacts``, (m, 2): identities of the pairs in contact: what exact JKR remembers, and others
      count
    - ``lineage``: births, deaths and ends so far
    - ``next_id``: first identity that is free
    - ``unsorted``: number of new cells since all were last sorted in space
    - ``divisions``, ``removals``: numbers of events so far
    - ``released``, µm³: volume that dead cells have lost, their remains at removal included
    - ``separation``: when and how the last contact broke in a pull
    - ``first_states``, name -> int: cells that rested and were dead at the start, as it found them,
      and whose state does not fit the field
    - ``exposures``: how many events are too many by the length of steps, and what that is estimated
      from (:func:`multicell.biology.exposure.remainders`)
    - ``named``, table of the scene -> (k,) identities: cells that are driven from outside because
      of who or where they were at the start
    - ``replays``: effects of small shifts on the ends of steps that were taken twice; None to
      take none
    - ``stability``: how far a fixed step was from its limit; None where the method has no limit
    - ``work``: counts of the cost of integration
    - ``lengths``: of steps that the run chooses, and from what (:class:`.step_lengths.Lengths`)
    - ``learnt``: what ``auto`` has learnt from them (:class:`.integrators.costs.Learnt`)
    - ``cavity``, µm: radius to which cells have widened a gel, where its next one is looked for;
      None without a gel
    - ``inside``: names of the columns of ``cells.inside``, of the networks in cells
    - ``growth``, (n,) or None: how fast cells would grow where they are, once it is known
    """

    cells: Cells = field(metadata=_IN_FRAME)
    timeline: Timeline = field(metadata=_IN_FRAME)
    fields: FieldsState = field(metadata=_IN_FRAME)
    contacts: IntArray = field(metadata=_IN_FRAME)
    lineage: Lineage = field(metadata=_IN_LOGS)
    next_id: int = field(metadata=_entry())
    unsorted: int = field(metadata=_entry())
    divisions: int = field(metadata=_entry())
    removals: int = field(metadata=_entry())
    released: float = field(metadata=_entry())
    separation: Mapping[str, float] | None = field(metadata=_entry())
    first_states: Mapping[str, int] = field(metadata=_entry())
    exposures: Mapping[str, float] = field(metadata=_entry())
    named: Mapping[str, IntArray] = field(metadata=_entry("driven", _lists, _arrays))
    replays: Replays | None = field(metadata=_entry(None, _entries, _replays))
    stability: Stability | None = field(metadata=_entry(None, _entries, _stability))
    work: Mapping[str, int] = field(metadata=_entry(None, dict, dict))
    lengths: Sequence[float] = field(metadata=_entry(None, list, tuple))
    learnt: Sequence[float] = field(metadata=_entry(None, list, tuple))
    cavity: float | None = field(metadata=_entry())
    inside: Sequence[str] = field(metadata=_entry(None, list, tuple))
    growth: FloatArray | None = field(default=None, metadata=_DERIVED)

    @classmethod
    def of_frame(
        cls, frame: Frame, *, timeline: Timeline, fields: FieldsState, lineage: Lineage
    ) -> RunState:
        """Return the state that a frame and the logs of its run hold.

        - ``timeline``, ``fields``: at the frame, which only those can make who know the scene
        """
        known = frame.progress
        stored = {name: read(getattr(known, entry)) for name, entry, _, read in _PROGRESS}
        cells, contacts = frame.cells.copy(), np.array(frame.contacts)
        return cls(
            cells=cells,
            timeline=timeline,
            fields=fields,
            contacts=contacts,
            lineage=lineage,
            **stored,
        )

    def progress(self) -> Progress:
        """Return the part of a frame to resume from, beside cells and fields."""
        stored = {entry: write(getattr(self, name)) for name, entry, write, _ in _PROGRESS}
        return Progress(**stored, **self.fields.progress())

    def frame(self, *, shared: bool = False) -> Frame:
        """Return the state as a frame; one that is ``shared`` has its arrays."""
        cells, found = self.cells, self.fields.concentrations
        if not shared:
            cells, found = cells.copy(), {name: values.copy() for name, values in found.items()}
        return replace(
            self.view(),
            cells=cells,
            concentrations=found,
            fields=self.fields.fields(),
            progress=self.progress(),
        )

    def view(self) -> Frame:
        """Return it as a frame without fields and what only those need who resume from it."""
        time, step_index = self.timeline.time, self.timeline.step_index
        found = self.fields.concentrations
        return Frame(time, step_index, self.cells, found, contacts=self.contacts)

    def with_cells(self, cells: Cells, kinds: int) -> RunState:
        """Return the state with cells as a user has left them, in arrays of its own.

        Some may be missing, which counts as removal, and their order may be another one. There are
        ``kinds`` types of cells.

        Raises ValueError where a column does not fit or holds what no cell can have, or for cells
        that are not of the run.
        """
        after = Cells(**dict(cells.columns())).copy()
        _refuse_impossible(after, kinds)
        if np.array_equal(after.id, self.cells.id):
            return replace(self, cells=after, growth=None)
        rows = self.cells.rows_of(after.id)
        if (rows < 0).any() or len(np.unique(rows)) < len(rows):
            raise ValueError(
                "cells.id must be identities of the run's own cells, none of them twice: "
                "start another run with other cells, Simulation(scene, cells=...)"
            )
        gone = len(self.cells) - len(after)
        return replace(
            self,
            cells=after,
            fields=self.fields.at_rows(rows),
            contacts=after.id[contact_rows(after, self.contacts)],
            lineage=self.lineage.events(self.cells, after, self.timeline.time),
            removals=self.removals + gone,
            growth=None,
        )


def _refuse_impossible(cells: Cells, kinds: int) -> None:
    """Raise ValueError for values that no cell can have: compiled code would not notice them."""
    wanted = {
        "position": (np.isfinite(cells.position).all(axis=1), "finite"),
        "radius": (np.isfinite(cells.radius) & (cells.radius > 0.0), "finite and above 0"),
        "young": (np.isfinite(cells.young) & (cells.young > 0.0), "finite and above 0"),
        "state": (np.isin(cells.state, list(State)), f"one of {', '.join(map(str, State))}"),
        "kind": ((cells.kind >= 0) & (cells.kind < kinds), f"from 0 to {kinds - 1}"),
    }
    for name, (fits, words) in wanted.items():
        if not fits.all():
            row = int(np.argmin(fits))
            found = getattr(cells, name)[row]
            raise ValueError(f"cells.{name}[{row}] is {found}, must be {words}")


_PROGRESS: Final = tuple(
    (f.name, f.metadata["entry"] or f.name, f.metadata["write"], f.metadata["read"])
    for f in fields(RunState)
    if f.metadata["stored"] == "progress"
)
"""Name, entry of the progress, and what writes and reads it, of each field that is stored there."""
