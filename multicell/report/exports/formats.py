"""Runs in the formats of other programs: netCDF, VTK, AnnData, OpenVT, RO-Crate.

Tables of OpenVT (https://www.openvt.org) have the columns of its workshop of 2026, and where cells
grow each frame is also a file ``data000000.csv`` with its time in ``timeline.txt``, as in the study
of growing monolayers. They are of a plane: in three dimensions ours have one more column, z, at the
end. Sources: https://github.com/jmosborne/OpenVt2026Workshop (schema and data of six frameworks)
and https://github.com/rheiland/OpenVT_monolayer_PhysiCell (``analysis/gen_time_series.py``).
"""

from __future__ import annotations

import csv
import filecmp
import hashlib
import json
import shutil
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from multicell.errors import OutputError
from multicell.report.tables import TABLES, Frames, joined_table
from multicell.report.wording import measures
from multicell.results.folder import versions
from multicell.results.hdf5 import check_readable, whole_file
from multicell.results.netcdf import write_netcdf as write_file
from multicell.results.observables import touching
from multicell.results.tables import frame_arrays, frame_blocks
from multicell.scene.sizes import birth_radius
from multicell.vectors import nearest_differences

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.report.result import Result
    from multicell.results.frame import Frame

_ENDINGS: Final = {"PolyData": "vtp", "ImageData": "vti", "UnstructuredGrid": "vtu"}
_PLACE: Final = ("position_x_um", "position_y_um", "position_z_um")
_WHO: Final = ("frame", "time_s", "id", "parent", "state", "kind", "phase")
_CRATE: Final = "ro-crate-metadata.json"
_SCENE: Final = "scene.toml"
_KINDS: Final = {
    ".toml": ("application/toml", "The scene as run: all parameters with their units"),
    ".h5": ("application/x-hdf5", "All saved frames, and the history of each coupling step"),
    ".json": ("application/json", "Key figures of the run, with the versions of all packages"),
    ".html": ("text/html", "The report: pictures, values and the view of the cells"),
    ".png": ("image/png", "A picture of the run"),
    ".csv": ("text/csv", "The cells at the start"),
    ".parquet": ("application/vnd.apache.parquet", "The cells at the start"),
}
"""Media type and description of the files of a run."""


def write_netcdf_files(run: Result, frames: Frames, folder: Path) -> list[str]:
    """Write the history and each frame into files of their own and return the names."""
    names = ["history.nc"]
    write_file(run.to_xarray(), folder / names[0])
    for number, frame in frames():
        names.append(f"frame-{number:04d}.nc")
        write_file(frame_arrays(frame, tuple(run.scene.types)), folder / names[-1])
    return names


def write_vtk(run: Result, frames: Frames, folder: Path) -> list[str]:
    """Write frames and their index into a folder and return the names of the files."""
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(root, "Collection")
    names = ["run.pvd"]
    for number, frame in frames():
        shown = frame.within(run.scene.domain)
        parts = frame_blocks(shown, tuple(run.scene.types))
        for part, name in enumerate(parts.keys()):
            data: Any = parts[name]
            names.append(f"{name}-{number:04d}.{_ENDINGS[type(data).__name__]}")
            (folder / names[-1]).write_text(_vtk_text(data), "utf-8")
            known = {"timestep": repr(float(frame.time)), "part": str(part), "name": name}
            ElementTree.SubElement(collection, "DataSet", known | {"file": names[-1]})
    ElementTree.indent(root)
    path = folder / names[0]
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    return names


def _vtk_text(data: Any) -> str:
    """Return the file of an object of VTK, which itself prints many lines where a disk is full."""
    from vtkmodules import vtkIOXML

    writer: Any = getattr(vtkIOXML, f"vtkXML{type(data).__name__.removesuffix('_')}Writer")()
    writer.SetInputData(data)
    writer.SetDataModeToBinary()
    writer.WriteToOutputStringOn()
    writer.Write()
    text: str = writer.GetOutputString()
    return text


def write_anndata(run: Result, frames: Frames, folder: Path) -> list[str]:
    """Write the cells of all frames into one file and return its name."""
    import anndata
    import h5py
    import pandas

    name = "cells.h5ad"
    # the tables and the contacts each go through the frames
    table = joined_table(TABLES["cells"](run, frames()))
    features = [title for title in table if title not in (*_PLACE, *_WHO)]
    who = pandas.DataFrame({title: table[title] for title in _WHO if title in table})
    who.index = [f"{k}-{id}" for k, id in zip(who["frame"], who["id"], strict=True)]
    words = {title: "category" for title in ("state", "kind", "phase") if title in who}
    data = anndata.AnnData(
        X=np.column_stack([table[title].astype(float) for title in features]),
        obs=who.astype(words),
        var=pandas.DataFrame(index=features),
        obsm={"spatial": np.column_stack([table[title] for title in _PLACE])},
        uns={"scene": run.scene.to_toml(), "versions": versions()},
    )
    domain = run.scene.domain
    _connect(data, [frame for _, frame in frames()], None if domain is None else domain.period)
    with whole_file(folder / name, check_readable) as target, h5py.File(target, "w") as file:
        anndata.io.write_elem(file, "/", data, dataset_kwargs={"compression": "gzip"})
    return [name]


