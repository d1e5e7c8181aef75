"""Read files of other programs: CSV and XML, regular ones of a reasonable size.

XML becomes a tree whose elements know their line; it is read by :mod:`multicell.host.xml`.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import final

from multicell.errors import SceneError
from multicell.host.files import read_text_of_others
from multicell.host.xml import parse_xml
from multicell.schema import Bounds
from multicell.units import whole_number

_MAX_BYTES = 100_000_000  # of a file: it bounds memory and time of reading


def read_rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return the rows of a CSV file that hold something, each with the number of its line."""
    rows = []
    for number, line in enumerate(read_text_of_others(path, _MAX_BYTES).split("\n"), start=1):
        try:
            row = [word.strip() for word in next(csv.reader([line]), [])]
        except csv.Error as error:
            raise SceneError(f"{path.name}, line {number}", f"is no row of CSV: {error}") from None
        if any(row):
            rows.append((number, row))
    return rows


_MAX_DEPTH = 50  # levels of elements; settings of PhysiCell have eight
_MAX_ELEMENTS = 200_000  # the largest models of PhysiCell have some thousand
_MAX_NAME = 80  # characters of a tag or a name that places in messages and accounts show
_YES = ("1", "t", "T", "y", "Y")
"""How true, yes and 1 begin; the rest is not read."""


def shortened(text: str, most: int) -> str:
    """Return a text, or its beginning and a mark where it is longer than ``most`` characters."""
    return text if len(text) <= most else f"{text[:most]}…"


@final
@dataclass(eq=False, slots=True)
class Element:
    """An element: its tag, content and place."""

    tag: str
    attributes: dict[str, str]
    file: str
    line: int
    above: Element | None
    text: str = ""
    children: list[Element] = field(default_factory=list)
    _off: bool | None = None

    @property
    def path(self) -> str:
        """Its place: tags from below the root, with names of those that have one: a/b[name]/c."""
        about = self.attributes
        name = shortened(about.get("name", about.get("ID", about.get("index", ""))), _MAX_NAME)
        own = shortened(self.tag, _MAX_NAME) + (f"[{name}]" if name else "")
        return own if self.above is None or self.above.above is None else f"{self.above.path}/{own}"

    def all(self, path: str) -> list[Element]:
        """Return the elements at a path of tags below this one."""
        found = [self]
        for tag in path.split("/"):
            found = [child for one in found for child in one.children if child.tag == tag]
        return found

    def find(self, path: str) -> Element | None:
        """Return the first element at a path of tags below this one, or None."""
        return next(iter(self.all(path)), None)

    def leaves(self) -> Iterator[Element]:
        """Yield the elements that hold no other ones, in their order."""
        if not self.children:
            yield self
        for child in self.children:
            yield from child.leaves()

    @property
    def tags(self) -> str:
        """Its path by tags alone, from below the root."""
        higher = "" if self.above is None or self.above.above is None else f"{self.above.tags}/"
        return f"{higher}{self.tag}"

    def is_off(self) -> bool:
        """Return whether it, or what it stands in, is disabled by an attribute or an element."""
        if self._off is None:  # looked for once: each of many children asks
            switches = [one for one in self.children if one.tag in ("enable", "enabled")]
            off = "enabled" in self.attributes and not self.says("enabled")
            off = off or any(not one.flag() for one in switches)
            self._off = off or (self.above is not None and self.above.is_off())
        return self._off

    def error(self, problem: str, hint: str = "") -> SceneError:
        """Return the error of what stands here."""
        return SceneError(f"{self.file}, line {self.line}, {self.path}", problem, hint)

    def word(self) -> str:
        """Return its text without blanks and marks of direction at both ends."""
        return self.text.strip().strip("\u200b\u202a\u202c\ufeff")

    def number_at(self, path: str, usual: float, **bounds: float) -> float:
        """Return a number below this element; ``usual`` where there is none."""
        found = self.find(path)
        return usual if found is None or not found.word() else found.number(**bounds)

    def number(self, **bounds: float) -> float:
        """Return its text as a finite number within :class:`Bounds`; SceneError otherwise."""
        try:
            value = float(self.word())
        except ValueError:
            raise self.error(f"is {self.word()[:60]!r}, must be a number") from None
        if not math.isfinite(value):
            raise self.error(f"is {self.word()[:60]!r}, must be a finite number")
        wanted = Bounds(**bounds)
        if not wanted.contain(value):
            raise self.error(f"is {self.word()[:60]}, must be {wanted.words()}")
        return value

    def whole(self, attribute: str) -> int:
        """Return an attribute as a whole number from 0 on; SceneError otherwise."""
        stated = self.attributes.get(attribute, "")
        number = whole_number(stated)
        if number is None:
            raise self.error(
                f"has the {attribute} {stated[:60]!r}, must be a whole number below 2^63"
            )
        return number

    def flag(self) -> bool:
        """Return whether its text says yes."""
        return self.word()[:1] in _YES

    def says(self, attribute: str) -> bool:
        """Return whether an attribute says yes; an absent one does not."""
        return self.attributes.get(attribute, "")[:1] in _YES


