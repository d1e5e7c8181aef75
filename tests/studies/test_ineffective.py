"""Keys without effect are refused, with the reason and where."""

import pytest
from rich_medium import RICH

import multicell as mc
from multicell import SceneError
from multicell.studies.axes import check_ranges, parse_ranges
from multicell.studies.keys import _RULES, _keys_of, no_effect
from multicell.studies.plan import make_plan

NONE = [
    (RICH, {}, "growth.cycle_time", "phases of the cycle"),
    (RICH, {}, "integrator.step", "chooses its steps"),
    (RICH, {"nutrients.oxygen.media": [[0, 0.1]]}, "nutrients.oxygen.boundary", "'media'"),
    ("sorting", {}, "contact.surface_energy", "surface energy of its own"),
]


@pytest.mark.parametrize(("name", "changes", "key", "said"), NONE)
def test_keys_without_effect(name, changes, key, said):
    scene = mc.load_scene(name).with_changes(changes)
    assert said in no_effect(scene, key)


@pytest.mark.parametrize(
    ("name", "changes", "key"),
    [
        (RICH, {}, "growth.phases.G1.variation"),
        (RICH, {"integrator": "euler"}, "integrator.step"),
        (RICH, {"nutrients.oxygen.media": [["1 d", 0.1]]}, "nutrients.oxygen.boundary"),
    ],
)
def test_keys_with_an_effect(name, changes, key):
    assert no_effect(mc.load_scene(name).with_changes(changes), key) == ""


def test_rules_name_keys_that_there_are():
    """Each rule is of a key that some scene has, so that renamed keys do not leave rules behind."""
    changes = {"types": {"a": {}, "b": {}}}
    scene = mc.load_scene(RICH).with_changes(changes)
    keys = {key.name for key in _keys_of(scene, scene, "", [])}
    missing = [
        rule
        for rules, *_ in _RULES
        for rule in rules.split()
        if not any(
            len(rule.split(".")) == len(key.split("."))
            and all(r in ("*", k) for r, k in zip(rule.split("."), key.split("."), strict=True))
            for key in keys
        )
    ]
    assert missing == []


def planned(scene, **given):
    """Plan what is given: ranges of free parameters, or values of a grid."""
    if all(":" in text for text in given.values()):
        check_ranges(scene, parse_ranges(given, scene))
    else:
        make_plan(scene, given)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            {"contact.law": "jkr,hertz", "contact.surface_energy": "0.1,0.2 nN/um"},
            "contact.surface_energy: has no meaning where contact.law = 'hertz'",
        ),
        (
            {"integrator.method": "euler,cvode", "integrator.step": "1,2 s"},
            "integrator.step: has no effect where integrator.method = 'cvode'",
        ),
        (
            {"growth.phases.S.distribution": "fixed,gamma", "growth.phases.S.variation": "0.1,0.3"},
            "growth.phases.S.variation: has no effect where growth.phases.S.distribution = 'fixed'",
        ),
        ({"growth.cycle_time": "8:25 h"}, "growth.cycle_time: has no effect: the phases"),
        ({"nutrients.oxygen.necrosis": "0.001:0.05 mM"}, "must be below quiescence"),
    ],
)
def test_axes_that_do_not_go_together_are_told(given, said):
    with pytest.raises(SceneError) as error:
        planned(mc.load_scene(RICH), **given)
    assert said in str(error.value)


def test_ranges_that_go_together_are_taken():
    """Each alone would leave the scene behind: the thresholds rise together."""
    planned(
        mc.load_scene(RICH),
        **{
            "nutrients.oxygen.necrosis": "0.001:0.03 mM",
            "nutrients.oxygen.quiescence": "0.02:0.06 mM",
        },
    )
    assert no_effect(mc.load_scene(RICH), "nutrients.oxygen.necrosis") == ""
