"""Copies of the files that fields begin as, and their places beside a scene's file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from multicell.errors import SceneError
from multicell.scene.own_files import altered, made_whole
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
        part = altered(field.initial_file, file=os.path.abspath(folder / title))
        fields[name] = altered(field, initial_file=part)
    return (altered(scene, nutrients=Tables(fields)) if files else scene), files


def place_initial_files(entries: dict[str, Any], source: str | Path) -> dict[str, Any]:
    """Return the entries of a scene file with the paths of its fields' files made whole."""
    fields = entries.get("nutrients")
    if not isinstance(fields, dict):
        return entries
    placed = {
        name: {**field, "initial_file": made_whole(field["initial_file"], source)}
        if isinstance(field, dict) and "initial_file" in field
        else field
        for name, field in fields.items()
    }
    return {**entries, "nutrients": placed}
