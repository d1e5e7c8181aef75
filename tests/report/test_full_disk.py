"""A full disk ends every writer of files of HDF5 in words, and never the process.

``pytest tests/report/test_full_disk.py --full-disks 40`` tries as many sizes of disks for each.
"""

import json
import random
import sys

import pytest
import xarray
from studied import SHORT

import multicell as mc

WRITERS = {"history and frames": ("export", "netcdf"), "cells": ("export", "anndata"),
           "study": ("study_table", "")}  # fmt: skip


@pytest.fixture(scope="module")
def sources(forks, tmp_path_factory):
    """Return a run and a study, and load what writes them."""
    place = tmp_path_factory.mktemp("sources")
    scene = mc.load_scene("growth").with_changes({**SHORT, "initial.count": 40})
    mc.run(scene, output=place / "export", report=False, threads=1)
    made = mc.study(scene, {"cells.young": "1,2 kPa"}, seeds=2, output=place / "study_table")
    made.run(cores=1)
    size = {}
    for name, (way, kind) in WRITERS.items():
        task = {"way": way, "source": str(place / way), "folder": str(place / name),
                "format": kind}  # fmt: skip
        (place / name).mkdir()
        forks.load(function="full_disk:attempt", **{"with": task})
        size[name] = sum(path.stat().st_size for path in (place / name).iterdir()) / 1024.0
    return place, size


@pytest.mark.harness
@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="small disks are mounted on Linux")
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_ends_no_process(name, sources, forks, small_disk, pytestconfig):
    place, size = sources
    way, kind = WRITERS[name]
    mount, unmount = small_disk
    stopped = 0
    for case in range(pytestconfig.getoption("full_disks") + 1):
        share = random.Random(case).uniform(0.1, 1.2)
        folder = mount(max(8, int(share * size[name])))
        try:
            task = {"way": way, "source": str(place / way), "folder": str(folder), "format": kind}
            done = forks.ask(function="full_disk:attempt", **{"with": task})
            assert done["code"] == 0, (case, done)
            lines = done["text"].splitlines()
            assert len(lines) == 1, (case, done["text"])
            found = json.loads(lines[0])
            assert found["left"] == []
            for said in filter(None, found["said"]):
                assert "No space left on device" in said, said
                assert len(said.splitlines()) == 1
            stopped += bool(found["said"][-1])
            assert not [p.name for p in folder.iterdir() if p.suffix not in (".nc", ".h5ad")]
        finally:
            unmount()
    assert stopped


@pytest.mark.slow
def test_a_table_is_the_one_that_xarray_would_write(sources, tmp_path):
    place, _ = sources
    table = mc.load_study(place / "study_table").to_xarray()
    with xarray.open_dataset(place / "study_table" / "study.nc") as found:
        xarray.testing.assert_identical(found.load(), _as_read(table, tmp_path))


def _as_read(table, folder):
    table.to_netcdf(folder / "by_xarray.nc", engine="h5netcdf")
    with xarray.open_dataset(folder / "by_xarray.nc") as found:
        return found.load()
