"""Parts: declarations convert and check what they are given."""

from __future__ import annotations

import copy
import pickle
from dataclasses import FrozenInstanceError, replace
from typing import Any, final

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multicell.errors import SceneError
from multicell.schema import (
    Bounds,
    build_part,
    choice,
    count,
    near_miss,
    number,
    parameters,
    part_as_dict,
    quantity,
    table,
    tables,
    text,
    variant,
)
from multicell.units import RANGES


@final
@parameters
class Inner:
    size: float = quantity("um", default=2.0, above=0, at_most=10, doc="a size", hint="Be small.")
    share: float = number(default=0.5, at_least=0, below=1)


@final
@parameters
class Smooth:
    pass


@final
@parameters
class Rough:
    height: float = quantity("um", default=1.0, at_least=0)


SURFACES = {"smooth": Smooth, "rough": Rough}


@final
@parameters
class Outer:
    name: str = text(default="")
    length: float = quantity("um", above=0, doc="how long")
    limit: float | None = quantity("kPa", default=None, above=0)
    times: int = count(default=3, at_least=1, at_most=9)
    kind: str = choice(["round", "flat"], default="round")
    inner: Inner = table(Inner, default_factory=Inner, shorthand="size")
    extra: Inner | None = table(Inner, default=None)
    surface: Any = variant(SURFACES, key="type", usual="rough", default_factory=Rough)
    many: Any = tables(
        Inner,
    )

    def check(self) -> None:
        if self.inner.size > self.length:
            raise SceneError("inner.size", f"is {self.inner.size:g} um, must fit into length")


def problem(entries):
    """Return path, problem and hint of the error that a table for Outer causes."""
    with pytest.raises(SceneError) as caught:
        build_part(Outer, {"length": 5, **entries}, "outer")
    return caught.value.path, caught.value.problem, caught.value.hint


def test_values_are_converted():
    part = Outer(length="0.1 mm", limit="10 Pa", times=np.int64(4), inner="3 um")
    assert (part.length, part.limit, part.times, part.inner.size) == (100.0, 0.01, 4, 3.0)
    assert (type(part.length), type(part.times)) == (float, int)
    assert type(Inner(size=3).size) is float


def test_parts_are_frozen_hashable_comparable_and_keyword_only():
    part = Outer(length=5, many={"a": {"size": 1}})
    with pytest.raises(FrozenInstanceError):
        part.length = 6.0
    with pytest.raises(TypeError):
        part.many["b"] = Inner()
    with pytest.raises(TypeError):
        Inner(3.0)
    twin = Outer(length="5 um", many={"a": Inner(size="1 um")})
    assert part == twin
    assert hash(part) == hash(twin)
    assert part != Outer(length=5)


def test_parts_survive_pickle_and_copy():
    part = Outer(length=5, many={"a": {"size": 1}}, surface={"type": "smooth"})
    assert pickle.loads(pickle.dumps(part)) == part
    assert copy.deepcopy(part) == part


def test_replace_checks_again():
    with pytest.raises(SceneError, match="above 0 um"):
        replace(Outer(length=5), length=-1)


def test_plain_is_read_back():
    part = Outer(length=5, surface={"type": "smooth"}, many={"a": {"share": 0}}, extra={})
    entries = part_as_dict(part)
    assert entries == {
        "name": "",
        "length": 5.0,
        "times": 3,
        "kind": "round",
        "inner": {"size": 2.0, "share": 0.5},
        "extra": {"size": 2.0, "share": 0.5},
        "surface": {"type": "smooth"},
        "many": {"a": {"size": 2.0, "share": 0.0}},
    }
    assert build_part(Outer, entries) == part


