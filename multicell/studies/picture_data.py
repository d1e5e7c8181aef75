"""Data of a study's pictures from its table: axes, final values, scatter, labels.

The table is an ``xarray.Dataset`` with the dimensions of the axes, ``seed`` and ``time``; of a
list of points ``point``, ``seed`` and ``time``, with the value of each axis as a coordinate along
``point``. Its variable ``state`` says how each run stands, over axes and seeds.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.report.wording import time_unit, written
from multicell.results.quantities import known_unit
from multicell.schema import near_miss

if TYPE_CHECKING:
    import xarray as xr

    from multicell.cells import FloatArray

POINT, SEED, TIME, STATE = "point", "seed", "time", "state"
RUN_DONE: Final = "done"
_PLAIN: Final = ("cells", "growth", "nutrients")  # tables whose keys speak for themselves
_LOG_RATIO: Final = 30.0  # ratio of the ends of an axis from which it is drawn logarithmically


class Scale(NamedTuple):
    """An axis of a study as a picture shows it.

    - ``name``: of the dimension or coordinate
    - ``words``, ``unit``: how it is read, and the unit that is shown
    - ``values``: in the order of the table, numbers or words; once each, sorted, of a list
    - ``numbers``, (n,) or None: the same in the shown unit; None for words
    - ``texts``: how the values are written
    - ``factor``: base units in the shown unit
    """

    name: str
    words: str
    unit: str
    values: list[Any]
    numbers: FloatArray | None
    texts: list[str]
    factor: float

    @property
    def label(self) -> str:
        """Name and unit."""
        return with_unit(self.words, self.unit)

    @property
    def log(self) -> bool:
        """Whether the numbers need a logarithmic axis."""
        if self.numbers is None or len(self.numbers) < 2:
            return False
        low, high = float(self.numbers.min()), float(self.numbers.max())
        return low > 0.0 and high >= _LOG_RATIO * low


def is_list(table: xr.Dataset) -> bool:
    """Return whether the points are a list and not a grid."""
    return POINT in table.dims


def axes_of(table: xr.Dataset) -> list[str]:
    """Return the names of the axes that have more than one value."""
    names = [str(name) for name in table[STATE].dims if name != SEED]
    if is_list(table):
        names = [str(n) for n, entry in table.coords.items() if entry.dims == (POINT,)]
    return [n for n in names if n != POINT and len(distinct(table[n].values)) > 1]


def distinct(values: NDArray[Any]) -> NDArray[Any]:
    """Return sorted numbers, or words, each once."""
    return np.unique(values if values.dtype.kind in "fiu" else values.astype(str))


def observables(table: xr.Dataset) -> list[str]:
    """Return the names of the variables that are numbers of each run."""
    return [
        str(name)
        for name, entry in table.data_vars.items()
        if SEED in entry.dims and entry.dtype.kind in "fiu"
    ]


def table_variable(table: xr.Dataset, name: str) -> xr.DataArray:
    """Return a variable of the table; raises SceneError if there is none of this name."""
    known = observables(table)
    if name not in known:
        raise SceneError("", f"the study has no observable {name!r}", near_miss(name, known))
    return table[name].astype(float)


def at_end(table: xr.Dataset, name: str) -> xr.DataArray:
    """Return an observable at the last time of each run: over the axes and seeds.

    What does not exist then, such as a viable rim without a core, is NaN, also where it existed
    before.
    """
    values = table_variable(table, name)
    if TIME not in values.dims:
        return values
    going = table["cells"].notnull() if "cells" in table else values.notnull()
    last = going.cumsum(TIME).argmax(TIME)
    return values.isel({TIME: last}).drop_vars(TIME).where(going.any(TIME))


def statistics(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation of what is finite over the last axis; NaN without."""
    with warnings.catch_warnings():
        # of no seed there is no mean, of one no deviation
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmean(values, axis=-1), np.nanstd(values, axis=-1, ddof=1)


def reading_unit(table: xr.Dataset, name: str) -> str:
    """Return the unit of a variable or axis as it is read."""
    return written(str(table[name].attrs.get("units") or known_unit(name)))


def label(table: xr.Dataset, name: str) -> str:
    """Return name and unit of a variable."""
    return with_unit(words(name), reading_unit(table, name))


def with_unit(name: str, unit: str) -> str:
    """Return the label of an axis."""
    return f"{name} ({unit})" if unit else name


def sentence(text: str) -> str:
    """Return a text with a capital at its beginning; units keep theirs."""
    return text[:1].upper() + text[1:]


def words(name: str) -> str:
    """Return a name as it is read."""
    return name.replace("_", " ").replace(".", " ")


def axis_scale(table: xr.Dataset, name: str) -> Scale:
    """Return how to show an axis; long times are given in minutes, hours or days."""
    found = table[name].values
    if is_list(table):
        found = distinct(found)
    long = key_words(str(table[name].attrs.get("key", name)), name)
    if found.dtype.kind not in "fiu":
        values = [str(value) for value in found]
        return Scale(name, long, "", values, None, values, 1.0)
    unit, factor = reading_unit(table, name), 1.0
    if unit == "s" and len(found):
        unit, factor = time_unit(float(found.max()))
    numbers = found / factor
    return Scale(name, long, unit, list(found), numbers, list(map(number_text, numbers)), factor)


def key_words(key: str, name: str) -> str:
    """Return how a key of a scene is read whose short name is given.

    These are its last two parts: a name alone, such as that of a boundary, may leave open of which
    field it is.
    """
    parts = key.split(".")
    kept = parts[-2:] if len(parts) > 1 and parts[-2] not in _PLAIN else parts[-1:]
    return words(max(".".join(kept), name, key=len))


def number_text(value: float, digits: int = 3) -> str:
    """Return a number with few digits, thousands separated."""
    if not np.isfinite(value):
        return "none"
    if abs(value) >= 10.0**digits:
        return f"{value:,.0f}"
    return f"{value:.{digits}g}"


def at_middle(table: xr.Dataset, names: Sequence[str]) -> tuple[xr.Dataset, str]:
    """Return the part of a grid at the middle values of some axes, and these in words."""
    parts = []
    for name in names:
        shown, place = axis_scale(table, name), (table.sizes[name] - 1) // 2
        table = table.isel({name: place})
        parts.append(f"{shown.words} {shown.texts[place]} {shown.unit}".strip())
    return table, ", ".join(parts)
