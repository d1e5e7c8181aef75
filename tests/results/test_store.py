"""Result files: every bit comes back, whatever happened to the writer."""

import json
import os
from contextlib import closing
from pathlib import Path

import h5py
import numpy as np
import pytest
from stored import written
from synthetic import BARE, SCENE, cells_at, growing_frames, history_of, spheroid

import multicell
from multicell.cells import Cells
from multicell.errors import OutputError
from multicell.report.result import Result, history_columns, load_result
from multicell.results.documents import write_table
from multicell.results.folder import RUN_FILES, to_json
from multicell.results.frame import Field, Frame
from multicell.results.reader import Contents, Frames
from multicell.results.records import SPARSE
from multicell.results.writer import Store
from multicell.scene.scene import load_scene
from multicell.scene.start_table import COPIES


def assert_same_frame(first, second):
    assert (first.time, first.step) == (second.time, second.step)
    for name, column in first.cells.columns():
        other = getattr(second.cells, name)
        assert other.dtype == column.dtype
        np.testing.assert_array_equal(other, column, err_msg=name)
    assert set(first.concentrations) == set(second.concentrations)
    for name, values in first.concentrations.items():
        np.testing.assert_array_equal(second.concentrations[name], values)
    assert set(first.fields) == set(second.fields)
    for name, field in first.fields.items():
        other = second.fields[name]
        assert (other.name, other.unit, other.spacing) == (field.name, field.unit, field.spacing)
        np.testing.assert_array_equal(other.origin, field.origin)
        np.testing.assert_array_equal(other.values, field.values)


def test_round_trip_is_exact_to_the_bit(tmp_path):
    frames = growing_frames(count=5, last=700)
    written(tmp_path / "out", frames)
    back = Frames(Contents(tmp_path / "out"))
    assert len(back) == 5
    for first, second in zip(frames, back, strict=True):
        assert_same_frame(first, second)
    history = Contents(tmp_path / "out").history()
    for name, values in history_columns(history_of(frames)).items():
        np.testing.assert_array_equal(history[name], values)


def test_frames_are_a_lazy_sequence(tmp_path):
    frames = growing_frames(count=4, last=50)
    back = Frames(Contents(written(tmp_path / "out", frames)))
    assert_same_frame(frames[-1], back[-1])
    assert [frame.time for frame in back[1:3]] == [frames[1].time, frames[2].time]
    assert [frame.time for frame in back[::-1]] == [frame.time for frame in frames[::-1]]
    np.testing.assert_array_equal(back.times, [frame.time for frame in frames])
    for place in (3, 0, 2, 2, 1):
        assert_same_frame(frames[place], back[place])
    for wrong in (4, -5):
        with pytest.raises(IndexError, match="of 4"):
            back[wrong]


def test_frames_without_nutrients_without_cells_and_without_field(tmp_path):
    frames = [Frame(0.0, 0, cells_at([[0, 0, 0]])), Frame(60.0, 1, Cells.empty())]
    back = Frames(Contents(written(tmp_path / "bare", frames, BARE)))
    for first, second in zip(frames, back, strict=True):
        assert_same_frame(first, second)
    full = spheroid(60)
    frames = [Frame(0.0, 0, full.cells, full.concentrations), full]
    back = Frames(Contents(written(tmp_path / "late", frames)))
    assert back[0].fields == {}
    assert_same_frame(full, back[1])


def test_values_that_are_not_numbers_survive(tmp_path):
    cells, found = cells_at([[np.nan, np.inf, -0.0]]), {"oxygen": np.array([np.nan])}
    field = Field("oxygen", "mM", np.zeros(3), 1.0, np.full((2, 2, 2), np.nan))
    with closing(Store.create(tmp_path / "out", SCENE)) as store:
        store.append(Frame(0.0, 0, cells, found, {"oxygen": field}))
        store.settle()
    (back,) = Frames(Contents(tmp_path / "out"))
    assert back.cells.position.tobytes() == cells.position.tobytes()
    assert back.concentrations["oxygen"].tobytes() == found["oxygen"].tobytes()
    assert back.fields["oxygen"].values.tobytes() == field.values.tobytes()