@pytest.mark.parametrize(
    ("entries", "path", "words"),
    [
        ({"length": -3}, "outer.length", "is -3 um, must be above 0 um"),
        ({"length": None}, "outer.length", "is None, must be a number in um"),
        ({"inner": {"size": 11}}, "outer.inner.size", "is 11 um, must be above 0 um and at most"),
        ({"inner": {"share": 1}}, "outer.inner.share", "is 1, must be at least 0 and below 1"),
        ({"inner": {"share": "0.5"}}, "outer.inner.share", "without unit and quotes"),
        ({"inner": {"share": float("nan")}}, "outer.inner.share", "is nan, must be a finite"),
        ({"inner": 5}, "outer.inner", "is 5, must be a table"),
        ({"inner": None}, "outer.inner", "is None, must be a table"),
        ({"inner": {1: 2}}, "outer.inner", "keys that are not text"),
        ({"inner": "5 kPa"}, "outer.inner.size", "must be a length"),
        ({"inner": {"size": 6}}, "outer.inner.size", "must fit into length"),
        ({"times": 0}, "outer.times", "is 0, must be at least 1 and at most 9"),
        ({"times": 3.0}, "outer.times", "is 3.0, must be a whole number"),
        ({"times": True}, "outer.times", "is True, must be a whole number"),
        ({"times": 10**400}, "outer.times", "at most 9"),
        ({"kind": 3}, "outer.kind", "is 3, must be one of 'round', 'flat'"),
        ({"name": 3}, "outer.name", "must be one line of text"),
        ({"name": "two\nlines"}, "outer.name", "must be one line of text"),
        ({"surface": {"type": "bumpy"}}, "outer.surface.type", "must be one of 'smooth', 'rough'"),
        ({"surface": "smooth"}, "outer.surface", "must be a table"),
        ({"many": []}, "outer.many", "is a list, must be a table"),
        ({"many": {"a": 3}}, "outer.many.a", "is 3, must be a table"),
        ({"many": {"a": {"size": 0}}}, "outer.many.a.size", "is 0 um, must be above 0 um"),
        ({"many": {"a/b": {}}}, "outer.many", "letters, digits"),
    ],
)
def test_refusals_carry_path_value_and_what_is_allowed(entries, path, words):
    found_path, found_problem, _ = problem(entries)
    assert found_path == path
    assert words in found_problem


@pytest.mark.parametrize(
    ("entries", "hint"),
    [
        ({"lenght": 5}, "Did you mean 'length'?"),
        ({"inner": {"siz": 1}}, "Did you mean 'size'? Allowed: size, share"),
        ({"kind": "rond"}, "Did you mean 'round'?"),
        ({"inner": {"size": -1}}, "Be small."),
        ({"surface": {"type": "smooth", "height": 1}}, "Allowed: type"),
        ({"surface": {"heigth": 1}}, "Did you mean 'height'? Allowed: type, height"),
    ],
)
def test_hints(entries, hint):
    assert hint in problem(entries)[2]


def test_far_names_get_no_suggestion():
    assert "Did you mean" not in near_miss("qqq", ["length"])


def test_names_that_differ_by_case_are_all_listed():
    assert near_miss("qqq", ["K_hif", "k_hif"]) == "Allowed: K_hif, k_hif"


def test_missing_key():
    with pytest.raises(SceneError) as caught:
        build_part(Outer, {}, "outer")
    assert (caught.value.path, caught.value.problem) == ("outer.length", "is missing")
    assert caught.value.hint == "how long"


def test_build_leaves_its_input_alone():
    entries = {"length": 5, "surface": {"type": "rough"}}
    build_part(Outer, entries)
    assert entries == {"length": 5, "surface": {"type": "rough"}}


def test_a_field_must_be_declared():
    with pytest.raises(TypeError, match="must be declared"):

        @parameters
        class Loose:
            size: float = 3.0


@given(value=st.floats(allow_nan=False), low=st.floats(-5, 5), high=st.floats(-5, 5))
def test_bounds_are_intervals(value, low, high):
    assert Bounds(above=low, below=high).contain(value) == (low < value < high)
    assert Bounds(at_least=low, at_most=high).contain(value) == (low <= value <= high)
    assert Bounds().contain(value)


@given(value=st.floats())
def test_a_number_is_kept_exactly_or_refused(value):
    if RANGES["um"][0] <= value <= 10:
        assert Inner(size=value).size == value
    else:
        with pytest.raises(SceneError):
            Inner(size=value)