def read_xml(path: Path) -> Element:
    """Return the root element of an XML file."""
    elements, above = list[Element](), list[Element]()
    pieces: list[list[str]] = []  # of the texts of elements that are open

    def begin(tag: str, attributes: dict[str, str], line: int) -> None:
        made = Element(tag, attributes, path.name, line, above[-1] if above else None)
        elements.append(made)
        if above:
            above[-1].children.append(made)
        above.append(made)
        pieces.append([])

    def end() -> None:
        above.pop().text = "".join(pieces.pop())

    def characters(text: str) -> None:
        pieces[-1].append(text)

    text = read_text_of_others(path, _MAX_BYTES)
    parse_xml(text, path.name, begin, end, characters, levels=_MAX_DEPTH, elements=_MAX_ELEMENTS)
    return elements[0]


_CONFIG = "config"
"""Name of PhysiCell's folder of settings; the model's folder is the one above it."""


def found_file(element: Element, home: Path, tag: str = "filename") -> Path:
    """Return the file that ``folder`` and ``filename`` in an element name.

    PhysiCell runs in the folder above that of its settings, and names count from there. Settings
    may come from anybody: what they name is opened only below the model's folder, links followed.
    That is the folder above ``config``, and for settings elsewhere their own folder. Of a path on
    another machine the end counts: what is there by it below the model's folder.

    - ``home``: folder of the settings
    - ``tag``: what names the file
    """
    folder, name = (element.find(each) for each in ("folder", tag))
    if name is None or not name.word():
        raise element.error("names no file")
    under = Path("." if folder is None else folder.word() or ".") / name.word()
    home = home.resolve()
    project = home.parent if home.name == _CONFIG else home
    ends = [project.joinpath(*under.parts[k:]) for k in range(1, len(under.parts))]
    usual = [home.parent / under, home / under, home / name.word()]
    places = ends if under.is_absolute() else [*usual, *ends]  # ends: from PhysiCell's root
    for place in places:
        if _is_file_below(place, project):
            return place
    hint = f"Looked for in '{project}', links followed; what lies outside of it is not opened."
    raise name.error(f"is '{under}', but there is no such file", hint)


def elsewhere(element: Element, home: Path, path: Path) -> str:
    """Return in words where a file was found, if not where PhysiCell looks for it; else nothing.

    - ``home``: folder of the settings
    - ``path``: of the file, from :func:`found_file`
    """
    folder, name = (element.find(each) for each in ("folder", "filename"))
    assert name is not None
    home = home.resolve()
    under = Path("." if folder is None else folder.word() or ".") / name.word()
    if path.resolve() == (home.parent / under).resolve():
        return ""
    project = home.parent if home.name == _CONFIG else home
    return f"not there; taken from '{path.resolve().relative_to(project)}'"


def _is_file_below(path: Path, folder: Path) -> bool:
    """Return whether a path leads to a regular file below a folder, links followed."""
    try:
        found = path.resolve(strict=True)
        return found.is_relative_to(folder) and found.is_file()
    except (OSError, RuntimeError):  # no file, a circle of links, or a name that none can have
        return False
