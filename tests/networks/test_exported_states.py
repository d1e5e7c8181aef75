"""States of networks in files for other programs."""

from __future__ import annotations

import anndata
import numpy as np
import pandas as pd
import pytest
import pyvista
import xarray as xr

import multicell as mc

NAMES = ("relax.A", "relax.B")


@mc.network(states={"A": 1.0, "B": 0.25}, inputs={"source": 0.0}, parameters={"k": 2e-4})
def relax(t, y, u, p, out):
    """Relaxation towards an input, at two rates."""
    out[0] = p[0] * (u[0] - y[0])
    out[1] = 2.0 * p[0] * (u[0] - y[1])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run in which one of two types has a network."""
    part = {"network": relax, "inputs": {"source": "radius"}, "cells": "with"}
    scene = mc.load_scene("growth").with_changes({
        "duration": "2 h", "initial.count": 12, "output.every": "1 h",
        "types": {"with": {"fraction": 0.5}, "without": {"fraction": 0.5}},
        "networks": {"relax": part},
    })  # fmt: skip
    return mc.run(scene, output=tmp_path_factory.mktemp("states") / "run", report=False)


def _tables(run, folder):
    """Yield format, and for each frame the values of each state."""
    mc.export(run.folder, folder / "csv", format="csv", tables=["cells"])
    table = pd.read_csv(folder / "csv" / "cells.csv", float_precision="round_trip")
    yield "csv", [table[table["frame"] == k] for k in sorted(set(table["frame"]))]
    mc.export(run.folder, folder / "parquet", format="parquet", tables=["cells"])
    table = pd.read_parquet(folder / "parquet" / "cells.parquet")
    yield "parquet", [table[table["frame"] == k] for k in sorted(set(table["frame"]))]
    mc.export(run.folder, folder / "anndata", format="anndata")
    data = anndata.read_h5ad(folder / "anndata" / "cells.h5ad")
    frames = sorted(set(data.obs["frame"]))
    yield "anndata", [data[data.obs["frame"] == k].to_df() for k in frames]
    mc.export(run.folder, folder / "netcdf", format="netcdf")
    paths = sorted((folder / "netcdf").glob("frame-*.nc"))
    yield "netcdf", [xr.load_dataset(path) for path in paths]
    mc.export(run.folder, folder / "vtk", format="vtk")
    paths = sorted((folder / "vtk").glob("cells-*.vtp"))
    yield "vtk", [pyvista.read(path).point_data for path in paths]


def test_every_format_has_the_states_of_each_frame(run, tmp_path):
    frames = list(run.frames)
    assert len(frames) == 3
    without = frames[-1].cells.kind == 1
    assert 0 < without.sum() < len(without)
    for name, read in _tables(run, tmp_path):
        assert len(read) == len(frames), name
        for frame, table in zip(frames, read, strict=True):
            for state in NAMES:
                own = np.asarray(table[state], dtype=float)
                np.testing.assert_array_equal(own, frame.inside[state], err_msg=name)
                assert np.isnan(own).tolist() == (frame.cells.kind == 1).tolist()
    assert np.ptp(frames[-1].inside["relax.A"][~without]) > 0.0
