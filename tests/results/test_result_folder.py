"""One run at a time in a folder, links that are never followed, and a file that others can open."""

import errno
import os
import runpy
import shutil
import tomllib
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from stored import written
from synthetic import SCENE, growing_frames, spheroid

import multicell as mc
from multicell.cli.main import main
from multicell.errors import OutputError
from multicell.report.plots.run import PICTURES
from multicell.results import folder as folder_module
from multicell.results import hdf5
from multicell.results.folder import LOCK, write_text
from multicell.results.hdf5 import write_hdf5
from multicell.results.journal import array_digest
from multicell.results.lineage import LINEAGE_COLUMNS, Lineage
from multicell.results.reader import Contents, Frames
from multicell.results.records import arrays_of, log_arrays
from multicell.results.writer import Store

QUICK = {"duration": "4 min", "output.every": "1 min", "initial.count": 12}
ARGUMENTS = ["--set", "duration=4 min", "--set", "initial.count=12", "--no-report", "--quiet"]


def test_h5py_pandas_and_xarray_open_the_file(tmp_path):
    frames = growing_frames(count=4, last=300)
    folder = written(tmp_path / "out", frames)
    # a copy of the one file is complete
    path = shutil.copy(folder / "frames.h5", tmp_path / "copy.h5")
    shutil.rmtree(folder)
    count = sum(len(frame.cells) for frame in frames)
    with h5py.File(path) as file:
        radius = file["cells/radius"][()]
        offset = file["offsets"]["frames"]
        table = pd.DataFrame({name: file["cells"][name][()] for name in ("id", "radius", "state")})
        history = pd.DataFrame(file["history"][()])
        scene = tomllib.loads(file["scene"][()].tobytes().decode())
    assert mc.Scene.from_dict(scene) == SCENE
    assert len(table) == count
    last = frames[-1].cells
    np.testing.assert_array_equal(radius[offset[-2] : offset[-1]], last.radius)
    assert table["radius"].iloc[-len(last) :].tolist() == last.radius.tolist()
    assert history["time"].tolist() == [frame.time for frame in frames]
    with xr.open_dataset(path, group="cells", engine="h5netcdf", phony_dims="sort") as cells:
        assert cells["radius"].attrs["unit"] == "um"
        np.testing.assert_array_equal(cells["radius"].values, radius)
        assert cells["position"].shape == (count, 3)
    with xr.open_dataset(path, engine="h5netcdf", phony_dims="sort") as tables:
        np.testing.assert_array_equal(tables["history"].values["cells"], history["cells"])


def without_tables(path):
    """Write a file in the layout of format 5: each column of a table is a data set."""
    with h5py.File(path, "r+") as file:
        digest = file["history"].attrs["digest"]
        logs = [f"lineage/{log}" for log in file["lineage"]]
        tables = ("frames", "history", *logs, "offsets")
        for name in tables:
            if isinstance(file[name], h5py.Group):  # a history that no table can hold
                continue
            table, units = file[name][()], file[name].attrs["unit"]
            del file[name]
            for field, unit in zip(table.dtype.names, units, strict=True):
                column = f"{field}/offset" if name == "offsets" else f"{name}/{field}"
                file[column] = table[field]
                file[column].attrs["unit"] = unit
        file["history"].attrs["digest"] = digest
        file.attrs["format"] = 5
        return [*file["frames"], *file["lineage/births"]]


