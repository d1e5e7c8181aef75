"""Plans: written and read back exactly, refused with words before anything runs."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich_medium import RICH

import multicell as mc
from multicell import OutputError, SceneError
from multicell.studies.plan import make_plan, read_plan
from multicell.studies.runs import run_digest
from multicell.studies.study import write_study

OXYGEN, GLUCOSE = "nutrients.oxygen.boundary", "nutrients.glucose.boundary"
EMT6 = mc.load_scene(RICH)
GRID = {OXYGEN: "0.07,0.14,0.28 mM", GLUCOSE: [0.8, "1.8 mM"], "contact.law": "jkr,hertz"}


def write(folder, text, scene=EMT6):
    folder.mkdir(exist_ok=True)
    (folder / "scene.toml").write_text(scene.to_toml(), encoding="utf-8")
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return folder


PLANS = {
    "grid": {"vary": GRID, "seeds": 3},
    "nothing": {},
    "seeds": {"seeds": 4},
    "list": {
        "points": {OXYGEN: [0.1, 0.1], GLUCOSE: ["0.8 mM", "1.8 mM"], "contact.law": ["jkr"] * 2}
    },
    "rows": {"points": [{OXYGEN: 0.1, "stop_cells": 5}, {"stop_cells": 6, OXYGEN: 0.1}]},
    "frame": {"points": pd.DataFrame({OXYGEN: [0.1, 0.2], "contact.law": ["jkr", "hertz"]})},
    "lists": {"vary": {"cells.heritable": [["young"], [], ["young", "cycle_time"]]}},
    "true": {"vary": {"growth.phases.M.grows": [True, False]}},
    "numpy": {"vary": {OXYGEN: np.array([0.1, 1 / 3]), "initial.count": np.arange(1, 4)}},
}  # fmt: skip


@pytest.mark.parametrize("name", PLANS)
def test_a_plan_is_read_back_exactly(tmp_path, name):
    plan = make_plan(EMT6, **PLANS[name])
    write_study(plan, tmp_path / "study")
    again = read_plan(tmp_path / "study")
    assert again == plan
    assert again.points == plan.points
    assert again.names == plan.names
    assert again.to_toml() == plan.to_toml()


@given(st.lists(st.floats(1e-6, 1.0), min_size=1, max_size=6, unique=True), st.integers(1, 9))
@settings(max_examples=10)
def test_numbers_are_read_back_exactly(tmp_path_factory, values, seeds):
    plan = make_plan(EMT6, {OXYGEN: values}, seeds=seeds)
    folder = tmp_path_factory.mktemp("plan")
    write_study(plan, folder / "study")
    assert read_plan(folder / "study") == plan


def test_every_run_is_named_by_what_it_is_of():
    plan = make_plan(EMT6, GRID, seeds=3)
    runs = plan.runs([1.0] * len(plan.points))
    assert len({run.name for run in runs}) == 3 * 2 * 2 * 3 == len(runs)
    for run in runs:
        assert run_digest(run.scene) == run.name
        assert run.scene.seed == run.coordinates["seed"]
        assert run.scene.nutrients["oxygen"].boundary == run.coordinates["oxygen.boundary"]
        assert run.scene.nutrients["glucose"].boundary == run.coordinates["glucose.boundary"]
    assert [run.coordinates["seed"] for run in runs[:4]] == [7, 8, 9, 7]


BY_HAND = {
    f'seeds = 2\n[vary]\n"{OXYGEN}" = "0.1, 0.2 mM"\n': 4,
    f'[vary]\n{OXYGEN} = "0.1, 0.2 mM"\n{GLUCOSE} = [0.8, 1.8]\n': 4,
    f'[vary]\n{OXYGEN} = "0.05:0.2:4 mM"\n': 4,
    '[vary.nutrients.oxygen]\nboundary = ["0.1 mM"]\n[vary.contact]\nlaw = "jkr,hertz"': 2,
    f'design = "list"\n[points]\n{OXYGEN} = "0.1,0.1 mM"\n{GLUCOSE} = "1,2 mM"\n': 2,
    "": 1,
}


@pytest.mark.parametrize("text", BY_HAND)
def test_plans_written_by_hand_are_read(tmp_path, text):
    folder = write(tmp_path / "study", text)
    assert len(read_plan(folder).names) == BY_HAND[text]


BAD = {
    f'[vary]\n{OXYGEN} = "0.1"\n{OXYGEN} = "0.2"\n': "not valid TOML",
    f'[vary]\n{OXYGEN} = "0.1"\n"{OXYGEN}" = "0.2"\n': "is varied twice",
    "seeds = 0\n": "seeds: is 0, must be a whole number from 1",
    'design = "list"\n': "points: is missing",
    'design = "lhs"\n': "design: is 'lhs', must be one of grid, list",
    "[points]\ncells.young = [1]\n[vary]\nduration = [1]\n": "cannot stand beside keys",
    "sead = 3\n": "Did you mean 'seeds'",
    '[vary]\nnutrients.oxygen.necrosis = "0.001,0.03 mM"\n':
        "(where nutrients.oxygen.necrosis = '0.03 mM')",
    "x = " + "[" * 5000 + "\n": "not valid TOML",
}  # fmt: skip


@pytest.mark.parametrize("text", BAD)
def test_plans_that_are_none_are_told(tmp_path, text):
    folder = write(tmp_path / "study", text)
    with pytest.raises(SceneError) as error:
        read_plan(folder)
    assert BAD[text] in str(error.value)


def test_files_that_are_no_plans_are_told(tmp_path):
    with pytest.raises(SceneError, match="holds no study"):
        read_plan(tmp_path)
    (tmp_path / "study.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(SceneError, match="not UTF-8"):
        read_plan(tmp_path)


def test_a_point_that_the_scene_refuses_is_told_with_its_values():
    with pytest.raises(SceneError) as error:
        make_plan(
            EMT6,
            {
                "nutrients.oxygen.necrosis": "0.001,0.015 mM",
                "nutrients.oxygen.quiescence": "0.01,0.02 mM",
            },
        )
    assert error.value.path == "nutrients.oxygen.necrosis"
    assert "necrosis = '0.015 mM', nutrients.oxygen.quiescence = '0.01 mM'" in str(error.value)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"points": {"contact.law": ["jkr", "hertz"], "contact.surface_energy": [0.02] * 2}},
         "has no meaning where"),
        ({"vary": {OXYGEN: "1000 uM, 1 mM"}}, "'1000 uM' and nutrients.oxygen.boundary = '1 mM'"),
        ({"points": {"contact.law": ["jkr", "jkr"]}}, "contact.law: makes no difference"),
    ],
)  # fmt: skip
def test_points_whose_scenes_are_equal_are_told(given, said):
    with pytest.raises(SceneError) as error:
        make_plan(EMT6, **given)
    assert said in str(error.value)


def test_seeds_must_fit_behind_that_of_the_scene():
    scene = EMT6.with_changes({"seed": 2**63 - 2})
    assert len(make_plan(scene, seeds=2).names) == 2
    with pytest.raises(SceneError, match="end too high"):
        make_plan(scene, seeds=3)


WIDER = [
    {"vary": {OXYGEN: [0.1, 0.2]}, "seeds": 2},
    {"vary": {OXYGEN: [0.1, 0.2]}, "seeds": 3},
    {"vary": {OXYGEN: [0.2, 0.15, 0.1]}, "seeds": 3},
    {"vary": {OXYGEN: [0.2, 0.15, 0.1], GLUCOSE: ["5.5 mM", "0.8 mM"]}, "seeds": 3},
]


def test_a_study_is_widened_step_by_step(tmp_path):
    folder, before = tmp_path / "study", set()
    for options in WIDER:
        study = mc.study(EMT6, output=folder, **options)
        names = set(study.plan.names)
        assert names > before
        before = names
        assert mc.load_study(folder).plan == study.plan


@pytest.mark.parametrize(
    ("scene", "options", "said"),
    [
        (EMT6, {"seeds": 1}, "of which 4 are not in this one"),
        (EMT6, {"vary": {OXYGEN: [0.1]}, "seeds": 9}, "of which 2 are not in this one"),
        (EMT6.with_changes({"duration": "8 d", "cells.young": 2.0}), WIDER[0],
         "another scene: it differs in duration, cells"),
        (mc.load_scene("growth"), {}, "another scene"),
    ],
)  # fmt: skip
def test_another_study_is_not_put_into_a_folder(tmp_path, scene, options, said):
    folder = tmp_path / "study"
    mc.study(EMT6, output=folder, **WIDER[0])
    text = (folder / "study.toml").read_text()
    with pytest.raises(OutputError) as error:
        mc.study(scene, output=folder, **options)
    assert said in str(error.value)
    assert error.value.exit_code == 2
    assert (folder / "study.toml").read_text() == text
    mc.study(scene, output=folder, overwrite=True, **options)
    assert mc.load_study(folder).plan.scene == scene


def test_a_title_is_no_other_scene(tmp_path):
    mc.study(EMT6, output=tmp_path / "study", **WIDER[0])
    study = mc.study(EMT6.with_changes({"title": "x"}), output=tmp_path / "study", **WIDER[0])
    assert study.plan.scene.title == "x"


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(OutputError, match="is not empty"):
        mc.study(EMT6, output=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize("file", ["study.toml", "scene.toml"])
def test_a_plan_that_is_cut_short_is_no_other_plan(file, tmp_path):
    folder = tmp_path / "study"
    mc.study(EMT6, output=folder, **WIDER[0])
    plan, path = mc.load_study(folder).plan, folder / file
    text = path.read_text()
    for size in (*range(0, len(text.rstrip()) - 8, 37), text.rindex("\n# end")):
        path.write_text(text[:size])
        with pytest.raises((SceneError, OutputError)):
            mc.load_study(folder)
        with pytest.raises((SceneError, OutputError)):
            mc.study(EMT6, output=folder, **WIDER[0])
    mc.study(EMT6, output=folder, overwrite=True, **WIDER[0])
    assert mc.load_study(folder).plan == plan
    assert path.read_text() == text


def test_an_edited_plan_is_read_and_what_it_leaves_out_is_named(tmp_path):
    folder = tmp_path / "study"
    study = mc.study(EMT6, output=folder, **WIDER[0])
    for name in (*study.plan.names, f"{study.plan.names[0]}.damaged-1"):
        (folder / "runs" / name).mkdir(parents=True)
    path = folder / "study.toml"
    path.write_text(path.read_text().replace("seeds = 2", "seeds = 1") + "# a remark\n")
    edited = mc.load_study(folder)
    left = set(study.plan.names) - set(edited.plan.names)
    assert len(left) == 2
    assert set(edited.others()) == {*left, f"{study.plan.names[0]}.damaged-1"}


def test_a_plan_of_an_older_version_has_no_mark_at_its_end(tmp_path):
    text = 'scene = "scene.toml"\nseeds = 2\n\n[vary]\ncontact.law = ["jkr", "hertz"]\n'
    assert len(read_plan(write(tmp_path / "study", text)).names) == 4
