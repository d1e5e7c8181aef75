"""The table of cells that a run starts with: read once, known by the digest of its bytes.

The content of a file is read here for any scene: columns, their units, numbers and names. What of
it fits to a scene is checked by :mod:`multicell.scene.start_checks`.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, FloatArray, Phase, State
from multicell.errors import DataError, SceneError
from multicell.schema import (
    below,
    choice,
    count,
    file_path,
    near_miss,
    number,
    parameters,
    quantity,
    table,
    text,
)
from multicell.tables.columns import PARQUET, Columns, from_bytes, from_h5ad, from_object, parsed
from multicell.tables.text import read_bytes
from multicell.tables.titles import Title, read_title, titled, unknown_title
from multicell.units import RANGES, shown
from multicell.vectors import lengths, nearest_differences, wrapped

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

_MAX_BYTES: Final = 16_000_000_000
"""Bytes of a table: more than those of the largest number of cells."""
MAX_IDS: Final = 10**8
"""Identities of cells at the start are below."""

COPIES: Final[tuple[str, ...]] = ("cells.csv", "cells.parquet")
"""Names of the copy of a table in the folder of a run."""

START_COLUMNS: Final[Mapping[str, str]] = {
    "id": "",
    "position_x": "um",
    "position_y": "um",
    "position_z": "um",
    "radius": "um",
    "young": "kPa",
    "poisson": "",
    "state": "",
    "age": "s",
    "cycle_time": "s",
    "pressure": "kPa",
    "kind": "",
    "phase": "",
    "progress": "s",
    "phase_length": "s",
    "doomed": "",
    "damage": "",
    "lag": "s",
}
"""Columns that a start takes, with their base units, in the order in which they are written."""
ALIASES: Final = {"x": "position_x", "y": "position_y", "z": "position_z", "type": "kind"}
"""Other names of columns."""
IGNORED_COLUMNS: Final[Mapping[str, str]] = {
    "parent": "",
    "receptor": "",
    "ligand": "",
    "frame": "",
    "time": "s",
}
"""Columns of an exported frame that are ignored, as are concentrations."""
_BLOCK: Final = 50_000  # rows that are written at a time
_CROWDED: Final = 50  # pairs of deep overlaps for each cell; packed tissue has a few
_COINCIDING: Final = 0.01
"""Distance of two centres over the sum of the radii below which they are at one place."""
INTENSITY: Final = "intensity"
"""Beginning of the names of columns with what an image shows of a cell, which starts ignore."""
CONCENTRATION_PREFIX: Final = "concentration_"
"""Beginning of the names of columns with what cells found of a field."""

_OF_NETWORK: Final = re.compile(r"[A-Za-z_]\w*\.[A-Za-z_]\w*")
"""Title of a column with a value of a network in each cell."""

_NAMES: Final[Mapping[str, Mapping[str, int]]] = {
    "state": {state.name.lower(): int(state) for state in State},
    "phase": {phase.name: int(phase) for phase in Phase},
}
_POSITIVE: Final = ("radius", "young", "cycle_time")
_NOT_NEGATIVE: Final = ("age", "progress", "phase_length", "damage")


@final
@dataclass(frozen=True, eq=False)
class Given:
    """The cells at the start as a table states them.

    - ``columns``, name -> (n,): of :data:`START_COLUMNS`, in base units; ``state`` and ``phase`` as
      numbers of :class:`State` and :class:`Phase`, ``kind`` as places in ``kinds``. After them
      values of networks, ``NETWORK.NAME``, NaN where there is none
    - ``kinds``: the types that are named
    - ``source``: the table as it was read
    - ``titles``: title in the source by name
    """

    columns: Mapping[str, NDArray[Any]]
    kinds: tuple[str, ...]
    source: Columns
    titles: Mapping[str, str]

    def __len__(self) -> int:
        return len(self.source)

    def place(self, row: int, name: str = "") -> str:
        """Return where the value of a column stands in the source, in words."""
        return self.source.place(row, self.titles.get(name, ""))

    def refuse(self, wrong: NDArray[np.bool_], name: str, problem: str, hint: str = "") -> None:
        """Raise ``DataError`` for the first row that is wrong; ``{}`` stands for its value."""
        if not wrong.any():
            return
        row = int(np.argmax(wrong))
        value = self.source.columns[self.titles[name]][row]
        others = int(wrong.sum()) - 1
        more = f" (and {others:,} more)" if others else ""
        said = repr(value) if isinstance(value, str) else f"{value:g}"
        raise DataError(self.place(row, name), problem.format(said) + more, hint)

    @property
    def inside(self) -> dict[str, FloatArray]:
        """Values of networks by column, (n,)."""
        return {name: x for name, x in self.columns.items() if _OF_NETWORK.fullmatch(name)}

    def content(self) -> bytes:
        """Return the table as CSV that is read back bit by bit."""
        titles = ",".join(titled(name, START_COLUMNS.get(name, "")) for name in self.columns)
        blocks = [titles.encode()]
        for start in range(0, len(self), _BLOCK):  # text takes ten times the memory of numbers
            fields = (self._texts(name, slice(start, start + _BLOCK)) for name in self.columns)
            blocks.append("\n".join(map(",".join, zip(*fields, strict=True))).encode())
        return b"\n".join(blocks) + b"\n"

    def _texts(self, name: str, rows: slice) -> list[str]:
        values = self.columns[name][rows].tolist()
        if name == "kind":
            return [self.kinds[value] for value in values]
        if name in _NAMES:
            words = {number: word for word, number in _NAMES[name].items()}
            return [words[value] for value in values]
        return list(map(repr, values))


_KNOWN: Final[WeakValueDictionary[str, Given]] = WeakValueDictionary()
"""Tables by digest, as long as a scene holds them."""


_ENTRIES: Final = ("file", "sha256", "rows", "columns", "frame", "time")


@final
@parameters
class StartTable:
    """A file with one row for each cell at the start.

    Columns are titled as exported ones are, or as a known program's, or named by ``columns``.

    ``sha256`` and ``rows`` are what a scene keeps of it: a file with another content is refused.
    """

    file: str = file_path(doc="CSV or Parquet; relative paths count from the folder of the scene")
    sha256: str | None = text(default=None, doc="digest of the file; absent: that which it has")
    rows: int | None = count(default=None, at_least=1, at_most=10**8, doc="number of cells")
    columns: str = text(
        default="",
        doc='meaning of the columns of another program, as "x=POSITION_X um, type=class"',
    )
    frame: int | None = count(
        default=None, at_least=0, doc="in tables of other programs; absent: first"
    )
    time: float | None = quantity("s", default=None, doc="in place of frame: that nearest to it")

    def check(self) -> None:
        """Read the file, unless its content is known."""
        given = None if self.sha256 is None else _KNOWN.get(self.sha256)
        if given is None:
            if self.sha256 is not None and self.rows is not None:
                return
            given = self._read()
        if self.rows is not None and self.rows != len(given):
            raise SceneError("rows", f"is {self.rows:,}, but the table has {len(given):,} rows")
        object.__setattr__(self, "rows", len(given))
        self._hold(given)

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in _ENTRIES}

    @property
    def at_hand(self) -> bool:
        """Whether the table has been read and is known."""
        return hasattr(self, "_given")

    @property
    def said(self) -> str:
        """The reading of another program's table in words; empty for multicell's own."""
        return str(getattr(self, "_said", ""))

    @property
    def given(self) -> Given:
        """Content of the table; read now if it has not been."""
        found: Given | None = getattr(self, "_given", None)
        if found is None:
            assert self.sha256 is not None
            with below("initial.cells"):
                found = _KNOWN.get(self.sha256)
                found = self._read() if found is None else found
                if len(found) != self.rows:
                    raise SceneError("rows", f"is {self.rows}, but the table has {len(found):,}")
            self._hold(found)
        return found

    def content(self) -> tuple[str, bytes]:
        """Return name and content of a file with this table, for the folder of a run."""
        if not self.file:
            return COPIES[0], self.given.content()
        content = self._bytes()
        return COPIES[content[:4] == PARQUET], content

    def _hold(self, given: Given) -> None:
        assert self.sha256 is not None
        object.__setattr__(self, "_given", _KNOWN.setdefault(self.sha256, given))

    def _read(self) -> Given:
        content = self._bytes()
        object.__setattr__(self, "sha256", hashlib.sha256(content).hexdigest())
        return normalise(from_bytes(content, Path(self.file).name))

    def _bytes(self) -> bytes:
        """Return the content of the file if it is the one that is meant."""
        if not self.file:
            problem = "is empty: the cells were given in memory, to another run or process"
            raise SceneError("file", problem, "Write them to a file and name it.")
        try:
            content = read_bytes(Path(self.file), _MAX_BYTES)
        except DataError as error:
            hint = "Relative paths count from the folder of the scene file."
            raise SceneError("file", f"'{self.file}' {error.problem}", hint) from None
        if content.startswith(b"\x89HDF\r\n\x1a\n"):  # from here on it is the table that is in it
            path = Path(self.file)
            # a point in a name says nothing of whose it is: others' annotations are left out
            own = lambda title: "." not in title and _title(title, path.name) is not None  # noqa: E731
            known = from_h5ad(path, own)
            content = normalise(from_object(known, path.name)).content()
        elif (foreign := self._foreign(content)) is not None:
            content = foreign
        if self.sha256 not in (None, hashlib.sha256(content).hexdigest()):
            problem = f"'{self.file}' is not the table that the scene was made with"
            raise SceneError("file", problem, "Leave sha256 and rows out to take it as it is now.")
        return content

    def _foreign(self, content: bytes) -> bytes | None:
        """Return the cells of another program's table as multicell writes them; None: they are."""
        from multicell.scene.foreign_cells import CellsChoice, foreign_cells

        choice = CellsChoice(self.columns, self.frame, self.time)
        try:
            found = foreign_cells(content, Path(self.file), choice)
        except DataError as error:
            if not error.place.startswith("columns"):
                raise
            problem = f"{error.place.removeprefix('columns').strip(', ')} {error.problem}".strip()
            raise SceneError("columns", problem, error.hint) from None
        if found is None:
            return None
        table, words = found
        object.__setattr__(self, "_said", words)
        return normalise(table).content()


