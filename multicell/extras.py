"""Packages that only some commands need, and what to do where they are not installed."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import Final

from multicell.errors import OutputError

EXTRAS: Final = {
    "anndata": "export",
    "pandas": "export",
    "pyarrow": "export",
    "pyvista": "export",
    "xarray": "export",
    "h5netcdf": "export",
}
"""Package -> the extra of multicell that brings it."""


def needs(name: str, purpose: str) -> ModuleType:
    """Return a module of a package that not every installation has.

    Parameters
    ----------
    name
        Of the module, with dots: the first part is the package.
    purpose
        What it is wanted for, as the subject of a sentence ("an export to ParaView").

    Raises
    ------
    OutputError
        If it is not installed; it says how to install it.
    """
    package = name.partition(".")[0]
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise  # the package is there and lacks something itself
        raise OutputError(
            f"{purpose} needs the package '{package}', which is not installed. "
            f"pip install 'multicell[{EXTRAS[package]}]' brings it"
        ) from None
