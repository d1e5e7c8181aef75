"""Packages that only some commands need, and all else that there is here to run with."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Final

from multicell import __version__
from multicell.errors import MissingPackage
from multicell.host.closed import cache_folder, choose_cache
from multicell.host.memory import physical_memory

EXTRAS: Final = {
    "export": ("anndata", "h5netcdf", "pandas", "pyarrow", "pyvista", "xarray"),
    "images": ("skimage", "tifffile"),
    "movie": ("imageio_ffmpeg",),
    "networks": ("antimony", "libsbml", "sbmlode"),
    "play": ("tornado",),
    "simularium": ("simulariumio",),
    "tables": ("charset_normalizer", "openpyxl"),
}
"""What some of the optional sets of packages bring; all others are those of studies."""


def needs(*packages: str) -> None:
    """Raise an error unless some packages are installed.

    - ``packages``: names as they are imported, such as ``"pyvista"``
    """
    absent = [name for name in packages if not _there(name)]
    if absent:
        extras = [extra for extra, known in EXTRAS.items() if set(absent) <= set(known)]
        raise MissingPackage(absent, extras[0] if extras else "study")


def _there(name: str) -> bool:
    try:
        import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise  # the package is there and lacks something itself
        return False
    return True


@contextmanager
def quiet(*packages: str) -> Iterator[None]:
    """Let packages log nothing: what matters of it is said by errors and notes of our own.

    - ``packages``: names of their loggers. Those below them that there are have levels of their
      own, perhaps.
    """
    import logging

    inner = [name for name in logging.root.manager.loggerDict if name.startswith(packages)]
    loggers = [logging.getLogger(name) for name in {*packages, *inner}]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def checkup() -> dict[str, Any]:
    """Return the facts that decide speed and abilities here.

    ``system``, ``python``; ``versions`` of multicell and of what it always needs; ``cores``,
    ``threads`` that numba will use, ``memory_GiB``; ``cache`` (where compiled code is kept) and
    ``cache_writable``; ``missing``, extra -> packages of it that are not installed.
    """
    import numba

    needed, extras = _requirements()
    memory = physical_memory()
    settings: Any = numba.config
    choose_cache(vars(settings))
    cache = cache_folder(settings)
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {"multicell": __version__} | {name: _version(name) for name in needed},
        "cores": os.cpu_count() or 1,
        "threads": int(settings.NUMBA_NUM_THREADS),
        "memory_GiB": memory and round(memory / 2**30, 1),
        "cache": cache,
        "cache_writable": _writable(cache),
        "missing": {
            extra: absent
            for extra, names in extras.items()
            if (absent := [name for name in names if not _version(name)])
        },
    }


def _requirements() -> tuple[list[str], dict[str, list[str]]]:
    """Return the packages that are always needed, and those of each extra that users know."""
    from importlib import metadata

    needed: list[str] = []
    extras: dict[str, list[str]] = {name: [] for name in (*EXTRAS, "study")}
    try:
        known = metadata.requires("multicell") or []
    except metadata.PackageNotFoundError:  # used from its sources
        known = []
    for text in known:
        name = re.match(r"[\w.-]+", text)
        extra = re.search(r"extra == ['\"](\w+)['\"]", text)
        assert name is not None
        if extra is None:
            needed.append(name[0])
        elif extra[1] in extras:
            extras[extra[1]].append(name[0])
    return needed, extras


def _version(name: str) -> str:
    """Return the version of a package, or nothing if it is not installed."""
    from importlib import metadata

    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def _writable(folder: str) -> bool:
    """Return whether files can be made in a folder, or in the one that it will be made in."""
    while not os.path.isdir(folder):
        folder, before = os.path.dirname(folder), folder
        if folder == before:
            return False
    return os.access(folder, os.W_OK)
