"""Partial pressures of oxygen, by tables that are not ours."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from rich_medium import MUCH_OXYGEN, SCALE

from multicell.cli.main import main
from multicell.errors import SceneError
from multicell.runner import run
from multicell.scene.scene import Scene, load_scene
from multicell.studies.axes import parse_axis
from multicell.units import oxygen_solubility, to_base, vapour_pressure

MMHG = 0.133322387  # kPa


def scene(name="oxygen", **nutrient):
    return Scene.from_dict({"duration": "1 h", "nutrients": {name: nutrient}})


@pytest.mark.parametrize("text", ["40 mmHg", "5.332896 kPa", "53.32896 mbar", "40 torr"])
def test_a_pressure_becomes_a_concentration(text):
    found = scene(boundary=text).nutrients["oxygen"].boundary
    assert found == pytest.approx(40 * MMHG * oxygen_solubility(37.0), rel=1e-5)
    cool = scene(boundary=text, temperature=20).nutrients["oxygen"].boundary
    assert cool == pytest.approx(40 * MMHG * oxygen_solubility(20.0), rel=1e-5)
    assert cool > 1.2 * found


@pytest.mark.parametrize("name", ["O2", "o2", "pO2", "Oxygen"])
def test_oxygen_has_the_names_that_people_give_it(name):
    found = scene(name, boundary="40 mmHg", temperature=20).nutrients[name].boundary
    assert found == pytest.approx(40 * MMHG * oxygen_solubility(20.0), rel=1e-5)
    with pytest.raises(SceneError, match=rf"nutrients\.{name}\.boundary: is 21 mM, but under pure"):
        scene(name, boundary=21)
    with pytest.raises(SceneError, match="Only of the field named 'oxygen'"):
        scene(f"{name}_2", boundary="40 mmHg")
    assert scene("glucose", boundary=21).nutrients["glucose"].boundary == 21.0


def test_as_a_level_of_other_parts_of_a_scene():
    cool = 20.0
    made = Scene.from_dict(
        {
            "duration": "1 h",
            "nutrients": {
                "oxygen": {"temperature": cool, "initial": "medium", "regime": "transient"},
                "glucose": {"uptake_on": {"oxygen": {"effect": 1.0, "half": "5 %"}}},
                "waste": {"uptake": 0, "regime": "transient"},
            },
            "responses": {"a": {"behaviour": "speed", "signal": "oxygen", "law": "table",
                                "points": [["1 %", 0.2], ["40 mmHg", 1]]}},
            "motility": {},
        }
    )  # fmt: skip
    share = (101.325 - vapour_pressure(cool)) * oxygen_solubility(cool)
    pressure = MMHG * oxygen_solubility(cool)
    assert made.nutrients["glucose"].uptake_on["oxygen"].half == pytest.approx(0.05 * share)
    curve = made.responses["a"].points
    assert curve[0][0] == pytest.approx(0.01 * share)
    assert curve[1][0] == pytest.approx(40 * pressure, rel=1e-6)
    changed = made.with_changes({"nutrients.glucose.uptake_on.oxygen.half": "10 %"})
    assert changed.nutrients["glucose"].uptake_on["oxygen"].half == pytest.approx(0.1 * share)


def test_along_an_axis_of_a_study():
    made = scene(boundary=0.1, media=[["1 h", 0.1]])
    axis = parse_axis("nutrients.oxygen.boundary", "1,5,20.946 %", made)
    assert axis.numbers[2] / axis.numbers[0] == pytest.approx(20.946)
    assert axis.numbers[1] == scene(boundary="5 %").nutrients["oxygen"].boundary
    media = parse_axis("nutrients.oxygen.media", [[["1 h", "5 %"]], [["1 h", "40 mmHg"]]], made)
    assert len(media.values) == 2


def test_wherever_a_concentration_stands():
    half = MMHG * oxygen_solubility(37.0)
    made = scene(
        boundary="160 mmHg", half_saturation="2 mmHg", quiescence="8 mmHg", necrosis="1 mmHg",
        growth_half_saturation="3 mmHg", media=[["1 h", "20 mmHg"], [7200.0, 0.1]],
        sides={"x-": {"value": "7 mmHg"}},
    ).nutrients["oxygen"]  # fmt: skip
    found = [made.boundary, made.half_saturation, made.quiescence, made.necrosis,
             made.growth_half_saturation, made.media[0][1], made.sides["x-"].value]  # fmt: skip
    assert found == pytest.approx([k * half for k in (160, 2, 8, 1, 3, 20, 7)], rel=1e-6)
    assert made.media[1] == (7200.0, 0.1)


REFUSED = {
    "another field": (("glucose", {"boundary": "40 mmHg"}), "glucose.boundary", "partial pressure"),
    "a part of a gas": (("glucose", {"boundary": "5 %"}), "glucose.boundary", "part of a gas"),
    "more than all": (("oxygen", {"quiescence": "101 %"}), "oxygen.quiescence", "at most 100 %"),
    "less than nothing": (("oxygen", {"boundary": "-1 %"}), "oxygen.boundary", "at least 0"),
    "no pressure": (("oxygen", {"uptake": "3 mmHg"}), "oxygen.uptake", "an amount per time"),
    "too warm": (("oxygen", {"boundary": "3 mmHg", "temperature": 90}), "oxygen.temperature",
                 "at most 60"),
    "no number": (("oxygen", {"boundary": "3 mmHg", "temperature": "warm"}), "oxygen.temperature",
                  "number"),
    "beyond any": (("oxygen", {"boundary": "3 mmHg", "temperature": -300.0}),
                   "oxygen.temperature", "at least 0"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_words(case):
    (name, nutrient), path, words = REFUSED[case]
    with pytest.raises(SceneError) as caught:
        scene(name, **nutrient)
    assert caught.value.path == f"nutrients.{path}"
    assert words in str(caught.value)


def test_a_concentration_stays_what_it_is():
    assert scene(boundary="0.07 mM").nutrients["oxygen"].boundary == to_base("0.07 mM", "mM")
    assert scene("glucose", boundary=0.07).nutrients["glucose"].boundary == 0.07


TOO_MUCH = {
    "boundary": 21.0, "media": [[0.0, 0.1], ["1 h", "1.1 mM"]], "sides.x-": {"value": 5.0},
    "quiescence": 8.0, "necrosis": 2.0, "hypoxia": 5.0, "necrosis_above": 90.0,
    "growth_half_saturation": 5.0, "growth_inhibition": 60.0,
}  # fmt: skip


@pytest.mark.parametrize("key", TOO_MUCH)
def test_more_oxygen_than_dissolves_is_refused(key):
    """21 without a unit is 21 mM, and pure oxygen has 1 mM."""
    changes = {f"nutrients.oxygen.{key}": TOO_MUCH[key]}
    if key == "necrosis":
        changes["nutrients.oxygen.quiescence"] = None
    with pytest.raises(
        SceneError, match=r"under pure oxygen water dissolves 1 mM.*'[\d.]+ %'"
    ) as it:
        load_scene("spheroid").with_changes(changes)
    assert it.value.path == f"nutrients.oxygen.{key.replace('x-', 'x-.value')}"
    other = {"nutrients.glucose": {"necrosis": 1e-3, "quiescence": 9.0}}
    if key == "boundary":
        load_scene("spheroid").with_changes({**other, "nutrients.glucose.boundary": 21.0})


@pytest.mark.parametrize("keys", [{"law": "hill", "half": 5}, {"law": "threshold", "half": "8 mM"},
                                  {"law": "linear", "begin": 0.1, "end": 21},
                                  {"law": "table", "points": [[0.0, 0.0], [21, 1.0]]}])  # fmt: skip
def test_responses_to_more_than_dissolves_are_refused(keys):
    response = {"behaviour": "growth rate", "signal": "oxygen", **keys}
    with pytest.raises(SceneError, match="under pure oxygen water dissolves"):
        load_scene("spheroid").with_changes({"responses": [response]})


@pytest.mark.parametrize(("level", "celsius"), [("100 %", 37), (1.0, 37), ("100 %", 10), (1.0, 60)])
def test_what_dissolves_of_pure_oxygen_is_accepted(level, celsius):
    assert scene(boundary=level, temperature=celsius).nutrients["oxygen"].boundary >= 1.0


DOORS = {
    "run": ["run", "spheroid", "-o", "out", "--set", "nutrients.oxygen.boundary=21"],
    "explain": ["explain", "spheroid", "--set", "nutrients.oxygen.boundary=21"],
    "play": ["play", "spheroid", "--no-browser", "--key", "nutrients.oxygen.boundary=1:21"],
    "study": ["study", "new", "spheroid", "-o", "out", "--vary", "nutrients.oxygen.boundary=1,21"],
    "fit": ["fit", "spheroid", "--data", "data.csv", "-o", "out", "--free",
            "nutrients.oxygen.boundary=1:21"],
    "sensitivity": ["sensitivity", "spheroid", "-o", "out", "--free",
                    "nutrients.oxygen.boundary=1:21", "--observable", "cells"],
}  # fmt: skip


@pytest.mark.parametrize("door", DOORS)
def test_no_command_runs_at_21_mM(door, tmp_path, monkeypatch):  # noqa: N802
    monkeypatch.chdir(tmp_path)
    Path("data.csv").write_text("day, cells\n1, 3\n2, 5\n", "utf-8")
    answer = CliRunner().invoke(main, DOORS[door])
    said = " ".join(answer.output.split())
    assert answer.exit_code == 2, said
    assert "21 mM, but under pure oxygen water dissolves" in said


def test_much_oxygen_for_the_uptake_gives_the_figures_of_more_than_dissolves(monkeypatch):
    """Concentrations, thresholds and uptake over one number: the same fields over it."""
    ball = load_scene("spheroid").with_changes(
        {"initial.count": 300, "initial.stage": "asynchronous", "duration": "1 h"}
    )
    much = run(ball.with_changes(MUCH_OXYGEN), threads=1)
    monkeypatch.setattr("multicell.scene.checks._check_oxygen", lambda *_: None)
    beyond = run(ball.with_changes({"nutrients.oxygen.boundary": 5.0}), threads=1)
    for name, values in beyond.history.items():
        scale = SCALE if "uptake" in name else 1.0
        np.testing.assert_array_equal(much.history[name] * scale, values, err_msg=name)


@pytest.mark.parametrize("text", ["5 percent", "5 per cent", "5percent", "5 %"])
def test_percentages_in_words(text):
    expected = scene(boundary="5 %").nutrients["oxygen"].boundary
    assert scene(boundary=text).nutrients["oxygen"].boundary == expected
    with pytest.raises(SceneError, match="part of a gas"):
        scene("glucose", boundary=text)


def test_torr_in_both_spellings():
    found = [scene(boundary=text).nutrients["oxygen"].boundary for text in ("160 Torr", "160 torr")]
    assert found == pytest.approx([160 / 760 * 101.325 * oxygen_solubility(37.0)] * 2)
