"""Packages that only some commands need: whether they are there, and what to do if not."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Final

from multicell.errors import MissingPackage

EXTRAS: Final = {
    "export": ("anndata", "h5netcdf", "pandas", "pyarrow", "pyvista", "xarray"),
    "movie": ("imageio_ffmpeg",),
    "play": ("tornado",),
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
