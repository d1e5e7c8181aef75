"""Frames of the file that was written last: kept as they were read back, while it is the same."""

import numpy as np
import pytest

import multicell as mc
from multicell.results import hdf5
from multicell.results.journal import array_digest


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kept") / "out"
    change = {"duration": "20 min", "output.every": "10 min", "initial.count": 2}
    scene = mc.load_scene("growth").with_changes(change)
    mc.run(scene, output=folder, report=False, threads=1)
    return folder


def test_frames_in_memory_are_those_on_disk_and_belong_to_their_readers(folder):
    file = hdf5.File(folder / "frames.h5")
    assert list(hdf5._FRAMES) == [file.identity]
    found = [file.frame(k) for k in range(3)]
    for arrays in found:
        arrays["cells/position"][:] = np.nan
    found = [file.frame(k) for k in range(3)]
    hdf5._FRAMES.clear()
    on_disk = [file.frame(k) for k in range(3)]
    assert [array_digest(arrays) for arrays in found] == file.digests.tolist()
    assert [array_digest(arrays) for arrays in on_disk] == file.digests.tolist()


@pytest.mark.parametrize("change", [lambda p: p.write_bytes(b""), lambda p: p.unlink()])
def test_frames_of_a_file_that_has_changed_are_read_from_it(folder, change):
    path = folder.with_name("copy.h5")
    path.write_bytes((folder / "frames.h5").read_bytes())
    file = hdf5.File(path, own=True)
    hdf5._note_read_back(path, file)
    assert len(hdf5._FRAMES[file.identity][1]) == 3
    change(path)
    with pytest.raises(mc.OutputError, match=r"cannot read"):
        file.frame(0)


def test_frames_that_take_much_memory_are_not_kept(folder, monkeypatch):
    monkeypatch.setattr(hdf5, "_BATCH", 1000)
    assert hdf5.File(folder / "frames.h5", own=True).take_frames() == []
