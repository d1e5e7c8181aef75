"""Tables of a run as CSV, read back with NumPy and held against the run."""

import csv

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

import multicell as mc
from multicell.cells import State
from multicell.results.frame import Frame


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("export") / "run"
    scene = mc.load_scene("treatment").with_changes(
        {"duration": "1 d", "initial.count": 40, "output.every": "12 h"}
    )
    return mc.run(scene, output=folder, report=False)


def rows(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_every_cell_of_every_frame_is_a_row(run, tmp_path):
    mc.export(run, tmp_path, tables=["cells"])
    table = rows(tmp_path / "cells.csv")
    assert len(table) == sum(len(frame.cells) for frame in run.frames)
    last = [row for row in table if row["frame"] == str(len(run.frames) - 1)]
    cells = run.frames[-1].cells
    # all digits are there: reading gives the same bits
    for axis, name in enumerate("xyz"):
        read = np.array([float(row[f"position_{name}_um"]) for row in last])
        np.testing.assert_array_equal(read, cells.position[:, axis])
    assert [row["state"] for row in last] == [State(int(s)).name.lower() for s in cells.state]
    read = [float(row["concentration_oxygen_mM"]) for row in last]
    np.testing.assert_array_equal(read, run.frames[-1].concentrations["oxygen"])


def test_lineage_and_history(run, tmp_path):
    mc.export(run.folder, tmp_path, tables=["lineage", "history"])
    lineage = rows(tmp_path / "lineage.csv")
    assert [int(row["id"]) for row in lineage] == run.lineage["id"].tolist()
    born = [row for row in lineage if row["parent"] != "-1"]
    by_id = {row["id"]: row for row in lineage}
    assert born
    for row in born:
        assert by_id[row["parent"]]["end"] == "division"
        assert by_id[row["parent"]]["end_time_s"] == row["birth_time_s"]
    history = rows(tmp_path / "history.csv")
    np.testing.assert_array_equal([float(r["time_s"]) for r in history], run.history["time"])
    assert "diameter_um" in history[0]


def test_contacts_name_cells_by_identity(run, tmp_path):
    mc.export(run, tmp_path, tables=["contacts"], frame=-1)
    cells = run.frames[-1].cells
    apart = squareform(pdist(cells.position))
    touching = np.argwhere(np.triu(apart < np.add.outer(cells.radius, cells.radius), 1))
    table = rows(tmp_path / "contacts.csv")
    read = {frozenset((int(r["first_id"]), int(r["second_id"]))) for r in table}
    assert read == {frozenset(pair) for pair in cells.id[touching].tolist()}
    assert len(read) == len(table) > 40
    assert all(float(row["overlap_um"]) > 0.0 for row in table)


def test_bad_input(run, tmp_path):
    with pytest.raises(mc.OutputError, match=r"no table 'linage'.*Did you mean 'lineage'"):
        mc.export(run, tmp_path, tables=["linage"])
    with pytest.raises(mc.OutputError, match="no frame 99: the run has"):
        mc.export(run, tmp_path, frame=99)
    with pytest.raises(mc.OutputError, match="there are no results"):
        mc.export(tmp_path / "nowhere", tmp_path)
    mc.export(run, tmp_path, tables=["lineage"])
    with pytest.raises(mc.OutputError, match="exists already"):
        mc.export(run, tmp_path)
    assert not (tmp_path / "cells.csv").exists()
    mc.export(run, tmp_path, overwrite=True)


def test_contacts_are_between_cells_that_are_there():
    """Mothers that divided and cells that were removed once stayed in the pairs of a frame."""
    scene = mc.Scene.from_dict(
        {
            "duration": "6 h",
            "coupling_step": "30 min",
            "output": {"every": "30 min"},
            "initial": {"count": 30, "stage": "uniform"},
            "growth": {"cycle_time": "8 h"},
            "contact": {"law": "exact-jkr", "surface_energy": 0.02},
            "death": {"apoptosis_rate": "4e-5 1/s", "apoptosis_time": "30 min"},
        }
    )
    result = mc.run(scene)
    assert min(result.summary()[name] for name in ("divisions", "removals")) > 0
    for frame in result.frames:
        assert len(frame.contacts)
        assert np.isin(frame.contacts, frame.cells.id).all()
        assert (frame.contacts[:, 0] != frame.contacts[:, 1]).all()


def test_contacts_that_a_run_counts_are_written_but_those_of_cells_that_are_gone(tmp_path):
    scene = mc.load_scene("sorting").with_changes({"initial.count": 30, "duration": "10 min"})
    run = mc.run(scene)
    last = run.frames[-1]
    mc.export(run, tmp_path, tables=["contacts", "cells"], frame=-1)
    read = {(int(r["first_id"]), int(r["second_id"])) for r in rows(tmp_path / "contacts.csv")}
    assert read == set(map(tuple, last.contacts.tolist()))
    assert {row["kind"] for row in rows(tmp_path / "cells.csv")} == set(scene.types)
    gone = [int(last.contacts[0, 0]), int(last.cells.id.max())]
    kept = last.cells.take(~np.isin(last.cells.id, gone))
    frame = Frame(last.time, last.step, kept, contacts=last.contacts)
    result = mc.Result(None, [frame], run.history, run.summary(), scene, run.lineage)
    mc.export(result, tmp_path, tables=["contacts"], overwrite=True)
    read = {(int(r["first_id"]), int(r["second_id"])) for r in rows(tmp_path / "contacts.csv")}
    expected = last.contacts[~np.isin(last.contacts, gone).any(axis=1)]
    assert read == set(map(tuple, expected.tolist()))
    assert 0 < len(read) < len(last.contacts)