def test_folder_holds_the_scene_and_the_file_its_units(tmp_path):
    written(tmp_path / "out", [spheroid(30)])
    assert load_scene(tmp_path / "out" / "scene.toml") == SCENE
    with h5py.File(tmp_path / "out" / "frames.h5") as file:
        assert file.attrs["format"] == 6
        assert file.attrs["multicell"] == multicell.__version__
        units = {name: column.attrs["unit"] for name, column in file["cells"].items()}
        for name, spec in Cells.schema().items():
            if f"cells/{name}" not in SPARSE:
                assert units[name] == spec["unit"]
        place = file["history"].dtype.names.index("diameter")
        assert file["history"].attrs["unit"][place] == "um"


def test_file_can_be_read_while_it_is_written(tmp_path):
    """So a process that is killed leaves all finished frames; see also test_kill_and_full_disk."""
    frames = growing_frames(count=3, last=200)
    with closing(Store.create(tmp_path / "out", SCENE)) as store:
        assert len(Frames(Contents(tmp_path / "out"))) == 0
        for done, frame in enumerate(frames, start=1):
            store.append(frame)
            back = Frames(Contents(tmp_path / "out"))
            assert len(back) == done
            assert_same_frame(frame, back[-1])
        result = load_result(tmp_path / "out")
    assert result.summary()["interrupted"] is True
    assert result.summary()["cells"] == len(frames[-1].cells)


def test_append_that_breaks_off_leaves_no_trace(tmp_path, monkeypatch):
    frames = growing_frames(count=3, last=300)
    write = os.write

    for stop in (0, 20, 5_000):

        def interrupted(descriptor, data, stop=stop):
            write(descriptor, data[:stop])
            raise KeyboardInterrupt

        folder = tmp_path / str(stop)
        with closing(Store.create(folder, SCENE)) as store:
            store.append(frames[0])
            with monkeypatch.context() as patch:
                patch.setattr(os, "write", interrupted)
                with pytest.raises(KeyboardInterrupt):
                    store.append(frames[1])
            assert len(Frames(Contents(folder))) == 1
            # a shorter one than that which broke off: nothing of it may stay behind
            store.append(spheroid(20))
            store.append(frames[2])
            store.settle()
        back = Frames(Contents(folder))
        assert len(back) == 3
        assert_same_frame(frames[0], back[0])
        assert_same_frame(spheroid(20), back[1])
        assert_same_frame(frames[2], back[2])


def test_a_resumed_run_keeps_its_columns(tmp_path):
    with closing(Store.create(tmp_path / "out", SCENE)) as store:
        store.append_history({"time": 0.0, "cells": 1.0})
        # a column that the version of the first row did not have
        store.append_history({"time": 1.0, "cells": 3.0, "energy": 2.0})
        store.settle()
    history = Contents(tmp_path / "out").history()
    assert {name: column.tolist() for name, column in history.items()} == {
        "time": [0.0, 1.0], "cells": [1.0, 3.0]
    }  # fmt: skip


def test_folder_that_holds_something_is_refused_unless_overwritten(tmp_path):
    folder = tmp_path / "out"
    written(folder, [spheroid(30)])
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"not empty.*--overwrite"):
        Store.create(folder, SCENE)
    assert len(Frames(Contents(folder))) == 1
    write_table(folder / "summary.json", {"cells": 30})
    Store.create(folder, SCENE, overwrite=True).close()
    assert len(Frames(Contents(folder))) == 0
    assert not (folder / "summary.json").exists()
    assert (folder / "notes.txt").read_text() == "mine"
    (folder / "frames.h5").mkdir()  # a foreign folder in the place of a file
    with pytest.raises(OutputError, match="cannot remove"):
        Store.create(folder, SCENE, overwrite=True)
    assert (folder / "frames.h5").is_dir()