def in_memory(source: Any) -> StartTable:
    """Return the table of cells that are given as an object.

    - ``source``: a ``DataFrame`` or a mapping of titles to columns
    """
    given = normalise(from_object(source, "cells"))
    digest = hashlib.sha256(given.content()).hexdigest()
    given = _KNOWN.setdefault(digest, given)
    return StartTable(file="", sha256=digest, rows=len(given))


def with_cells(scene: Scene, source: Any) -> Scene:
    """Return a scene that starts with the cells of a table.

    - ``scene``: all but its start
    - ``source``: path of a table, the entries of ``initial.cells`` as a mapping (``file``,
      ``columns`` ...), a ``DataFrame``, a mapping of titles to columns, or :class:`Cells`
    """
    if isinstance(source, str | Path):
        return scene.with_changes({"initial.cells": str(source)})
    if isinstance(source, Mapping) and isinstance(source.get("file"), str | Path):
        return scene.with_changes({"initial.cells": {**source, "file": str(source["file"])}})
    if isinstance(source, Cells):
        inside = inside_of(scene, source)
        source = {**_columns_of(source, tuple(scene.types)), **inside}
    table = in_memory(source)
    # the scene is checked with the table, which is known as long as it is held here
    return scene.with_changes({"initial.cells": table.__getstate__()})


