"""The files that settings name: none but those of the model's own folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multicell.importing.xml import Element

_CONFIG = "config"
"""Name of PhysiCell's folder of settings; the model's folder is the one above it."""


def found_file(element: Element, home: Path) -> Path:
    """Return the file that ``folder`` and ``filename`` in an element name.

    PhysiCell runs in the folder above that of its settings, and names count from there. Settings
    may come from anybody: what they name is opened only below the model's folder, links followed.
    That is the folder above ``config``, and for settings elsewhere their own folder. Of a path on
    another machine the end counts: what is there by it below the model's folder.

    Parameters
    ----------
    home
        Folder of the settings.
    """
    folder, name = (element.find(tag) for tag in ("folder", "filename"))
    if name is None or not name.word():
        raise element.error("names no file")
    under = Path("." if folder is None else folder.word() or ".") / name.word()
    home = home.resolve()
    project = home.parent if home.name == _CONFIG else home
    moved = [project.joinpath(*under.parts[k:]) for k in range(1, len(under.parts))]
    for place in moved if under.is_absolute() and ".." not in under.parts else ():
        if _is_below(place, project) and _is_file(place):
            return place
    if under.is_absolute() or ".." in under.parts:
        problem = f"is '{under}', which is not below the folder of the model, '{project}'"
        raise name.error(problem, "Copy the file there, and name it from there.")
    places = dict.fromkeys([home.parent / under, home / under, home / name.word()])
    within = [place for place in places if _is_below(place, project)]
    for place in within:
        if _is_file(place):
            return place
    looked = " and ".join(f"'{place.parent}'" for place in within) or "no place"
    hint = f"Looked for in {looked}; what lies outside of '{project}' is not opened."
    raise name.error(f"is '{name.word()}', but there is no such file", hint)


def _is_below(path: Path, folder: Path) -> bool:
    """Return whether a path leads to below a folder, links followed."""
    try:
        return path.resolve().is_relative_to(folder)
    except (OSError, RuntimeError):  # a circle of links
        return False


def _is_file(path: Path) -> bool:
    """Return whether there is a regular file."""
    try:
        return path.is_file()
    except OSError:  # a name that the system cannot have, or a folder that may not be read
        return False
