"""Quantities at the door: ``"15 h"`` or ``"1 kPa"`` becomes a float in base units.

The base units are µm, s, nN and amol. Then stress is kPa = nN/µm², surface energy mN/m = nN/µm,
viscosity kPa·s and concentration mM = amol/µm³, all without a factor. pint is imported only when
a string arrives whose unit is not among the common ones (:data:`COMMON`): its registry takes longer
to load than a small scene to start.
"""

from __future__ import annotations

import functools
import math
import re
from decimal import Decimal
from numbers import Real
from typing import Any

from multicell.errors import SceneError

BASE_UNITS = "um, s, nN, amol; hence kPa = nN/um^2, nN/um = mN/m, kPa s, mM = amol/um^3"
"""The base units in words, for headers and messages."""

_UNITS = {
    "um": (1e-6, 1e6, "a length", "5 um"),
    "um^3": (1e-3, 1e18, "a volume", "1e8 um^3"),
    "s": (1e-6, 1e12, "a time", "15 h"),
    "kPa": (1e-9, 1e10, "a pressure or modulus", "1 kPa"),
    "nN": (1e-12, 1e9, "a force", "1 nN"),
    "nN/s": (1e-15, 1e9, "a change of force", "1 nN/s"),
    "nN/um": (1e-9, 1e9, "a surface energy", "0.1 nN/um"),
    "kPa s": (1e-8, 1e12, "a viscosity", "5 kPa s"),
    "kPa s/um": (1e-12, 1e12, "a friction per area", "0.1 kPa s/um"),
    "um/s": (1e-12, 1e6, "a velocity", "0.1 um/s"),
    "um^2/s": (1e-9, 1e9, "a diffusion coefficient", "2000 um^2/s"),
    "mM": (1e-12, 1e5, "a concentration", "0.07 mM"),
    "mM/um": (1e-15, 1e6, "a gradient of concentration", "1e-4 mM/um"),
    "amol/s": (1e-12, 1e12, "an amount per time", "20 amol/s"),
    "1/s": (1e-15, 1e6, "a rate", "1e-5 1/s"),
    "mM/s": (1e-15, 1e12, "a change of concentration", "1e-3 mM/s"),
    "1/mM/s": (1e-15, 1e12, "a rate constant of second order", "0.1 1/mM/s"),
    "1/mM^2/s": (1e-15, 1e12, "a rate constant of third order", "1 1/mM^2/s"),
    "1/mM^3/s": (1e-15, 1e12, "a rate constant of fourth order", "1 1/mM^3/s"),
    "Gy": (1e-9, 1e6, "a dose", "2 Gy"),
    "1/Gy": (1e-9, 1e6, "an effect per dose", "0.3 1/Gy"),
    "1/Gy^2": (1e-9, 1e6, "an effect per dose squared", "0.03 1/Gy^2"),
    "": (1e-12, 1e12, "a number", "1"),
}
COMMON = {
    "um": {"µm": 1.0, "μm": 1.0, "nm": 0.001, "mm": 1000.0, "cm": 10000.0},
    "um^3": {"µm^3": 1.0, "mm^3": 1e9, "uL": 1e9, "mL": 1e12},
    "s": {"ms": 0.001, "min": 60.0, "h": 3600.0, "d": 86400.0, "hours": 3600.0, "days": 86400.0},
    "kPa": {"Pa": 0.001, "MPa": 1000.0, "mmHg": 0.133322387415},
    "nN": {"pN": 0.001, "uN": 1000.0},
    "nN/um": {"mN/m": 1.0, "N/m": 1000.0, "nN/µm": 1.0},
    "kPa s": {"Pa s": 0.001, "kPa*s": 1.0, "Pa*s": 0.001},
    "um/s": {"µm/s": 1.0, "nm/s": 0.001},
    "um^2/s": {"µm^2/s": 1.0, "µm²/s": 1.0, "m^2/s": 1e12, "cm^2/s": 1e8, "mm^2/s": 1e6},
    "mM/s": {"amol/s/um^3": 1.0, "amol/s/µm^3": 1.0},
    "mM": {"uM": 0.001, "µM": 0.001, "nM": 1e-6, "M": 1000.0, "mol/m^3": 1.0},
    "Gy": {"cGy": 0.01, "mGy": 0.001},
    "1/Gy": {"Gy^-1": 1.0},
    "1/Gy^2": {"Gy^-2": 1.0},
}
"""What pint makes of common units, as numbers of the base unit that is the outer key."""

