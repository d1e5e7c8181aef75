"""The cells of a frame as a table, its columns titled with their units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, Phase, State
from multicell.host.extras import needs
from multicell.results.quantities import unit_of
from multicell.tables.titles import titled

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pandas import DataFrame

    from multicell.results.frame import Frame

_AXES = ("x", "y", "z")
NAMED: Final[Mapping[str, list[str]]] = {
    "state": [s.name.lower() for s in sorted(State)],
    "phase": [p.name for p in sorted(Phase)],
}
OF_PHASES = ("phase", "progress", "phase_length")


def cell_columns(frame: Frame) -> Iterator[tuple[str, NDArray[Any], str]]:
    """Yield name, values and unit of all that is known of the cells, concentrations last."""
    for name in Cells.schema():
        yield name, getattr(frame.cells, name), unit_of(f"cells.{name}")
    for name, values in frame.concentrations.items():
        title = f"concentration_{name}"
        yield title, values, unit_of(f"cells.{title}")


def cells_table(
    frame: Frame, *, kinds: NDArray[Any] | None = None, phases: bool = True
) -> dict[str, NDArray[Any]]:
    """Return the cells of a frame, one row each, with what is stored of them.

    - ``kinds``: names of the types by number; absent: the numbers
    - ``phases``: whether there are phases of the cycle, whose columns are left out otherwise
    """
    table: dict[str, NDArray[Any]] = {}
    for name, column, unit in cell_columns(frame):
        if name in OF_PHASES and not phases:
            continue
        if name == "kind" and kinds is not None:
            column = kinds[column]
        elif name in NAMED:
            column = np.array(NAMED[name], dtype=object)[column]
        if column.ndim == 1:
            table[titled(name, unit)] = column
        else:
            for axis, values in zip(_axes(column.shape[1]), column.T, strict=True):
                table[titled(f"{name}_{axis}", unit)] = values
    return table


def data_frame(table: Mapping[str, NDArray[Any]]) -> DataFrame:
    """Return a table as pandas' ``DataFrame``; raises MissingPackage if pandas is not installed.

    States, phases and types are categories, so that tables by group have all of them in order.
    """
    needs("pandas")
    import pandas

    frame = pandas.DataFrame(dict(table))
    for name in {*NAMED, "kind"} & set(frame):
        if frame[name].dtype.kind == "O":
            words = NAMED.get(name, list(dict.fromkeys(frame[name])))
            frame[name] = pandas.Categorical(frame[name], words)
    return frame


def _axes(width: int) -> Sequence[str]:
    return _AXES if width == len(_AXES) else [str(k) for k in range(width)]
