"""Files that a scene names: beside its own file, and as copies in the folder of a run."""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from multicell.schema import Tables, below

if TYPE_CHECKING:
    from multicell.scene.initial_files import InitialFile
    from multicell.scene.networks import CellNetwork
    from multicell.scene.scene import Scene

_T = TypeVar("_T")
_Part = TypeVar("_Part", "CellNetwork", "InitialFile")

COPIED_NETWORK: Final = ".network"
"""In the name of the copy of a network's file in the folder of a run, ``NAME.network.ant``."""
COPIED_FIELD: Final = ".begins"
"""In the name of the copy of a field's file in the folder of a run, ``NAME.begins.npy``."""
_SUFFIXES: Final = (".npy", ".tif", ".tiff", ".png", ".csv")
_NAMED: Final = ("initial.cells", "networks.*.file", "nutrients.*.initial_file")
"""Keys that name files; a star stands for all names."""


def place_files(entries: dict[str, Any], source: str | Path) -> dict[str, Any]:
    """Return the entries of a scene file with the paths of the files that it names made whole.

    They count from the folder of the scene's file ``source``; what names no file stays as it is.
    """
    for key in _NAMED:
        entries = _placed(entries, key.split("."), source)
    return entries


def _placed(given: Any, keys: Sequence[str], source: str | Path) -> Any:
    """Return a table in which the files below a path of keys have whole paths."""
    if not keys:
        return _whole(given, source)
    if not isinstance(given, dict):
        return given
    names = given.keys() if keys[0] == "*" else given.keys() & {keys[0]}
    return {k: _placed(x, keys[1:], source) if k in names else x for k, x in given.items()}


def _whole(given: Any, source: str | Path) -> Any:
    """Return the name of a file, or a table with one as ``file``, with the path made whole."""
    file = given.get("file") if isinstance(given, dict) else given
    if not isinstance(file, str) or not file:
        return given
    try:
        whole = str(Path(os.path.expanduser(source)).parent / os.path.expanduser(file))
    except (OSError, ValueError):
        return given  # whoever reads it will say what is wrong
    return {**given, "file": whole} if isinstance(given, dict) else whole


def files_copied(scene: Scene, folder: Path) -> tuple[Scene, dict[str, bytes]]:
    """Return a scene that names copies of the files of its networks and fields, and their content.

    The copies need not be in the folder yet.
    """
    networks, fields, files = dict(scene.networks), dict(scene.nutrients), dict[str, bytes]()

    def copied(part: _Part, title: str, path: str) -> _Part:
        with below(path):
            files[title] = part.content()
        return _altered(part, file=os.path.abspath(folder / title))

    for name, part in scene.networks.items():
        if part.file is not None:
            title = f"{name}{COPIED_NETWORK}{part.document.suffix}"
            networks[name] = copied(part, title, f"networks.{name}")
    for name, field in scene.nutrients.items():
        if field.initial_file is not None:
            suffix = Path(field.initial_file.file).suffix.lower()
            title = f"{name}{COPIED_FIELD}{suffix if suffix in _SUFFIXES else '.dat'}"
            file = copied(field.initial_file, title, f"nutrients.{name}.initial_file")
            fields[name] = _altered(field, initial_file=file)
    if files:
        scene = _altered(scene, networks=Tables(networks), nutrients=Tables(fields))
    return scene, files


def _altered(part: _T, **values: Any) -> _T:
    """Return a part of a scene with other values, unchecked.

    It is not made anew: that would read files which need not be there yet.
    """
    part = copy.copy(part)
    for name, value in values.items():
        object.__setattr__(part, name, value)
    return part
