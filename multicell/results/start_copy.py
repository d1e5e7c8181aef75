"""A copy of the table of the cells at the start, in the folder of what starts with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from multicell.results.folder import write_bytes
from multicell.scene.scene import Scene


def with_copy(scene: Scene, folder: Path) -> Scene:
    """Return a scene that names a copy of its table in a folder; it is written if not there.

    A scene without a table is returned as it is.
    """
    table = scene.initial.cells
    if table is None:
        return scene
    name, content = table.content()
    path = folder / name
    if not path.is_file() or path.read_bytes() != content:
        write_bytes(path, content)
    return replace(scene, initial=replace(scene.initial, cells=replace(table, file=str(path))))
