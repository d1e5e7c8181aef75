"""The types of cells, and which of them take over what from which."""

from __future__ import annotations

from typing import TYPE_CHECKING

from multicell.errors import SceneError
from multicell.importing.account import Account, Fate
from multicell.importing.physicell.model import Kind, keys_of

if TYPE_CHECKING:
    from multicell.importing.xml import Element


def read_kinds(root: Element, account: Account) -> list[Kind]:
    """Return the types of cells.

    A type takes what it does not say from the one named as its ``parent_type``, else from that
    called ``default`` or with the ID 0.
    """
    elements = root.all("cell_definitions/cell_definition")
    if not elements:
        problem = "has no cell_definition: its cells are defined by C++ code, which is not read"
        raise SceneError(root.file, problem, "Such files were written before PhysiCell 1.8.")
    for element in elements:
        if not element.attributes.get("name"):
            raise element.error("has no name")
    keys = keys_of((element.attributes["name"] for element in elements), "type")
    made: list[Kind] = []
    for place, (element, key) in enumerate(zip(elements, keys, strict=True)):
        made.append(_kind(element, key, place, made))
        _account_for(made[-1], account)
    return made


def _kind(element: Element, key: str, place: int, above: list[Kind]) -> Kind:
    name, stated = element.attributes["name"], element.attributes.get("ID", str(place))
    try:
        number = int(stated)
    except ValueError:
        raise element.error(f"has the ID {stated!r}, must be a whole number") from None
    for other in above:
        if other.name == name or other.number == number:
            problem = f"has the name or ID of '{other.name}' (line {other.element.line})"
            raise element.error(problem)
    declared = element.attributes.get("parent_type", "")
    parent = next((kind for kind in above if kind.name == declared), None)
    if declared and parent is None:
        raise element.error(f"has the parent_type '{declared}', which is no type above it")
    if parent is None:
        parent = next((k for k in above if k.name == "default" or k.number == 0), None)
    return Kind(name, key, number, element, parent, bool(declared))


def _account_for(kind: Kind, account: Account) -> None:
    note = [] if kind.key == kind.name else [f"called {kind.key} here"]
    if kind.declared and kind.parent is not None:
        note.append(f"takes what it does not say from '{kind.parent.name}'")
    account.take(kind.element, Fate.MAPPED, f"types.{kind.key}", "; ".join(note), kind.name)
