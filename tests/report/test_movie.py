"""Moving pictures: one window, one range of colours, all frames."""

import itertools
import re

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from multicell.cli.main import main
from multicell.report.plots.movie import movie


@pytest.mark.slow
def test_a_gif_has_every_frame_in_turn(small_run, tmp_path):
    seen = []
    path = movie(small_run, tmp_path / "a.gif", rate=4.0, progress=lambda k, n: seen.append((k, n)))
    count = len(small_run.frames)
    assert seen == [(k + 1, count) for k in range(count)]
    with Image.open(path) as film:
        assert film.n_frames == count
        assert film.size == (800, 500)
        assert film.info["loop"] == 0
        pictures, rests = [], []
        for k in range(count):
            film.seek(k)
            rests.append(film.info["duration"])
            pictures.append(np.asarray(film.convert("RGB")).astype(int))
    assert rests == [250] * (count - 1) + [1750]  # the last one rests for 1.5 s
    assert all(np.abs(a - b).max() > 60 for a, b in itertools.pairwise(pictures))


@pytest.mark.slow
def test_the_window_and_the_colours_stay(small_run, tmp_path, monkeypatch):
    drawn = []
    from multicell.report.plots import movie as room

    def noted(frame, scene, shade, plane, half):
        drawn.append((half, shade.range))
        return original(frame, scene, shade, plane, half)

    original = room.section
    monkeypatch.setattr(room, "section", noted)
    movie(small_run, tmp_path / "b.gif", colour="pressure", plane="x")
    assert len(set(drawn)) == 1
    every = np.concatenate([frame.cells.pressure for frame in small_run.frames])
    assert drawn[0][1] == pytest.approx(tuple(np.percentile(every, (0.5, 99.5))))


@pytest.mark.slow
def test_a_film_lasts_as_long_as_its_frames(small_run, tmp_path):
    import imageio_ffmpeg

    path = movie(small_run, tmp_path / "c.mp4", rate=5.0)
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    pictures = [np.frombuffer(picture, np.uint8) for picture in reader]
    assert about["size"] == (800, 500)
    assert len(pictures) == len(small_run.frames) + 8  # the last one rests for 1.5 s
    assert np.abs(pictures[0].astype(int) - pictures[-1].astype(int)).max() > 60


REFUSED = {
    "kind": (["-o", "a.avi"], r"must end in \.gif or \.webp or \.mp4"),
    "rate": (["-o", "a.gif", "--rate", "0"], "above 0"),
    "plane": (["-o", "a.gif", "--section", "x=900"], "cuts no cell"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_made_is_said(small_run, tmp_path, monkeypatch, case):
    monkeypatch.chdir(tmp_path)
    options, words = REFUSED[case]
    done = CliRunner().invoke(main, ["movie", str(small_run.folder), *options])
    assert done.exit_code == 2, done.output
    assert re.search(words, done.output)
    assert list(tmp_path.iterdir()) == []
