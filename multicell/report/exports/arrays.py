"""Cells and fields as netCDF files, and for ParaView as VTK's with the list of their times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree

from multicell.report.tables import Frames
from multicell.results.tables import blocks, frame_arrays

if TYPE_CHECKING:
    from multicell.report.result import Result

_ENDINGS: Final = {"PolyData": "vtp", "ImageData": "vti", "UnstructuredGrid": "vtu"}


def write_netcdf(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write the history and each frame into files of their own and return the names."""
    names = ["history.nc"]
    run.to_xarray().to_netcdf(folder / names[0], engine="h5netcdf")
    for number, frame in frames():
        names.append(f"frame-{number:04d}.nc")
        arrays = frame_arrays(frame, tuple(run.scene.types))
        arrays.to_netcdf(folder / names[-1], engine="h5netcdf")
    return names


def write_vtk(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write frames and their index into a folder and return the names of the files."""
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(root, "Collection")
    names = ["run.pvd"]
    for number, frame in frames():
        parts = blocks(frame, tuple(run.scene.types))
        for part, name in enumerate(parts.keys()):
            data: Any = parts[name]
            names.append(f"{name}-{number:04d}.{_ENDINGS[type(data).__name__]}")
            data.save(folder / names[-1])
            known = {"timestep": repr(float(frame.time)), "part": str(part), "name": name}
            ElementTree.SubElement(collection, "DataSet", known | {"file": names[-1]})
    ElementTree.indent(root)
    path = folder / names[0]
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return names
