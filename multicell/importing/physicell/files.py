"""The files that settings name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multicell.importing.xml import Element


def found_file(element: Element, home: Path) -> Path:
    """Return the file that ``folder`` and ``filename`` in an element name.

    PhysiCell runs in the folder above that of its settings, and names count from there.

    Parameters
    ----------
    home
        Folder of the settings.

    Raises
    ------
    SceneError
        If there is no such file, with where it was looked for.
    """
    folder, name = (element.find(tag) for tag in ("folder", "filename"))
    if name is None or not name.word():
        raise element.error("names no file")
    under = Path("." if folder is None else folder.word() or ".")
    places = [home.parent / under, home / under, home]
    for place in places:
        if (place / name.word()).is_file():
            return place / name.word()
    looked = " and ".join(f"'{place}'" for place in dict.fromkeys(map(str, places)))
    raise name.error(f"is '{name.word()}', but there is no such file", f"Looked for in {looked}.")