def test_files_without_tables_are_read_and_resumed(tmp_path):
    new, old = tmp_path / "new", tmp_path / "old"
    scene = mc.load_scene("spheroid").with_changes(
        {"initial.count": 40, "initial.stage": "asynchronous", "duration": "40 min",
         "output.every": "10 min"})  # fmt: skip
    mc.run(scene, output=new, report=False, threads=1)
    shutil.copytree(new, old)
    columns = ["digest", "offset", "step", "time", "id", "kind", "offset", "parent", "time"]
    assert without_tables(old / "frames.h5") == columns
    one, other = mc.load_result(new), mc.load_result(old)
    assert len(one.frames) == len(other.frames) == 5
    for frame, same in zip(one.frames, other.frames, strict=True):
        np.testing.assert_equal(arrays_of(frame, ["oxygen"]), arrays_of(same, ["oxygen"]))
    np.testing.assert_equal(dict(one.history), dict(other.history))
    np.testing.assert_equal(one.lineage, other.lineage)
    with h5py.File(old / "frames.h5", "r+") as file:
        file["history/radius"][1] += 1.0
    with pytest.raises(OutputError, match=r"the history in .* is not what was written"):
        dict(mc.load_result(old).history)
    shutil.copytree(new, old, dirs_exist_ok=True)
    without_tables(old / "frames.h5")
    for folder in (new, old):
        mc.resume(folder, changes={"duration": "1 h"}, report=False, threads=1)
    one, other = mc.load_result(new).frames, mc.load_result(old).frames
    assert len(one) == len(other) == 7
    assert one[6].cells.position.tobytes() == other[6].cells.position.tobytes()


def measures(names, folder):
    """Return observables of some names: the number of cells and the place of the name."""
    text = "import multicell as mc\n" + "".join(
        f"@mc.observable(name={name!r})\n"
        f"def measure_{k}(state):\n    return {k} + len(state.cells)\n"
        for k, name in enumerate(names)
    )
    (folder / "measures.py").write_text(text, encoding="utf-8")
    found = runpy.run_path(str(folder / "measures.py"))
    return [found[f"measure_{k}"] for k in range(len(names))]


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("names", [
    ("offset", "frames", "digest", "offsets", "scene", "history", "ends", "unit"),
    [f"count_of_something_{k}" for k in range(2_000)],
], ids=["like paths", "many"])  # fmt: skip
def test_a_run_keeps_observables_of_any_name_and_number(names, old, tmp_path):
    """Names that columns of the file have, too, and more than a table can have; continued, too."""
    own = measures(names, tmp_path)
    scene = mc.load_scene("settle").with_changes(QUICK).with_observables(*own)
    folder = tmp_path / "out"
    mc.run(scene, output=folder, report=False, threads=1)
    for changes, rows in ((None, 5), ({"duration": "6 min"}, 7)):
        if changes:
            mc.resume(folder, changes=changes, report=False, threads=1)
        path = folder / "frames.h5"
        with h5py.File(path) as file:
            many = len(names) > 1_000
            assert isinstance(file["history"], h5py.Group if many else h5py.Dataset)
        if old:
            without_tables(path)
        history = mc.load_result(folder).history
        assert history["time"].tolist() == [60.0 * k for k in range(rows)]
        for k, name in enumerate(names):
            assert history[name].tolist() == [k + 12.0] * rows, name


@pytest.mark.parametrize("length", [8, 60, 1_000, 14_000, 29_900])
def test_a_history_as_wide_as_a_table_can_be_is_one(length, tmp_path):
    """One with a column more has a group; both come back."""
    count = (30_000 - len("time") - 40) // (length + 40)
    for more in (0, 1):
        row = {"time": 0.0} | {f"{k:0{length}}": float(k) for k in range(count + more)}
        folder = tmp_path / f"{more}"
        with closing(Store.create(folder, SCENE)) as store:
            store.append_history(row)
            store.settle()
        history = Contents(folder).history()
        assert {name: column.tolist() for name, column in history.items()} == {
            name: [value] for name, value in row.items()
        }
        with h5py.File(folder / "frames.h5") as file:
            assert isinstance(file["history"], h5py.Group if more else h5py.Dataset)


