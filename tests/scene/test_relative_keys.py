"""Concentrations that are parts of others: in files, changes and fits."""

import pytest

import multicell as mc
from multicell import Scene, SceneError
from multicell.units import oxygen_solubility, to_base


def scene(**oxygen):
    field = {"boundary": "0.1 mM", "quiescence": "0.02 mM", "necrosis": "0.4 quiescence", **oxygen}
    return Scene.from_dict({"duration": "1 h", "growth": {}, "nutrients": {"oxygen": field}})


def test_a_part_of_another_concentration():
    field = scene().nutrients["oxygen"]
    assert field.necrosis == 0.4 * 0.02
    chain = scene(quiescence="0.5 hypoxia", hypoxia="20 mmHg").nutrients["oxygen"]
    level = to_base("20 mmHg", "kPa", "hypoxia") * oxygen_solubility(37.0)
    assert chain.necrosis == pytest.approx(0.4 * 0.5 * level, rel=1e-14)
    assert scene(boundary="5quiescence").nutrients["oxygen"].boundary == 5.0 * 0.02


def test_it_follows_changes_and_files_until_it_is_set_itself(tmp_path):
    first = scene()
    changed = first.with_changes({"nutrients.oxygen.quiescence": "0.03 mM"})
    assert changed.nutrients["oxygen"].necrosis == 0.4 * 0.03
    file = tmp_path / "scene.toml"
    file.write_text(changed.to_toml(), encoding="utf-8")
    again = mc.load_scene(file)
    assert again == changed
    further = again.with_changes({"nutrients.oxygen.quiescence": "0.05 mM"})
    assert further.nutrients["oxygen"].necrosis == 0.4 * 0.05
    key = "nutrients.oxygen.relative.necrosis.factor"
    assert further.with_changes({key: 0.2}).nutrients["oxygen"].necrosis == 0.2 * 0.05
    text = further.with_changes({"nutrients.oxygen.necrosis": "0.1 quiescence"})
    assert text.nutrients["oxygen"].necrosis == 0.1 * 0.05
    own = further.with_changes({"nutrients.oxygen.necrosis": "0.001 mM"})
    assert not own.nutrients["oxygen"].relative
    later = own.with_changes({"nutrients.oxygen.quiescence": "0.06 mM"})
    assert later.nutrients["oxygen"].necrosis == 0.001


def test_a_fit_may_vary_the_part_and_what_it_is_of():
    data = {"time / h": [1.0], "diameter / um": [20.0]}
    free = {"nutrients.oxygen.quiescence": "0.01:0.05 mM",
            "nutrients.oxygen.relative.necrosis.factor": "0.2:0.8"}  # fmt: skip
    from multicell.calibration.fitting.fit import plan_fit

    problem = plan_fit(scene(), data, free).problem
    made = scene().with_changes(problem.values([0.5, 0.5]))
    assert made.nutrients["oxygen"].necrosis == pytest.approx(0.5 * 0.03, rel=1e-12)


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ({"necrosis": "1.5 quiescence"}, "necrosis.*must be below quiescence"),
        ({"necrosis": "0.4 growth_inhibition"}, "necrosis.*a part of growth_inhibition"),
        ({"quiescence": "2 necrosis"}, "depends on itself"),
        ({"necrosis": "0.4 uptake"}, "necrosis"),
        ({"necrosis": "0 quiescence"}, "factor.*above 0"),
        ({"relative": {"uptake": {"factor": 1, "to": "quiescence"}}}, "relative.uptake"),
    ],
)
def test_relations_that_make_no_sense_are_refused(field, words):
    with pytest.raises(SceneError, match=f"nutrients.oxygen.*{words}"):
        scene(**field)
