"""Runs ended before their first result, by a full disk or a kill, begin anew unasked."""

import errno
import os

import numpy as np
import pytest
from stored import assert_same_bits

import multicell as mc
from multicell.errors import OutputError
from multicell.results import folder as folders
from multicell.results.folder import is_begun
from multicell.results.journal import Journal
from multicell.results.writer import Store

SCENE = mc.load_scene("growth").with_changes({"duration": "4 h", "output.every": "2 h"})
FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def full_at(monkeypatch, call):
    """Let the disk be full at one of the first calls that write."""
    left = [call]
    for place, name in ((folders, "put_in_place"), (Journal, "append"), (Store, "append")):
        usual = getattr(place, name)

        def writes(*given, usual=usual, **more):
            left[0] -= 1
            if left[0] < 0:
                raise OutputError("cannot write") from FULL
            return usual(*given, **more)

        monkeypatch.setattr(place, name, writes)


@pytest.mark.parametrize("table", [False, True])
def test_a_run_that_ended_before_its_first_frame_is_begun_anew(table, tmp_path, monkeypatch):
    cells = {"position_x_um": [0.0, 15.0], "position_y_um": [0.0, 0.0], "position_z_um": [0.0, 0.0]}
    options = {"cells": {k: np.array(v) for k, v in cells.items()}} if table else {}
    whole = mc.run(SCENE, output=tmp_path / "whole", report=False, threads=1, **options)
    assert len(whole.frames) == 3
    begun = 0
    for call in range(12):
        out = tmp_path / f"out{call}"
        with monkeypatch.context() as patch:
            full_at(patch, call)
            with pytest.raises(OutputError):
                mc.run(SCENE, output=out, report=False, threads=1, **options)
        if (out / "frames.journal").is_file() and mc.load_result(out).frames:
            break
        begun += 1
        mc.run(SCENE, output=out, report=False, threads=1, **options)
        assert_same_bits(out, tmp_path / "whole")
    assert begun >= 3


def test_what_is_of_another_run_or_the_users_own_is_never_replaced(tmp_path):
    def run(scene=SCENE, **options):
        return mc.run(scene, output=tmp_path, report=False, threads=1, **options)

    (tmp_path / "scene.toml").write_text(SCENE.to_toml() + "# mine\n")
    with pytest.raises(OutputError, match="is not empty"):
        run()
    (tmp_path / "scene.toml").unlink()
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="is not empty"):
        run()
    (tmp_path / "notes.txt").unlink()
    run()
    with pytest.raises(OutputError, match="is not empty"):
        run()
    (tmp_path / "frames.h5").unlink()
    with pytest.raises(OutputError, match="is not empty"):
        run()


def test_only_what_is_to_be_written_counts_as_begun(tmp_path):
    first = {"a": b"one", "b": "two"}
    assert not is_begun(tmp_path, first)
    (tmp_path / "a").write_text("one")
    (tmp_path / "b.part").write_text("t")
    assert is_begun(tmp_path, first)
    (tmp_path / "b").write_text("three")
    assert not is_begun(tmp_path, first)
    assert not is_begun(tmp_path / "none", first)


@pytest.mark.parametrize("kind", ["fit", "study"])
def test_fits_and_studies_that_are_hardly_begun_continue(kind, tmp_path, monkeypatch):
    data = {"time / h": [1.0, 2.0, 4.0], "diameter / um": [20.0, 24.0, 28.0]}
    free = {"growth.cycle_time": "8:25 h"}

    def begin(out):
        if kind == "study":
            return mc.study(SCENE, {"cells.young": "1,2 kPa"}, output=out)
        from multicell.calibration.fitting.fit import plan_fit

        with plan_fit(SCENE, data, free).open_folder(out) as folder:
            return folder

    refused = 0
    for call in range(6):
        out = tmp_path / f"{kind}{call}"
        with monkeypatch.context() as patch:
            full_at(patch, call)
            try:
                begin(out)
                break
            except OutputError as error:
                assert "cannot write" in str(error)  # noqa: PT017
        refused += 1
        begin(out)
    assert refused >= 2
