"""Python as people type it: keywords, both spellings, and errors of one line."""

import re
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

import multicell as mc
from multicell.errors import FrameError, OutputError, SceneError
from multicell.results.history import History

SCENE = mc.load_scene("growth").with_changes({"duration": "2 h", "initial.count": 3})


@pytest.fixture(scope="module")
def result():
    return mc.run(SCENE, threads=1)


def test_keywords_are_changes_beside_the_dict():
    wanted = SCENE.with_changes({"duration": "8 d", "seed": 4})
    assert SCENE.with_changes(duration="8 d", seed=4) == wanted
    assert SCENE.with_changes({"duration": "8 d"}, seed=4) == wanted
    assert SCENE.with_changes() == SCENE


def test_a_dict_of_a_keyword_keeps_the_other_keys_of_its_table():
    scene = mc.load_scene("spheroid")
    changed = scene.with_changes(
        nutrients={"oxygen": {"boundary": "5 %"}}, growth={"cycle_time": "9 h"}
    )
    assert changed == scene.with_changes(
        {"nutrients.oxygen.boundary": "5 %", "growth.cycle_time": "9 h"}
    )
    assert changed.growth.critical_pressure == scene.growth.critical_pressure


def test_a_dict_of_a_keyword_makes_a_table_that_is_not_there():
    scene = mc.load_scene("settle")
    assert scene.growth is None
    assert scene.with_changes(growth={"cycle_time": "9 h"}).growth.cycle_time == 9 * 3600.0
    assert scene.with_changes(growth=None) == scene


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("explain", "multicell explain SCENE"),
        ("plot", "result.plot.section()"),
        ("workprecision", "multicell.compare"),
        ("Run", "no attribute 'Run'"),
    ],
)
def test_names_that_the_package_lacks_are_answered(name, words):
    with pytest.raises(AttributeError, match=re.escape(words)) as caught:
        getattr(mc, name)
    assert (caught.value.name, caught.value.obj) == (name, mc)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: mc.run(SCENE, duration="8 d"), SceneError, "scene.with_changes(duration=...)"),
        (lambda: mc.run(SCENE, progess=True), SceneError, "Did you mean 'progress'?"),
        (lambda: mc.run(SCENE, "out"), SceneError, "For example output='out'"),
        (lambda: mc.run(SCENE, output=5), OutputError, "must be a path"),
        (lambda: mc.run(SCENE, threads="two"), SceneError, "must be a number from 1"),
        (lambda: mc.resume("x", frames=3), SceneError, "Did you mean 'frame'?"),
        (lambda: SCENE.with_changes("duration=2 d"), SceneError, "with_changes(duration='8 d')"),
        (lambda: SCENE.with_changes(["duration"]), SceneError, "must be keys with values"),
        (lambda: SCENE.with_changes(durration="2 d"), SceneError, "Did you mean 'duration'?"),
        (lambda: mc.load_scene({"duration": "2 d"}), SceneError, "mc.Scene.from_dict"),
        (lambda: mc.load_scene(None), SceneError, "no name and no path"),
    ],
)
def test_the_message_says_what_was_meant(call, error, words):
    with pytest.raises(error) as caught:
        call()
    assert words in str(caught.value)


@pytest.mark.parametrize(("part", "key"), [("", "duration"), ("initial", "count")])
def test_scenes_say_how_they_are_changed(part, key):
    target = getattr(SCENE, part) if part else SCENE
    with pytest.raises(FrozenInstanceError, match="with_changes"):
        setattr(target, key, 5)


@pytest.mark.parametrize("place", [100, -4, "last", 1.5])
def test_a_frame_that_is_not_there_is_answered_with_those_that_are(result, place):
    with pytest.raises(FrameError, match=r"the frames 0 to|frames\[-1\] the last"):
        result.frames[place]
    assert issubclass(FrameError, IndexError)  # by which loops over frames end
    assert len(list(result.frames)) == len(result.frames)


def test_errors_are_one_line_in_notebooks_and_all_of_it_when_asked(monkeypatch):
    interactiveshell = pytest.importorskip("IPython.core.interactiveshell")
    shell = interactiveshell.InteractiveShell()
    seen = []
    monkeypatch.setattr(shell, "_showtraceback", lambda kind, value, lines: seen.append(lines))
    shell.run_cell("import multicell as mc; mc.load_scene('spheriod')")
    assert len(seen[0]) == 1
    assert seen[0][0].startswith("SceneError: there is no scene named 'spheriod'")
    for setting, traceback in (("0", False), ("false", False), ("1", True)):
        monkeypatch.setenv("MULTICELL_DEBUG", setting)
        shell.run_cell("mc.load_scene('spheriod')")
        assert ("Traceback" in "".join(seen[-1])) == traceback


def test_colour_has_both_spellings(result):
    both = [result.plot.section(**{name: "pressure"}) for name in ("colour", "color")]
    assert both[0]._repr_png_() == both[1]._repr_png_()
    with pytest.raises(OutputError, match="two names of one option"):
        result.plot.section(colour="pressure", color="state")
    assert result.frames[-1].plot(color="pressure")._repr_png_() == both[0]._repr_png_()


def test_a_history_prints_in_ten_lines(result):
    text = repr(result.history)
    lines = text.splitlines()
    assert len(lines) <= 10
    assert max(map(len, lines)) <= 96
    assert lines[0].startswith(f"<history: {len(result.history['time'])} rows of ")
    assert lines[1].split()[:2] == ["time", "(s)"]
    assert float(lines[2].split()[0]) == 0.0
    assert float(lines[-2].split()[0]) == result.history["time"][-1]
    assert result.history._repr_html_().startswith("<pre>&lt;history: ")


@pytest.mark.parametrize("rows", [0, 1, 5, 6, 7])
def test_short_histories_show_each_row_once(rows):
    text = repr(History({"time": np.arange(rows, dtype=float)}))
    shown = [line.strip() for line in text.splitlines()[2:]]
    whole = [f"{k}" for k in range(rows)]
    assert shown == (whole if rows <= 6 else [*whole[:3], "…", *whole[-3:]])
    assert repr(History({})).startswith("<history: 0 rows of 0 columns")
