"""Numbers without a unit are named once in words; fields that nobody feels are refused."""

import warnings

import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import main
from multicell.errors import SceneError, UnitWarning
from multicell.scene import bare


@pytest.fixture(autouse=True)
def _nothing_named_before(monkeypatch):
    monkeypatch.setattr(bare, "_NAMED", set())


def noted(make):
    """Return the warnings, each without its module."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        make()
    return [str(one.message) for one in caught if one.category is UnitWarning]


GIVEN = {
    "duration": ({"duration": 12}, "duration: 12 was read as 12 s. Write '12 h' for hours."),
    "a long time": ({"duration": 86400}, "duration: 86400 was read as 86400 s. Write '86400 s' to"),
    "a modulus": ({"cells.young": 3}, "cells.young: 3 was read as 3 kPa. Write '3 kPa' to say so."),
    "a step": ({"coupling_step": 60}, "coupling_step: 60 was read as 60 s. Write '60 s' to say so"),
    "a table": ({"drag": {"viscosity": 2}}, "drag.viscosity: 2 was read as 2 kPa s."),
    "a course": ({"nutrients.oxygen.media": [[7, 0.1]]}, "oxygen.media: 7 was read as 7 s."),
    "a pair": ({"domain": {k: [-50, 50] for k in "xyz"}}, "domain.x: -50 was read as -50 um."),
    "a vector": ({"motions": {"a": {"velocity": [0, 1e-3, 0], "end": 60}}}, "motions.a.end: 60"),
    "two of one key": ({"output.every": 7}, "output.every: 7 was read as 7 s."),
}


@pytest.mark.parametrize("case", GIVEN)
def test_a_bare_number_is_named_once_in_words(case):
    changes, words = GIVEN[case]
    scene = mc.load_scene("spheroid")
    first = noted(lambda: scene.with_changes(changes))
    assert words in first[0]
    assert noted(lambda: scene.with_changes(changes)) == []


PLAIN = {
    "with a unit": {"duration": "12 h", "cells.young": "3 kPa"},
    "of no dimension": {"initial.count": 7, "seed": 3, "cells.poisson": 0.4, "initial.spacing": 1},
    "zero": {"growth.critical_pressure": None, "nutrients.oxygen.decay": 0},
    "as computed": {"duration": 43200.0, "cells.young": 3.5, "nutrients.oxygen.boundary": 0.07},
}


@pytest.mark.parametrize("case", PLAIN)
def test_others_are_not_named(case):
    assert noted(lambda: mc.load_scene("spheroid").with_changes(PLAIN[case])) == []


def test_doors_of_python(tmp_path):
    assert "duration: 600 was read as" in noted(lambda: mc.Scene(duration=600))[0]
    assert "duration: 7 was" in _first(lambda: mc.Scene.from_dict({"duration": 7}))
    file = tmp_path / "mine.toml"
    file.write_text("duration = 12.5\n[cells]\nyoung = 3.0\n", "utf-8")
    assert _first(lambda: mc.load_scene(file)).startswith("duration: 12.5 was read as 12.5 s")
    file.write_text(mc.load_scene(file).to_toml(), "utf-8")
    bare._NAMED.clear()
    assert noted(lambda: mc.load_scene(file)) == []
    for name in mc.scene_names():
        assert noted(lambda name=name: mc.load_scene(name)) == [], name


def _first(make):
    bare._NAMED.clear()
    return noted(make)[0]


def test_the_time_of_a_frame(tmp_path):
    scene = mc.load_scene("doublet").with_changes({"duration": "20 s", "coupling_step": "5 s"})
    result = mc.run(scene, threads=1)
    assert noted(lambda: result.at(1)) == ["time: 1 was read as 1 s. Write '1 h' for hours."]
    assert noted(lambda: result.at(1)) == []
    assert noted(lambda: [result.at("1 s"), result.at(result.frames[-1].time), result.at(0)]) == []


def test_the_warning_stands_where_the_package_was_called():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mc.load_scene("growth").with_changes({"duration": 12})
    assert caught[0].filename == __file__


def test_the_command_line_says_the_same():
    answer = CliRunner().invoke(main, ["explain", "growth", "--set", "duration=18.5", "--set",
                                       "seed=3", "--set", "drag.viscosity=2"])  # fmt: skip
    notes = [line for line in answer.stderr.splitlines() if line.startswith("Note: ")]
    assert sorted(notes) == [
        "Note: drag.viscosity: 2 was read as 2 kPa s. Write '2 kPa s' to say so.",
        "Note: duration: 18.5 was read as 18.5 s. Write '18.5 h' for hours.",
    ]


UNUSED = {
    "a slip": ("growth", "nutrients.oxigen.boundary"),
    "a new one": ("spheroid", "nutrients.drug.boundary"),
    "taken up for nothing": ("spheroid", "nutrients.drug.uptake"),
}


@pytest.mark.parametrize("case", UNUSED)
def test_a_field_that_no_cell_feels_is_not_made_by_one_key(case):
    name, key = UNUSED[case]
    scene = mc.load_scene(name)
    with pytest.raises(SceneError, match="no field of the scene") as caught:
        scene.with_changes({key: 0.1})
    assert caught.value.path == key.rpartition(".")[0]
    felt = scene.with_changes({key: 0.1, f"{key.rpartition('.')[0]}.quiescence": 0.01})
    assert key.split(".")[1] in felt.nutrients
    whole = scene.with_changes({key.rpartition(".")[0]: {}, key: 0.1})
    assert key.split(".")[1] in whole.nutrients
