"""The view in space and time, as parts of a page: frames as columns of small integers, compressed.

A column is scaled over its range in the whole run; what is shown under the pointer is therefore
rounded: places to a 16,383rd of the extent of the run, quantities to a 255th of their range. Each
number is packed as its difference from that of the same cell in the frame before, bytes of one
weight together: what changes little compresses well.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from multicell import random
from multicell.cells import IntArray
from multicell.errors import OutputError
from multicell.population.extents import centre
from multicell.random import Purpose
from multicell.report.plots.colouring import SCALE, clone_colours, founder, limits_of
from multicell.report.plots.style import STATE_COLOURS, type_colours
from multicell.report.wording import TimeUnit, cell_count, time_unit, written
from multicell.results.frame import Frame
from multicell.results.quantities import known_unit, title_of, unit_of
from multicell.results.tables import NAMED

if TYPE_CHECKING:
    from multicell.report.result import Result
    from multicell.report.tables import Frames

MAX_FRAMES: Final = 50  # frames that are shown at most
MAX_CELLS: Final = 10_000  # cells of a frame that are shown at most
MAX_PAGE_BYTES: Final = 5_500_000
"""Size of the packed columns at most; fewer cells are shown where it would be more."""
POINTS: Final = 300  # points of a curve, besides those of the frames

_MAX_READ: Final = 3e6  # cells of all frames that are read at most
_MIN_FRAMES: Final = 8  # frames, however large
_CURVES: Final = ("cells", "diameter", "viable_rim", "largest_pressure")
_SHADES: Final = 64  # steps of the colour scale on the page
_EFFORT: Final = 6  # of the compression: 9 takes four times as long for one per cent less
_MAX_CLONES: Final = 250  # clones that are numbered, the largest ones
_SCRIPTS: Final = ("three.min.js", "viewer.js")
_PAGE_CELLS: Final = 100_000  # cells of a frame on the page of 'view', in place of MAX_CELLS
_PAGE_BYTES: Final = 17_500_000
"""Limits of :func:`pack_frames` for a page of its own, which then has less than 25 MB."""


@final
@dataclass(frozen=True)
class PackedColumn:
    """A column that is packed of each cell."""

    name: str
    unit: str
    kind: str  # of its integers: "u1", "u2" or "u4"
    values: Callable[[Frame], NDArray[Any]]  # returns the column of a frame
    words: Sequence[str] = ()  # names of its numbers, for groups
    title: str = ""
    low: float = 0.0  # range that is scaled
    high: float = 1.0
    gaps: bool = False  # whether some cells have no value, whose number is then 0

    @property
    def label(self) -> str:
        """Name in words."""
        return self.title or (self.name if "." in self.name else self.name.replace("_", " "))

    @property
    def plain(self) -> bool:
        """Whether the numbers are not scaled: identities and groups."""
        return self.kind == "u4" or bool(self.words)

    @property
    def top(self) -> int:
        """The largest of its integers."""
        return {"u1": 255, "u2": 16_383, "u4": 2**32 - 1}[self.kind]


@final
@dataclass(frozen=True)
class Packed:
    """Contents of a view: a table of contents for JSON, columns as text, and a note."""

    about: Mapping[str, Any]
    data: str
    note: str


def pack_frames(
    result: Result, *, max_cells: int = MAX_CELLS, max_bytes: int = MAX_PAGE_BYTES
) -> Packed | None:
    """Return the frames of a run for the view, or None where there is nothing to see.

    Of more than :data:`MAX_FRAMES` frames some are left out, evenly; of more than ``max_cells``
    cells, or where the packed columns would exceed ``max_bytes``, those are shown whose identities
    a random function ranks first, so that a cell that is shown once is shown as long as there is
    room. The note says both.
    """
    frames, whole = [], []
    for number in _frame_numbers(result):
        frame = result.frames[number].within(result.scene.domain)
        if len(frame.cells):
            whole.append({"cells": len(frame.cells), "groups": _groups(frame)})
            frames.append(_thin(frame, max_cells))  # one whole frame in memory at a time
    if not frames:
        return None
    curves, points = _curves(result, frames)
    whole = [{**entry, "point": point} for entry, point in zip(whole, points, strict=True)]
    columns = [_ranged(column, frames) for column in _columns(result, frames)]
    most = max(len(frame.cells) for frame in frames)
    unit = time_unit(frames[-1].time)
    while True:
        body, contents = _body(frames, whole, columns, unit)
        squeezed = gzip.compress(body, _EFFORT, mtime=0)
        if len(squeezed) <= max_bytes or most <= 100:
            break
        most = int(most * 0.95 * max_bytes / len(squeezed))
        frames = [_thin(frame, most) for frame in frames]
    about = {
        "frames": contents,
        "columns": [_describe(column) for column in columns],
        "colourings": list(_colourings(columns, frames, result)),
        "flat": result.scene.dimensions == 2,
        **_extent(frames),
        **curves,
    }
    return Packed(about, base64.b64encode(squeezed).decode("ascii"), _note(result, contents))


def _frame_numbers(result: Result) -> list[int]:
    """Return the numbers of the frames to show: first, last, and evenly between.

    Fewer of runs so large that reading frames would take long.
    """
    count = len(result.frames)
    cells = result.history.get("cells", np.empty(0))
    mean = float(cells.mean()) if len(cells) else 0.0
    most = min(MAX_FRAMES, max(_MIN_FRAMES, int(_MAX_READ / mean))) if mean > 0.0 else MAX_FRAMES
    if count <= most:
        return list(range(count))
    return sorted({round(k) for k in np.linspace(0, count - 1, most)})


def _thin(frame: Frame, most: int) -> Frame:
    """Return a frame with at most so many cells, in the order of their identities, no fields."""
    ids = frame.cells.id
    rows = np.argsort(ids, kind="stable")
    if len(rows) > most:
        rank = random.uniform(0, Purpose.VIEW, 0, ids[rows])[:, 0]
        rows = rows[np.sort(np.argpartition(rank, most)[:most])]
    values = {name: column[rows] for name, column in frame.concentrations.items()}
    taken = frame.cells.take(rows)
    return Frame(frame.time, frame.step, taken, values, progress=frame.progress)


def _groups(frame: Frame) -> dict[str, list[int]]:
    cells = frame.cells
    of: dict[str, NDArray[Any]] = {"state": cells.state, "type": cells.kind, "phase": cells.phase}
    return {name: np.bincount(column).tolist() for name, column in of.items()}


def _columns(result: Result, frames: Sequence[Frame]) -> list[PackedColumn]:
    scene, lineage = result.scene, result.lineage
    columns = [
        PackedColumn("id", "", "u4", lambda f: f.cells.id, title="cell"),
        *(PackedColumn(x, "µm", "u2", partial(_axis, k)) for k, x in enumerate("xyz")),
        PackedColumn("radius", "µm", "u1", lambda f: f.cells.radius),
        PackedColumn("state", "", "u1", lambda f: f.cells.state, NAMED["state"]),
    ]
    if len(scene.types) > 1:
        columns.append(PackedColumn("type", "", "u1", lambda f: f.cells.kind, list(scene.types)))
    if scene.growth is not None:
        if scene.growth.phases:
            columns.append(PackedColumn("phase", "", "u1", lambda f: f.cells.phase, NAMED["phase"]))
        columns.append(PackedColumn("age", "h", "u1", lambda f: f.cells.age / 3600.0))
        clones = _clone_numbers(frames, lineage)
        if clones is not None:
            known, count = clones
            words = [f"clone {k + 1}" for k in range(count)]
            columns.append(PackedColumn("clone", "", "u1", known, words))
    columns.append(PackedColumn("pressure", "kPa", "u1", lambda f: f.cells.pressure))
    for name in scene.nutrients:
        if all(name in frame.concentrations for frame in frames):
            unit = written(unit_of(f"cells.concentration_{name}"))
            columns.append(PackedColumn(name, unit, "u1", partial(_entry, "concentrations", name)))
    for name in frames[-1].inside:
        if all(name in frame.inside for frame in frames):
            columns.append(PackedColumn(name, "", "u1", partial(_entry, "inside", name)))
    return columns


def _axis(k: int, frame: Frame) -> NDArray[Any]:
    return frame.cells.position[:, k]


def _entry(table: str, name: str, frame: Frame) -> Any:
    return getattr(frame, table)[name]


def _clone_numbers(
    frames: Sequence[Frame], lineage: Mapping[str, NDArray[Any]]
) -> tuple[Callable[[Frame], NDArray[Any]], int] | None:
    """Return a function that numbers the clones of a frame's cells, and their count, if several."""
    if "id" not in lineage:
        return None
    founders = np.unique(np.concatenate([founder(f.cells.id, lineage) for f in frames]))
    if len(founders) < 2:
        return None
    count = min(len(founders), _MAX_CLONES)

    def numbers(frame: Frame) -> NDArray[Any]:
        return np.searchsorted(founders, founder(frame.cells.id, lineage)) % count

    return numbers, count