def test_new_folders_are_taken_and_what_cannot_be_used_is_refused_with_words(tmp_path):
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "empty", tmp_path / "a" / "b"):
        Store.create(folder, SCENE).close()
        assert (folder / "scene.toml").is_file()
    (tmp_path / "file").write_text("x")
    cases = {
        tmp_path / "file": "is a file, not a folder",
        tmp_path / "file" / "out": "Not a directory",
        Path("/proc/multicell-out"): "No such file",
        tmp_path / ("n" * 300): "File name too long",
    }
    for folder, words in cases.items():
        with pytest.raises(OutputError, match=words):
            Store.create(folder, SCENE)


def test_results_that_cannot_be_read_are_refused_with_words(tmp_path):
    with pytest.raises(OutputError, match="no results"):
        Frames(Contents(tmp_path / "nowhere"))
    (tmp_path / "frames.h5").write_bytes(b"not HDF5")
    with pytest.raises(OutputError, match="cannot read"):
        Frames(Contents(tmp_path))
    (tmp_path / "frames.h5").unlink()
    with h5py.File(tmp_path / "frames.h5", "w", libver=("v110", "v110")) as file:
        file.attrs["format"] = 99
    with pytest.raises(
        OutputError, match="has result format 99; this multicell reads formats 5 and 6"
    ):
        Contents(tmp_path).history()


def test_broken_summary_is_refused(tmp_path):
    folder = written(tmp_path / "out", [spheroid(30)])
    for text in ("{", "[1]"):
        (folder / "summary.json").write_text(text)
        with pytest.raises(OutputError, match=r"summary\.json' is damaged"):
            load_result(folder)


def test_summary_is_strict_json(tmp_path):
    summary = {"cells": np.int64(3), "wall": {"total": np.float64(np.nan)}, "list": (1, np.inf)}
    write_table(tmp_path / "summary.json", summary)
    written = json.loads((tmp_path / "summary.json").read_text())
    assert len(written.pop("checksum")) == 8
    assert written == {"cells": 3, "wall": {"total": None}, "list": [1, None]}
    assert to_json(np.arange(2)) == "[\n  0,\n  1\n]"
    assert [entry.name for entry in tmp_path.iterdir()] == ["summary.json"]


def test_result_gives_a_copy_of_its_summary(tmp_path):
    folder = written(tmp_path / "out", [spheroid(30)])
    write_table(folder / "summary.json", {"states": {"necrotic": 1}})
    result = load_result(folder)
    result.summary()["states"]["necrotic"] = 5
    assert result.summary() == {"states": {"necrotic": 1}}
    assert result.scene == SCENE


def test_history_rows_must_agree():
    assert history_columns([]) == {}
    with pytest.raises(ValueError, match="same columns"):
        history_columns([{"time": 0.0}, {"time": 1.0, "cells": 2.0}])


@pytest.mark.slow
def test_report_writes_only_files_that_overwriting_removes(tmp_path):
    frames = growing_frames(count=3, last=60)
    folder = written(tmp_path / "out", frames)
    write_table(folder / "summary.json", {"cells": len(frames[-1].cells)})
    load_result(folder).report()
    # one cell type, no pull, one field, no table of cells
    expected = set(RUN_FILES) - {"contacts.png", "pull.png", "fields.png", *COPIES}
    assert {entry.name for entry in folder.iterdir()} == expected


def test_result_in_memory_needs_a_folder_for_its_report():
    with pytest.raises(OutputError, match="no output folder"):
        Result(None, [], {}, {}, SCENE).report()


def test_fields_of_different_size_keep_their_order(tmp_path):
    full = spheroid(20)
    shapes = [(2, 3, 4), (5, 1, 2), (3, 3, 3)]
    frames = []
    for k, shape in enumerate(shapes):
        values = np.arange(np.prod(shape), dtype=float).reshape(shape) + k
        field = Field("oxygen", "mM", np.full(3, -k, float), 1.0 + k, values)
        frames.append(Frame(k, k, full.cells, full.concentrations, {"oxygen": field}))
    back = Frames(Contents(written(tmp_path / "out", frames)))
    for first, second in zip(frames, back, strict=True):
        assert_same_frame(first, second)