def test_fields_by_the_hundred_have_offsets_of_their_own(tmp_path):
    """A table holds as many as it has room for, 502 with these names, beside six others."""
    frame = spheroid(3)
    for count in (502, 503, 1_200):
        names = [f"{k:05}" for k in range(count)]
        found = {name: np.full(len(frame.cells), float(name)) for name in names}
        fields = {names[-1]: replace(frame.fields["oxygen"], name=names[-1])}
        arrays = arrays_of(replace(frame, concentrations=found, fields=fields), names)
        log = log_arrays(Lineage().born(frame.cells, 0.0), dict.fromkeys(LINEAGE_COLUMNS, 0))
        path = tmp_path / f"{count}.h5"
        write_hdf5(path, "", names, [(arrays, array_digest(arrays), log)], {}, "0" * 32)
        hdf5._FRAMES.clear()
        with h5py.File(path) as file:
            assert len(file["offsets"].dtype.names) == 6 + (502 if count == 502 else 0)
        back = hdf5.File(path).frame(0)
        assert {name: a.tobytes() for name, a in back.items()} == {
            name: a.tobytes() for name, a in arrays.items()
        }


def _lose_all(file):
    del file["history"]


def _lose_columns(file):
    digest = file["history"].attrs["digest"]
    del file["history"]
    file.create_group("history").attrs["digest"] = digest


@pytest.mark.parametrize("lose", [_lose_all, _lose_columns])
@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("rows", [0, 3])
def test_a_lost_history_is_damage(rows, old, lose, tmp_path):
    with closing(Store.create(tmp_path / "out", SCENE)) as store:
        for k in range(rows):
            store.append_history({"time": float(k), "cells": 1.0})
        store.append(spheroid(30))
        store.settle()
    path = tmp_path / "out" / "frames.h5"
    if old:
        without_tables(path)
    whole = {name: len(column) for name, column in Contents(path.parent).history().items()}
    assert whole == ({"time": 3, "cells": 3} if rows else {})
    with h5py.File(path, "r+") as file:
        lose(file)
    if lose is _lose_columns and not rows:  # nothing was lost
        assert Contents(path.parent).history() == {}
        return
    with pytest.raises(OutputError, match=r"damaged|not what was written") as found:
        Contents(path.parent).history()
    assert found.value.damaged


def test_journal_and_file_read_the_same(tmp_path):
    frames = growing_frames(count=5, last=200)
    journal = written(tmp_path / "journal", frames, settle=False)
    settled = written(tmp_path / "settled", frames)
    assert {entry.name for entry in journal.iterdir()} == {"scene.toml", "frames.journal"}
    assert {entry.name for entry in settled.iterdir()} == {"scene.toml", "frames.h5"}
    one, other = Contents(journal), Contents(settled)
    assert [place.digest for place in one.places] == [place.digest for place in other.places]
    np.testing.assert_equal(one.history(), other.history())
    # a process that is killed between writing the one and removing the other
    written(tmp_path / "both", frames, settle=False)
    store = Store.create(tmp_path / "crash", SCENE)
    store.append(frames[0])
    shutil.copy(tmp_path / "crash" / "frames.journal", tmp_path / "kept")
    store.settle()
    store.close()
    shutil.copy(tmp_path / "kept", tmp_path / "crash" / "frames.journal")
    assert len(Frames(Contents(tmp_path / "crash"))) == 1
    assert Contents(tmp_path / "crash").journal is None
    # a journal beside a file that it knows nothing of
    shutil.copy(settled / "frames.h5", tmp_path / "both" / "frames.h5")
    with pytest.raises(OutputError, match="one of them is from another run"):
        Frames(Contents(tmp_path / "both"))


def test_a_reader_keeps_its_frames_when_the_run_ends(tmp_path):
    frames = growing_frames(count=3, last=100)
    store = Store.create(tmp_path / "out", SCENE)
    for frame in frames:
        store.append(frame)
    back = Frames(Contents(tmp_path / "out"))
    store.settle()
    store.close()
    for first, second in zip(frames, back, strict=True):
        np.testing.assert_array_equal(first.cells.position, second.cells.position)
    shutil.rmtree(tmp_path / "out")
    written(tmp_path / "out", [spheroid(7), spheroid(8), spheroid(9)])
    with pytest.raises(OutputError, match="it holds another run"):
        back[0]


