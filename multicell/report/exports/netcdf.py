"""Histories and frames as netCDF files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from multicell.report.tables import Frames
from multicell.results.tables import frame_arrays

if TYPE_CHECKING:
    from multicell.report.result import Result


def write(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write the history and each frame into files of their own and return the names."""
    names = ["history.nc"]
    run.to_xarray().to_netcdf(folder / names[0], engine="h5netcdf")
    types = tuple(run.scene.types)
    for number, frame in frames():
        names.append(f"frame-{number:04d}.nc")
        frame_arrays(frame, types).to_netcdf(folder / names[-1], engine="h5netcdf")
    return names
