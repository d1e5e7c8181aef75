"""Packages that only some commands need: whether they are there, and what to do if not."""

from __future__ import annotations

from importlib import import_module
from typing import Final

from multicell.errors import MissingPackage

EXPORT: Final = ("anndata", "h5netcdf", "pandas", "pyarrow", "pyvista", "xarray")
"""What ``multicell[export]`` brings."""


def needs(*packages: str) -> None:
    """Refuse to go on without some packages.

    Parameters
    ----------
    packages
        Names as they are imported, such as ``"pyvista"``.

    Raises
    ------
    MissingPackage
        If one of them is not installed; the text says how to install them all.
    """
    absent = [name for name in packages if not _there(name)]
    if absent:
        raise MissingPackage(absent, "export" if set(absent) <= set(EXPORT) else "study")


def _there(name: str) -> bool:
    try:
        import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise  # the package is there and lacks something itself
        return False
    return True
