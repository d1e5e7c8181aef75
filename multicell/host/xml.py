"""XML of others: read by Python's ``expat`` with harmful parts refused.

Nothing is expanded, fetched or executed. A document type is refused, with which entities come that
grow without bound or name files, and so is anything that is large or deep beyond any use.
"""

from __future__ import annotations

from collections.abc import Callable
from xml.parsers import expat

from multicell.errors import SceneError


def parse_xml(
    text: str,
    name: str,
    begin: Callable[[str, dict[str, str], int], None],
    end: Callable[[], None],
    characters: Callable[[str], None],
    *,
    levels: int,
    elements: int,
    separator: str | None = None,
) -> None:
    """Call functions with the parts of a document, in their order.

    - ``name``: of the file, for messages
    - ``begin``: called with tag, attributes and line of an element, ``end`` where it is closed,
      ``characters`` with pieces of its text
    - ``levels``, ``elements``: largest numbers of elements in each other and in all
    - ``separator``: between the name of a space and a tag; None: spaces are not looked at

    Raises SceneError with file and line.
    """
    parser = expat.ParserCreate(namespace_separator=separator)
    parser.buffer_text = True
    deep = seen = 0

    def refused(problem: str, hint: str = "") -> SceneError:
        return SceneError(f"{name}, line {parser.CurrentLineNumber}", problem, hint)

    def enter(tag: str, attributes: dict[str, str]) -> None:
        nonlocal deep, seen
        if deep >= levels or seen >= elements:
            raise refused("is nested too deeply, or too large")
        deep, seen = deep + 1, seen + 1
        begin(tag, attributes, parser.CurrentLineNumber)

    def leave(_: str) -> None:
        nonlocal deep
        deep -= 1
        end()

    def document_type(*_: object) -> None:
        hint = "Entities may name files or grow without bound; remove <!DOCTYPE …>."
        raise refused("has a document type, which is not read", hint)

    parser.StartElementHandler, parser.EndElementHandler = enter, leave
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = characters, document_type
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        problem = f"is not well-formed XML: {expat.errors.messages[error.code]}"
        raise SceneError(f"{name}, line {error.lineno}", problem) from None
