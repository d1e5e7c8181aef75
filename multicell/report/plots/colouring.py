"""Colouring of cells: by state or another group, or by the value of a quantity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from multicell.cells import HAZARDS, Cells, FloatArray, IntArray, State, rows_by_id
from multicell.errors import OutputError
from multicell.report.plots.style import STATE_COLOURS, type_colours
from multicell.report.wording import written
from multicell.results.frame import Frame
from multicell.results.quantities import unit_of
from multicell.results.tables import NAMED
from multicell.scene.scene import Scene
from multicell.schema import near_miss

GROUPS: Final = ("state", "type", "phase", "clone", "doomed")
_NO_COLOUR: Final = (
    "id",
    "parent",
    "position",
    "kind",
    "state",
    "phase",
    "doomed",
    *HAZARDS,
    "inside",
)
_MIN_FOUNDERS: Final = 8  # clones into which the descendants of a single cell are parted
_MAX_NAMED_CLONES: Final = 12  # more than these are coloured, not listed
_NO_VALUE: Final = "#d5dbe0"  # of a cell without a value


@final
@dataclass(frozen=True, eq=False)
class Colouring:
    """The colours of all cells of a frame, and what explains them."""

    title: str
    rgb: FloatArray  # (n, 3)
    group: IntArray | None = None  # of each cell, (n,); None for the values of a quantity
    palette: Mapping[str, str] | None = None  # of the groups by name; empty where they are too many
    values: FloatArray | None = None  # of a quantity, (n,)
    range: tuple[float, float] | None = None  # of its colours, those of its ends beyond it


SCALE: Final = "viridis"  # of quantities: even in lightness and for any colour vision


def colourings(frame: Frame) -> list[str]:
    """Return the names of all that cells of a frame can be coloured by."""
    columns = [name for name in Cells.schema() if name not in _NO_COLOUR]
    return [*GROUPS, *columns, "volume", *frame.concentrations, *frame.inside]


def colouring(
    frame: Frame,
    scene: Scene,
    name: str | None,
    lineage: Mapping[str, NDArray[Any]],
    limits: tuple[float, float] | None = None,
) -> Colouring:
    """Return the colours of cells by what is asked for.

    - ``name``: one of :func:`colourings`; None for the types where there are several, else the
      states
    - ``lineage``: table of all cells that ever were, for clones
    - ``limits``: range of the colours of a quantity; absent: :func:`limits_of` the frame
    """
    if name is None:
        name = "type" if len(scene.types) > 1 else "state"
    if name == "state":
        colours = {word: STATE_COLOURS[word] for word in NAMED["state"]}
        return _by_group("state", frame.cells.state, colours)
    if name == "type":  # cells that are necrotic are dark
        types = list(scene.types) or ["cells"]
        colours = type_colours(types)
        # a type may be named like the state
        dead = "necrotic" if "necrotic" not in colours else "dead (necrotic)"
        group = np.where(frame.cells.state == State.NECROTIC, len(types), frame.cells.kind)
        return _by_group("type", group, {**colours, dead: STATE_COLOURS["necrotic"]})
    if name == "phase":
        return _by_group("phase", frame.cells.phase, type_colours(NAMED["phase"]))
    if name == "clone":
        return _by_clone(frame.cells, lineage)
    if name == "doomed":
        group = np.where(frame.cells.dead, 2, frame.cells.doomed > 0)
        colours = type_colours(("clonogenic", "doomed"))
        return _by_group("irradiation", group, {**colours, "dead": STATE_COLOURS["necrotic"]})
    known = colourings(frame)
    if name not in known:
        hint = near_miss(name, known)
        raise OutputError(f"there is nothing called {name!r} to colour cells by. {hint}")
    return _by_value(frame, name, limits)


def _by_group(title: str, group: NDArray[Any], palette: Mapping[str, str]) -> Colouring:
    colours = np.array([to_rgb(colour) for colour in palette.values()])
    return Colouring(title, colours[group], group.astype(np.int64), palette)


def _by_clone(cells: Cells, lineage: Mapping[str, NDArray[Any]]) -> Colouring:
    """Return a colour for the descendants of each founder: one of the first cells.

    Where there was one first cell, the founders are the first eight or more of one generation.
    """
    if "id" not in lineage:
        raise OutputError("the run has no lineage, which clones are identified by")
    founders, group = np.unique(founder(cells.id, lineage), return_inverse=True)
    count = len(founders)
    rgb = clone_colours(count)
    names = [f"from cell {number}" for number in founders] if count <= _MAX_NAMED_CLONES else []
    palette = dict(zip(names, map(mpl.colors.to_hex, rgb), strict=False))
    title = "clone" if palette else f"{count:,} clones"
    return Colouring(title, rgb[group], group.astype(np.int64), palette)


def clone_colours(count: int) -> FloatArray:
    """Return colours of clones, (count, 3).

    Neighbours in number are sisters: distant colours distinguish them.
    """
    turns = 0.05 + 0.9 * (np.arange(count) * 0.618034 % 1.0)
    return np.asarray(mpl.colormaps["turbo"](turns)[:, :3])


def founder(ids: IntArray, lineage: Mapping[str, NDArray[Any]]) -> IntArray:
    """Return the founder of each cell, (n,): the ancestor by which its clone is named."""
    known, parents = lineage["id"], lineage["parent"]
    # the last one, -1, is of cells that the lineage does not know: they are founders
    mother = np.append(rows_by_id(known, parents), -1)
    first = known[parents < 0]
    wanted = 1 if len(first) >= _MIN_FOUNDERS else _MIN_FOUNDERS
    generation = first
    for _ in range(64):  # a lineage in which each cell has one daughter at most ends, too
        if len(generation) >= wanted or len(generation) == 0:
            break
        generation = known[np.isin(parents, generation)]
    named = np.append(np.isin(known, generation if len(generation) else first), True)
    row = rows_by_id(known, ids)
    while (climbing := ~named[row] & (mother[row] >= 0)).any():
        row[climbing] = mother[row[climbing]]
    return np.where(row < 0, ids, np.append(known, -1)[row])


def _by_value(frame: Frame, name: str, limits: tuple[float, float] | None) -> Colouring:
    values, unit = cell_quantity(frame, name)
    finite = np.isfinite(values)
    low, high = limits or limits_of([values], from_zero=name in frame.concentrations)
    rgb = np.tile(np.array(to_rgb(_NO_VALUE)), (len(values), 1))
    rgb[finite] = mpl.colormaps[SCALE]((values[finite] - low) / (high - low))[:, :3]
    shown = name.replace("_", " ")
    title = f"{shown} ({written(unit)})" if unit else shown
    return Colouring(title, rgb, values=values, range=(low, high))


def cell_quantity(frame: Frame, name: str) -> tuple[FloatArray, str]:
    """Return the values of a quantity of the cells, (n,), and its unit."""
    if name in frame.concentrations:
        return frame.concentrations[name], unit_of(f"cells.concentration_{name}")
    if name == "volume":
        return frame.cells.volume, "um^3"
    if name in frame.inside:
        return frame.inside[name], ""
    if name not in Cells.schema() or name in _NO_COLOUR:
        raise OutputError(f"cells have no quantity {name!r}. {near_miss(name, colourings(frame))}")
    return getattr(frame.cells, name).astype(float), unit_of(f"cells.{name}")


def limits_of(parts: Sequence[FloatArray], *, from_zero: bool) -> tuple[float, float]:
    """Return the range of colours for values: all but the lowest and the highest half per cent.

    A few fresh daughters under pressure would leave all others one colour.
    """
    values = np.concatenate(parts)
    values = values[np.isfinite(values)]
    low, high = map(float, np.percentile(values, (0.5, 99.5))) if len(values) else (0.0, 1.0)
    low = 0.0 if from_zero else low
    return low, high if high > low else low + 1.0
