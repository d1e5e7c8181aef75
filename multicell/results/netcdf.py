"""Data sets of xarray as files of netCDF, written as ``frames.h5`` is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from multicell.host.extras import needs
from multicell.results.hdf5 import check_readable, whole_file

if TYPE_CHECKING:
    from xarray import Dataset


def write_netcdf(
    table: Dataset, path: Path, encoding: Mapping[Any, Any] | None = None, beside: str = "part"
) -> None:
    """Write a data set as netCDF, so that the file is either the old one or complete.

    - ``encoding``, variable -> options of h5netcdf
    - ``beside``: as of :func:`multicell.results.folder.replace_by_name`

    Raises MissingPackage; OutputError if it cannot be written.
    """
    needs("xarray", "h5netcdf")
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    with whole_file(path, check_readable, beside) as target, h5netcdf.File(target, "w") as file:
        table.dump_to_store(H5NetCDFStore(file), encoding=encoding)
