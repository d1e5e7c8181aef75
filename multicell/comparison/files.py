"""The folder of a comparison: tables, pictures, and a page that holds the pictures."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from multicell.results.folder import file_errors, make_folder, remove, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from multicell.scene.scene import Scene

Row = dict[str, Any]
"""One row of a table: column -> value."""

DONE, FAILED, SKIPPED = "done", "failed", "skipped"
"""How a solve went."""

CLOCKS: Final = {"wall": "wall time", "cpu": "processor time"}
"""Column of the table that may judge -> what it is."""


def prepare(output: str | Path | None, names: Iterable[str], overwrite: bool) -> None:
    """Make sure that results can be written, before they are computed; without output do nothing.

    Parameters
    ----------
    output
        The folder.
    names
        Files of an earlier comparison, which are removed if ``overwrite``; nothing else is.
    overwrite
        Whether the folder may hold something.

    Raises
    ------
    OutputError
        If the folder cannot be used.
    """
    if output is not None:
        remove(make_folder(output, overwrite=overwrite), names)


def to_csv(rows: Sequence[Row]) -> str:
    """Return a table as CSV; NaN is written as ``nan``."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def write(
    folder: str | Path,
    scene: Scene,
    texts: Mapping[str, str],
    drawings: Mapping[str, tuple[Callable[[], Figure], str]],
    template: str,
    **context: Any,
) -> Path:
    """Write everything, and return the path of the page, ``report.html``.

    Parameters
    ----------
    folder
        Made if it is not there.
    scene
        What was compared on.
    texts
        Name of a file -> what it holds.
    drawings
        Name of a picture -> the function that draws it, and its caption.
    template, **context
        See :func:`multicell.report.html.write_page`.

    Raises
    ------
    OutputError
        If the folder cannot be written to.
    """
    from multicell.report.html import write_page

    folder = Path(folder)
    with file_errors("use the output folder", folder):
        folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        write_text(folder / name, text)
    pictures = {folder / name: drawing for name, drawing in drawings.items()}
    return write_page(folder / "report.html", template, scene=scene, pictures=pictures, **context)