def test_a_folder_in_which_a_run_goes_on_is_refused(tmp_path):
    scene = mc.load_scene("settle").with_changes(QUICK)
    folder, tried = tmp_path / "out", []

    def try_others(simulation):
        if tried:
            return
        before = len(Frames(Contents(folder)))
        run = ["run", "settle", "-o", str(folder), *ARGUMENTS]
        for arguments, words in (
            (run, "not empty"),
            ([*run, "--overwrite"], "another run uses"),
            (["resume", str(folder), "--no-report", "--quiet"], "another run uses"),
        ):
            done = CliRunner().invoke(main, arguments)
            assert done.exit_code == (2 if words == "not empty" else 3), done.output
            assert words in done.output
            tried.append(words)
        assert len(Frames(Contents(folder))) == before

    result = mc.run(scene, output=folder, report=False, progress=try_others)
    assert len(tried) == 3
    assert len(result.frames) == 5
    assert not (folder / LOCK).exists()
    # nothing is locked any more
    mc.run(scene, output=folder, report=False, overwrite=True)


@pytest.fixture
def settled(whole, tmp_path):
    return Path(shutil.copytree(whole.folder, tmp_path / "out"))


@pytest.mark.usefixtures("one_picture")
def test_links_are_never_followed_out_of_the_folder(settled, tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    names = ["frames.h5", "frames.journal", "scene.toml", "summary.json", "growth.png", LOCK,
             "frames.h5.part", "frames.journal.part", "summary.json.part"]  # fmt: skip
    for name in names:
        (outside / name).write_text("precious")
        (settled / name).unlink(missing_ok=True)
        (settled / name).symlink_to(outside / name)
    scene = mc.load_scene("settle").with_changes(QUICK)
    mc.run(scene, output=settled, overwrite=True)
    for name in names:
        assert (outside / name).read_text() == "precious"
        assert not (settled / name).is_symlink()
    assert mc.load_result(settled).summary()["cells"] == 12
    # tables too
    for name in ("cells", "history"):
        (outside / f"{name}.csv").write_text("precious")
        (tmp_path / "tables").mkdir(exist_ok=True)
        (tmp_path / "tables" / f"{name}.csv").symlink_to(outside / f"{name}.csv")
    mc.export(settled, tmp_path / "tables", tables=["cells", "history"], overwrite=True)
    for name in ("cells", "history"):
        assert (outside / f"{name}.csv").read_text() == "precious"
        assert len((tmp_path / "tables" / f"{name}.csv").read_text()) > 100


def test_a_folder_that_is_a_link_is_written_to_but_not_overwritten(settled, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(settled)
    before = (settled / "frames.h5").read_bytes()
    scene = mc.load_scene("settle").with_changes(QUICK)
    with pytest.raises(OutputError, match="name that folder itself"):
        mc.run(scene, output=link, overwrite=True)
    assert (settled / "frames.h5").read_bytes() == before
    assert len(mc.load_result(link).frames) == 5
    dangling = tmp_path / "dangling"
    dangling.symlink_to(tmp_path / "nowhere")
    with pytest.raises(OutputError, match="is missing"):
        mc.run(scene, output=dangling, overwrite=True)
    new = tmp_path / "new"
    new.mkdir()
    (tmp_path / "to-new").symlink_to(new)
    mc.run(scene, output=tmp_path / "to-new", report=False)
    assert len(mc.load_result(new).frames) == 5


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "out"
    return mc.run(mc.load_scene("settle").with_changes(QUICK), output=folder, report=False)


@pytest.fixture
def one_picture():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("multicell.report.page.PICTURES", {"growth": PICTURES["growth"]})
        yield


@pytest.mark.usefixtures("one_picture")
@pytest.mark.parametrize("stage", ["frames.journal", "frames.h5", "summary.json", "growth.png"])
def test_each_file_that_cannot_be_written_is_one_error(stage, whole, tmp_path, monkeypatch):
    """As on a full disk, at each of the files in turn; see also test_kill_and_full_disk."""
    scene = mc.load_scene("settle").with_changes(QUICK)
    folder = tmp_path / "out"
    _refuse(monkeypatch, stage)
    with pytest.raises(OutputError, match="No space left on device") as caught:
        mc.run(scene, output=folder)
    assert caught.value.exit_code == 3
    assert stage in str(caught.value)
    assert not list(folder.glob("*.part"))
    assert not (folder / LOCK).exists()
    monkeypatch.undo()
    left = mc.load_result(folder)
    assert len(left.frames) == (1 if stage == "frames.journal" else 5)
    for one, other in zip(left.frames, whole.frames, strict=False):
        np.testing.assert_array_equal(one.cells.position, other.cells.position)
    if stage == "growth.png":
        with pytest.raises(OutputError, match="To prolong it"):
            mc.resume(folder)
        left.report()
    else:
        mc.resume(folder)
    assert (folder / "report.html").is_file()
    assert mc.load_result(folder).summary()["cells"] == 12
    assert "interrupted" not in mc.load_result(folder).summary()
    for one, other in zip(Contents(folder).places, Contents(whole.folder).places, strict=True):
        assert one.digest == other.digest


def _refuse(monkeypatch, stage):
    """Let the system refuse to write one file, the journal after its first frame."""
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    if stage == "frames.journal":
        write = os.write

        def refused(descriptor, data):
            if os.lseek(descriptor, 0, os.SEEK_CUR) > 4000:
                write(descriptor, data[:500])
                raise full
            return write(descriptor, data)

        monkeypatch.setattr(os, "write", refused)
        return
    new_file = folder_module.new_file

    def limited(path):
        descriptor = new_file(path)
        if path.name == f"{stage}.part":
            os.close(descriptor)
            return os.open("/dev/full", os.O_RDWR)
        return descriptor

    monkeypatch.setattr(folder_module, "new_file", limited)


def test_a_summary_that_cannot_be_written_leaves_the_old_one(tmp_path):
    write_text(tmp_path / "summary.json", "old")
    (tmp_path / "summary.json.part").mkdir()
    with pytest.raises(OutputError, match=r"cannot write .*summary\.json"):
        write_text(tmp_path / "summary.json", "new")
    assert (tmp_path / "summary.json").read_text() == "old"


@pytest.mark.slow
def test_damage_says_what_can_still_be_read(tmp_path):
    folder = tmp_path / "out"
    changes = {**QUICK, "duration": "20 min", "initial.count": 400}
    mc.run(mc.load_scene("settle").with_changes(changes), output=folder, report=False)
    data = bytearray((folder / "frames.h5").read_bytes())
    with h5py.File(folder / "frames.h5") as file:
        chunk = file["cells/position"].id.get_chunk_info(1)
        rows = file["cells/position"].chunks[0]
        first = int(np.searchsorted(file["offsets"]["frames"], rows, side="right")) - 1
    data[chunk.byte_offset + 100] ^= 1
    (folder / "frames.h5").write_bytes(data)
    result = mc.load_result(folder)
    with pytest.raises(OutputError, match=f"frame {first} .* damaged.* --frame {first - 1}"):
        result.frames[first]
    assert len(result.frames[first - 1].cells) == 400
    done = CliRunner().invoke(main, ["resume", str(folder), "--frame", str(first - 1), "--quiet"])
    assert done.exit_code == 0, done.output
    assert len(mc.load_result(folder).frames[first].cells) == 400


@pytest.mark.parametrize(
    ("every", "expected"),
    [("1e-6 s", 5), ("60 s", 5), ("90 s", 4), ("1 h", 2)],
)
def test_frames_are_counted_at_once_however_many_are_due(every, expected):
    """At 0, 60 ... 240 s: of 90 s those at 0, 120, 180 and 240 (the end), of an hour two."""
    scene = mc.load_scene("settle").with_changes({**QUICK, "output.every": every})
    assert len(mc.run(scene).frames) == expected


@pytest.mark.parametrize("name", ["frames.h5", "frames.journal", "scene.toml", "summary.json"])
def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(name, settled):
    (settled / name).unlink(missing_ok=True)
    os.mkfifo(settled / name)
    if name != "frames.journal":
        with pytest.raises(OutputError, match=r"no results|is no file|is no regular file"):
            mc.load_result(settled)
    else:
        assert len(mc.load_result(settled).frames) == 5
