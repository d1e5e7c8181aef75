"""Exports read back by the programs that they are for, and held against the store bit by bit."""

import hashlib
import sys

import anndata
import numpy as np
import pandas as pd
import pytest
import pyvista
import xarray as xr
from click.testing import CliRunner
from scipy.spatial.distance import pdist, squareform

import multicell as mc
from multicell.cells import HAZARDS, Cells, State
from multicell.cli.main import main
from multicell.report.exports.files import FORMATS
from multicell.report.tables import TABLES
from multicell.results.frame import Field
from multicell.results.quantities import unit_of
from multicell.results.tables import field_grid
from multicell.tables.titles import titled


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run with two fields, one of them on shells, and two types of cells."""
    folder = tmp_path_factory.mktemp("formats") / "run"
    scene = mc.load_scene("spheroid").with_changes(
        {
            "duration": "12 h",
            "initial.count": 40,
            "output.every": "6 h",
            "nutrients.glucose": {"boundary": "5 mM", "geometry": "radial", "spacing": "10 um"},
            "types": {"soft": {"fraction": 0.5}, "hard": {"fraction": 0.5}},
        }
    )
    return mc.run(scene, output=folder, report=False)


def test_paraview_finds_every_frame_with_its_values(run, tmp_path):
    mc.export(run.folder, tmp_path, format="vtk")
    reader = pyvista.get_reader(tmp_path / "run.pvd")
    np.testing.assert_array_equal(reader.time_values, [frame.time for frame in run.frames])
    for frame in run.frames:
        reader.set_active_time_value(frame.time)
        cells, *fields = reader.read()
        np.testing.assert_array_equal(cells.points, frame.cells.position)
        for name, values in frame.cells.columns():
            if name != "position":
                read = cells.point_data[titled(name, unit_of(f"cells.{name}"))]
                np.testing.assert_array_equal(read, values)
        np.testing.assert_array_equal(
            cells.point_data["concentration_oxygen_mM"], frame.concentrations["oxygen"]
        )
        for data, field in zip(fields, frame.fields.values(), strict=True):
            read = data.cell_data[f"{field.name}_mM"]
            assert set(read) == set(field.values.ravel())
    assert list(cells.field_data["kind_names"]) == ["soft", "hard"]
    assert list(cells.field_data["state_names"]) == [s.name.lower() for s in sorted(State)]


def test_cubes_and_squares_lie_where_their_field_has_them():
    values = np.arange(24.0).reshape(2, 3, 4)
    grid = field_grid(Field("oxygen", "mM", np.array([1.0, 2.0, 3.0]), 5.0, values))
    for index in np.ndindex(values.shape):
        place = np.array([1.0, 2.0, 3.0]) + 5.0 * (np.array(index) + 0.5)
        assert grid.cell_data["oxygen_mM"][grid.find_containing_cell(place)] == values[index]
    flat = Field("oxygen", "mM", np.zeros(3), 5.0, values[:, :, :1], height=8.0)
    np.testing.assert_allclose(field_grid(flat).bounds, (0.0, 10.0, 0.0, 15.0, 0.0, 8.0))


def test_shells_lie_at_their_distances():
    values = np.arange(1.0, 7.0)[:, None, None]
    centre = np.array([10.0, -5.0, 2.0])
    grid = field_grid(Field("glucose", "mM", centre, 4.0, values, kind="radial"))
    rng = np.random.default_rng(3)
    for shell in range(1, 6):
        towards = rng.normal(size=3)
        # boxes of 15 degrees bulge less than the sphere: by 1 - cos(7.5 deg) twice over
        place = centre + 4.0 * (shell + 0.4) * towards / np.linalg.norm(towards)
        assert grid.cell_data["glucose_mM"][grid.find_containing_cell(place)] == shell + 1.0
    volume = grid.compute_cell_sizes(length=False, area=False).cell_data["Volume"].sum()
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 24.0**3, rel=0.04)


def test_parquet_tables_have_the_values_and_types_of_the_run(run, tmp_path):
    mc.export(run, tmp_path, format="parquet")
    cells = pd.read_parquet(tmp_path / "cells.parquet")
    last = cells[cells["frame"] == len(run.frames) - 1]
    np.testing.assert_array_equal(last["radius_um"], run.frames[-1].cells.radius)
    assert set(cells["kind"]) == {"soft", "hard"}
    history = pd.read_parquet(tmp_path / "history.parquet")
    for name, values in run.history.items():
        np.testing.assert_array_equal(history[titled(name, unit_of(name))], values)
    pd.testing.assert_frame_equal(history, run.to_pandas(), check_dtype=False)
    lineage = pd.read_parquet(tmp_path / "lineage.parquet")
    assert len(lineage) == len(run.lineage["id"])


def test_observations_with_places_and_contacts(run, tmp_path):
    mc.export(run, tmp_path, format="anndata")
    data = anndata.read_h5ad(tmp_path / "cells.h5ad")
    assert data.obs_names.is_unique
    assert data.n_obs == sum(len(frame.cells) for frame in run.frames)
    rows = np.flatnonzero(data.obs["frame"] == len(run.frames) - 1)
    last, cells = data[rows], run.frames[-1].cells
    np.testing.assert_array_equal(last.obsm["spatial"], cells.position)
    np.testing.assert_array_equal(last[:, "radius_um"].X.ravel(), cells.radius)
    np.testing.assert_array_equal(
        last[:, "concentration_glucose_mM"].X.ravel(), run.frames[-1].concentrations["glucose"]
    )
    apart = squareform(pdist(cells.position))
    touch = (apart < np.add.outer(cells.radius, cells.radius)) & ~np.eye(len(cells), dtype=bool)
    np.testing.assert_array_equal(last.obsp["spatial_connectivities"].toarray() > 0.0, touch)
    np.testing.assert_allclose(last.obsp["spatial_distances"].toarray(), np.where(touch, apart, 0))
    # cells of different frames do not touch
    links = data.obsp["spatial_connectivities"].tocoo()
    frames = data.obs["frame"].to_numpy()
    np.testing.assert_array_equal(frames[links.row], frames[links.col])


def test_netcdf_history_and_frames(run, tmp_path):
    mc.export(run, tmp_path, format="netcdf")
    with xr.open_dataset(tmp_path / "history.nc") as history:
        xr.testing.assert_identical(history.drop_attrs(), run.to_xarray().drop_attrs())
        assert history["diameter"].attrs["units"] == "um"
        assert "[nutrients.oxygen]" in history.attrs["scene"]
    for number, frame in enumerate(run.frames):
        with xr.open_dataset(tmp_path / f"frame-{number:04d}.nc") as data:
            np.testing.assert_array_equal(data["position"], frame.cells.position)
            assert float(data["time"]) == frame.time
            for name, field in frame.fields.items():
                np.testing.assert_array_equal(data[name], np.squeeze(field.values))
            oxygen = frame.fields["oxygen"]
            np.testing.assert_array_equal(data["x_oxygen"], oxygen.axis(0))


@pytest.mark.slow
def test_openvt_tables_have_columns_and_units_of_its_frameworks(run, tmp_path):
    files = mc.export(run, tmp_path / "space", format="openvt")
    assert {file.name for file in files} == {
        "openvt.csv", "timeline.txt", "data000000.csv", "data000001.csv", "data000002.csv",
    }  # fmt: skip
    table = pd.read_csv(files[0], float_precision="round_trip")
    assert list(table) == ["simID", "time", "cellID", "cellType", "x", "y", "z"]
    born = run.scene.cells.division_radius / 2 ** (1 / 3)
    for frame in run.frames:
        rows = table[table["time"] == frame.time / 3600]
        np.testing.assert_array_equal(rows["cellID"], frame.cells.id)
        np.testing.assert_array_equal(rows["cellType"], frame.cells.kind)
        place = rows[["x", "y", "z"]] * 2 * born
        np.testing.assert_allclose(place, frame.cells.position, rtol=1e-14)
    assert set(table["simID"]) == {run.scene.seed}
    one = np.loadtxt(tmp_path / "space" / "data000002.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(one[:, 2] * born, run.frames[2].cells.radius, rtol=1e-14)
    line = np.loadtxt(tmp_path / "space" / "timeline.txt", delimiter=",", skiprows=1)
    np.testing.assert_allclose(line, [[0, 0], [1, 6 / 15], [2, 12 / 15]], rtol=1e-14)
    # of a plane, and without growth: the columns of the workshop and nothing else
    flat = mc.run(mc.load_scene("openvt-chain").with_changes({"duration": "12 min"}))
    (file,) = mc.export(flat, tmp_path / "plane", format="openvt")
    assert file.read_text().splitlines()[0] == "simID,time,cellID,cellType,x,y"
    first = pd.read_csv(file, nrows=11)
    np.testing.assert_allclose(first["x"], np.arange(-2.5, 2.6, 0.5), rtol=1e-9)


def test_a_frame_by_itself(run):
    frame = run.frames[-1]
    table = frame.to_pandas()
    np.testing.assert_array_equal(table["position_y_um"], frame.cells.position[:, 1])
    assert set(table["state"]) <= {s.name.lower() for s in State}
    blocks = frame.to_pyvista()
    assert blocks.keys() == ["cells", *frame.fields]
    assert blocks["cells"].n_points == len(frame.cells)
    arrays = frame.to_xarray()
    # no rate has acted on these cells, and they have no network
    assert set(Cells.schema()) - {*HAZARDS, "inside"} < set(arrays)


def test_formats_that_cannot_be_written(run, tmp_path, monkeypatch):
    with pytest.raises(mc.OutputError, match=r"no format 'vkt'.*Did you mean 'vtk'"):
        mc.export(run, tmp_path, format="vkt")
    having = " and ".join(name for name, known in FORMATS.items() if known.tables)
    with pytest.raises(mc.OutputError, match=f"has no tables to choose from: {having} have"):
        mc.export(run, tmp_path, format="vtk", tables=["cells"])
    mc.export(run, tmp_path, format="vtk", frame=0)
    with pytest.raises(mc.OutputError, match=r"run\.pvd' exists already"):
        mc.export(run, tmp_path, format="vtk")
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(mc.MulticellError, match=r'pip install "multicell\[export\]"'):
        mc.export(run, tmp_path / "other", format="vtk")
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("format", ["csv", "vtk", "ro-crate"])
def test_command(run, tmp_path, format):
    given = ["export", str(run.folder), "-o", str(tmp_path), "--format", format, "--frame", "-1"]
    done = CliRunner().invoke(main, given)
    assert done.exit_code == 0, done.output
    files = {entry.name for entry in tmp_path.iterdir()}
    assert files == {line.rpartition("/")[2] for line in done.output.split()}
    assert files
    if FORMATS[format].tables:
        assert {name.partition(".")[0] for name in files} == set(TABLES)
    wrong = CliRunner().invoke(main, [*given, "--json"])
    assert wrong.exit_code == 2
    assert "exists already" in wrong.output


def test_a_crate_describes_all_files_of_the_run(run, tmp_path):
    from rocrate.rocrate import ROCrate

    paths = mc.export(run.folder, tmp_path / "crate", format="ro-crate")
    crate = ROCrate(tmp_path / "crate")
    assert crate.version == "1.1"
    files = {entity.id: entity for entity in crate.get_by_type("File")}
    assert {path.name for path in paths} == {*files, "ro-crate-metadata.json"}
    assert {"scene.toml", "frames.h5", "summary.json"} <= set(files)
    for name, entity in files.items():
        content = (tmp_path / "crate" / name).read_bytes()
        assert content == (run.folder / name).read_bytes()
        assert entity["sha256"] == hashlib.sha256(content).hexdigest()
    (action,) = crate.get_by_type("CreateAction")
    assert action["object"].id == "scene.toml"
    assert {entity.id for entity in action["result"]} == set(files) - {"scene.toml"}
    made = {entity["name"]: entity["softwareVersion"] for entity in action["instrument"]}
    assert made["multicell"] == mc.__version__
    figures = {entity["name"]: entity["value"] for entity in crate.root_dataset["variableMeasured"]}
    assert figures["cells"] == f"{run.summary()['cells']:,}"
    # what is in a crate is a run like any other
    assert len(mc.load_result(tmp_path / "crate").frames) == len(run.frames)


def test_a_crate_needs_files_of_a_run_that_is_done(tmp_path):
    with pytest.raises(mc.OutputError, match="no output folder"):
        mc.export(mc.run("doublet-settle"), tmp_path, format="ro-crate")


def test_a_run_starts_with_the_cells_of_an_anndata_file(run, tmp_path):
    mc.export(run.folder, tmp_path, format="anndata", frame=-1)
    data = anndata.read_h5ad(tmp_path / "cells.h5ad")
    data.obs["leiden"] = "1"  # of another program
    data.write_h5ad(tmp_path / "cells.h5ad")
    scene = run.scene.with_changes({"duration": "10 min"})
    mine = mc.run(scene, cells=tmp_path / "cells.h5ad", output=tmp_path / "mine", report=False)
    same = mc.run(scene, cells=run.frames[-1].cells)
    for name in ("position", "radius", "state", "kind", "age", "cycle_time"):
        ours, theirs = (getattr(r.frames[-1].cells, name) for r in (mine, same))
        np.testing.assert_array_equal(ours, theirs)
    again = mc.run(tmp_path / "mine" / "scene.toml")  # the folder holds the table
    np.testing.assert_array_equal(again.frames[-1].cells.position, mine.frames[-1].cells.position)


@pytest.mark.parametrize("content", ["nothing", "places"])
def test_an_anndata_file_without_cells_is_refused(content, tmp_path):
    path = tmp_path / "cells.h5ad"
    if content == "nothing":
        path.write_bytes(b"\x89HDF\r\n\x1a\n")
    else:
        anndata.AnnData(np.ones((3, 2))).write_h5ad(path)
    with pytest.raises(mc.MulticellError, match=r"is no AnnData file|holds no rows|no column"):
        mc.run("growth", cells=path)
