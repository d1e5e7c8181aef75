"""Reactions of a scene: units, round trips, and refusals with their places."""

import pytest

from multicell.errors import SceneError
from multicell.scene.dependences import solving_order
from multicell.scene.reactions import Reaction, groups
from multicell.scene.scales import largest_spacing, regime
from multicell.scene.scene import Scene, load_scene

WALLS = {"*": {"type": "derivative", "derivative": 0.0}}
FIELD = {"uptake": 0.0}
A_TO_B = {"rate": "1e-3 1/s", "consumes": {"a": 1}, "produces": {"b": 1}}


def scene(reaction=None, *, fields=None, reactions=None, **changes):
    fields = {name: {**FIELD, **((fields or {}).get(name, {}))} for name in "abc"}
    known = reactions or {"x": {**A_TO_B, **(reaction or {})}}
    return Scene.from_dict({"duration": 3600.0, "nutrients": fields, "reactions": known, **changes})


@pytest.mark.parametrize(
    ("consumes", "rate", "base", "unit"),
    [
        ({}, "36 uM/h", 1e-5, "mM/s"),
        ({"a": 1}, "18 1/min", 0.3, "1/s"),
        ({"a": 1, "b": 1}, "2e5 1/(M s)", 200.0, "1/mM/s"),
        ({"a": 2, "b": 1}, "5 1/(mM^2 s)", 5.0, "1/mM^2/s"),
        ({"a": 4}, "5 1/mM^3/s", 5.0, "1/mM^3/s"),
    ],
)
def test_the_unit_of_a_rate_is_that_of_its_order(consumes, rate, base, unit):
    made = Reaction(rate=rate, consumes=consumes, produces={"c": 1})
    assert made.rate == pytest.approx(base, rel=1e-12)
    assert made.unit == unit
    with pytest.raises(SceneError, match="rate: is '5 um', must be"):
        Reaction(rate="5 um", consumes=consumes, produces={"c": 1})


def test_a_scene_with_reactions_is_written_and_read_back(tmp_path):
    other = {"rate": 1e-3, "consumes": {"c": 2}, "where": "tissue"}
    made = scene(reactions={"x": A_TO_B, "y": other})
    file = tmp_path / "scene.toml"
    file.write_text(made.to_toml(), encoding="utf-8")
    assert load_scene(file) == made
    changed = made.with_changes({"reactions.x.rate": "2e-3 1/s"})
    assert changed.reactions["x"].rate == 2e-3
    assert made.with_changes({"reactions": None}).reactions == {}


@pytest.mark.parametrize(
    ("change", "path", "words"),
    [
        ({"rate": "1 mM/s"}, "rate", "order 1 has 1/s"),
        ({"rate": True}, "rate", "must be a number or a string"),
        ({"rate": 0.0}, "rate", "must be from 1e-15"),
        ({"consumes": {"a": 1.5}}, "consumes.a", "whole number"),
        ({"consumes": {"a": 4, "b": 1}}, "consumes", "are 5 in all"),
        ({"produces": {"a": 1}}, "consumes", "change nothing"),
    ],
)  # fmt: skip
def test_what_is_no_reaction_is_refused_at_its_place(change, path, words):
    with pytest.raises(SceneError, match=words) as caught:
        scene(change)
    assert caught.value.path == f"reactions.x.{path}"


@pytest.mark.parametrize(
    ("fields", "path", "words"),
    [
        ({"a": {"spacing": 8}, "b": {"spacing": 9}}, "b.spacing", "share one grid"),
        ({"b": {"margin": 80}}, "b.margin", "is 80, but that of a is 50"),
        ({"b": {"margin_shape": "tissue"}}, "b.margin_shape", "is tissue, but that of a is box"),
        ({"b": {"geometry": "radial"}}, "b.geometry", "is radial, but that of a is box"),
        ({"a": {"regime": "steady"}, "b": {"regime": "transient"}}, "a.regime", "'transient'"),
        (
            {"a": {"regime": "steady", "decay": "1 1/h", "sides": WALLS}, "b": {"sides": WALLS}},
            "a.regime", "fixes the level of b",
        ),
        (
            {"a": {"uptake": 1}, "b": {"secretion_from": {"a": 1}}},
            "b.secretion_from.a", "reacts with",
        ),
        (
            {
                "c": {"uptake": 1, "uptake_on": {"b": {"effect": 1, "half": 1}}},
                "a": {"uptake": 1, "uptake_on": {"c": {"effect": 1, "half": 1}}},
            },
            "a", "depends on itself",
        ),
    ],
)  # fmt: skip
def test_fields_that_cannot_react_are_refused_at_their_place(fields, path, words):
    with pytest.raises(SceneError, match=words) as caught:
        scene(fields=fields)
    assert caught.value.path.startswith(f"nutrients.{path}")


def test_fields_that_react_share_grid_and_regime_and_come_one_after_another():
    made = scene(
        fields={
            "a": {"uptake": 100.0, "boundary": 0.01},
            "c": {"uptake": 1.0, "uptake_on": {"a": {"effect": 1.0, "half": 0.1}}},
        }
    )
    assert largest_spacing(made, "a") == largest_spacing(made, "b") < largest_spacing(made, "c")
    assert [regime(made, name) for name in "abc"] == ["transient", "transient", "steady"]
    assert solving_order(made.nutrients, made.reactions) == ["a", "b", "c"]
    given = made.with_changes({"nutrients.b.spacing": 9.0, "nutrients.b.regime": "steady"})
    assert largest_spacing(given, "a") == 9.0
    assert regime(given, "a") == "steady"


def test_fields_are_grouped_by_what_reacts_with_what():
    def of(*fields):
        return Reaction(rate=1.0, consumes=dict.fromkeys(fields, 1))

    known = {"x": of("a", "c"), "y": of("d", "e"), "z": of("c", "d"), "w": of("f")}
    assert groups("abcdefg", known) == [["a", "c", "d", "e"], ["f"]]