def _ranged(column: PackedColumn, frames: Sequence[Frame]) -> PackedColumn:
    if column.plain:
        return replace(column, high=float(column.top))
    every = np.concatenate([column.values(frame) for frame in frames])
    values = every[np.isfinite(every)]
    gaps = len(values) < len(every)
    if not len(values):
        return replace(column, gaps=gaps)
    low, high = float(values.min()), float(values.max())
    high = high if high > low else low + 1.0
    if gaps:  # the least number is that of no value
        low -= (high - low) / (column.top - 1)
    return replace(column, low=low, high=high, gaps=gaps)


def _body(
    frames: Sequence[Frame],
    whole: Sequence[Mapping[str, Any]],
    columns: Sequence[PackedColumn],
    unit: TimeUnit,
) -> tuple[bytes, list[dict[str, Any]]]:
    """Return the columns of all frames one after the other, and a table of the frames.

    The table holds what is known of each frame before cells are left out, its time in ``unit``.
    """
    parts: list[bytes] = []
    contents: list[dict[str, Any]] = []
    known_ids: IntArray = np.empty(0, dtype=np.int64)
    before: dict[str, NDArray[Any]] = {}
    for frame, known in zip(frames, whole, strict=True):
        ids = frame.cells.id
        _, here, there = np.intersect1d(ids, known_ids, assume_unique=True, return_indices=True)
        now = {c.name: _integers(c, c.values(frame)) for c in columns}
        for column in columns:
            values = now[column.name]
            guess = np.zeros_like(values)
            if column.name == "id":
                guess[1:] = values[:-1]
            elif before:
                guess[here] = before[column.name][there]
            parts.append(_planes(values - guess))
        known_ids, before = ids, now
        label = unit.text(frame.time)
        contents.append({"time": frame.time, "label": label, "shown": len(ids), **known})
    return b"".join(parts), contents


