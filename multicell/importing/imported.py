"""A model of another program as a scene, with its cells and an account of what became of all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from numpy.typing import NDArray

from multicell.errors import OutputError
from multicell.results.folder import file_errors, is_begun, write_text
from multicell.scene.scene import Scene, with_units
from multicell.units import BASE_UNITS

if TYPE_CHECKING:
    from multicell.importing.files import Element


@final
class Fate(StrEnum):
    """Possible outcomes of an element."""

    MAPPED = "mapped"
    APPROXIMATED = "approximated"
    LEFT_OUT = "left out"
    OFF = "off"


MEANING = {
    Fate.MAPPED: "says the same here",
    Fate.APPROXIMATED: "has a similar counterpart here; the note says how it differs",
    Fate.LEFT_OUT: "has no counterpart here, or none that is read",
    Fate.OFF: "has no effect in the model: disabled, zero, or overruled",
}


@final
@dataclass(frozen=True)
class Entry:
    """One thing that the model says, and what became of it."""

    path: str  # element, or file and line or column
    line: int | None  # in the XML file
    value: str  # as it stands there
    fate: Fate
    key: str = ""  # of the scene, where it went to; empty where it went nowhere
    note: str = ""


@final
class Account:
    """The entries of an import: each element has one."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self._taken: set[Element] = set()

    def take(
        self,
        element: Element | None,
        fate: Fate,
        key: str = "",
        note: str = "",
        value: str | None = None,
    ) -> None:
        """Account for an element, if there is one; ValueError if it is accounted for already.

        ``value`` stands for what its attributes say, where other elements are in it.
        """
        if element is None:
            return
        if element in self._taken:
            raise ValueError(f"{element.path} (line {element.line}) is accounted for twice")
        self._taken.add(element)
        value = " ".join(element.text.split())[:100] if value is None else value
        self.entries.append(Entry(element.path, element.line, value, fate, key, note))

    def take_all(
        self, elements: Iterable[Element | None], fate: Fate, key: str = "", note: str = ""
    ) -> None:
        """Account for all leaves of elements in one way, those aside that have an entry."""
        for element in filter(None, elements):
            for leaf in element.leaves():
                if leaf not in self:
                    self.take(leaf, fate, key, note)

    def __contains__(self, element: Element) -> bool:
        return element in self._taken

    def add(self, path: str, value: str, fate: Fate, key: str = "", note: str = "") -> None:
        """Account for what is no element: a column or a line of another file."""
        self.entries.append(Entry(path, None, value, fate, key, note))

    def in_order(self) -> tuple[Entry, ...]:
        """Return all entries in the order of the file, those of other files behind."""
        last = max((entry.line or 0 for entry in self.entries), default=0) + 1
        return tuple(sorted(self.entries, key=lambda e: last if e.line is None else e.line))


IMPORT_FILES = ("scene.toml", "cells.csv", "account.md")
"""What is written of an import."""

_HEAD = ("| line | element | value | key | note |", "|---|---|---|---|---|")


@final
@dataclass(frozen=True)
class Imported:
    """A model of another program.

    - ``scene``: it starts with the cells
    - ``cells``, title -> (n,): those at the start, as the columns of ``cells.csv``
    - ``entries``: what became of each thing that the model says
    - ``keys``: what the scene was made of, without keys that the model says nothing of
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

        Files of networks are copied beside them.

        Raises
        ------
        OutputError
            If one of them exists and ``overwrite`` is not set, or the folder cannot be written.
        """
        place = Path(folder)
        networks = {key: Path(table["file"]) for key, table in self._networks().items()}
        copies = [place / f"{key}{file.suffix}" for key, file in networks.items()]
        paths = [*(place / name for name in IMPORT_FILES), *copies]
        with file_errors("use", place):
            place.mkdir(parents=True, exist_ok=True)
            there = [path for path in paths if path.exists() or path.is_symlink()]
        assert self.scene.initial.cells is not None
        cells = self.scene.initial.cells.given.content().decode()
        with file_errors("read", place):
            models = [file.read_text(encoding="utf-8-sig") for file in networks.values()]
        texts = dict(zip(paths, (self._toml(), cells, self.account(), *models), strict=True))
        # what a process that was ended, or found its disk full, has left is no reason to refuse
        content = {path.name: text for path, text in texts.items()}
        begun = len(there) < len(paths) and is_begun(place, content)
        if there and not overwrite and not begun:
            raise OutputError(f"'{there[0]}' exists already: name another folder or overwrite it")
        for path, text in texts.items():
            write_text(path, text)
        return paths

    def _networks(self) -> Mapping[str, Any]:
        found: Mapping[str, Any] = self.keys.get("networks", {})
        return found

    def _toml(self) -> str:
        """Return the scene with what the model says, and the table of cells beside it."""
        import tomli_w

        head = f"# A scene of multicell\n# units: {BASE_UNITS}\n"
        given = {**self.keys, "initial": {**self.keys.get("initial", {}), "cells": "cells.csv"}}
        if networks := self._networks():
            beside = {key: f"{key}{Path(table['file']).suffix}" for key, table in networks.items()}
            given["networks"] = {k: {**table, "file": beside[k]} for k, table in networks.items()}
        ordered = {name: given[name] for name in self.scene.to_dict() if name in given}
        return head + with_units(self.scene, tomli_w.dumps(ordered))

    def account(self) -> str:
        """Return the account of all elements as a page of Markdown."""
        parts = [f"# {self.scene.title}"]
        for fate in Fate:
            entries, lines = self.of(fate), [*_HEAD]
            for one in entries:
                line = "" if one.line is None else str(one.line)
                cells = (line, one.path, one.value, one.key, one.note)
                lines.append(
                    f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
                )
            count = f"## {fate.value.capitalize()}: {len(entries)}"
            parts += [f"{count}\n\nWhat {MEANING[fate]}.", "\n".join(lines)]
        return "\n\n".join(parts) + "\n"