def _connect(data: Any, frames: Sequence[Frame], period: FloatArray | None) -> None:
    """Add who touches whom, and how far apart they are, under squidpy's names."""
    from scipy.sparse import coo_array

    pairs, apart, before = [np.empty((0, 2), np.int64)], [np.empty(0)], 0
    for frame in frames:
        rows, place = touching(frame, period), frame.cells.position
        pairs.append(before + rows)
        way = nearest_differences(place[rows[:, 1]], place[rows[:, 0]], period)
        apart.append(np.linalg.norm(way, axis=1))
        before += len(frame.cells)
    first, second = np.concatenate(pairs).T
    both = (np.concatenate([first, second]), np.concatenate([second, first]))
    distance: NDArray[np.float64] = np.tile(np.concatenate(apart), 2)
    shape = (data.n_obs, data.n_obs)
    data.obsp["spatial_connectivities"] = coo_array((np.ones(len(distance)), both), shape).tocsr()
    data.obsp["spatial_distances"] = coo_array((distance, both), shape).tocsr()
    data.uns["spatial_neighbors"] = {
        "connectivities_key": "spatial_connectivities",
        "distances_key": "spatial_distances",
        "params": {"coord_type": "generic", "radius": "cells in contact"},
    }


def write_openvt(run: Result, frames: Frames, folder: Path) -> list[str]:
    """Write the tables of OpenVT into a folder and return the names of the files.

    Lengths are diameters of a newborn cell in ``openvt.csv`` and radii of one in the files of each
    frame, time is h in the one and cycles in the others. ``simID`` is the seed of the run.
    """
    scene, born = run.scene, birth_radius(run.scene)
    axes = "xyz"[: scene.dimensions]
    names, timeline = ["openvt.csv"], []
    with (folder / names[0]).open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["simID", "time", "cellID", "cellType", *axes])
        for number, frame in frames():
            cells = frame.cells
            place = cells.position[:, : scene.dimensions] / born
            who = zip(cells.id.tolist(), cells.kind.tolist(), (0.5 * place).tolist(), strict=True)
            hours = frame.time / 3600.0
            table.writerows([scene.seed, hours, id, kind, *x] for id, kind, x in who)
            if scene.growth is not None:
                names.append(f"data{number:06d}.csv")
                timeline.append([number, frame.time / scene.growth.mean_cycle])
                rows = np.column_stack([place[:, :2], cells.radius / born, place[:, 2:]])
                title = ["x", "y", "r", *axes[2:]]
                _write_table(folder / names[-1], [title, *rows.tolist()])
    if timeline:
        names.append("timeline.txt")
        _write_table(folder / names[-1], [["index", "t"], *timeline])
    return names


def _write_table(path: Path, rows: Sequence[Sequence[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)


def write_crate(run: Result, frames: Frames, folder: Path) -> list[str]:
    """Copy the files of a run and describe them; return all names.

    Raises OutputError for a run that has no folder, or is not at its end.
    """
    if run.folder is None:
        raise OutputError("the run has no output folder: only files can be described")
    if not (run.folder / "frames.h5").is_file():
        raise OutputError(f"the run in '{run.folder}' is not at its end: resume it first")
    files = sorted(p for p in run.folder.iterdir() if p.is_file() and p.suffix in _KINDS)
    files = [path for path in files if path.name != _CRATE]
    for path in files:
        shutil.copyfile(path, folder / path.name)
        if not filecmp.cmp(path, folder / path.name, shallow=False):
            raise OutputError(f"the copy of '{path}' does not read back as it was written")
    text = json.dumps(_described(run, files), indent=2, ensure_ascii=False)
    (folder / _CRATE).write_text(text + "\n", "utf-8")
    return [_CRATE, *(path.name for path in files)]


def _described(run: Result, files: Sequence[Path]) -> dict[str, Any]:
    summary = run.summary()
    ended = datetime.fromtimestamp(max(p.stat().st_mtime for p in files), UTC)
    when = ended.isoformat(timespec="seconds")
    figures = [
        {"@id": f"#figure-{k}", "@type": "PropertyValue", "name": name, "value": value}
        for k, (name, value) in enumerate(measures(summary))
    ]
    software = [
        {"@id": f"#{name}", "@type": "SoftwareApplication", "name": name, "softwareVersion": number}
        for name, number in summary["versions"].items()
    ]
    title = run.scene.title or "Untitled run"
    parts = [{"@id": path.name} for path in files]
    described = {
        "@id": _CRATE,
        "@type": "CreativeWork",
        "about": {"@id": "./"},
        "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
    }
    root = {
        "@id": "./",
        "@type": "Dataset",
        "name": title,
        "datePublished": when,
        "description": f"Cell-based simulation of tissue with multicell: {title}",
        "license": "No licence is stated; ask the authors of the run.",
        "hasPart": parts,
        "mentions": {"@id": "#run"},
        "variableMeasured": [{"@id": entry["@id"]} for entry in figures],
    }
    action = {
        "@id": "#run",
        "@type": "CreateAction",
        "endTime": when,
        "name": f"Run of the scene with seed {run.scene.seed}",
        "instrument": [{"@id": entry["@id"]} for entry in software],
        "object": {"@id": _SCENE},
        "result": [part for part in parts if part["@id"] != _SCENE],
    }
    graph = [described, root, action, *map(_file, files), *software, *figures]
    return {"@context": "https://w3id.org/ro/crate/1.1/context", "@graph": graph}


def _file(path: Path) -> dict[str, Any]:
    kind, words = _KINDS[path.suffix]
    content = path.read_bytes()
    return {
        "@id": path.name,
        "@type": "File",
        "name": path.name,
        "description": words,
        "encodingFormat": kind,
        "contentSize": str(len(content)),
        "sha256": hashlib.sha256(content).hexdigest(),
    }