def inside_of(scene: Scene, cells: Cells) -> dict[str, FloatArray]:
    """Return the values of networks in cells by title; their names are those of the scene.

    Raises SceneError if the scene has other networks than the cells.
    """
    from multicell.scene.networks import HIDDEN, network_columns

    if cells.inside is None:
        return {}
    names = network_columns(scene)
    if len(names) != cells.inside.shape[1]:
        problem = "have networks that are not those of this scene"
        raise SceneError("initial.cells", problem, "Give the frame's to_pandas() in their place.")
    pairs = zip(names, cells.inside.T, strict=True)
    return {name: values for name, values in pairs if HIDDEN not in name}


def _columns_of(cells: Cells, types: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Return the columns of cells of a start, by title; types by name where there are some."""
    found = dict(zip(("position_x", "position_y", "position_z"), cells.position.T, strict=True))
    for name in START_COLUMNS:
        column = found[name] if name in found else getattr(cells, name)
        if name in _NAMES:
            words = np.array(sorted(_NAMES[name], key=_NAMES[name].__getitem__), dtype=object)
            column = words[column]
        if name == "kind":
            column = np.array(types or [""], dtype=object)[column]
        found[name] = column
    return {titled(name, START_COLUMNS[name]): found[name] for name in START_COLUMNS}


def _title(title: str, place: str) -> Title | None:
    """Return the known title of a column, or None if nothing is known of it."""
    known = {
        **START_COLUMNS,
        **{alias: START_COLUMNS[name] for alias, name in ALIASES.items()},
        **IGNORED_COLUMNS,
    }
    if _OF_NETWORK.fullmatch(title):
        return Title(title, 1.0)
    return read_title(title, known, place)


def normalise(source: Columns) -> Given:
    """Return a table in base units and under the names of :data:`START_COLUMNS`."""
    titles: dict[str, str] = {}
    factors: dict[str, float] = {}
    for title in source.columns:
        if title.startswith((CONCENTRATION_PREFIX, INTENSITY)):
            continue
        read = _title(title, source.name)
        if read is None:
            raise unknown_title(title, START_COLUMNS, source.name)
        name = ALIASES.get(read.name, read.name)
        if name in titles:
            raise DataError(f"{source.name}, '{title}'", f"says the same as '{titles[name]}'")
        titles[name], factors[name] = title, read.factor
    made: dict[str, NDArray[Any]] = {}
    given = Given(made, (), source, titles)
    _one_frame(given)
    networks = (name for name in titles if _OF_NETWORK.fullmatch(name))
    for name in (*(name for name in START_COLUMNS if name in titles), *networks):
        raw = source.columns[titles[name]]
        if name != "kind":
            made[name] = _read_column(given, name, raw, factors[name])
    for axis in "xy":
        if f"position_{axis}" not in made:
            hint = f"Columns are titled with their units, as '{titled(f'position_{axis}', 'um')}'."
            raise DataError(source.name, f"has no column for {axis}", hint)
    if "kind" not in titles:
        return given
    kinds, codes = _kinds(source.columns[titles["kind"]])
    return Given({**made, "kind": codes} if kinds else made, kinds, source, titles)


def refuse_coinciding(given: Given, period: FloatArray | None, *, near: bool) -> None:
    """Refuse two cells at one place: between them no force has a direction.

    - ``period``: as in :func:`near_pairs`
    - ``near``: at places that differ by less than a small part of their radii, which are known to
      be those of cells; else at exactly the same one
    """
    if near:
        pairs = near_pairs(given, _COINCIDING, 0.5, period)
    else:
        place = positions(given)
        pairs = _same_places(place if period is None else wrapped(place, period))
    if len(pairs):
        first, second = sorted(pairs[np.lexsort(pairs.T)][0].tolist())
        other = given.place(first).removeprefix(f"{given.source.name}, ")
        more = len(np.unique(pairs[:, 1])) - 1
        problem = f"is at the place of {other}: their centres coincide"
        problem += f", and so do {more:,} more" if more else ""
        raise DataError(given.place(second, "position_x"), problem, "One cell has one row.")


def _same_places(place: FloatArray) -> NDArray[np.int64]:
    """Return the cells at exactly the place of an earlier one, each with the first there, (m, 2).

    Sorted, not paired: a thousand cells at one place are half a million pairs.
    """
    _, first, code = np.unique(place, axis=0, return_index=True, return_inverse=True)
    earliest = first[code.reshape(-1)]
    later = np.flatnonzero(earliest != np.arange(len(place)))
    return np.stack([earliest[later], later], axis=1)


def near_pairs(
    given: Given, part: float, usual_radius: float | FloatArray, period: FloatArray | None
) -> NDArray[np.int64]:
    """Return the pairs (m, 2) of cells nearer than a part of the sum of their radii.

    They are counted before they are listed; ``DataError`` for more than a run could work with.

    - ``usual_radius``, µm, one or (n,): of cells in a table without radii
    - ``period``, (3,) µm: lengths after which space repeats, zero where it does not; None: nowhere
    """
    from scipy.spatial import KDTree

    place = positions(given) if period is None else wrapped(positions(given), period)
    radius = given.columns.get("radius", np.full(len(given), usual_radius))
    tree, distance = KDTree(place, boxsize=period), 2.0 * part * float(radius.max())
    most = _CROWDED * len(place) + 10**5
    if (tree.count_neighbors(tree, distance) - len(place)) // 2 <= most:
        pairs = tree.query_pairs(distance, output_type="ndarray")
        first, second = pairs.T
        apart = lengths(nearest_differences(place[first], place[second], period))
        return np.asarray(pairs[apart < part * radius[pairs].sum(axis=1)])
    if radius.max() > 2.0 * radius.min():  # a few large cells among small ones, perhaps
        from multicell.mechanics import neighbours  # loads numba

        with suppress(neighbours.TooManyPairsError):
            wide = part * radius
            if period is None:
                found = neighbours.build(np.ascontiguousarray(place), wide, 0.0)
            else:
                found = neighbours.build_periodic(place, wide, period)
            if len(found) <= most:
                return found.pairs().astype(np.int64)
    problem = f"has {len(place):,} cells of which more than {most:,} pairs lie on top of each other"
    hint = "Check the units of places and radii, and whether cells stand in it twice."
    raise DataError(given.source.name, problem, hint)


def positions(given: Given) -> FloatArray:
    """Return the places of the cells, (n, 3) µm."""
    axes = (given.columns.get(f"position_{axis}", np.zeros(len(given))) for axis in "xyz")
    return np.stack(list(axes), axis=1)


def _one_frame(given: Given) -> None:
    if "frame" not in given.titles:
        return
    frames = np.unique(given.source.columns[given.titles["frame"]])
    if len(frames) > 1:
        hint = "'multicell export --frame -1' writes the last one."
        problem = f"holds {len(frames)} frames, but a run starts with one"
        raise DataError(f"{given.source.name}, '{given.titles['frame']}'", problem, hint)


def _kinds(column: NDArray[Any]) -> tuple[tuple[str, ...], NDArray[np.int64]]:
    """Return the types that a column names, and which of them each row does; none if all empty.

    Whole numbers, or digits, are the places of types in the scene.
    """
    if column.dtype.kind == "f" and np.isnan(column).all():
        return (), np.zeros(len(column), np.int64)
    words, codes = np.unique(column.astype(str), return_inverse=True)
    return tuple(map(str, words)) if "".join(words) else (), codes.astype(np.int64)


def _read_column(given: Given, name: str, raw: NDArray[Any], factor: float) -> NDArray[Any]:
    """Return a column in base units, or as numbers of its names."""
    if name in _NAMES:
        return _read_names(given, name, raw)
    title = given.titles[name]
    if raw.dtype == object:
        raw = parsed(raw.tolist())  # of numbers as text, as in a CSV file
    if raw.dtype == object:
        row = next(k for k, value in enumerate(raw) if not _number(value))
        raise DataError(given.place(row, name), f"is {raw[row][:60]!r}, must be a number")
    if name == "id":
        return _ids(given, raw)
    if name == "doomed":
        wrong = ~((raw >= 0) & (raw <= 100) & (raw == np.floor(raw)))
        given.refuse(wrong, name, "is {}, must be a whole number from 0 to 100")
        return raw.astype(np.int8)
    if _OF_NETWORK.fullmatch(name):
        given.refuse(np.isinf(raw), name, "is {}, must be a finite number")
        return raw.astype(np.float64)
    values = raw.astype(np.float64) * factor if factor != 1.0 else raw.astype(np.float64)
    missing = np.isnan(values)
    if missing.any():
        hint = f"Leave the whole column '{title}' out where values are unknown."
        if name.startswith("position"):
            hint = "Every cell has a place."
        given.refuse(missing, name, "is empty or NaN, must be a number", hint)
    unit = START_COLUMNS[name]
    largest = 10.0 * RANGES[unit][1]  # cells vary round what a scene may hold
    beyond = np.abs(values) > largest
    if name == "cycle_time":  # of cells that do not grow
        beyond &= ~np.isposinf(values)
    given.refuse(beyond, name, f"is {{}}, must be at most {largest:g} {unit} in size")
    if name in _POSITIVE:
        given.refuse(values <= 0.0, name, "is {}, must be above 0")
    if name in _NOT_NEGATIVE:
        given.refuse(values < 0.0, name, "is {}, must not be negative")
    return values


def _number(value: str) -> bool:
    try:
        float(value or "nan")
    except ValueError:
        return False
    return True


def _ids(given: Given, raw: NDArray[Any]) -> NDArray[np.int64]:
    """Return identities: whole numbers, none twice."""
    wrong = ~((raw >= 0) & (raw < MAX_IDS) & (raw == np.floor(raw)))
    problem = f"is {{}}, must be a whole number from 0 to {MAX_IDS - 1:,}"
    given.refuse(wrong, "id", problem, "Leave the column out to number cells by their rows.")
    ids = raw.astype(np.int64)
    order = np.argsort(ids, kind="stable")
    twice = np.zeros(len(ids), dtype=bool)
    twice[order[1:]] = ids[order[1:]] == ids[order[:-1]]
    given.refuse(twice, "id", "is {}, which another row has too")
    return ids


def _read_names(given: Given, name: str, raw: NDArray[Any]) -> NDArray[np.int8]:
    known = _NAMES[name]
    words, codes = np.unique(raw.astype(str), return_inverse=True)
    numbers = np.array([known.get(str(word), -1) for word in words])[codes]
    if (numbers < 0).any():
        row = int(np.argmax(numbers < 0))
        word = str(raw[row])
        raise DataError(given.place(row, name), f"is {word!r}, no {name}", near_miss(word, known))
    return numbers.astype(np.int8)


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
        hint="For example 100.",
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

    def prepare(self) -> None:
        """Refuse a number of cells in the place of their table."""
        if isinstance(self.cells, Real) and not isinstance(self.cells, bool):
            problem = f"is {shown(self.cells)}, must be a table of cells or the name of its file"
            raise SceneError("cells", problem, "The number of cells is initial.count.")

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
