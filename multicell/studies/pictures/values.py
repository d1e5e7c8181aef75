"""What the pictures of a study read from its table: axes, final values, scatter, labels.

The table is an ``xarray.Dataset`` with the dimensions of the axes, ``seed`` and ``time``; of a
sampled design ``point``, ``seed`` and ``time``, with the value of each axis as a coordinate along
``point``. Its variable ``state`` says how each run stands. Runs are in the order of their places
over axes and seeds, the last of which runs fastest.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from matplotlib.ticker import EngFormatter
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.report.wording import time_unit, written
from multicell.results.quantities import known_unit
from multicell.schema import near_miss

if TYPE_CHECKING:
    import xarray as xr

    from multicell.cells import FloatArray

POINT, SEED, TIME, STATE = "point", "seed", "time", "state"
DONE: Final = "done"
_PLAIN: Final = ("cells", "growth", "nutrients")  # tables whose keys speak for themselves
_LOG_RATIO: Final = 30.0  # ratio of the ends of an axis from which it is drawn logarithmically


class Statistics(NamedTuple):
    """Mean and standard deviation over seeds (ddof = 1; NaN of one seed), and how many there are.

    Each as an array over the axes.
    """

    mean: xr.DataArray
    sd: xr.DataArray
    number: xr.DataArray


class Scale(NamedTuple):
    """An axis of a study as a picture shows it.

    - ``name``: of the dimension or coordinate
    - ``label``: name and unit
    - ``values``: in the order of the table, numbers or words; once each, sorted, of a sampled
      design
    - ``numbers``, (n,) or None: the same in the shown unit; None for words
    - ``texts``: how the values are written
    - ``factor``: base units in the shown unit
    """

    name: str
    label: str
    values: list[Any]
    numbers: FloatArray | None
    texts: list[str]
    factor: float

    @property
    def log(self) -> bool:
        """Whether the numbers need a logarithmic axis."""
        if self.numbers is None or len(self.numbers) < 2:
            return False
        low, high = float(self.numbers.min()), float(self.numbers.max())
        return low > 0.0 and high >= _LOG_RATIO * low


def is_sampled(table: xr.Dataset) -> bool:
    """Return whether the points are a sample and not a grid."""
    return POINT in table.dims


def axes_of(table: xr.Dataset) -> list[str]:
    """Return the names of the axes that have more than one value, or all where none has."""
    if is_sampled(table):
        names = [
            str(name)
            for name, entry in table.coords.items()
            if entry.dims == (POINT,) and name != POINT
        ]
    else:
        names = sides_of(table)[:-1]
    return [name for name in names if len(distinct(table[name].values)) > 1] or names


def compact(table: xr.Dataset) -> xr.Dataset:
    """Return a table without dimensions of one value, beside those that a picture shows."""
    kept = {SEED, TIME, *axes_of(table)}
    alone = {name: 0 for name in sides_of(table) if table.sizes[name] == 1 and name not in kept}
    return table if is_sampled(table) else table.isel(alone)


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


def observable(table: xr.Dataset, name: str) -> xr.DataArray:
    """Return a variable of the table; raises SceneError if there is none of this name."""
    known = observables(table)
    if name not in known:
        raise SceneError("", f"the study has no observable {name!r}", near_miss(name, known))
    return table[name].astype(float)


def axis_named(table: xr.Dataset, name: str) -> str:
    """Return the name of an axis, or raise ``SceneError`` with the nearest one."""
    known = axes_of(table)
    if name not in known:
        raise SceneError("", f"the study has no axis {name!r}", near_miss(name, known))
    return name


def at_end(table: xr.Dataset, name: str) -> xr.DataArray:
    """Return an observable at the last time of each run: over the axes and seeds.

    What does not exist then, such as a viable rim without a core, is NaN, also where it existed
    before.
    """
    values = observable(table, name)
    if TIME not in values.dims:
        return values
    going = table["cells"].notnull() if "cells" in table else values.notnull()
    last = going.cumsum(TIME).argmax(TIME)
    return values.isel({TIME: last}).drop_vars(TIME).where(going.any(TIME))


def statistics(values: xr.DataArray, over: Sequence[str] = (SEED,)) -> Statistics:
    """Return mean and scatter of what is finite, over the seeds or other dimensions."""
    with warnings.catch_warnings():
        # of no seed there is no mean, of one no deviation
        warnings.simplefilter("ignore", RuntimeWarning)
        return Statistics(values.mean(over), values.std(over, ddof=1), values.count(over))


def unit_of(table: xr.Dataset, name: str) -> str:
    """Return the unit of a variable or axis as it is read."""
    return written(str(table[name].attrs.get("units") or known_unit(name)))


def label(table: xr.Dataset, name: str) -> str:
    """Return name and unit of a variable."""
    unit = unit_of(table, name)
    return f"{words(name)} ({unit})" if unit else words(name)


def sentence(text: str) -> str:
    """Return a text with a capital at its beginning; units keep theirs."""
    return text[:1].upper() + text[1:]


def words(name: str) -> str:
    """Return a name as it is read."""
    return name.replace("_", " ").replace(".", " ")


def scale(table: xr.Dataset, name: str) -> Scale:
    """Return how to show an axis; long times are told in minutes, hours or days."""
    found = table[name].values
    if is_sampled(table):
        found = distinct(found)
    long = axis_words(table, name)
    if found.dtype.kind not in "fiu":
        values = [str(value) for value in found]
        return Scale(name, long, values, None, values, 1.0)
    unit, factor = unit_of(table, name), 1.0
    if unit == "s" and len(found):
        shown = time_unit(float(found.max()))
        unit, factor = shown.name, shown.seconds
    numbers = found / factor
    told = f"{long} ({unit})" if unit else long
    return Scale(name, told, list(found), numbers, [number_text(v) for v in numbers], factor)


def axis_words(table: xr.Dataset, name: str) -> str:
    """Return the name of an axis as it is read: the last two parts of its key, where it is known.

    A name alone, such as that of a boundary, may leave open of which field it is.
    """
    return key_words(str(table[name].attrs.get("key", name)), name)


def key_words(key: str, name: str) -> str:
    """Return how a key of a scene is read whose short name is given."""
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


def scatter_text(mean: float, sd: float) -> tuple[str, str]:
    """Return a mean and its standard deviation, which is empty for one seed.

    From 100,000 on they are written as ``157k`` or ``1.2M``, which leaves room in a tile.
    """
    if not np.isfinite(sd):
        return number_text(mean), ""
    if abs(mean) >= 1e5:
        short = EngFormatter(sep="")
        return short(float(f"{mean:.3g}")), f"± {short(float(f'{sd:.2g}'))}"
    spread = f"{sd:#.2g}".rstrip(".") if 0.0 < sd < 100.0 else number_text(sd, 2)
    return number_text(mean), f"± {spread}"


def at_point(table: xr.Dataset, fixed: Mapping[str, Any]) -> xr.Dataset:
    """Return the part of a grid at given values of some axes, the nearest there are."""
    for name, wanted in fixed.items():
        axis_named(table, name)
        table = table.isel({name: nearest(table, name, wanted)})
    return table


def nearest(table: xr.Dataset, name: str, wanted: Any) -> int:
    """Return the place of the value of an axis that is nearest to a number, or is a word."""
    values = table[name].values
    if values.dtype.kind in "fiu":
        return int(np.abs(values - float(wanted)).argmin())
    known = [str(value) for value in values]
    if str(wanted) not in known:
        raise SceneError(name, f"has no value {wanted!r}", near_miss(str(wanted), known))
    return known.index(str(wanted))


def middle(table: xr.Dataset, names: Sequence[str]) -> dict[str, Any]:
    """Return the middle value of each of some axes."""
    return {name: table[name].values[(table.sizes[name] - 1) // 2] for name in names}


def point_text(table: xr.Dataset, fixed: Mapping[str, Any]) -> str:
    """Return values of axes in words: ``"oxygen boundary 0.07 mM"``."""
    parts = []
    for name, value in fixed.items():
        shown = scale(table, name)
        long, unit, text = shown.label, "", str(value)
        if not is_sampled(table):
            text = shown.texts[nearest(table, name, value)]
        elif shown.numbers is not None:
            text = number_text(float(value) / shown.factor)
        if shown.numbers is not None:
            long = axis_words(table, name)
            unit = shown.label.removeprefix(long).strip(" ()")
        parts.append(f"{long} {text} {unit}".strip())
    return ", ".join(parts)


def sides_of(table: xr.Dataset) -> list[str]:
    """Return the dimensions of one number of each run, the seeds last.

    They are in the order of the variables, which a data set itself may not keep.
    """
    wide = max(table.data_vars.values(), key=lambda entry: entry.ndim, default=None)
    found = [] if wide is None else list(wide.dims)
    names = [*found, *(name for name in table.dims if name not in found)]
    return [*(str(name) for name in names if name not in (SEED, TIME)), SEED]
