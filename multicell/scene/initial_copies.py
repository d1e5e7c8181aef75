"""Copies of the files that fields begin as, and their places beside a scene's file."""

from __future__ import annotations

import copy
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from multicell.errors import SceneError
from multicell.schema import Tables

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

COPIED_FIELD: Final = ".begins"
"""In the name of the copy of a field's file in the folder of a run, ``NAME.begins.npy``."""
_SUFFIXES: Final = (".npy", ".tif", ".tiff", ".png", ".csv")


def initial_files_copied(scene: Scene, folder: Path) -> tuple[Scene, dict[str, bytes]]:
    """Return a scene that names copies of its fields' files in a folder, and their content.

    The copies need not be there yet.
    """
    fields, files = dict(scene.nutrients), {}
    for name, field in scene.nutrients.items():
        if field.initial_file is None:
            continue
        suffix = Path(field.initial_file.file).suffix.lower()
        title = f"{name}{COPIED_FIELD}{suffix if suffix in _SUFFIXES else '.dat'}"
        try:
            files[title] = field.initial_file.content()
        except SceneError as error:
            path = f"nutrients.{name}.initial_file.{error.path}"
            raise SceneError(path, error.problem, error.hint) from None
        part = copy.copy(field.initial_file)  # not made anew: that would read the copy
        object.__setattr__(part, "file", os.path.abspath(folder / title))
        fields[name] = copy.copy(field)
        object.__setattr__(fields[name], "initial_file", part)
    if files:
        scene = copy.copy(scene)
        object.__setattr__(scene, "nutrients", Tables(fields))
    return scene, files


def place_initial_files(entries: dict[str, Any], source: str | Path) -> dict[str, Any]:
    """Return the entries of a scene file with the paths of its fields' files made whole."""
    fields = entries.get("nutrients")
    if not isinstance(fields, dict):
        return entries
    folder, placed = Path(os.path.expanduser(source)).parent, {}
    for name, field in fields.items():
        given = field.get("initial_file") if isinstance(field, dict) else None
        file = given.get("file") if isinstance(given, dict) else given
        placed[name] = field
        if isinstance(file, str) and file:
            whole = str(folder / os.path.expanduser(file))
            part = {**given, "file": whole} if isinstance(given, dict) else whole
            placed[name] = {**field, "initial_file": part}
    return {**entries, "nutrients": placed}
