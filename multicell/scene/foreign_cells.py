"""Cells as other programs write them, as columns that a start takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import DataError, SceneError
from multicell.tables.columns import PARQUET, Columns, from_bytes, from_rows, from_titles
from multicell.tables.images import TIFF, cells_of_image
from multicell.tables.mapping import ColumnMap, like, mapped, numbers_of, parse_map
from multicell.tables.sheets import ZIP, sheet_rows
from multicell.tables.text import read_bytes, text_form
from multicell.tables.titles import split_title
from multicell.tables.writers import UNITS_BELOW, Writer, map_of, unit_word, writer_of
from multicell.units import time_text, unit_factor

_PLAIN: Final = ("x", "y", "z")
_IMAGES: Final = (".tif", ".tiff", ".png", ".jpg", ".jpeg", ".czi", ".nd2", ".lif")
_LARGEST_IMAGE: Final = 16_000_000_000  # bytes


@final
@dataclass(frozen=True)
class CellsChoice:
    """Options of a user for a table of cells.

    - ``columns``: text as of ``--columns``
    - ``frame``: value in the column of frames; None: the first
    - ``time``: s; the frame nearest to it
    """

    columns: str = ""
    frame: int | None = None
    time: float | None = None

    @property
    def given(self) -> bool:
        """Whether anything is said."""
        return bool(self.columns) or self.frame is not None or self.time is not None


def foreign_cells(content: bytes, path: Path, choice: CellsChoice) -> tuple[Columns, str] | None:
    """Return the cells of a table of another program, and in words what it was read as.

    None for a table as multicell writes them, of which nothing is said.
    """
    names, name = parse_map(choice.columns), path.name
    if content[:4] in TIFF:
        image = None
        if names.setting("image"):  # a relative path counts from the folder of the labels
            place = path.parent / Path(names.setting("image")).expanduser()
            image = read_bytes(place, _LARGEST_IMAGE), place.name
        columns, words = cells_of_image(content, name, names, choice.frame, image)
        return Columns(name, columns), words
    if path.suffix.lower() in _IMAGES:
        raise DataError(name, "is no TIFF image", "Save the labels of the cells as TIFF.")
    if content[:4] == PARQUET:
        return None if not choice.given else _read(from_bytes(content, name), names, choice, None)
    if content[:4] == ZIP:
        table = from_rows(sheet_rows(content, name, names.setting("sheet")), name)
        writer = None if names.columns else writer_of(list(table.columns))
        return _read(table, names, choice, writer)
    form = text_form(content, name)
    titles, below = from_titles(content, name, form, UNITS_BELOW)
    writer = None if names.columns else writer_of(titles)
    if not choice.given and form.plain and writer is None:
        if _PLAIN[:2] == tuple(title.lower() for title in titles[:2]):
            raise _without_units(titles, name)
        return None
    wanted = _wanted(writer, names)
    table = from_bytes(content, name, form=form, skip=len(below), wanted=wanted)
    unit = below[-1][titles.index(UNITS_BELOW[-1])] if below else ""
    try:
        return _read(table, names, choice, writer, unit)
    except DataError:
        if len(table.columns) == len(titles):
            raise
    # with all columns, so that the error names those that are there
    return _read(from_bytes(content, name, form=form, skip=len(below)), names, choice, writer, unit)


def read_cells(
    file: str | Path, columns: str = "", *, frame: int | None = None, time: float | None = None
) -> dict[str, NDArray[Any]]:
    """Read a table of cells or an image of labels as columns that a start takes.

    Parameters
    ----------
    file
        CSV, Excel, Parquet or TIFF.
    columns
        What the columns are, as of ``--columns``; for labels ``pixel`` and ``slice``, and
        ``image``, the file of the image whose mean intensities become the column ``intensity``.
    frame
        Of several; by default the first.
    time
        In place of it, s: the frame nearest to it.

    Returns
    -------
    dict
        Column by title, (cells,): ``x / um``, ``radius / um`` and so on. ``cells=`` of runs takes
        it, with columns added or without some.

    Raises
    ------
    DataError, SceneError
        For what cannot be read.
    """
    place = Path(file)
    content = read_bytes(place, _LARGEST_IMAGE)
    found = foreign_cells(content, place, CellsChoice(columns, frame, time))
    table = from_bytes(content, place.name) if found is None else found[0]
    return dict(table.columns)


def _wanted(writer: Writer | None, names: ColumnMap) -> Callable[[str], bool]:
    """Return which columns are needed: of some tables they are one in ten."""
    if not names.columns and writer is None:
        return lambda title: True
    texts = [*names.columns.values()]
    if writer is not None and not names.columns:
        texts += [text for some in writer.columns.values() for text in some]
        texts += [writer.units]
    said = like(" ".join(texts))
    return lambda title: not title or like(title) in said


def _read(
    table: Columns,
    names: ColumnMap,
    choice: CellsChoice,
    writer: Writer | None,
    below: str = "",
) -> tuple[Columns, str]:
    """Return the columns that a start takes, of one frame; ``below`` the titles is a unit."""
    if writer is not None:
        unit = _stated_unit(table, writer, below)
        names = map_of(writer, list(table.columns), unit, names, table.name)
    if names.columns:
        columns = mapped(table.columns, names, table.place, table.name)
    else:
        columns = dict(table.columns)
    table = replace(table, columns=columns)
    table, words = _of_frame(table, choice, foreign=writer is not None or bool(names.columns))
    return table, _said(table, writer, words)


def _stated_unit(table: Columns, writer: Writer, below: str) -> str:
    """Return the unit of lengths that a program's table states; empty where it states none."""
    if not writer.units:
        return ""
    if writer.units in UNITS_BELOW:
        return unit_word(below)
    words = {unit_word(str(word)) for word in np.unique(table.columns[writer.units].astype(str))}
    if len(words) > 1:
        listed = ", ".join(sorted(words))
        raise DataError(f"{table.name}, '{writer.units}'", f"has several units: {listed}")
    return words.pop()


