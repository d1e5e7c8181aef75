"""SBML as it is written: whether it can be read at all, before any library touches it.

Libraries convert documents, and lose unknown parts on the way. So the document is
searched as text for what would change its meaning: fast reactions, delays, algebraic rules,
priorities, models made of others, and packages that it cannot be understood without. What is large
or deep beyond any use is refused as well: libraries recurse.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final

from multicell.errors import SceneError
from multicell.host.files import read_text_of_others
from multicell.host.xml import parse_xml

MAX_DOCUMENT: Final = 20_000_000  # the largest curated model of BioModels has half of it
_MAX_DEPTH: Final = 200  # elements in elements; annotations have up to 20, formulas 50
_MAX_ELEMENTS: Final = 500_000  # of a document, for its memory
_MAX_FORMULA: Final = 5_000  # characters of a formula of Level 1, which a library reads recursively
_MAX_QUANTITIES: Final = 20_000  # libraries search lists of them for each
_QUANTITIES: Final = ("compartment", "parameter", "localParameter", "reaction", "species")
_SBML: Final = re.compile(r"http://www\.sbml\.org/sbml/level(\d)(?:/version\d+(?:/core)?)?")
_PACKAGE: Final = re.compile(r"http://www\.sbml\.org/sbml/level3/version\d+/(\w+)/version\d+")
_MATHML: Final = "http://www.w3.org/1998/Math/MathML"
_SYMBOLS: Final = ("time", "avogadro", "rateOf")  # by their definitionURL
_YES: Final = ("true", "1")
_HARMLESS: Final = ("annot", "groups", "l3v2extendedmath", "layout", "render")
"""Packages that change nothing of what is computed, or nothing that is not read."""
_REASONS: Final = {
    "algebraicRule": ("an algebraic rule", "Solve it for a variable and write an assignment rule."),
    "delay": ("a delay", "What was the case some time ago is not stored."),
    "priority": ("an event with a priority", "Events of one time come in the document's order."),
    "fast": ("a fast reaction", "Give it a rate constant that is large beside the others."),
    "comp": ("a model made of submodels", "Flatten it first, as libSBML and COPASI do."),
    "fbc": ("flux balance analysis", "Only models with rates are read."),
    "qual": ("a qualitative (Boolean) model", "Only models with rates are read."),
}


def read_network_document(path: Path) -> str:
    """Return the text of a file of networks; SceneError with its name where it cannot be read."""
    return read_text_of_others(path, MAX_DOCUMENT)


@final
@dataclass(eq=False)
class _Search:
    """A document while it is searched.

    - ``above``: local names of the elements that are open
    - ``lacking``: what is not read -> where it stands first, and the name of the element
    - ``event``: the last one's name
    - ``hidden``: how many of the open elements are notes or annotations, which mean nothing here
    """

    name: str
    above: list[str] = field(default_factory=list)
    lacking: dict[str, tuple[int, str]] = field(default_factory=dict)
    packages: dict[str, int] = field(default_factory=dict)
    quantities: int = 0
    hidden: int = 0
    line: int = 0
    event: str = ""
    delay: list[str] | None = None  # what an open delay of an event holds

    def refuse(self, problem: str, hint: str = "") -> SceneError:
        return SceneError(f"{self.name}, line {self.line}", problem, hint)

    def note(self, what: str, who: str = "") -> None:
        self.lacking.setdefault(what, (self.line, who[:80]))

    def begin(self, tag: str, about: dict[str, str], line: int) -> None:
        self.line = line
        space, _, local = tag.rpartition(" ")
        if not self.above:
            self._root(space, local, about)
        elif local in ("annotation", "notes"):
            self.hidden += 1
        elif not self.hidden:
            self._look(space, local, about)
        self.above.append(local)

    def end(self) -> None:
        local = self.above.pop()
        if local in ("annotation", "notes"):
            self.hidden -= 1
        elif local == "delay" and self.delay is not None and not self.hidden:
            if not _is_nothing(self.delay):
                self.note("delay", self.event)
            self.delay = None

    def text(self, characters: str) -> None:
        if self.delay is not None and not self.hidden:
            self.delay.append(characters)

    def _root(self, space: str, local: str, about: dict[str, str]) -> None:
        if local != "sbml" or not _SBML.fullmatch(space):
            why = f"its first element is '{local[:60]}'"
            if local == "sbml":
                why = "it lacks the namespace of its level, as xmlns='...'"
            raise self.refuse(f"is no SBML: {why}")
        for key, value in about.items():
            package = _PACKAGE.fullmatch(key.rpartition(" ")[0])
            if package and key.endswith(" required") and value in _YES:
                self.packages.setdefault(package[1], self.line)

    def _look(self, space: str, local: str, about: dict[str, str]) -> None:
        who = about.get("id", about.get("name", ""))
        package = _PACKAGE.fullmatch(space)
        if package and package[1] not in _HARMLESS:
            self.note(package[1], who)
        self.quantities += local in _QUANTITIES
        if self.quantities > _MAX_QUANTITIES:
            raise self.refuse(
                f"has more than {_MAX_QUANTITIES:,} parameters, species and reactions"
            )
        if local == "reaction" and about.get("fast") in _YES:
            self.note("fast", who)
        elif local == "event":
            self.event = who
        elif local in ("algebraicRule", "priority"):
            self.note(local, who or self.event)
        elif local == "delay" and space != _MATHML:
            self.delay = []
        elif self.delay is not None:
            self.delay.append(f"<{local}>")
        if space == _MATHML and local == "csymbol":
            symbol = about.get("definitionURL", "").rpartition("/")[2]
            if symbol not in _SYMBOLS:
                self.note("delay" if symbol == "delay" else f"symbol {symbol[:60]}")
        if len(about.get("formula", "")) > _MAX_FORMULA:
            raise self.refuse(f"has a formula of more than {_MAX_FORMULA} characters")


def _is_nothing(delay: list[str]) -> bool:
    """Return whether the content of a delay is the number 0, as some programs write none."""
    text = "".join("".join(delay).split())
    number = text.removeprefix("<math><cn>") if text.startswith("<math><cn>") else ""
    return bool(re.fullmatch(r"0+\.?0*", number))


def check_document(text: str, name: str) -> None:
    """Refuse a document that is no SBML, or that holds what is not read, by name.

    - ``text``: the document as it is written
    - ``name``: of the file, for messages

    Raises SceneError with file and line.
    """
    search = _Search(name)
    parse_xml(
        text,
        name,
        search.begin,
        search.end,
        search.text,
        levels=_MAX_DEPTH,
        elements=_MAX_ELEMENTS,
        separator=" ",
    )
    _refuse_lacking(search)


def _refuse_lacking(search: _Search) -> None:
    for package, line in search.packages.items():
        if package not in _HARMLESS:
            search.lacking.setdefault(package, (line, ""))
    if not search.lacking:
        return
    found = sorted(search.lacking.items(), key=lambda item: item[1][0])
    words, hints = [], []
    for what, (line, who) in found:
        usual = what if " " in what else f"the package '{what}'"
        word, hint = _REASONS.get(what, (usual, ""))
        words.append(f"{word} ('{who}', line {line})" if who else f"{word} (line {line})")
        hints.append(hint)
    problem = f"has {', '.join(words)}: not read here"
    raise SceneError(search.name, problem, " ".join(filter(None, hints)))
