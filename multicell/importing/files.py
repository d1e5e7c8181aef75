"""Reading the files of other programs: regular ones of a reasonable size."""

from __future__ import annotations

import csv
from pathlib import Path

from multicell.errors import SceneError
from multicell.host import files

_MAX_BYTES = 100_000_000


def read_text(path: Path) -> str:
    """Return the text of a file."""
    name = str(path)
    try:
        return files.read_text(path, _MAX_BYTES)
    except FileNotFoundError:
        raise SceneError("", f"there is no file '{name}'") from None
    except UnicodeDecodeError as error:
        raise SceneError("", f"'{name}' is not UTF-8 text (byte {error.start})") from None
    except OSError as error:
        raise SceneError("", f"'{name}' cannot be read: {error.strerror}") from None


def read_rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return the rows of a CSV file that hold something, each with the number of its line."""
    rows = []
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        try:
            row = [word.strip() for word in next(csv.reader([line]), [])]
        except csv.Error as error:
            raise SceneError(f"{path.name}, line {number}", f"is no row of CSV: {error}") from None
        if any(row):
            rows.append((number, row))
    return rows