_FAMILIES = {text: base for base in _UNITS if base for text in (base, *COMMON.get(base, ()))}
"""The base unit of each unit that is known without pint; no two of them have one dimension."""

RANGES = {unit: entry[:2] for unit, entry in _UNITS.items()}
"""Smallest and largest size of a number other than zero that a scene may hold, by its unit.

Far beyond any use: lengths from a picometre to a metre, volumes to a cubic metre,
times from a microsecond to thirty thousand years, moduli from a micropascal to beyond diamond,
viscosities from half of air's to a thousand times that of glass at its transition, concentrations
from a femtomole per litre to beyond any pure substance, diffusion up to a hundred
times that in gases. Inside, a product of a dozen such numbers stays far from the ends of a float
(1e-308 and 1e308), so that no formula overflows or loses what it needs to an underflow.
"""

_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(.*)", re.DOTALL)
_UNIT_TEXT = re.compile(r"[A-Za-zµμ0-9 */^().²³¹⁻-]{1,40}")
# A power of a power or a long exponent would keep the parser busy for ever.
_RUNAWAY = re.compile(r"[\d)]\s*(?:\^|\*\*)|\d\d|\.\d")


def to_base(value: object, unit: str, path: str = "") -> float:
    """Return a quantity as a number of base units.

    - ``value``: a number, taken to be in ``unit`` already, or a string of a number and a unit
    - ``unit``: the wanted unit, a product of base units such as ``"um^2/s"``
    - ``path``: where the value stands, for the error

    Returns float: the value in ``unit``. The product with the unit's factor is rounded once, so
    that ``"1.1 h"`` is exactly 3960 s.
    """
    if isinstance(value, str):
        return _from_text(value, unit, path)
    return finite(value, path, f"a number in {unit} or a string with a unit", _example(unit))


def finite(value: object, path: str, wanted: str, hint: str = "") -> float:
    """Return a real, finite number as a float."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise SceneError(path, f"is {shown(value)}, must be {wanted}", hint)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise SceneError(path, f"is {shown(value)}, must be a finite number", hint)
    return number + 0.0  # there is one zero: -0.0 would be written and drawn as another


def shown(value: object) -> str:
    """Return a value as an error message shows it: short, tables and lists by their kind."""
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, str):
        value = value if len(value) <= 60 else f"{value[:60]}..."
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # integers of thousands of digits, deep nesting
        return f"an '{type(value).__name__}' too long to show"
    return text if len(text) <= 60 else f"{text[:57]}..."


def time_text(seconds: float, digits: int = 3, *, least_days: float = 1.0) -> str:
    """Return a time in the unit that suits it; in days from so many on."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= (least_days if unit == "d" else 1.0) * size:
            return f"{seconds / size:.{digits}g} {unit}"
    return f"{seconds:.{digits}g} s"


def oxygen_solubility(temperature: float) -> float:
    """Return how much oxygen pure water dissolves at a partial pressure, mM/kPa.

    - ``temperature``, float, °C: from 0 to 60

    ln x = -66.73538 + 87.47547/τ + 24.45264 ln τ, τ = T/(100 K), is the mole fraction at
    101.325 kPa (Battino, Rettich & Tominaga 1983, J. Phys. Chem. Ref. Data 12, 163); it is
    proportional to the pressure (Henry). The density is that of
    McCutcheon et al. (1993). At 37 °C: 0.01052 mM/kPa = 1.403e-3 mM/mmHg.
    """
    t = (temperature + 273.15) / 100.0
    fraction = math.exp(-66.73538 + 87.47547 / t + 24.45264 * math.log(t))
    spread = (temperature + 288.9414) / (508929.2 * (temperature + 68.12963))
    density = 1000.0 * (1.0 - spread * (temperature - 3.9863) ** 2)  # kg/m³
    return fraction * density / 0.0180153 / 101.325


