"""XML as a tree whose elements know their line; nothing is expanded, fetched or executed.

Python's parser ``expat`` with what can do harm refused: a document type, with which entities come
that grow without bound or name files, and anything that is large or deep beyond any use.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import final
from xml.parsers import expat

from multicell.errors import SceneError
from multicell.importing.files import read_text
from multicell.schema import Bounds

_MAX_DEPTH = 50
_MAX_ELEMENTS = 1_000_000


@final
@dataclass(eq=False)
class Element:
    """An element: its tag, what it holds, and where it stands.

    Attributes
    ----------
    path : str
        Tags from below the root, with the name of those that have one: ``a/b[name]/c``.
    file : str
        Name of the file, for errors.
    line : int
    """

    tag: str
    attributes: dict[str, str]
    path: str
    file: str
    line: int
    text: str = ""
    children: list[Element] = field(default_factory=list)

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

    def error(self, problem: str, hint: str = "") -> SceneError:
        """Return the error of what stands here."""
        return SceneError(f"{self.file}, line {self.line}, {self.path}", problem, hint)

    def word(self) -> str:
        """Return its text without blanks and marks of direction at both ends."""
        return self.text.strip().strip("\u200b\u202a\u202c\ufeff")

    def number(
        self,
        *,
        above: float | None = None,
        at_least: float | None = None,
        at_most: float | None = None,
    ) -> float:
        """Return its text as a finite number within bounds; SceneError otherwise."""
        try:
            value = float(self.word())
        except ValueError:
            raise self.error(f"is {self.word()[:60]!r}, must be a number") from None
        if not math.isfinite(value):
            raise self.error(f"is {self.word()[:60]!r}, must be a finite number")
        bounds = Bounds(above, at_least, at_most)
        if not bounds.contain(value):
            raise self.error(f"is {self.word()}, must be {bounds.words()}")
        return value

    def whole(self, attribute: str) -> int:
        """Return an attribute as a whole number from 0 on; SceneError otherwise."""
        stated = self.attributes.get(attribute, "")
        if not stated.isdecimal():
            raise self.error(f"has the {attribute} {stated!r}, must be a whole number")
        return int(stated)

    def flag(self) -> bool:
        """Return whether its text says yes."""
        return _yes(self.word())

    def says(self, attribute: str) -> bool:
        """Return whether an attribute says yes; an absent one does not."""
        return _yes(self.attributes.get(attribute, ""))


def _yes(text: str) -> bool:
    """Return whether a text begins as true, yes or 1 do; the rest is not read."""
    return text[:1] in ("1", "t", "T", "y", "Y")


def read_xml(path: Path) -> Element:
    """Return the root element of an XML file."""
    parser, tree = expat.ParserCreate(), _Tree(path.name)
    tree.listen(parser)
    try:
        parser.Parse(read_text(path), True)
    except expat.ExpatError as error:
        problem = f"is not well-formed XML: {expat.errors.messages[error.code]}"
        raise SceneError(f"{path.name}, line {error.lineno}", problem) from None
    assert tree.root is not None
    return tree.root


@final
class _Tree:
    """The elements as the parser meets them."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.root: Element | None = None
        self._open: list[Element] = []
        self._count = 0

    def listen(self, parser: expat.XMLParserType) -> None:
        """Have the parser call this object."""
        self._parser = parser
        parser.buffer_text = True
        parser.StartElementHandler = self._begin
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters
        parser.StartDoctypeDeclHandler = self._document_type

    def _begin(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        line = self._parser.CurrentLineNumber
        if len(self._open) >= _MAX_DEPTH or self._count > _MAX_ELEMENTS:
            raise SceneError(f"{self.file}, line {line}", "is nested too deeply, or too large")
        name = attributes.get("name", attributes.get("ID", attributes.get("index", "")))
        title = f"{tag}[{name}]" if name else tag
        above = self._open[-1].path if len(self._open) > 1 else ""
        path = f"{above}/{title}" if above else title
        made = Element(tag, attributes, path, self.file, line)
        if self._open:
            self._open[-1].children.append(made)
        else:
            self.root = made
        self._open.append(made)

    def _end(self, tag: str) -> None:
        self._open.pop()

    def _characters(self, text: str) -> None:
        self._open[-1].text += text

    def _document_type(self, *_: object) -> None:
        place = f"{self.file}, line {self._parser.CurrentLineNumber}"
        hint = "Entities may name files or grow without bound; remove <!DOCTYPE …>."
        raise SceneError(place, "has a document type, which is not read", hint)
