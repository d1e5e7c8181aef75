"""The account of an import: what became of each element of another program's model."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, final

if TYPE_CHECKING:
    from multicell.importing.xml import Element


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
    """One thing that the model says.

    Attributes
    ----------
    path : str
        Element, or file and line or column.
    line : int or None
        In the XML file.
    value : str
        As it stands there.
    fate : Fate
    key : str
        Of the scene, where it went to; empty where it went nowhere.
    note : str
    """

    path: str
    line: int | None
    value: str
    fate: Fate
    key: str = ""
    note: str = ""


@final
class Account:
    """The entries of an import: each element has one."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self._taken: set[Element] = set()

    def take(
        self, element: Element, fate: Fate, key: str = "", note: str = "", value: str | None = None
    ) -> None:
        """Account for an element; ValueError for one that is accounted for already.

        ``value`` stands for what its attributes say, where other elements are in it.
        """
        if element in self._taken:
            raise ValueError(f"{element.path} (line {element.line}) is accounted for twice")
        self._taken.add(element)
        value = " ".join(element.text.split())[:100] if value is None else value
        self.entries.append(Entry(element.path, element.line, value, fate, key, note))

    def take_all(
        self, elements: Iterable[Element], fate: Fate, key: str = "", note: str = ""
    ) -> None:
        """Account for all leaves of elements in one way, those aside that have an entry."""
        for element in elements:
            for leaf in element.leaves():
                if leaf not in self._taken:
                    self.take(leaf, fate, key, note)

    def leave_out(self, elements: Iterable[Element], note: str, *, acts: bool = True) -> None:
        """Account for what has no counterpart; without effect in the model it is off."""
        fate = Fate.LEFT_OUT if acts else Fate.OFF
        self.take_all(elements, fate, note=note if acts else "")

    def add(self, path: str, value: str, fate: Fate, key: str = "", note: str = "") -> None:
        """Account for what is no element: a column or a line of another file."""
        self.entries.append(Entry(path, None, value, fate, key, note))

    def close(self, root: Element) -> tuple[Entry, ...]:
        """Return all entries in the order of the file; what has none yet is left out."""
        for leaf in root.leaves():
            if leaf not in self._taken:
                empty = not (leaf.word() or leaf.attributes)
                note = "" if empty else "not known to this import"
                self.take(leaf, Fate.OFF if empty else Fate.LEFT_OUT, note=note)
        last = max((entry.line or 0 for entry in self.entries), default=0) + 1
        return tuple(sorted(self.entries, key=lambda e: last if e.line is None else e.line))