def _of_frame(table: Columns, choice: CellsChoice, *, foreign: bool) -> tuple[Columns, str]:
    """Return the rows of one frame, without its number and time, and which it is in words."""
    by_name = {split_title(title)[0].removesuffix("_s"): title for title in table.columns}
    frames = times = None
    if "frame" in by_name:
        frames = numbers_of(table.columns[by_name["frame"]], table.place, by_name["frame"])
    if "time" in by_name:
        title = by_name["time"]
        unit = split_title(title)[1] or "s"
        factor = unit_factor(unit, "s")
        if factor is None:
            raise DataError(f"{table.name}, '{title}'", f"has the unit '{unit}', must be a time")
        times = numbers_of(table.columns[title], table.place, title) * factor
    for said, column, word in ((choice.frame, frames, "frame"), (choice.time, times, "time")):
        if said is not None and column is None:
            problem = f"chooses from {table.name}, which has no column of the {word}"
            raise SceneError(word, problem, f'Name it: columns = "{word}=TITLE".')
    if not foreign and not choice.given:
        return table, ""  # several frames of an own table are refused further on
    left = {t: c for t, c in table.columns.items() if split_title(t)[0] not in ("frame", "time")}
    key = frames if choice.time is None and frames is not None else times
    if key is None:
        return replace(table, columns=left), ""
    if choice.time is not None:
        wanted = key[np.nanargmin(np.abs(key - choice.time))]
    else:
        wanted = np.nanmin(key) if choice.frame is None else float(choice.frame)
    rows = key == wanted
    if not rows.any():
        span = f"{np.nanmin(key):g} to {np.nanmax(key):g}"
        problem = f"is {wanted:g}, which {table.name} does not have"
        raise SceneError("frame", problem, f"It has frames from {span}.")
    several = len(np.unique(key)) > 1
    lines = None if table.lines is None else table.lines[rows]
    word = f"frame {wanted:g}" if key is frames else time_text(float(wanted))
    return (
        replace(table, columns={t: c[rows] for t, c in left.items()}, lines=lines),
        f" of {word}" if several or choice.given else "",
    )


def _said(table: Columns, writer: Writer | None, words: str) -> str:
    what = f"read as {writer.name}: " if writer else "read: "
    form = table.form.words()
    return f"{table.name} {what}{len(table):,} cells{words}; µm" + (f"; {form}" if form else "")


def _without_units(titles: Sequence[str], name: str) -> DataError:
    """Return the error of a table with coordinates whose unit nobody states."""
    axes = [f"{t.lower()}={t} um" for t in titles if t.lower() in _PLAIN]
    hint = f"Title it '{titles[0].lower()}_um', or say what columns are"
    return DataError(
        f"{name}, '{titles[0]}'", "has no unit", f'{hint}: --columns "{", ".join(axes)}".'
    )
