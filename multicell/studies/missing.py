"""Packages that only studies need: whether they are there, and what to do if not."""

from __future__ import annotations

from importlib.util import find_spec

from multicell.errors import MissingPackage


def needs(*packages: str) -> None:
    """Refuse to go on without some packages.

    Parameters
    ----------
    packages
        Names as they are imported, such as ``"distributed"`` or ``"xarray"``.

    Raises
    ------
    MissingPackage
        If one of them is not installed; the text says how to install them all.
    """
    absent = [name for name in packages if find_spec(name) is None]
    if absent:
        raise MissingPackage(absent, "study")