def _planes(change: NDArray[np.unsignedinteger[Any]]) -> bytes:
    """Return differences as bytes, those of the lowest weight first; small ones have few bits.

    The sign is the lowest bit: 0, -1, 1, -2 become 0, 1, 2, 3.
    """
    size = change.itemsize
    signed = change.view(f"i{size}")
    folded = (signed << 1) ^ (signed >> (8 * size - 1))
    return folded.astype(f"<i{size}").view("u1").reshape(-1, size).T.tobytes()


def _integers(column: PackedColumn, values: NDArray[Any]) -> NDArray[np.unsignedinteger[Any]]:
    """Return values as small integers over their range; what is no number is the least one."""
    if column.plain:
        return values.astype(column.kind)
    share = np.nan_to_num((values - column.low) / (column.high - column.low), nan=0.0)
    return np.rint(column.top * share).astype(column.kind)


def _describe(column: PackedColumn) -> dict[str, Any]:
    more = [*["words"][: len(column.words)], *["gaps"][: column.gaps]]
    names = ("name", "label", "unit", "kind", "low", "high", "top", *more)
    return {name: getattr(column, name) for name in names}


def _colourings(
    columns: Sequence[PackedColumn], frames: Sequence[Frame], result: Result
) -> Iterator[dict[str, Any]]:
    """Yield the colourings of cells: types first where there are several."""
    several = len(result.scene.types) > 1
    order = sorted(columns, key=lambda column: column.name != ("type" if several else "state"))
    for column in order:
        if column.name in ("id", "x", "y", "z"):
            continue
        entry: dict[str, Any] = {"name": column.name, "label": column.label, "unit": column.unit}
        if column.words:
            yield entry | {"palette": _palette(column)}
            continue
        low, high = limits_of([column.values(frame) for frame in frames], from_zero=False)
        shades = mpl.colormaps[SCALE](np.linspace(0.0, 1.0, _SHADES))[:, :3]
        palette = np.round(shades, 3).tolist()
        yield entry | {"low": low, "high": high, "palette": palette}


def _palette(column: PackedColumn) -> list[list[float]]:
    colours: Iterable[Any] = type_colours(column.words).values()
    if column.name == "state":
        colours = [STATE_COLOURS[word] for word in column.words]
    elif column.name == "clone":
        colours = clone_colours(len(column.words))
    return [[round(float(c), 3) for c in to_rgb(colour)] for colour in colours]


