"""Results in a notebook: short words, a picture with the view, frames by their time, a bar."""

import pickle
import re
from html import unescape

import numpy as np
import pytest

import multicell as mc
from multicell.cells import State
from multicell.results.frame import Frame, Named

SMALL = mc.load_scene("growth").with_changes({"duration": "4 h", "output.every": "1 h"})


@pytest.fixture(scope="module")
def result():
    return mc.run(SMALL)


def test_everything_is_described_in_a_line(result):
    frame = result.frames[-1]
    for shown in map(repr, (result, result.scene, frame, frame.cells, result.frames)):
        assert len(shown) < 300
        assert "\n" not in shown


def test_a_run_is_shown_with_its_picture_and_its_view(result):
    html = result._repr_html_()
    assert result.scene.title in html
    assert html.count("<img alt=") == 1
    (inside,) = re.findall(r'srcdoc="([^"]*)"', html)
    page = unescape(inside)
    assert page.lstrip().startswith("<!DOCTYPE html>")
    assert "default-src 'none'" in page
    assert 'id="viewer-data"' in page


def test_a_run_without_frames_is_shown_without_picture(result):
    html = mc.Result(None, [], {}, {}, SMALL)._repr_html_()
    assert "<img" not in html
    assert "<iframe" not in html


def test_a_scene_is_shown_with_all_its_keys():
    scene = SMALL.with_changes({"title": "<b>&"})
    html = scene._repr_html_()
    assert "<b>&lt;b&gt;&amp;</b>" in html
    assert unescape(html).count("coupling_step = ") == 1


@pytest.mark.parametrize(("asked", "hours"), [("2 h", 2), (2.4 * 3600, 2), ("160 min", 3), (0, 0)])
def test_a_frame_is_found_by_its_time(result, asked, hours):
    assert result.at(asked).time == 3600.0 * hours


@pytest.mark.parametrize(
    ("asked", "error", "words"),
    [("5 h", mc.OutputError, "no frame at 5 h: it goes from 0 h to 4 h"),
     (-1.0, mc.OutputError, "no frame at"), ("3 um", mc.SceneError, "time: is '3 um'")],
)  # fmt: skip
def test_times_without_a_frame_are_refused(result, asked, error, words):
    with pytest.raises(error, match=words):
        result.at(asked)


def test_frames_of_a_folder_are_found_and_drawn(result, tmp_path):
    mc.run(SMALL, output=tmp_path / "out", report=False)
    again = mc.load_result(tmp_path / "out")
    frame = again.at("3 h")
    np.testing.assert_array_equal(frame.cells.position, result.at("3 h").cells.position)
    assert frame.plot(plane="x").axes
    assert f"in '{tmp_path / 'out'}'" in repr(again)


def test_a_frame_of_no_result_cannot_be_drawn():
    frame = Frame(0.0, 0, mc.Simulation(SMALL).cells)
    with pytest.raises(ValueError, match="only frames of a result"):
        frame.plot()


def test_wrong_names_are_answered_with_near_ones(result):
    with pytest.raises(KeyError, match=r"history 'diametr'\. Did you mean 'diameter'"):
        result.history["diametr"]
    with pytest.raises(KeyError, match="no field 'oxygen'"):
        result.frames[-1].fields["oxygen"]
    again = pickle.loads(pickle.dumps(Named({"a": 1}, "thing")))
    assert again == {"a": 1}
    with pytest.raises(KeyError, match="no thing 'b'"):
        again["b"]


def test_states_are_categories_in_their_order(result):
    table = result.to_pandas("cells")
    assert table["state"].dtype == "category"
    counts = table.groupby("state", observed=False).size()
    assert list(counts.index) == [state.name.lower() for state in State]
    assert counts["proliferating"] == sum(len(frame.cells) for frame in result.frames)
    frame = result.frames[-1]
    again = mc.run(SMALL.with_changes({"duration": "30 min"}), cells=frame.to_pandas())
    np.testing.assert_array_equal(again.frames[0].cells.position, frame.cells.position)


def test_a_bar_goes_to_the_end(capsys):
    mc.run(SMALL, progress=True)
    shown = capsys.readouterr().err
    assert "100 %|" in shown
    assert re.search(r"4\.00 of 4 h, \d+ cells?", shown)
    mc.run(SMALL, progress=False)
    assert capsys.readouterr().err == ""
