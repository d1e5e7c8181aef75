"""Log of a comparison's measurements, on disk method by method, before anything is made of it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from operator import methodcaller
from pathlib import Path
from typing import Any, Final, final

from multicell.errors import OutputError, SceneError
from multicell.results.documents import Lines
from multicell.results.folder import file_errors, lock_folder, make_folder, remove, versions
from multicell.scene.scene import Scene
from multicell.studies.runs import MODEL_VERSION, canonical

LOG_FILE: Final = "measured.log"
"""File of what is measured; it is there until all files of the comparison are."""


@final
class Measurements:
    """Measurements of each method in a folder, also by processes that were ended.

    - ``lines``: its file; None where nothing is written
    - ``names``: methods whose entries are taken from it
    """

    def __init__(self, lines: Lines | None = None, names: Sequence[str] = ()) -> None:
        self._lines = lines
        entries = [] if lines is None else lines.entries[1:]
        self._known = {entry["method"]: entry for entry in entries if entry["method"] in names}

    def find(self, method: str) -> dict[str, Any] | None:
        """Return the measurements of a method; None where there are none."""
        return self._known.get(method)

    def has(self, methods: Sequence[str]) -> bool:
        """Return whether all methods were measured."""
        return all(method in self._known for method in methods)

    def add(self, method: str, **found: Any) -> None:
        """Write what was measured of a method; raises OutputError if that cannot be written."""
        if self._lines is not None:
            self._lines.append([_plain({"method": method, **found})])


@contextmanager
def open_measurements(
    output: str | Path | None,
    files: Sequence[str],
    scene: Scene,
    options: Mapping[str, Any],
    methods: Sequence[str],
    given: Sequence[Any],
    *,
    overwrite: bool,
) -> Iterator[Measurements]:
    """Open the folder of a comparison, of which nothing is measured twice; keep others out.

    - ``files``: what a comparison that comes to its end leaves in the folder
    - ``scene``, ``options``, ``methods``: all that decides its numbers; names, no two the same
    - ``given``: the methods as they were asked for: what was measured of those that are named may
      be taken from the folder; one of the user's own may have changed since

    Raises OutputError if the folder holds something else, or cannot be used.
    """
    if output is None:
        yield Measurements()
        return
    folder, names = Path(output), named_only(given)
    asked = _plain(
        {
            "model": MODEL_VERSION,
            "scene": canonical(scene),
            "versions": versions(),
            **options,
            "methods": list(methods),
            "named": names,
        }
    )
    with file_errors("use the output folder", folder):
        continued = not overwrite and (folder / LOG_FILE).is_file()
    if not continued:
        make_folder(folder, overwrite=overwrite)
    with lock_folder(folder):
        if not continued:
            remove(folder, (LOG_FILE, *files))
        lines = Lines(folder / LOG_FILE)
        if not lines.entries:
            lines.append([asked])
        there = lines.entries[0]
        other = [key for key in {**there, **asked} if there.get(key) != asked.get(key)]
        if other:
            raise OutputError(
                f"'{folder}' holds another comparison, which has not come to its end: "
                f"{', '.join(other)} differ. Choose another folder, or allow overwriting "
                "(--overwrite, overwrite=True)"
            )
        try:
            yield Measurements(lines, names)
        except SceneError:  # of input that shows itself as wrong when the reference is known
            if len(Lines(folder / LOG_FILE).entries) == 1:
                remove(folder, [LOG_FILE])
            raise
        remove(folder, [LOG_FILE])


def named_only(methods: Sequence[Any]) -> list[Any]:
    """Return those of some methods that are named, and so the package's own."""
    return [method for method in methods if isinstance(method, str) and ":" not in method]


def _plain(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return an entry as it comes back from its line; NaN and infinity stay what they are."""
    found: dict[str, Any] = json.loads(json.dumps(entry, default=methodcaller("item")))
    return found