def _extent(frames: Sequence[Frame]) -> dict[str, Any]:
    """Return the centre of the last frame's cells, and how far any cell is from it."""
    middle = centre(frames[-1].cells, 3)
    reach = max(
        float((np.linalg.norm(f.cells.position - middle, axis=1) + f.cells.radius).max())
        for f in frames
    )
    return {"middle": middle.tolist(), "reach": reach}


def _curves(result: Result, frames: Sequence[Frame]) -> tuple[dict[str, Any], list[int | None]]:
    """Return columns of the history, and for each frame its point on them.

    The points are the frames' own rows of the history, so that a curve shows at a frame what the
    frame shows, and others evenly spaced. A frame of a step that the history lacks has None.
    """
    history = result.history
    time, indices = (history.get(name, np.empty(0)) for name in ("time", "step"))
    if len(time) == 0:
        return {"times": [], "curves": [], "end": 0.0, "end_label": ""}, [None] * len(frames)
    of_step = {int(s): row for row, s in enumerate(indices)}
    own = [of_step.get(frame.step) for frame in frames]
    even = np.rint(np.linspace(0, len(time) - 1, POINTS)).astype(int).tolist()
    rows = sorted({*even, *(row for row in own if row is not None)})
    points = [None if row is None else rows.index(row) for row in own]
    curves = []
    for name in _CURVES:
        values = history.get(name)
        if values is not None and np.isfinite(values).any():
            shown = [_round(float(v)) for v in values[rows]]
            label, unit = title_of(name).capitalize(), written(known_unit(name))
            curves.append({"name": name, "label": label, "unit": unit, "values": shown})
    end = float(time[-1])
    about = {
        "times": time[rows].tolist(),
        "curves": curves,
        "end": end,
        "end_label": time_unit(end).text(end),
    }
    return about, points


def _round(value: float) -> float | None:
    """Return a value of a curve to six digits, a count as it is, and None for no number."""
    if not math.isfinite(value):
        return None
    return value if value.is_integer() else float(f"{value:.6g}")


def _note(result: Result, contents: Sequence[Mapping[str, Any]]) -> str:
    said = []
    if len(contents) < len(result.frames):
        said.append(f"{len(contents)} of {len(result.frames)} frames are shown.")
    thinned = [entry for entry in contents if entry["shown"] < entry["cells"]]
    if thinned:
        most = max(entry["shown"] for entry in thinned)
        said.append(
            f"Of more than {cell_count(most)} in a frame so many are drawn, chosen at random: "
            "there are gaps between them that the tissue does not have."
        )
    return " ".join(said)


def pack_view(
    result: Result, *, max_cells: int = MAX_CELLS, max_bytes: int = MAX_PAGE_BYTES
) -> dict[str, Any] | None:
    """Return the data of ``viewer.html`` for a run, or None where there is nothing to see.

    ``about`` is the table of contents as JSON, ``data`` the columns of all frames as text,
    ``scripts`` are texts, ``policy`` their hashes as sources for the page's
    Content-Security-Policy, and ``note`` says what is left out.
    """
    contents = pack_frames(result, max_cells=max_cells, max_bytes=max_bytes)
    if contents is None:
        return None
    # within a script "<" must not begin a tag; in JSON it can be written otherwise
    about = json.dumps(contents.about, allow_nan=False).replace("<", "\\u003c")
    folder = files("multicell.report.viewer")
    scripts = [(folder / name).read_text(encoding="utf-8") for name in _SCRIPTS]
    hashes = (hashlib.sha256(text.encode()).digest() for text in scripts)
    return {
        "about": Markup(about),
        "data": contents.data,
        "scripts": [Markup(script) for script in scripts],
        "policy": " ".join(f"'sha256-{base64.b64encode(one).decode('ascii')}'" for one in hashes),
        "note": contents.note,
    }


def view_page(result: Result, **limits: int) -> str | None:
    """Return a page of its own with the view, or None where there is nothing to see.

    - ``limits``: as for :func:`pack_view`
    """
    from multicell.report.html import rendered

    found = pack_view(result, **limits)
    if found is None:
        return None
    return rendered("view.html", title=result.scene.title or "Untitled run", viewer=found)


def write_view(run: Result, frames: Frames, folder: Path) -> list[str]:
    """Write the view of all frames as one page and return its name."""
    page = view_page(run, max_cells=_PAGE_CELLS, max_bytes=_PAGE_BYTES)
    if page is None:
        raise OutputError("no frame of the run has cells: there is nothing to show")
    (folder / "view.html").write_text(page, encoding="utf-8")
    return ["view.html"]
