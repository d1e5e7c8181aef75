"""The output folder of a run and the small files in it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import numpy as np

from multicell import __version__
from multicell.errors import OutputError

FILES: Final = (
    "scene.toml",
    "frames.h5",
    "summary.json",
    "report.html",
    "growth.png",
    "section.png",
    "fields.png",
    "profiles.png",
    "contacts.png",
    "pull.png",
)
"""Everything that multicell writes into an output folder, and all that overwriting removes."""

_PACKAGES: Final = ("numpy", "scipy", "numba", "scikit-sundae", "py-pde", "h5py")


def package_version(package: str = "multicell") -> str:
    """Return the version of a package, or ``"not installed"``."""
    if package == "multicell":
        return __version__
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def versions() -> dict[str, str]:
    """Return the versions of multicell and of the packages that decide its numbers."""
    return {name: package_version(name) for name in ("multicell", *_PACKAGES)}


@contextmanager
def words(action: str, path: Path) -> Iterator[None]:
    """Turn the system's refusal of a file into an error with words."""
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise OutputError(f"cannot {action} '{path}': {reason}") from error


def prepare_folder(folder: str | Path, *, overwrite: bool = False) -> Path:
    """Make an empty output folder, or clear an old one of multicell's own files.

    Parameters
    ----------
    folder
        Path of the folder; parents are made.
    overwrite
        Remove the files of an earlier run (:data:`FILES`, nothing else) first.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    OutputError
        If the folder is a file, holds something and may not be overwritten, or cannot be
        made or changed.
    """
    folder = Path(folder)
    with words("use the output folder", folder):
        if folder.exists() and not folder.is_dir():
            raise OutputError(f"output '{folder}' is a file, not a folder")
        folder.mkdir(parents=True, exist_ok=True)
        held = sorted(entry.name for entry in folder.iterdir())
    if held and not overwrite:
        raise OutputError(
            f"output folder '{folder}' is not empty (it holds {held[0]}"
            f"{f' and {len(held) - 1} more' if len(held) > 1 else ''}). "
            "Choose another folder, or allow overwriting (--overwrite, overwrite=True)"
        )
    for name in FILES:
        with words("remove", folder / name):
            (folder / name).unlink(missing_ok=True)
    return folder


def write_text(path: Path, text: str) -> None:
    """Write a text file so that it is either the old one or complete.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    with words("write", path):
        partial = path.with_name(path.name + ".part")
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)


def _plain(value: Any) -> Any:
    """Return a value as JSON can hold it; JSON knows no NaN or infinity, they become null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not np.isfinite(value) else value


def to_json(value: Any) -> str:
    """Return strict JSON; NumPy values become plain ones, NaN and infinity become null."""
    return json.dumps(_plain(value), indent=2, ensure_ascii=False, allow_nan=False)


def write_summary(folder: str | Path, summary: Mapping[str, Any]) -> Path:
    """Write ``summary.json`` and return its path.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    path = Path(folder) / "summary.json"
    write_text(path, to_json(summary) + "\n")
    return path
