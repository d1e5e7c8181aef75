"""Units: strings with units become base-unit floats, or an error in words."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pint
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from running import refused
from scipy import constants

from multicell import units
from multicell.errors import SceneError
from multicell.units import shown, to_base

REGISTRY = pint.UnitRegistry()  # which is not what the package reads units with

# (text, base unit, value from SI factors that SciPy and the SI brochure define)
KNOWN = [
    ("5 um", "um", 5.0),
    ("5um", "um", 5.0),
    ("5 µm", "um", 5.0),
    ("  +0.5e1  um ", "um", 5.0),
    ("0.1 mm", "um", 0.1 * constants.milli / constants.micro),
    ("15 h", "s", 15 * constants.hour),
    ("1.1 h", "s", 3960.0),
    ("11 d", "s", 11 * constants.day),
    ("10 min", "s", 10 * constants.minute),
    ("2 weeks", "s", 2 * constants.week),
    ("3 Pa", "kPa", 0.003),
    ("1 MPa", "kPa", 1000.0),
    ("1 nN/um^2", "kPa", 1.0),
    ("0.1 nN/um", "nN/um", 0.1),
    ("0.1 mN/m", "nN/um", 0.1),
    ("0.1 mJ/m**2", "nN/um", 0.1),
    ("5 kPa s", "kPa s", 5.0),
    ("70 Pa*s", "kPa s", 0.07),
    ("10 poise", "kPa s", 0.001),
    ("2000 um^2/s", "um^2/s", 2000.0),
    ("2000 µm²/s", "um^2/s", 2000.0),
    ("2e-5 cm^2/s", "um^2/s", 2000.0),
    ("0.07 mM", "mM", 0.07),
    ("0.07 amol/um^3", "mM", 0.07),
    ("70 umol/l", "mM", 0.07),
    ("0.07 mol/m^3", "mM", 0.07),
    ("20 amol/s", "amol/s", 20.0),
    ("72 fmol/(h)", "amol/s", 20.0),
    ("-3 um", "um", -3.0),
    ("0 um", "um", 0.0),
]


@pytest.mark.parametrize(("text", "unit", "value"), KNOWN)
def test_text_gives_the_known_value(text, unit, value):
    assert to_base(text, unit) == pytest.approx(value, rel=1e-15, abs=0)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [("1.1 h", "s", 3960.0), ("3 Pa", "kPa", 0.003), ("0.07 mM", "mM", 0.07)],
)
def test_product_is_rounded_once(text, unit, value):
    assert to_base(text, unit) == value


@pytest.mark.parametrize("value", [5, 5.0, np.float32(5), np.int64(5)])
def test_numbers_are_base_units(value):
    result = to_base(value, "um")
    assert result == 5.0
    assert type(result) is float


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("5", "without a unit"),
        ("", "number and a unit"),
        ("um", "number and a unit"),
        ("five um", "number and a unit"),
        ("nan um", "number and a unit"),
        ("inf um", "number and a unit"),
        ("1e999 um", "finite"),
        ("1e308 m", "finite"),
        ("5 kPa", "must be a length, which 'kPa' is not"),
        ("37 degC", "unknown unit"),
        ("5 parsecks", "unknown unit 'parsecks'"),
        ("5 2 um", "cannot be read"),
        ("5 um **", "cannot be read"),
        ("5 um ()", "unit"),
        ("5 um^9^9^9^9", "cannot be read"),
        ("5 um^99999999", "cannot be read"),
        ("5 " + "(" * 80 + "um", "cannot be read"),
        ("5 __import__('os')", "cannot be read"),
        ("0" * 200 + " um", "number and a unit"),
        (True, "must be a number"),
        (np.True_, "must be a number"),
        (float("nan"), "finite"),
        (float("inf"), "finite"),
        (10**400, "finite"),
        (1j, "must be a number"),
        (None, "must be a number"),
        ([5], "a list"),
        ({}, "a table"),
    ],
)
def test_bad_value_is_refused_in_words(value, words):
    with refused("cells.size", words):
        to_base(value, "um", "cells.size")


def test_error_names_the_wanted_unit_and_an_example():
    with pytest.raises(SceneError) as caught:
        to_base("3 um", "kPa s", "drag.viscosity")
    assert caught.value.problem == "is '3 um', must be a viscosity, which 'um' is not"
    assert caught.value.hint == "Write for example '5 kPa s'."


def test_a_case_mistake_gets_the_reason():
    with pytest.raises(SceneError, match="Capitals matter"):
        to_base("1 kpa", "kPa")


def test_unit_without_an_entry_has_an_example_too():
    assert to_base("2 m^3/s", "um^3/s") == 2e18
    with pytest.raises(SceneError, match=r"a quantity in um\^3/s.*'1 um\^3/s'"):
        to_base("2 m", "um^3/s")


@given(
    value=st.floats(-1e200, 1e200, allow_subnormal=False),
    unit=st.sampled_from(["um", "s", "kPa", "nN/um", "kPa s", "um^2/s", "mM", "amol/s"]),
)
def test_base_units_round_trip_exactly(value, unit):
    assert to_base(f"{value!r} {unit}", unit) == value


@given(
    value=st.floats(1e-100, 1e100),
    pair=st.sampled_from([("mm", "um"), ("d", "s"), ("Pa", "kPa"), ("mol/l", "mM")]),
)
def test_there_and_back_again(value, pair):
    other, base = pair
    there = to_base(f"{value!r} {other}", base)
    assert to_base(f"{there!r} {base}", other) == pytest.approx(value, rel=1e-15)


def outcome(text, unit):
    try:
        return to_base(text, unit)
    except SceneError as error:
        return error


@settings(max_examples=300)
@given(unit=st.text("umskPah1 */^().²-M", max_size=12))
def test_any_unit_gives_a_finite_float_or_a_scene_error(unit):
    result = outcome(f"2 {unit}", "kPa s")
    assert math.isfinite(result) if isinstance(result, float) else result.problem.startswith("is ")


@given(text=st.text(max_size=30))
@example("0,0")
def test_any_text_gives_a_finite_float_or_a_scene_error(text):
    result = outcome(text, "um")
    assert math.isfinite(result) if isinstance(result, float) else "'5 um'" in result.hint


NAMES = [
    (name, base, float(size))
    for base, names in units.LISTED.items()
    for name, size in ((n, size) for row, size in names.items() for n in row.split())
]


@pytest.mark.parametrize(("name", "base", "size"), NAMES, ids=[name for name, *_ in NAMES])
def test_listed_units_are_what_pint_makes_of_them(name, base, size):
    other = {"wk": "week", "Torr": "torr"}.get(name, name)
    assert REGISTRY.Quantity(1.0, other).to(base).magnitude == pytest.approx(size, rel=1e-14)


PREFIXES = ("y", "z", "a", "f", "p", "n", "u", "m", "c", "d", "da", "h", "k", "M", "G", "T", "P")
FAMILIES = [unit for unit in units.RANGES if unit]


@pytest.mark.parametrize("base", units.LISTED)
def test_a_prefix_that_is_not_listed_is_refused(base):
    """Every prefix on every listed unit: listed itself, or no unit (pint takes them all)."""
    listed = {name for name, *_ in NAMES}
    for name in (name for row in units.LISTED[base] for name in row.split()):
        for prefix in PREFIXES:
            if units.unit_factor(prefix + name, base) is not None:
                assert prefix + name in listed
    assert {"Gy", "h", "d"} <= listed


@settings(max_examples=200)
@given(
    factors=st.lists(
        st.tuples(
            st.sampled_from([name for name, *_ in NAMES if name not in ("wk", "Torr")]),
            st.integers(-3, 3).filter(bool),
        ),
        min_size=1,
        max_size=3,
    ),
    style=st.sampled_from(["^", "**", ""]),
)
@example(factors=[("M", -1), ("s", -1)], style="^")
def test_products_are_what_pint_makes_of_them(factors, style):
    text = " ".join(f"{name}{style}{power}" for name, power in factors)
    quantity = REGISTRY.Quantity(1.0, " * ".join(f"{name}**{power}" for name, power in factors))
    over = "/".join(["1", *(name for name, power in factors for _ in range(abs(power)))])
    for base in FAMILIES:
        if quantity.check(REGISTRY.Quantity(1.0, base).dimensionality):
            found = units.unit_factor(text, base)
            if not (found is None and base == "mM" and factors == [("M", 1)]):
                assert found == pytest.approx(quantity.to(base).magnitude, rel=1e-12)
        else:
            assert units.unit_factor(text, base) is None
        inverse = [(name, -abs(power)) for name, power in factors]
        if len(over) <= 40 and sorted(inverse) == sorted(factors):
            assert units.unit_factor(over, base) == units.unit_factor(text, base)


@pytest.mark.parametrize(
    ("text", "unit", "meant"),
    [
        ("20 hh", "s", "'20 h'"),
        ("2 dd", "s", "'2 d'"),
        ("3 das", "s", "'3 days'"),
        ("2 ks", "s", "'2 s'"),
        ("3 Mm", "um", "'3 mm'"),
        ("5 ums", "um", "'5 um'"),
        ("1 kpa", "kPa", "'1 kPa'"),
        ("5 kpa s", "kPa s", "'5 kPa s'"),
        ("5 H", "s", "'5 h'"),
        ("7 mmhg", "kPa", "'7 mmHg'"),
        ("20 amoles/s", "amol/s", "'20 amol/s'"),
        ("0.05 M", "mM", "'0.05 mM'? 0.05 M is written '50 mM'"),
    ],
)
def test_what_is_refused_names_the_nearest(text, unit, meant):
    with pytest.raises(SceneError) as caught:
        to_base(text, unit)
    assert f"Did you mean {meant}" in caught.value.hint


@pytest.mark.parametrize("unit", ["px", "pixel", "pixels", "PX", "in", "inch", "pt", "ft", "yd"])
def test_what_is_no_length_in_a_tissue_is_refused(unit):
    with pytest.raises(SceneError, match=f"unknown unit '{unit}'") as caught:
        to_base(f"5 {unit}", "um")
    pixels = unit.lower() in ("px", "pixel", "pixels")
    assert ("How many um is a pixel?" in caught.value.hint) == pixels
    assert "Did you mean" not in caught.value.hint


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("2 days 3 h", 183_600.0),
        ("1 h 30 min", 5400.0),
        ("1h30min", 5400.0),
        ("7 min 14 s", 434.0),
        ("1 wk 2 d 3 h 4 min 5 s 6 ms", 788_645.006),
        ("0 d 3 h", 10_800.0),
        ("1.1 h 0.1 s", 3960.1),
    ],
)
def test_times_may_have_several_parts_in_falling_order(text, seconds):
    assert to_base(text, "s") == seconds


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("3 h 2 days", "do not fall"),
        ("1 h 1 h", "do not fall"),
        ("2 days 3 hh", "unknown unit"),
        ("2 days 3", "cannot be read"),
        ("-2 d 3 h", "cannot be read"),
        ("2 d -3 h", "cannot be"),
        ("2 d 3 um", "must be a time"),
    ],
)
def test_other_times_of_several_parts_are_refused(text, words):
    with refused("t", words):
        to_base(text, "s", "t")


@pytest.mark.parametrize("text", ["2 mm 3 um", "1 kPa 3 Pa", "1 um 2 h"])
def test_only_times_have_several_parts(text):
    with refused("x", "cannot be read"):
        to_base(text, "um", "x")


@pytest.mark.parametrize("text", ["µm", "μm", "um"])
def test_both_micro_signs_are_read(text):
    assert units.unit_factor(text, "um") == 1.0


def test_no_registry_is_loaded():
    code = (
        "import sys; from multicell.units import to_base; to_base('70 umol/l', 'mM');"
        "print('pint' in sys.modules)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.split() == ["False"]


def test_long_values_are_shown_shortened():
    assert len(shown("x" * 1000)) == 60
    assert shown({"a": 1}) == "a table"
