"""Directives that make tables of declarations: keys of a scene, units, and observables."""

import inspect
import re
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from multicell.results.measures import OBSERVABLES
from multicell.scene.scene import Scene
from multicell.schema import Parameter, Tables
from multicell.units import LISTED

KINDS = {
    "choice": "name",
    "count": "whole number",
    "course": "number, or list of [time, number]",
    "file_path": "path of a file",
    "draws": "table of numbers by name, or of { mean, variation }",
    "flag": "true or false",
    "interval": "list of two quantities",
    "measure": "number, or text with a unit",
    "measure_points": "list of pairs",
    "moments": "list of times",
    "names": "list of names",
    "number": "number",
    "quantities": "table of quantities by name",
    "quantity": "quantity",
    "schedule": "list of [time, quantity]",
    "table": "table",
    "tables": "tables by name",
    "text": "text",
    "texts": "table of texts by name",
    "variant": "table",
    "vector": "list of three",
    "whole_numbers": "list of whole numbers",
}
"""What a value is, by the function of :mod:`multicell.schema` that declared it."""
ROLE = re.compile(r":[a-z:]+:`~?([^`]+)`")


def page() -> str:
    """Return the tables of all keys in Markdown, a section for each table of a scene."""
    return "\n\n".join(_section(Scene, ""))


def keys() -> Iterator[str]:
    """Yield the dotted path of every key that has a row, as it stands there."""
    for line in page().splitlines():
        if line.startswith("## "):
            path = line.split("`")[1].strip("[]") if "`" in line else ""
        elif line.startswith("| `"):
            yield ".".join(filter(None, (path, line.split("`")[1])))


def parts(whole: type) -> list[type]:
    """Return the classes of the tables of a scene, each once, in the order of their keys."""
    found: dict[type, None] = {}
    for field in fields(whole):
        spec: Parameter = field.metadata["parameter"]
        inner = [spec.table] if spec.table is not None else list((spec.parts or {}).values())
        for part in inner:
            found |= dict.fromkeys([part, *parts(part)])
    return list(found)


def _section(part: type, path: str, case: str = "") -> Iterator[str]:
    """Yield the section of a part, then those of the tables in it."""
    heading = f"`[{path}]`" if path else "Keys at the top of the file"
    yield f"## {heading}{case}"
    yield _about(part) if path else ""
    rows = [_row(field) for field in fields(part)]
    yield "\n".join([_cells("key", "value", "unit", "default", "allowed", "meaning"),
                     _cells(*["---"] * 6), *rows])  # fmt: skip
    for field in fields(part):
        yield from _inner(field, f"{path}.{field.name}" if path else field.name)


def _inner(field: Field[Any], path: str) -> Iterator[str]:
    """Yield the sections of the tables that a key holds."""
    spec: Parameter = field.metadata["parameter"]
    if spec.kind == "tables":
        path += ".NAME"
    if spec.table is not None:
        yield from _section(spec.table, path)
    for name, part in (spec.parts or {}).items():
        yield from _section(part, path, f" with `{spec.key} = {name!r}`".replace("'", '"'))


def _about(part: type) -> str:
    """Return the description of a part, up to its attributes."""
    text = (inspect.getdoc(part) or "").partition("\n\nAttributes\n")[0]
    return ROLE.sub(r"`\1`", text).replace("``", "`")


def _row(field: Field[Any]) -> str:
    """Return the row of a key."""
    spec: Parameter = field.metadata["parameter"]
    key = f"`{field.name}`"
    meaning = spec.doc[:1].upper() + spec.doc[1:]
    allowed = spec.allowed or (spec.kind == "tables" and " or ".join(spec.options)) or ""
    kind = KINDS.get(spec.kind, spec.kind.replace("_", " "))
    return _cells(key, kind, spec.units, _default(field), allowed, meaning)


def _default(field: Field[Any]) -> str:
    """Return the default of a key as a scene file has it."""
    spec: Parameter = field.metadata["parameter"]
    if spec.kind in {"table", "tables", "variant"}:
        if field.default is MISSING and field.default_factory is MISSING:
            return "*needed*"
        made = None if field.default_factory is MISSING else field.default_factory()
        return "absent" if made is None or isinstance(made, Tables) else "its defaults"
    if field.default is MISSING:
        return "*needed*"
    if field.default is None:
        return "absent"
    value = spec.plain(field.default)
    shown = {True: "true", False: "false"}[value] if isinstance(value, bool) else f"{value!r}"
    return f"`{shown}`".replace("'", '"')


def _cells(*texts: str) -> str:
    return "| " + " | ".join(text.replace("|", r"\|").replace("\n", " ") for text in texts) + " |"


def observables() -> str:
    """Return the table of all observables with a description, in Markdown."""
    rows = [
        _cells(
            f"`{one.name.replace('*', '<field>')}`",
            one.unit.replace("um", "µm") or "1",
            "; ".join(filter(None, (one.doc, one.absent and f"absent {one.absent}"))),
        )
        for one in OBSERVABLES
        if one.doc
    ]
    head = _cells("name in history and summary", "unit", "meaning"), _cells(*["---"] * 3)
    return "\n".join([*head, *rows])


def units() -> str:
    """Return the table of all units that are read, in Markdown."""
    head = _cells("base unit", "units that are read"), _cells(*["---"] * 2)
    rows = (_cells(f"`{base}`", ", ".join(f"`{name}`" for row in names for name in row.split()))
            for base, names in LISTED.items())  # fmt: skip
    return "\n".join([*head, *rows])


class Units(SphinxDirective):
    """Puts the table of units in its place."""

    def run(self) -> list[nodes.Node]:
        """Return it as nodes of the page."""
        return self.parse_text_to_nodes(units())


class Observables(SphinxDirective):
    """Puts the table of observables in its place."""

    def run(self) -> list[nodes.Node]:
        """Return it as nodes of the page."""
        return self.parse_text_to_nodes(observables())


class SceneKeys(SphinxDirective):
    """Puts the tables in its place."""

    def run(self) -> list[nodes.Node]:
        """Return them as nodes of the page."""
        return self.parse_text_to_nodes(page(), allow_section_headings=True)


class SceneParts(SphinxDirective):
    """Puts the classes of all tables of a scene in its place."""

    def run(self) -> list[nodes.Node]:
        """Return them as nodes of the page."""
        names = [f"{part.__module__}.{part.__name__}" for part in parts(Scene)]
        lines = [f".. autoclass:: {name}()\n   :no-members:\n" for name in names]
        text = "\n".join(["```{eval-rst}", *lines, "```"])
        return self.parse_text_to_nodes(text)


def setup(app: Sphinx) -> dict[str, bool]:
    """Tell Sphinx the directive's name."""
    app.add_directive("observables", Observables)
    app.add_directive("scene-keys", SceneKeys)
    app.add_directive("scene-parts", SceneParts)
    app.add_directive("units", Units)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
