"""The JSON Schema of scene files against an independent validator, and units in written scenes."""

import copy
import json
import re
import tomllib
from importlib.resources import files

import pytest
import scene_strategies as drawn
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from jsonschema import Draft202012Validator

from multicell.cli.main import main
from multicell.errors import SceneError
from multicell.scene.json_schema import json_schema
from multicell.scene.scene import Scene, load_scene, scene_names
from multicell.units import to_base

VALIDATOR = Draft202012Validator(json_schema())


def text_of(name):
    return (files("multicell.scenes") / f"{name}.toml").read_text(encoding="utf-8")


def test_the_command_prints_a_schema_of_this_draft():
    done = CliRunner().invoke(main, ["schema"])
    assert done.exit_code == 0
    printed = json.loads(done.stdout)
    assert printed == json_schema()
    Draft202012Validator.check_schema(printed)


@pytest.mark.parametrize("name", scene_names())
def test_built_in_scenes_are_valid_as_written_and_as_resolved(name):
    assert not list(VALIDATOR.iter_errors(tomllib.loads(text_of(name))))
    assert not list(VALIDATOR.iter_errors(load_scene(name).to_dict()))


BAD = {
    "no duration": ({"duration": None}, None),
    "an unknown key": ({"drag": {"viscosty": 1.0}}, "drag"),
    "too small a quantity": ({"drag": {"viscosity": 0.0}}, "drag"),
    "no number": ({"cells": {"poisson": "0.3"}}, "cells"),
    "a fraction for a count": ({"seed": 1.5}, "seed"),
    "a key of another law": ({"contact": {"law": "hertz", "surface_energy": 0.1}}, "contact"),
    "a value for a table": ({"growth": 3}, "growth"),
    "a bad name": ({"types": {"a b": {}}}, "types"),
    "an unknown side": ({"nutrients": {"o": {"sides": {"w": {}}}}}, "nutrients"),
    "a point of three": ({"nutrients": {"o": {"media": [[1, 2, 3]]}}}, "nutrients"),
    "three ends": ({"domain": {"x": [0, 1, 2]}}, "domain"),
    "a phase without duration": ({"growth": {"phases": {"G1": {}}}}, "growth"),
    "text for yes": ({"growth": {"restriction": "yes"}}, "growth"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_a_scene_refuses_the_schema_refuses_there(case):
    changes, place = BAD[case]
    entries = {"duration": 3600.0} | changes
    if entries["duration"] is None:
        del entries["duration"]
    with pytest.raises(SceneError):
        Scene.from_dict(copy.deepcopy(entries))
    errors = list(VALIDATOR.iter_errors(entries))
    assert [next(iter(error.path), None) for error in errors] == [place]


@settings(max_examples=25, suppress_health_check=list(HealthCheck), deadline=None)
@given(entries=drawn.plausible(small=False))
def test_whatever_is_a_scene_is_valid(entries):
    try:
        scene = Scene.from_dict(copy.deepcopy(entries))
    except SceneError:
        return
    assert not list(VALIDATOR.iter_errors(entries))
    assert not list(VALIDATOR.iter_errors(scene.to_dict()))


def resolved(schema):
    """Follow a reference."""
    reference = schema.get("$ref", "")
    return VALIDATOR.schema["$defs"][reference.rpartition("/")[2]] if reference else schema


def test_every_declared_key_is_described_with_its_unit_default_and_choices():
    whole = VALIDATOR.schema
    for path, spec in drawn.declared():
        cases = [whole]
        for key in path.split("."):
            inner = []
            for case in cases:
                for one in map(resolved, [case, *case.get("anyOf", ())]):
                    names = one.get("properties", {})
                    inner += [names[name] for name in names if key in ("*", name)]
                    if key == "*" and isinstance(one.get("additionalProperties"), dict):
                        inner.append(one["additionalProperties"])
            cases = [found for case in inner for found in (case, resolved(case))]
        assert cases, path
        written = json.dumps(cases)
        if "const" not in written:
            assert any(case.get("description") for case in cases), path
        if spec.unit:
            assert f'"x-unit": "{spec.unit}"' in written, path
        for option in spec.options:
            assert f'"{option}"' in written, path
    assert whole["properties"]["coupling_step"]["default"] == 600.0


# --- units in written scenes ------------------------------------------------------------------


def quantities(entries, part=Scene):
    """Yield the declared unit of each quantity in a resolved scene."""
    known = drawn.specs(part)
    for key, value in entries.items():
        if key not in known:
            continue
        spec = known[key]
        if spec.parts is not None:
            yield from quantities(value, spec.parts[value[spec.key]])
        elif spec.kind == "tables":
            for entry in value.values():
                yield from quantities(entry, spec.table)
        elif spec.table is not None:
            yield from quantities(value, spec.table)
        elif spec.kind == "quantities":
            yield from [spec.unit] * len(value) * bool(spec.unit)
        elif spec.kind in ("course", "schedule"):
            if isinstance(value, list):
                yield f"[s, {spec.unit or 'number'}]"
        elif spec.unit and value not in spec.options:
            yield spec.unit


def check_units(scene):
    """Check that each quantity of a written scene, and nothing else, has its unit behind it."""
    text = scene.to_toml()
    assert Scene.from_dict(tomllib.loads(text)) == scene
    body = [line for line in text.splitlines() if not line.startswith("#")]
    found = [line.rpartition("  # ")[2] for line in body if "  # " in line]
    assert sorted(found) == sorted(quantities(scene.to_dict()))
    # the same numbers with these units as text make the same scene
    spelt = [re.sub(r"^([^=]+ = )([-\d.e+]+)  # (.+)$", r'\1"\2 \3"', line) for line in body]
    assert Scene.from_dict(tomllib.loads("\n".join(spelt))) == scene
    return set(found)


@pytest.mark.parametrize("name", scene_names())
def test_every_quantity_of_a_written_scene_has_its_unit(name):
    assert {"s", "um", "kPa", "kPa s"} <= check_units(load_scene(name))


@pytest.mark.slow
def test_every_declared_key_is_drawn_and_every_quantity_written_with_its_unit():
    """A key of a new kind needs a way to be drawn: ``Parameter.kind``, or ``examples``."""
    made, seen, units = set(), set(), set()
    declared = {path for path, _ in drawn.declared()} - drawn.OF_OWN_CODE
    with_units = {path: spec for path, spec in drawn.declared() if spec.unit}
    spelt = {path: spec.units for path, spec in with_units.items()}

    def missing():
        unseen = {path for path, unit in spelt.items() if path not in seen or unit not in units}
        return (declared - made) | unseen

    def look(entries):
        made.update(drawn.keys_of(entries))
        try:
            scene = Scene.from_dict(entries)
        except SceneError:
            return
        keys = set(drawn.keys_of(scene.to_dict())) & set(with_units)
        written = set(quantities(scene.to_dict()))
        if not (keys <= seen and written <= units):  # most scenes have nothing new
            units.update(check_units(scene))
            seen.update(keys)

    drawn.look_until(missing, look)
    assert not declared - made
    assert not set(with_units) - seen
    assert set(spelt.values()) <= units
    for unit in units:
        if not unit.startswith("["):
            assert to_base(f"1 {unit}", unit) == 1.0
