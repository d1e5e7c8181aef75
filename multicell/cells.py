"""The state of all cells as a structure of NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from enum import IntEnum
from functools import cache
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.vectors import FloatArray as FloatArray
from multicell.vectors import cubes

IntArray = NDArray[np.int64]
Mask = NDArray[np.bool_]
Signals = Mapping[str, FloatArray]
"""Signals at the cells by name, (n,) each: fields in mM, and others."""

SPHERE = 4.0 * np.pi / 3.0
"""Volume of a sphere of unit radius."""

HALF = 0.5 ** (1.0 / 3.0)
"""Radius of a sphere over the radius of one with twice its volume."""

_TABLE = 8  # identities for each cell that a table of them may span

Share = Callable[[Callable[[int, int], None], int], None]
"""Calls a function for parts of the rows of so many cells, as many as threads share the work."""


def stokes_drag(viscosity: float) -> float:
    """Return 6πη, the drag of a sphere over its radius, kPa s (Stokes; η in kPa s)."""
    return 6.0 * np.pi * viscosity


@final
class Phase(IntEnum):
    """Where a cell is in its cycle; the values are those stored in :attr:`Cells.phase`."""

    G0 = 0
    G1 = 1
    S = 2
    G2 = 3
    M = 4


@final
class State(IntEnum):
    """State of a cell; the values are those stored in :attr:`Cells.state`."""

    PROLIFERATING = 0
    QUIESCENT = 1
    NECROTIC = 2
    APOPTOTIC = 3


def _column(dtype: type, unit: str, *, width: int | None = None, optional: bool = False) -> Any:
    """Declare an array with one entry (or one row of ``width``) per cell.

    An optional one is zero where it is not given; those of :data:`HAZARDS` are absent there.
    """
    metadata = {"dtype": dtype, "unit": unit, "width": width}
    return field(default=None, metadata=metadata) if optional else field(metadata=metadata)


HAZARDS = ("necrosis_hazard", "apoptosis_hazard", "change_hazard", "type_changes")
"""Columns that are None, and cost nothing, until a rate has acted on cells."""

ANY_WIDTH = -1  # of a column whose entries a cell are as many as a scene needs
_ABSENT = (*HAZARDS, "inside")


@final
@dataclass
class Cells:
    """State of ``n`` cells; every array has ``n`` rows and the cells' common order.

    The order may change from step to step (spatial sorting): refer to a cell by its ``id``.
    Units are the base units µm, s, kPa.

    Attributes
    ----------
    id : (n,) int64
        Identity, unique over a run, counted from 0.
    parent : (n,) int64
        Identity of the mother, -1 for cells that were there at the start.
    position : (n, 3) float64, µm
    radius : (n,) float64, µm
    young : (n,) float64, kPa
        Young's modulus E.
    poisson : (n,) float64
        Poisson ratio ν.
    state : (n,) int8
        One of :class:`State`.
    age : (n,) float64, s
        Time since birth; of a dead cell, since its death.
    cycle_time : (n,) float64, s
        Time in which the cell doubles its volume when nothing limits it; with phases, the time
        that it spends in those in which it grows.
    pressure : (n,) float64, kPa
        Compression by the neighbours at the end of the last step, tension negative.
    kind : (n,) int16
        Index of the cell's type among the types of the scene, 0 where all cells are alike.
    receptor, ligand : (n,) float64
        Concentrations of adhesion molecules on the surface, zero where the scene has none.
    phase : (n,) int8
        One of :class:`Phase`, zero where the scene has no phases.
    progress : (n,) float64, s
        Time spent in the phase, in growing phases as far as growth was not limited; in one that a
        condition ends, all time.
    phase_length : (n,) float64, s
        Time that the cell is to spend in its phase.
    doomed : (n,) int8
        At which of its next divisions the cell dies, counted from 1, also of one that has died;
        zero for sound cells.
    damage : (n,) float64
        Part of the damage that kills the cell; a dead one keeps it, daughters have the mother's.
    lag : (n,) float64, s
        Time of unlimited growth that the cell has yet to make good, because coupling steps hold
        rates of growth fixed; negative: too much.
    necrosis_hazard, apoptosis_hazard, change_hazard : (n,) float64, or None
        Integral of a rate since the cell was born or last changed its type; where it reaches the
        cell's own threshold the cell dies, or changes its type (:mod:`multicell.biology.exposure`).
    type_changes : (n,) int64, or None
        How often the cell has changed its type since its birth.
    inside : (n, k) float64, or None
        States of the networks in each cell and what solvers know of them, NaN in cells without; the
        order is that of :class:`multicell.biology.inside.Networks`.
    """

    id: IntArray = _column(np.int64, "")
    parent: IntArray = _column(np.int64, "")
    position: FloatArray = _column(np.float64, "um", width=3)
    radius: FloatArray = _column(np.float64, "um")
    young: FloatArray = _column(np.float64, "kPa")
    poisson: FloatArray = _column(np.float64, "")
    state: NDArray[np.int8] = _column(np.int8, "")
    age: FloatArray = _column(np.float64, "s")
    cycle_time: FloatArray = _column(np.float64, "s")
    pressure: FloatArray = _column(np.float64, "kPa")
    kind: NDArray[np.int16] = _column(np.int16, "", optional=True)
    receptor: FloatArray = _column(np.float64, "", optional=True)
    ligand: FloatArray = _column(np.float64, "", optional=True)
    phase: NDArray[np.int8] = _column(np.int8, "", optional=True)
    progress: FloatArray = _column(np.float64, "s", optional=True)
    phase_length: FloatArray = _column(np.float64, "s", optional=True)
    doomed: NDArray[np.int8] = _column(np.int8, "", optional=True)
    damage: FloatArray = _column(np.float64, "", optional=True)
    lag: FloatArray = _column(np.float64, "s", optional=True)
    necrosis_hazard: FloatArray | None = _column(np.float64, "", optional=True)
    apoptosis_hazard: FloatArray | None = _column(np.float64, "", optional=True)
    change_hazard: FloatArray | None = _column(np.float64, "", optional=True)
    type_changes: IntArray | None = _column(np.int64, "", optional=True)
    inside: FloatArray | None = _column(np.float64, "", width=ANY_WIDTH, optional=True)

    def __post_init__(self) -> None:
        n = len(self.id)
        for name, (dtype, width) in _layout().items():
            column = getattr(self, name)
            if column is None and name in _ABSENT:
                del vars(self)[name]  # what is left is that of the class, None
                continue
            shape = (n,) if width is None else (n, width)
            column = np.zeros(shape) if column is None else column
            array = np.ascontiguousarray(column, dtype=dtype)
            if width == ANY_WIDTH and array.ndim == 2:
                shape = (n, array.shape[1])
            if array.shape != shape:
                raise ValueError(f"cells.{name} has shape {array.shape}, expected {shape}")
            setattr(self, name, array)

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in _layout() and not hasattr(type(self), name):
            from difflib import get_close_matches

            near = get_close_matches(name, _layout(), n=1, cutoff=0.5)
            hint = f"; did you mean {near[0]!r}?" if near else f": {', '.join(_layout())}"
            raise AttributeError(f"cells have no column {name!r}{hint}", name=name, obj=self)
        super().__setattr__(name, value)

    def __len__(self) -> int:
        return len(self.id)

    def __repr__(self) -> str:
        if not len(self):
            return "<Cells: none>"
        sizes = f"{self.radius.min():.3g} to {self.radius.max():.3g} µm"
        counts = zip(*np.unique(self.state, return_counts=True), strict=True)
        states = ", ".join(f"{n:,} {State(state).name.lower()}" for state, n in counts)
        return f"<Cells: {len(self):,}, radius {sizes}, {states}>"

    @property
    def volume(self) -> FloatArray:
        """Volume of each cell as a free sphere, (n,), µm³."""
        return np.asarray(SPHERE * cubes(self.radius))

    @property
    def dead(self) -> NDArray[np.bool_]:
        """Which cells only lose volume until they are removed, (n,)."""
        return np.asarray(self.state > _RESTING)

    def columns(self) -> Iterator[tuple[str, NDArray[Any]]]:
        """Yield the name and the array of every column that is there, in their order."""
        for name in _layout():
            if name in vars(self):
                yield name, getattr(self, name)

    def take(self, index: NDArray[Any], share: Share | None = None) -> Cells:
        """Return copies of the cells at ``index`` (integers or a mask), in that order.

        - ``share``: by which threads share the work; no index is negative then
        """
        if index.dtype == np.bool_:
            (index,) = index.nonzero()
        if share is not None:
            return self.replaced(index, Cells.empty(), share)
        return _made({name: column.take(index, axis=0) for name, column in vars(self).items()})

    def copy(self) -> Cells:
        """Return the same cells in arrays of their own."""
        return _made({name: column.copy() for name, column in vars(self).items()})

    def shared(self) -> Cells:
        """Return the same cells in the same arrays, of which some are to be replaced."""
        return _made(vars(self))

    def changed(self, **columns: NDArray[Any]) -> Cells:
        """Return the same cells with other arrays for some columns."""
        return _made({**vars(self), **columns})

    def equals(self, other: Cells) -> bool:
        """Return whether all columns of other cells are the same."""
        mine, others = vars(self), vars(other)
        return mine.keys() == others.keys() and all(
            np.array_equal(column, others[name]) for name, column in mine.items()
        )

    def rows_of(self, ids: IntArray) -> IntArray:
        """Return the row of the cell of each identity, in the shape of ``ids``; -1 without one."""
        return rows_by_id(self.id, ids)

    def replaced(self, index: NDArray[Any], other: Cells, share: Share | None = None) -> Cells:
        """Return the cells at ``index`` followed by those of ``other``, column by column.

        - ``index``: a mask, or integers of which none is negative
        - ``share``: by which threads share the work
        """
        if index.dtype == np.bool_:
            (index,) = index.nonzero()
        count, kept = len(index) + len(other), len(index)
        found = {
            name: np.empty((count, *column.shape[1:]), column.dtype)
            for name, column in vars(self).items()
        }

        def run(begin: int, end: int) -> None:
            rows = index[begin:end]
            for name, column in vars(self).items():
                column.take(rows, 0, found[name][begin:end], "clip")

        if share is None:
            run(0, kept)
        else:
            share(run, kept)
        for name, column in found.items():
            if count > kept:
                column[kept:] = getattr(other, name)
        return _made(found)

    @classmethod
    def schema(cls) -> dict[str, dict[str, Any]]:
        """Return ``dtype``, ``unit`` and ``width`` of every column by name."""
        return {spec.name: dict(spec.metadata) for spec in fields(cls)}

    @classmethod
    def empty(cls) -> Cells:
        """Return a population of no cells."""
        return cls(
            **{
                name: np.empty((0,) if s["width"] is None else (0, s["width"]), dtype=s["dtype"])
                for name, s in cls.schema().items()
                if name not in _ABSENT
            }
        )


_RESTING = int(State.QUIESCENT)  # the last of the living


def _made(columns: dict[str, NDArray[Any]]) -> Cells:
    """Return cells of columns that are known to fit together."""
    cells = object.__new__(Cells)
    cells.__dict__.update(columns)
    return cells


@cache
def _layout() -> dict[str, tuple[Any, int | None]]:
    """Return element type and width of every column by name; to ask a dataclass takes longer."""
    return {spec.name: (spec.metadata["dtype"], spec.metadata["width"]) for spec in fields(Cells)}


def rows_before(began: Cells, cells: Cells) -> IntArray:
    """Return the rows that cells had before a coupling step, or their mothers, (n,)."""
    if cells.id is began.id:
        return began.rows_of(cells.id)
    find = _finder(began.id)
    row = find(cells.id)
    born = np.flatnonzero(row < 0)
    row[born] = find(cells.parent[born])
    return row


def rows_by_id(known: IntArray, ids: IntArray) -> IntArray:
    """Return the place among ``known`` identities of each of ``ids``; -1 where it is not there.

    - ``known``, (n,): identities; of one that is there twice either place may be found
    - ``ids``, of any shape
    """
    if ids is known:  # as in all steps without divisions
        return np.arange(len(known))
    return _finder(known)(np.asarray(ids))


def _finder(known: IntArray) -> Callable[[IntArray], IntArray]:
    """Return a search for places among ``known`` identities.

    A table of all identities up to the largest where that is in proportion, else by sorting.
    """
    if len(known) == 0:
        return lambda ids: np.full(ids.shape, -1)
    low, high = int(known.min()), int(known.max())
    if high - low < _TABLE * len(known) + 1000:
        # the first and the last entry stand for all that are not between the two
        table = np.full(high - low + 3, -1, dtype=np.int64)
        table[known - (low - 1)] = np.arange(len(known))
        return lambda ids: table.take(ids - (low - 1), mode="clip")
    order = np.argsort(known)

    def find(ids: IntArray) -> IntArray:
        place = np.minimum(np.searchsorted(known, ids, sorter=order), len(known) - 1)
        return np.where(known[order[place]] == ids, order[place], -1)

    return find


def contact_rows(cells: Cells, contacts: IntArray) -> IntArray:
    """Return the rows of the cells of each pair, given by identities: (m, 2), absent ones left out.

    - ``cells``: all cells
    - ``contacts``, (m, 2): identities
    """
    rows = cells.rows_of(contacts).reshape(-1, 2)
    return rows[(rows >= 0).all(axis=1)]