def vapour_pressure(temperature: float) -> float:
    """Return the pressure of saturated water vapour, kPa.

    Parameters
    ----------
    temperature : float, °C
        From 0 to 60.

    Notes
    -----
    ln (p / 101.325 kPa) = 11.8571 - 3840.70/T - 216961/T² (Benson & Krause 1984, Limnol. Oceanogr.
    29, 620). At 37 °C: 6.27 kPa = 47 mmHg.
    """
    t = temperature + 273.15
    return 101.325 * math.exp(11.8571 - 3840.70 / t - 216961.0 / t**2)


def _from_text(text: str, unit: str, path: str) -> float:
    match = _QUANTITY.fullmatch(text) if len(text) <= 100 else None
    if match is None:
        raise SceneError(path, f"is {shown(text)}, must be a number and a unit", _example(unit))
    digits, unit_text = match[1], match[2].strip()
    if not unit_text:
        hint = f"Write for example '{digits} h'." if unit == "s" else _example(unit)
        raise SceneError(path, f"is {shown(text)}, a string without a unit", hint)
    factor = _factor(unit_text, unit, text, path)
    number = finite(float(digits), path, "a number")
    if number == 0.0 and not Decimal(digits).is_zero():
        raise SceneError(path, f"is {shown(text)}, too small for a number", _example(unit))
    if number == 0.0:
        return 0.0
    product = float(Decimal(digits) * Decimal(repr(factor)))
    return finite(product, path, "a number", _example(unit))


def _factor(unit_text: str, unit: str, text: str, path: str) -> float:
    """Return how many ``unit`` one ``unit_text`` is; ``text`` is what the user wrote."""
    family = _FAMILIES.get(unit_text)
    if family is not None and unit in _UNITS:
        if family != unit:
            raise _of_another_kind(unit_text, unit, text, path)
        return COMMON.get(unit, {}).get(unit_text, 1.0)
    import pint

    if re.match(r",\d", unit_text):
        hint = f"Use '.' as decimal separator. {_example(unit)}"
        raise SceneError(path, f"is {shown(text)}, its unit cannot be read", hint)
    if not _UNIT_TEXT.fullmatch(unit_text) or _RUNAWAY.search(unit_text):
        raise SceneError(path, f"is {shown(text)}, its unit cannot be read", _example(unit))
    try:
        return _conversion(unit_text, unit)
    except pint.DimensionalityError:
        raise _of_another_kind(unit_text, unit, text, path) from None
    except _parse_errors():
        problem = f"is {shown(text)}, with the unknown unit '{unit_text}'"
        hint = f"{_example(unit)} Capitals matter: kPa, mM, um."
        raise SceneError(path, problem, hint) from None


def _of_another_kind(unit_text: str, unit: str, text: str, path: str) -> SceneError:
    """Return the error of a quantity whose dimension is not that of ``unit``."""
    kind = _UNITS[unit][2] if unit in _UNITS else f"a quantity in {unit}"
    problem = f"is {shown(text)}, must be {kind}, which '{unit_text}' is not"
    hint = _example(unit)
    if unit == "mM" and unit_text.startswith(("g/", "mg/", "ug/", "µg/", "ng/")):
        hint += " Divide a mass by the molar mass: 1 g/l of glucose (180 g/mol) is 5.55 mM."
    return SceneError(path, problem, hint)


def _parse_errors() -> tuple[type[Exception], ...]:
    """Return what pint raises for text that is not a unit."""
    import tokenize

    import pint

    # pint's parser lets Python's own errors through for malformed expressions
    python = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError)
    return (pint.PintError, tokenize.TokenError, SyntaxError, *python)


@functools.cache
def _conversion(unit_text: str, unit: str) -> float:
    """Return the factor from one unit to another; a short decimal is freed of rounding."""
    registry = _registry()
    quantity = registry.Quantity(1.0, registry.parse_units(unit_text))
    factor = float(quantity.to(unit).magnitude)
    short = float(f"{factor:.12g}")
    return short if math.isclose(short, factor, rel_tol=1e-15) else factor


@functools.cache
def _registry() -> Any:
    """Return the one unit registry; private, so that a user's own definitions stay apart."""
    import pint

    return pint.UnitRegistry()


def _example(unit: str) -> str:
    return f"Write for example '{_UNITS[unit][3] if unit in _UNITS else f'1 {unit}'}'."
