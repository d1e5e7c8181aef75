"""Cells and fields for ParaView: VTK's XML files, and the list of when each of them was."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree

from multicell.report.tables import Frames
from multicell.results.tables import blocks

if TYPE_CHECKING:
    from multicell.report.result import Result

INDEX: Final = "run.pvd"


def write(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write frames and their index into a folder and return the names of the files."""
    index: list[tuple[float, int, str, str]] = []
    for number, frame in frames():
        parts = blocks(frame, tuple(run.scene.types))
        for part, name in enumerate(parts.keys()):
            data: Any = parts[name]
            file = f"{name}-{number:04d}.{_ENDINGS[type(data).__name__]}"
            data.save(folder / file)
            index.append((frame.time, part, name, file))
    _write_index(folder / INDEX, index)
    return [INDEX, *(file for *_, file in index)]


_ENDINGS: Final = {"PolyData": "vtp", "ImageData": "vti", "UnstructuredGrid": "vtu"}


def _write_index(path: Path, entries: Sequence[tuple[float, int, str, str]]) -> None:
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(root, "Collection")
    for time, part, name, file in entries:
        known = {"timestep": repr(float(time)), "part": str(part), "name": name, "file": file}
        ElementTree.SubElement(collection, "DataSet", known)
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
