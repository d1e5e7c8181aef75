"""Cells that are driven from outside: constant forces and prescribed velocities on named cells.

Which cells a table names is said by their identities, by a region in which they are at the start,
or by their type; what is given of these must all hold. Without any of them all cells are meant.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.scene.checks import check_kinds
from multicell.scene.parts import span
from multicell.schema import parameters, quantity, text, vector, whole_numbers

if TYPE_CHECKING:
    from multicell.cells import Cells
    from multicell.scene.scene import Scene

Vector = tuple[float, float, float]


_span = partial(span, doc="where the cells' centres are at the start")


@parameters
class _Driven:
    """Which cells a table drives, and when."""

    cells: tuple[int, ...] | None = whole_numbers(doc="identities; absent: not chosen by them")
    type: str = text(default="", doc="name of the cells' type; empty: any")
    x: tuple[float, float] | None = _span()
    y: tuple[float, float] | None = _span()
    z: tuple[float, float] | None = _span()
    begin: float = quantity("s", default=0.0, at_least=0, doc="when it begins to act")
    end: float | None = quantity("s", default=None, above=0, doc="when it ends; absent: never")

    def check(self) -> None:
        """Raise ``SceneError`` for times that do not follow each other."""
        if self.end is not None and not self.end > self.begin:
            problem = f"is {self.end:g} s, must be after begin, {self.begin:g} s"
            raise SceneError("end", problem)


@final
@parameters
class Force(_Driven):
    """A force from outside on each of the named cells: ``force`` + ``rate`` x time since ``begin``.

    A cell keeps it until it is removed, also after its death. Of the daughters of a cell that was
    named by identity or region the first one (the smaller identity) takes it over.
    """

    force: Vector = vector("nN", default=(0.0, 0.0, 0.0), doc="on each cell, at begin")
    rate: Vector = vector("nN/s", default=(0.0, 0.0, 0.0), doc="at which the force grows")

    def check(self) -> None:
        """Raise ``SceneError`` for a force that is none, or a time that is none."""
        if not any((*self.force, *self.rate)):
            hint = "For example force = ['1 nN', '0 nN', '0 nN']."
            raise SceneError("force", "is zero, and does not grow: it has no effect", hint)
        super().check()


@final
@parameters
class PrescribedMotion(_Driven):
    """A velocity that the named cells have whatever pushes them; zero holds them where they are.

    Until they are removed, also after their death. Of the daughters of a cell that was named by
    identity or region the first one (the smaller identity) takes the motion over, the other one
    is free.
    """

    velocity: Vector = vector("um/s", default=(0.0, 0.0, 0.0), doc="of each cell; zero: held")


Driver = Force | PrescribedMotion


class DrivingTables(Protocol):
    """What holds the tables that drive cells: a scene, or the plan of a run."""

    @property
    def forces(self) -> Mapping[str, Force]:
        """Forces from outside by name."""

    @property
    def motions(self) -> Mapping[str, PrescribedMotion]:
        """Prescribed motions by name."""

    @property
    def types(self) -> Mapping[str, Any]:
        """Types of cells by name."""


def drivers(scene: DrivingTables) -> Iterator[tuple[str, Driver]]:
    """Yield the tables of a scene that drive cells, each with its dotted path."""
    tables: Mapping[str, Mapping[str, Driver]] = {
        "forces": scene.forces, "motions": scene.motions
    }  # fmt: skip
    for table, entries in tables.items():
        for name, driver in entries.items():
            yield f"{table}.{name}", driver


def by_identity(driver: Driver) -> bool:
    """Return whether its cells are those of the start and who takes over from them."""
    return any(part is not None for part in (driver.cells, driver.x, driver.y, driver.z))


def within(driver: Driver, begin: float, end: float) -> float:
    """Return the part of a span of time in which it acts; of a moment, 1 or 0."""
    last = math.inf if driver.end is None else driver.end
    if end <= begin:
        return float(driver.begin <= begin < last)
    return max(0.0, min(end, last) - max(begin, driver.begin)) / (end - begin)


def check_driven(scene: Scene) -> None:
    """Raise ``SceneError`` for drivers that do not fit to the rest of the scene."""
    for path, driver in drivers(scene):
        check_kinds(scene, f"{path}.type", driver.type)
    for name, motion in scene.motions.items():
        way = scene.coupling_step * math.hypot(*motion.velocity)
        most = scene.cells.division_radius
        if way > most:
            problem = (
                f"moves cells by {way:.3g} um in a coupling step of {scene.coupling_step:g} s, "
                f"must be at most the division radius, {most:g} um"
            )
            hint = f"Take a coupling_step of {most / math.hypot(*motion.velocity):.3g} s or less."
            raise SceneError(f"motions.{name}.velocity", problem, hint)


def members(types: Iterable[str], driver: Driver, cells: Cells) -> NDArray[np.bool_]:
    """Return which cells of the start a driver names, (n,); ``types`` are those of the scene."""
    chosen = np.ones(len(cells), dtype=np.bool_)
    if driver.cells is not None:
        chosen &= np.isin(cells.id, driver.cells)
    if driver.type:
        chosen &= cells.kind == list(types).index(driver.type)
    for axis, ends in enumerate((driver.x, driver.y, driver.z)):
        if ends is not None:
            chosen &= (cells.position[:, axis] >= ends[0]) & (cells.position[:, axis] <= ends[1])
    return chosen


def check_members(scene: DrivingTables, cells: Cells) -> None:
    """Raise ``SceneError`` for drivers that name no cell of the start, or one that is not there.

    A cell that two motions would move at the same time is refused too.
    """
    moved: list[tuple[str, Driver, NDArray[np.bool_]]] = []
    for path, driver in drivers(scene):
        missing = np.setdiff1d(driver.cells or (), cells.id)
        if len(missing):
            problem = f"names the cell {int(missing[0])}, which is not there at the start"
            hint = f"Identities at the start go from {cells.id.min()} to {cells.id.max()}."
            raise SceneError(f"{path}.cells", problem, hint)
        chosen = members(scene.types, driver, cells)
        if not chosen.any() and by_identity(driver):
            hint = "All of its cells, type, x, y and z must hold for a cell."
            raise SceneError(path, "names no cell of the start", hint)
        if isinstance(driver, PrescribedMotion):
            for other, earlier, taken in moved:
                both = np.flatnonzero(taken & chosen)
                if len(both) and _overlap(earlier, driver):
                    problem = f"moves the cell {cells.id[both[0]]}, which {other} moves as well"
                    raise SceneError(path, problem, "Let one of them end before the other begins.")
            moved.append((path, driver, chosen))


def _overlap(first: Driver, second: Driver) -> bool:
    ends = [math.inf if driver.end is None else driver.end for driver in (first, second)]
    return first.begin < ends[1] and second.begin < ends[0]
