"""Cells that are driven from outside: prescribed velocities of named cells.

Which cells a table names is said by their identities, by a region in which they are at the start,
or by their type; what is given of these must all hold. Without any of them all cells are meant.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.scene.checks import check_kinds
from multicell.scene.parts import span
from multicell.scene.sizes import division_radii
from multicell.scene.steps import longest_coupling_step
from multicell.schema import parameters, quantity, text, vector, whole_numbers

if TYPE_CHECKING:
    from multicell.cells import Cells
    from multicell.scene.scene import Scene

_span = partial(span, doc="where the cells' centres are at the start")


@final
@parameters
class PrescribedMotion:
    """A velocity that the named cells have whatever pushes them; zero holds them where they are.

    Until they are removed, also after their death. Of the daughters of a cell that was named by
    identity or region the first one (the smaller identity) takes the motion over, the other one
    is free.
    """

    cells: tuple[int, ...] | None = whole_numbers(doc="identities; absent: not chosen by them")
    type: str = text(default="", doc="name of the cells' type; empty: any")
    x: tuple[float, float] | None = _span()
    y: tuple[float, float] | None = _span()
    z: tuple[float, float] | None = _span()
    begin: float = quantity("s", default=0.0, at_least=0, doc="when it begins to act")
    end: float | None = quantity("s", default=None, above=0, doc="when it ends; absent: never")
    velocity: tuple[float, float, float] = vector(
        "um/s", default=(0.0, 0.0, 0.0), doc="of each cell; zero: fixed"
    )

    def check(self) -> None:
        """Raise ``SceneError`` for times that do not follow each other."""
        if self.end is not None and not self.end > self.begin:
            problem = f"is {self.end:g} s, must be after begin, {self.begin:g} s"
            raise SceneError("end", problem)

    @property
    def by_identity(self) -> bool:
        """Whether its cells are those of the start and who takes over from them."""
        return any(part is not None for part in (self.cells, self.x, self.y, self.z))

    def within(self, begin: float, end: float) -> float:
        """Return the part of a span of time in which it acts; of a moment, 1 or 0."""
        last = math.inf if self.end is None else self.end
        if end <= begin:
            return float(self.begin <= begin < last)
        return max(0.0, min(end, last) - max(begin, self.begin)) / (end - begin)

    def members(self, types: Iterable[str], cells: Cells) -> NDArray[np.bool_]:
        """Return which cells of the start it names, (n,); ``types`` are those of the scene."""
        chosen = np.ones(len(cells), dtype=np.bool_)
        if self.cells is not None:
            chosen &= np.isin(cells.id, self.cells)
        if self.type:
            chosen &= cells.kind == list(types).index(self.type)
        for axis, ends in enumerate((self.x, self.y, self.z)):
            if ends is not None:
                place = cells.position[:, axis]
                chosen &= (place >= ends[0]) & (place <= ends[1])
        return chosen


Motions = Mapping[str, PrescribedMotion]
"""The prescribed motions of a scene by name."""


def check_driven(scene: Scene) -> None:
    """Raise ``SceneError`` for motions that do not fit to the rest of the scene."""
    table = scene.initial.cells
    for name, motion in scene.motions.items():
        check_kinds(scene, f"motions.{name}.type", motion.type)
        if motion.cells is not None and (table is None or table.at_hand):
            ids = None if table is None else table.given.columns.get("id")
            known = range(scene.initial.count) if ids is None else np.unique(ids)
            _check_identities(f"motions.{name}", motion, known)
        step = longest_coupling_step(scene)
        way = step * math.hypot(*motion.velocity)
        most = division_radii(scene)[0]
        if way > most:
            problem = (
                f"moves cells by {way:.3g} um in a coupling step of {step:g} s, "
                f"must be at most the smallest division radius, {most:g} um"
            )
            hint = f"Take a coupling_step of {most / math.hypot(*motion.velocity):.3g} s or less."
            raise SceneError(f"motions.{name}.velocity", problem, hint)


def check_members(motions: Motions, types: Iterable[str], cells: Cells) -> None:
    """Raise ``SceneError`` for motions that name no cell of the start, or one that is not there.

    A cell that two of them would move at the same time is refused too.
    """
    moved: list[tuple[str, PrescribedMotion, NDArray[np.bool_]]] = []
    for name, motion in motions.items():
        path = f"motions.{name}"
        _check_identities(path, motion, np.unique(cells.id))
        chosen = motion.members(types, cells)
        if not chosen.any() and motion.by_identity:
            hint = "All of its cells, type, x, y and z must hold for a cell."
            raise SceneError(path, "names no cell of the start", hint)
        for other, earlier, taken in moved:
            both = np.flatnonzero(taken & chosen)
            if len(both) and _overlap(earlier, motion):
                problem = f"moves the cell {cells.id[both[0]]}, which {other} moves as well"
                raise SceneError(path, problem, "Let one of them end before the other begins.")
        moved.append((path, motion, chosen))


def _check_identities(
    path: str, motion: PrescribedMotion, known: range | NDArray[np.int64]
) -> None:
    """Check that cells are among the known ones, whose identities rise."""
    found = known if isinstance(known, range) else set(known.tolist())
    for cell in motion.cells or ():
        if cell not in found:
            problem = f"names the cell {cell}, which is not there at the start"
            hint = f"Identities at the start go from {known[0]} to {known[-1]}."
            raise SceneError(f"{path}.cells", problem, hint)


def _overlap(first: PrescribedMotion, second: PrescribedMotion) -> bool:
    ends = [math.inf if motion.end is None else motion.end for motion in (first, second)]
    return first.begin < ends[1] and second.begin < ends[0]
