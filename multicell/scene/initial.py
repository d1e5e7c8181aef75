"""The keys of a scene that say which cells there are at the start, and where."""

from __future__ import annotations

from typing import Final, final

from multicell.errors import SceneError
from multicell.scene.start_table import StartTable
from multicell.schema import choice, count, number, parameters, table

_PACKED: Final = {"shape": "ball", "spacing": 1.0, "jitter": 0.0}
"""Keys that say where cells are if no table does, with their defaults."""


@final
@parameters
class Initial:
    """The cells at the start."""

    count: int = count(
        default=None,
        at_least=1,
        at_most=10**8,
        doc="number of cells; absent: 1, or those of the table",
        hint="A million is a lot.",
    )
    cells: StartTable | None = table(
        StartTable,
        default=None,
        shorthand="file",
        doc="table of positions, types, radii, ages ...; absent: a close packing, cut to a ball",
    )
    shape: str = choice(
        ["ball", "row"], default="ball", doc="of a close packing (in a plane a disc), or along x"
    )
    spacing: float = number(
        default=1.0,
        above=0,
        doc="centre distance / mean diameter",
    )
    jitter: float = number(
        default=0.0, at_least=0, doc="standard deviation of a random shift / mean diameter"
    )
    stage: str = choice(
        ["birth", "uniform", "asynchronous"],
        default="birth",
        doc="of the cycle: all at birth, spread uniformly, or as in a growing population",
    )

    def check(self) -> None:
        """Let the table say how many cells there are."""
        number = 1 if self.cells is None else self.cells.rows
        if self.count is None:
            object.__setattr__(self, "count", number)
        if self.cells is None:
            return
        if self.count != number:
            problem = f"is {self.count:,}, but the table of initial.cells has {number:,} rows"
            raise SceneError("count", problem, "Leave it out.")
        for name, usual in _PACKED.items():
            if getattr(self, name) != usual:
                problem = "has no effect: initial.cells gives the positions"
                raise SceneError(name, problem, "Leave it out.")
