"""A model of another program as a scene, with its cells and an account of what became of all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from numpy.typing import NDArray

from multicell.errors import OutputError
from multicell.importing.account import MEANING, Entry, Fate
from multicell.results.folder import file_errors, write_text
from multicell.scene.scene import Scene, with_units
from multicell.units import BASE_UNITS

FILES = ("scene.toml", "cells.csv", "account.md")
"""What is written of an import."""

_HEAD = ("| line | element | value | key | note |", "|---|---|---|---|---|")


@final
@dataclass(frozen=True)
class Imported:
    """A model of another program.

    Attributes
    ----------
    scene : Scene
        It starts with the cells.
    cells : title -> (n,)
        The cells at the start, as the columns of ``cells.csv``.
    entries : tuple of Entry
        What became of each thing that the model says.
    keys : nested dict
        What the scene was made of, without keys that the model says nothing of.
    """

    scene: Scene
    cells: Mapping[str, NDArray[Any]]
    entries: tuple[Entry, ...]
    keys: Mapping[str, Any]

    def __repr__(self) -> str:
        count = len(next(iter(self.cells.values()), ()))
        counts = ", ".join(f"{number} {fate}" for fate, number in self.counts().items())
        return f"<Imported {self.scene.title!r}: {count} cells; {counts}>"

    def counts(self) -> dict[str, int]:
        """Return how many entries there are of each fate."""
        found = Counter(entry.fate for entry in self.entries)
        return {fate.value: found[fate] for fate in Fate}

    def of(self, fate: Fate | str) -> list[Entry]:
        """Return the entries of one fate: "mapped", "approximated", "left out" or "off"."""
        return [entry for entry in self.entries if entry.fate == Fate(fate)]

    def write(self, folder: str | Path, *, overwrite: bool = False) -> list[Path]:
        """Write ``scene.toml``, ``cells.csv`` and ``account.md`` to a folder; return their paths.

        Raises
        ------
        OutputError
            If one of them exists and ``overwrite`` is not set, or the folder cannot be written.
        """
        place = Path(folder)
        paths = [place / name for name in FILES]
        with file_errors("use", place):
            place.mkdir(parents=True, exist_ok=True)
            there = [path for path in paths if path.exists() or path.is_symlink()]
        if there and not overwrite:
            raise OutputError(f"'{there[0]}' exists already: name another folder or overwrite it")
        for path, text in zip(paths, (self._toml(), self._csv(), self.account()), strict=True):
            write_text(path, text)
        return paths

    def _toml(self) -> str:
        """Return the scene with what the model says, and the table of cells beside it."""
        import tomli_w

        head = f"# A scene of multicell\n# units: {BASE_UNITS}\n"
        given = {**self.keys, "initial": {"cells": "cells.csv"}}
        ordered = {name: given[name] for name in self.scene.to_dict() if name in given}
        return head + with_units(self.scene, tomli_w.dumps(ordered))

    def _csv(self) -> str:
        assert self.scene.initial.cells is not None
        return self.scene.initial.cells.given.content().decode()

    def account(self) -> str:
        """Return what became of all as a page of Markdown."""
        parts = [f"# {self.scene.title}"]
        for fate in Fate:
            rows = self.of(fate)
            parts.append(f"## {fate.value.capitalize()}: {len(rows)}\n\nWhat {MEANING[fate]}.")
            parts.append("\n".join([*_HEAD, *map(_row, rows)]))
        return "\n\n".join(parts) + "\n"


def _row(entry: Entry) -> str:
    line = "" if entry.line is None else str(entry.line)
    cells = (line, entry.path, entry.value, entry.key, entry.note)
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
