"""PhysiCell's settings while they are read: the types of cells, and what the scene is to say."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, final

from multicell.cells import SPHERE, stokes_drag
from multicell.errors import SceneError
from multicell.importing.imported import Account, Fate

if TYPE_CHECKING:
    from multicell.importing.files import Element
    from multicell.importing.physicell.rules import Rule
    from multicell.importing.physicell.start import Start

MINUTE = 60.0
"""Seconds."""

VISCOSITY = 5.0
"""Viscosity of the medium, kPa s: PhysiCell has none, and nothing but forces depends on it."""

_MAX_TYPES = 1000
"""Types of cells that are read; what each says of each other one grows with the square of it."""

_FROM_ZERO = ("motility/options", "secretion", "cell_interactions", "cell_transformations")
"""Parts that a type inherits from the first one only if it names that as its parent."""


@final
@dataclass(eq=False)
class CellDefinition:
    """A ``cell_definition``."""

    name: str
    key: str  # its name in the scene
    number: int  # its ID, by which tables of cells name it
    element: Element
    parent: CellDefinition | None  # from which it inherits missing parts
    declared: bool  # whether it names that parent
    count: int = 0  # cells at the start

    def own(self, path: str) -> Element | None:
        """Return an element of its own phenotype, or None."""
        return self.element.find(f"phenotype/{path}")

    def given(self, path: str) -> Element | None:
        """Return an element of its phenotype or else of its parent's, or None."""
        found = self.own(path)
        if found is not None or self.parent is None:
            return found
        if not self.declared and path.startswith(_FROM_ZERO):
            return None
        return self.parent.given(path)

    def listed(self, table: str, path: str, *, own: bool = False) -> list[Element]:
        """Return the elements at a path below one of its phenotype, or else of its parent's."""
        found = self.own(table) if own else self.given(table)
        return [] if found is None else found.all(path)

    def number_of(self, path: str, usual: float, **bounds: float) -> float:
        """Return a number of its phenotype; ``usual`` where neither it nor a parent says it."""
        found = self.given(path)
        return usual if found is None else found.number(**bounds)

    @property
    def volume(self) -> float:
        """Total volume, µm³."""
        return self.number_of("volume/total", 2494.0, above=0.0)

    @property
    def radius(self) -> float:
        """Radius of a cell of its volume, µm."""
        return math.cbrt(self.volume / SPHERE)

    @property
    def drag(self) -> float:
        """Stokes drag of such a cell, nN s/µm."""
        return stokes_drag(VISCOSITY) * self.radius


@final
@dataclass
class Model:
    """A model of PhysiCell while it is read.

    - ``kinds``: in the order of the file
    - ``scene``: as nested tables
    - ``fields``: key in the scene of each substance by its name
    - ``unit``: mM for one unit of a substance, by its name
    - ``top``: the highest concentration of a substance that the settings name, in its own unit
    - ``rules``: those that are read, with what becomes of each
    - ``needs``: the fields on which uptake and secretion of a field depend by rules
    - ``cells``: those at the start, once they are read
    """

    root: Element
    account: Account
    kinds: list[CellDefinition]
    scene: dict[str, Any] = field(default_factory=dict)
    fields: dict[str, str] = field(default_factory=dict)
    unit: dict[str, float] = field(default_factory=dict)
    top: dict[str, float] = field(default_factory=dict)
    rules: list[Rule] = field(default_factory=list)
    needs: dict[str, set[str]] = field(default_factory=dict)
    cells: Start | None = None

    @property
    def leader(self) -> CellDefinition:
        """The type of which there are most cells at the start; it decides what types share."""
        return max(self.kinds, key=lambda kind: kind.count)

    def kind_named(self, name: str) -> CellDefinition | None:
        """Return the type of a name, or None."""
        return next((kind for kind in self.kinds if kind.name == name), None)

    def part(self, *path: str) -> dict[str, Any]:
        """Return a table of the scene, made if it is not there."""
        node = self.scene
        for name in path:
            node = node.setdefault(name, {})
        return node

    def of_type(self, kind: CellDefinition, name: str, value: Any) -> None:
        """Set a key of a type; in a scene of one type there are no types to set it for."""
        if len(self.kinds) > 1:
            self.part("types", kind.key)[name] = value


def keys_of(names: Iterable[str], prefix: str) -> list[str]:
    """Return names of letters, digits and ``_`` for names of any kind, no two alike."""
    made: dict[str, int] = {}  # and the number that the next name like it gets
    for name in names:
        key = re.sub(r"\W+", "_", name.strip(), flags=re.ASCII).strip("_")
        if not key or key[0].isdigit():
            key = f"{prefix}_{key}".rstrip("_")
        first, number = key, made.get(key, 2)
        while key in made:
            key, number = f"{first}_{number}", number + 1
        made[first], made[key] = number, made.get(key, 2)
    return list(made)


def read_kinds(root: Element, account: Account) -> list[CellDefinition]:
    """Return the types of cells.

    A type inherits missing parts from the one named as its ``parent_type``, else from that
    called ``default`` or with the ID 0.
    """
    elements = root.all("cell_definitions/cell_definition")
    if not elements:
        problem = "has no cell_definition: its cells are defined by C++ code, which is not read"
        raise SceneError(root.file, problem, "Such files were written before PhysiCell 1.8.")
    if len(elements) > _MAX_TYPES:
        raise elements[_MAX_TYPES].error(f"is one of more than {_MAX_TYPES} types of cells")
    for element in elements:
        if not element.attributes.get("name"):
            raise element.error("has no name")
    keys = keys_of((element.attributes["name"] for element in elements), "type")
    made: list[CellDefinition] = []
    for place, (element, key) in enumerate(zip(elements, keys, strict=True)):
        kind = _kind(element, key, place, made)
        note = [] if key == kind.name else [f"called {key} here"]
        if kind.declared and kind.parent is not None:
            note.append(f"inherits missing parts from '{kind.parent.name}'")
        account.take(element, Fate.MAPPED, f"types.{key}", "; ".join(note), kind.name)
        made.append(kind)
    return made


def _kind(element: Element, key: str, place: int, above: list[CellDefinition]) -> CellDefinition:
    name = element.attributes["name"]
    number = element.whole("ID") if "ID" in element.attributes else place
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
    return CellDefinition(name, key, number, element, parent, bool(declared))
