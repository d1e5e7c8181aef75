"""The export of a run: which formats there are, and files that are there whole or not at all."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Final, final

from multicell.errors import OutputError
from multicell.host.extras import needs
from multicell.host.interrupts import UNCUT
from multicell.report.result import Result, load_result
from multicell.report.tables import TABLES
from multicell.results.folder import file_errors, put_in_place, sync_file
from multicell.results.frame import Frame
from multicell.schema import near_miss


@final
@dataclass(frozen=True)
class Format:
    """A format of exported files.

    - ``function``: ``module.name`` in the room ``report``: ``write(run, frames, folder)``, with
      ``tables`` as well where there are any, writes into a folder and returns the names;
      ``frames()`` gives frames with their numbers
    """

    function: str
    files: Sequence[str]  # that are written in any case, "{table}" stands for each table
    packages: Sequence[str] = ()  # that write it, beside those of every installation
    tables: bool = False  # whether there is one file for each table, out of which a user may choose


FORMATS: Final = {
    "csv": Format("tables.write_csv_files", ["{table}.csv"], tables=True),
    "parquet": Format("tables.write_parquet", ["{table}.parquet"], ["pyarrow"], tables=True),
    "vtk": Format("exports.formats.write_vtk", ["run.pvd"], ["pyvista"]),
    "anndata": Format("exports.formats.write_anndata", ["cells.h5ad"], ["anndata"]),
    "netcdf": Format("exports.formats.write_netcdf_files", ["history.nc"], ["xarray", "h5netcdf"]),
    "openvt": Format("exports.formats.write_openvt", ["openvt.csv"]),
    "page": Format("viewer.pack.write_view", ["view.html"]),
    "simularium": Format(
        "exports.simularium.write_simularium", ["cells.simularium"], ["simulariumio"]
    ),
    "ro-crate": Format("exports.formats.write_crate", ["ro-crate-metadata.json"]),
}
"""Formats by name."""
_SUFFIXES: Final = {Path(name).suffix for one in FORMATS.values() for name in one.files}


def export(
    result: Result | str | Path,
    output: str | Path,
    *,
    format: str = "csv",
    tables: Sequence[str] | None = None,
    frame: int | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write a run as files that other programs read.

    ``"csv"`` and ``"parquet"`` have a file for each table: ``lineage`` one row for every cell that
    ever was (:meth:`Lineage.table`), ``history`` one for each coupling step, ``cells`` and
    ``contacts`` one for each cell and each pair in contact in each frame. Where a run does not
    count its contacts (:attr:`Frame.contacts`), pairs whose spheres overlap are taken. A column
    with a dimension ends in its unit (``position_x_um``), and a number that does not exist, such as
    the viable rim without a core, is left empty.

    ``"vtk"`` is for ParaView: ``run.pvd`` names the cells (``cells-0000.vtp``, points with all that
    is known of them) and the fields (``oxygen-0000.vti``; shells as ``.vtu``) of each frame.

    ``"anndata"`` is for scverse: ``cells.h5ad`` with one observation for each cell in each frame,
    coordinates in ``obsm["spatial"]`` and contacts in ``obsp["spatial_connectivities"]``.

    ``"netcdf"`` has the history in ``history.nc`` and each frame, cells and fields, in
    ``frame-0000.nc``.

    ``"openvt"`` has the tables that OpenVT's frameworks exchange: ``openvt.csv`` with a row for
    each cell in each frame, lengths in diameters of a newborn cell and time in h; and where cells
    grow ``data000000.csv`` for each frame, in newborn radii, with the cycles in ``timeline.txt``.

    ``"page"`` is for any browser: ``view.html`` shows the cells in space and time, up to 100,000 in
    a frame, 50 frames, and needs nothing else. It holds less than 25 MB.

    ``"simularium"`` is for https://simularium.allencell.org: ``cells.simularium``, spheres by type
    and state in µm and s.

    ``"ro-crate"`` is for repositories: the files of the folder, and ``ro-crate-metadata.json``,
    which states in the form of RO-Crate 1.1 what they are and what made them of which scene.

    Parameters
    ----------
    result
        A run, or the folder of one.
    output
        Folder for the files; it is made if it does not exist.
    format
        One of :data:`FORMATS`.
    tables
        Names out of :data:`TABLES`, for csv and parquet; by default all.
    frame
        The one frame whose cells, contacts and fields are written, counted from the end if
        negative; by default all.
    overwrite
        Replace files of the same names.

    Returns
    -------
    list of Path
        The files, those of csv and parquet in the order of ``tables``.

    Raises
    ------
    OutputError
        If the folder holds no results, has no such frame or table, or the files exist already or
        cannot be written; for a format that does not exist.
    MissingPackage
        If the packages of the format are not installed.
    """
    if format not in FORMATS:
        raise OutputError(f"there is no format {format!r}. {near_miss(format, FORMATS)}")
    chosen = FORMATS[format]
    run = result if isinstance(result, Result) else load_result(result)
    names = _chosen_tables(tables, format)
    count = len(run.frames)
    if frame is not None and not -count <= frame < count:
        raise OutputError(f"there is no frame {frame}: the run has {count}")
    folder = Path(output)
    if folder.suffix in _SUFFIXES and not folder.is_dir():
        raise OutputError(
            f"'{folder}' is the name of a file, and {format} writes several: name a folder"
        )
    with file_errors("use the output folder", folder):
        if not overwrite:
            _refuse_old(folder, [file.format(table=x) for x in names for file in chosen.files])
        needs(*chosen.packages)
        module, _, function = chosen.function.rpartition(".")
        write = getattr(import_module(f"multicell.report.{module}"), function)
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".export-", dir=folder) as place:
            staged = Path(place)
            with file_errors("write the files in", folder):
                more = [names] if chosen.tables else []
                written = write(run, partial(_frames, run, frame), staged, *more)
            if not overwrite:
                _refuse_old(folder, written)
            with UNCUT:
                for name in written:
                    sync_file(staged / name)
                    _read_back(staged / name)
                for name in written:
                    put_in_place(staged / name, folder / name)
    return [folder / name for name in written]


def _chosen_tables(tables: Sequence[str] | None, format: str) -> list[str]:
    if tables is None:
        return list(TABLES)
    if not FORMATS[format].tables:
        having = " and ".join(name for name, known in FORMATS.items() if known.tables)
        raise OutputError(f"the format {format!r} has no tables to choose from: {having} have")
    for name in tables:
        if name not in TABLES:
            raise OutputError(f"there is no table {name!r}. {near_miss(name, TABLES)}")
    return list(tables)


def _read_back(path: Path) -> None:
    """Read a file of HDF5, of which the system does not see whether it is complete."""
    if path.suffix in (".nc", ".h5ad"):
        from multicell.results.hdf5 import check_readable

        check_readable(path)


def _refuse_old(folder: Path, names: Iterable[str]) -> None:
    for path in (folder / name for name in names):
        if path.exists() or path.is_symlink():
            raise OutputError(f"'{path}' exists already: choose another folder or overwrite")


def _frames(run: Result, frame: int | None) -> Iterator[tuple[int, Frame]]:
    count = len(run.frames)
    for k in range(count) if frame is None else [frame % count]:
        yield k, run.frames[k]
