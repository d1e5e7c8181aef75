"""Quantities at the door: ``"15 h"`` or ``"1 kPa"`` becomes a float in base units.

The base units are µm, s, nN and amol. Then stress is kPa = nN/µm², surface energy mN/m = nN/µm,
viscosity kPa·s and concentration mM = amol/µm³, all without a factor. :data:`LISTED` has the units
that people write, each with the prefixes that they use; a unit may be a product of them
(``"amol/s/um^3"``). Whatever else is refused: a prefix on any unit makes ``"20 hh"`` 2,000 hours.
"""

from __future__ import annotations

import difflib
import functools
import math
import re
from collections.abc import Mapping
from decimal import Decimal
from itertools import pairwise
from numbers import Real
from typing import Final

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
    "amol": (1e-12, 1e30, "an amount", "5 fmol"),
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
_ROWS: Final = {
    "um": (
        "um micron microns micrometer micrometers micrometre micrometres 1, pm 1e-6, nm "
        "nanometer nanometers nanometre nanometres 1e-3, mm millimeter millimeters "
        "millimetre millimetres 1e3, cm centimeter centimeters centimetre centimetres "
        "1e4, dm 1e5, m meter meters metre metres 1e6"
    ),
    "um^3": (
        "fl fL 1, pl pL 1e3, nl nL 1e6, ul uL 1e9, ml mL 1e12, dl dL 1e14, l L liter "
        "liters litre litres 1e15"
    ),
    "s": (
        "s sec secs second seconds 1, us 1e-6, ms 1e-3, min mins minute minutes 60, h "
        "hr hrs hour hours 3600, d day days 86400, wk week weeks 604800"
    ),
    "1/s": "Hz 1",
    "nN": "fN 1e-6, pN 1e-3, nN 1, uN 1e3, mN 1e6, N 1e9, dyn dyne dynes 1e4",
    "nN um": "aJ 1e-3, fJ 1, pJ 1e3, nJ 1e6, uJ 1e9, mJ 1e12, J 1e15, erg ergs 1e8",
    "nN/um^2": (
        "uPa 1e-9, mPa 1e-6, Pa 1e-3, hPa 0.1, kPa 1, MPa 1e3, GPa 1e6, mbar 0.1, bar "
        "100, atm 101.325, mmHg 0.133322387415, torr Torr "
        "0.1333223684210526315789473684"
    ),
    "nN s/um^2": "P poise 1e-4, cP centipoise 1e-6, mP 1e-7",
    "nN s^2/um": "fg 1e-15, pg 1e-12, ng 1e-9, ug 1e-6, mg 1e-3, g gram grams 1, kg 1e3",
    "amol": ("zmol 1e-3, amol 1, fmol 1e3, pmol 1e6, nmol 1e9, umol 1e12, mmol 1e15, mol 1e18"),
    "amol/um^3": "fM 1e-12, pM 1e-9, nM 1e-6, uM 1e-3, mM 1, M 1e3",
    "Gy": "mGy 1e-3, cGy 1e-2, Gy 1",
}
LISTED: Final[Mapping[str, Mapping[str, str]]] = {
    base: {names: size for names, _, size in (row.rpartition(" ") for row in rows.split(", "))}
    for base, rows in _ROWS.items()
}
"""The units that are read: base unit, or what a product of them is -> names -> how many they are.

An ``u`` may also be written µ. Percentages (:data:`PERCENT`) are read where a gas is meant. ``M``
is for rate constants (``"1/M/s"``), not for a concentration: no medium has moles per litre, and it
is easily left of ``mM``.
"""

PERCENT: Final = ("%", "percent", "per cent")
"""How hundredths are written."""

_AXES: Final = ("um", "s", "nN", "amol", "Gy")
_UNEVEN: Final = ("month", "months", "mo", "year", "years", "yr", "yrs", "y", "a")
_PIXELS: Final = ("px", "pixel", "pixels", "voxel", "voxels", "vx")

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
_WRITTEN = str.maketrans({"µ": "u", "μ": "u", "·": "*", "²": "2", "³": "3", "¹": "1", "⁻": "-"})
_TOKEN = re.compile(r"\s*(?:([A-Za-z]+)(?:(?:\^|\*\*)?([+-]?[1-9])(?!\d))?|([*/()]|1(?=\s*/)))")
_SPAN = r"(\d+\.?\d*|\.\d+)\s*([A-Za-z]+)\s*"  # one of "2 days 3 h"
_SPANS = re.compile(rf"([A-Za-z]+)\s*((?:{_SPAN})+)")

Power = tuple[int, ...]
"""The powers of the :data:`_AXES` in a unit."""


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


def whole_number(text: str) -> int | None:
    """Return the number below 2^63 that a text of digits is; None for any other text.

    Python refuses to read one of thousands of digits.
    """
    number = int(text.lstrip("0")[:20] or "0") if text.isdecimal() else 2**63
    return number if number < 2**63 else None


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


def unit_factor(text: str, unit: str) -> float | None:
    """Return how many ``unit`` one of the unit in a text is; None where it is no such unit."""
    if text == unit:
        return 1.0
    found, wanted = _read(text), _read(unit)
    unlike = found is None or wanted is None or found[0] != wanted[0]
    if found is None or wanted is None or unlike or _is_bare_molar(text, unit):
        return None
    return float(found[1] / wanted[1])


def is_unit(text: str) -> bool:
    """Return whether a text is a unit, of any kind."""
    return _read(text) is not None


def unit_hint(text: str, unit: str) -> str:
    """Return units that may be meant by a text of another kind than ``unit``; may be empty."""
    names = [name for name, _ in _factors(text) or ()]
    if unit == "s" and any(name.lower() in _UNEVEN for name in names):
        return "Months and years differ in length: write days, as '90 d'."
    if any(name.lower() in _PIXELS for name in names):
        return "How many um is a pixel? Multiply by that, and write um."
    if _is_bare_molar(text, unit):
        return "Did you mean 'mM'?"
    known = {name.lower(): name for name in reversed(list(_sizes()))}
    for name in set(names) - _sizes().keys():
        for near in difflib.get_close_matches(name.lower(), known, 5, 0.6):
            meant = re.sub(rf"(?<![A-Za-z]){name}(?![A-Za-z])", known[near], _plain(text))
            if unit_factor(meant, unit) is not None:
                return f"Did you mean '{meant}'?"
    return ""


def _from_text(text: str, unit: str, path: str) -> float:
    match = _QUANTITY.fullmatch(text) if len(text) <= 100 else None
    if match is None:
        raise SceneError(path, f"is {shown(text)}, must be a number and a unit", _example(unit))
    digits, unit_text = match[1], match[2].strip()
    if not unit_text:
        hint = f"Write for example '{digits} h'." if unit == "s" else _example(unit)
        raise SceneError(path, f"is {shown(text)}, a string without a unit", hint)
    several = _SPANS.fullmatch(unit_text) if unit == "s" and digits[0] != "-" else None
    spans = [(digits, unit_text if several is None else several[1])]
    spans += re.findall(_SPAN, several[2]) if several else []
    factors = [_factor(name, unit, text, path) for _, name in spans]
    if any(a <= b for a, b in pairwise(factors)):
        hint = "Write for example '2 days 3 h'."
        raise SceneError(path, f"is {shown(text)}, whose units do not fall", hint)
    number = finite(float(digits), path, "a number")
    if number == 0.0 and not Decimal(digits).is_zero():
        raise SceneError(path, f"is {shown(text)}, too small for a number", _example(unit))
    if number == 0.0 and len(spans) == 1:
        return 0.0
    parts = zip((Decimal(part) for part, _ in spans), factors, strict=True)
    total = sum(part * Decimal(repr(factor)) for part, factor in parts)
    return finite(float(total), path, "a number", _example(unit))


def _factor(unit_text: str, unit: str, text: str, path: str) -> float:
    """Return how many ``unit`` one ``unit_text`` is; ``text`` is what the user wrote."""
    factor, hint = unit_factor(unit_text, unit), _example(unit)
    if factor is not None:
        return factor
    if _is_bare_molar(unit_text, unit):
        number = float(text.replace(unit_text, ""))
        hint = f"Did you mean '{number:g} mM'? {number:g} M is written '{1000.0 * number:g} mM'."
        raise SceneError(path, f"is {shown(text)}, in moles per litre", hint)
    if _read(unit_text) is not None:
        kind = _UNITS[unit][2] if unit in _UNITS else f"a quantity in {unit}"
        problem = f"is {shown(text)}, must be {kind}, which '{unit_text}' is not"
        if unit == "mM" and unit_text.startswith(("g/", "mg/", "ug/", "µg/", "ng/")):
            hint += " Divide a mass by the molar mass: 1 g/l of glucose (180 g/mol) is 5.55 mM."
        raise SceneError(path, problem, hint)
    if re.match(r",\d", unit_text):
        hint = f"Use '.' as decimal separator. {hint}"
    if not _factors(unit_text):
        if re.match(r"[-–±+:~]|\.\.|to\b", unit_text):
            hint = f"{hint} One value has one number; ranges are for --vary, --free and --key."
        raise SceneError(path, f"is {shown(text)}, its unit cannot be read", hint)
    meant = unit_hint(unit_text, unit).replace("mean '", f"mean '{text.replace(unit_text, '')}")
    hint = " ".join(filter(None, (meant, hint, "Capitals matter: kPa, mM, um.")))
    raise SceneError(path, f"is {shown(text)}, with the unknown unit '{unit_text}'", hint)


def _is_bare_molar(unit_text: str, unit: str) -> bool:
    """Return whether a concentration is in M, without a prefix."""
    return unit == "mM" and _factors(unit_text) == [("M", 1)]


def _plain(text: str) -> str:
    return text.translate(_WRITTEN).replace("mm Hg", "mmHg").strip()


def _factors(text: str) -> list[tuple[str, int]] | None:
    """Return names and powers of the product that a unit is; None where it cannot be read."""
    text, place, signs, sign, behind = _plain(text), 0, [1], 1, False
    found: list[tuple[str, int]] = []
    while place < len(text):
        match = _TOKEN.match(text, place)
        if match is None or len(text) > 40:
            return None
        place, (name, power, mark) = match.end(), match.groups()
        if name:
            found.append((name, sign * signs[-1] * int(power or 1)))
        elif mark == "(":
            signs.append(sign * signs[-1])
        elif behind != (mark != "1") or (mark == ")" and len(signs) == 1):
            return None
        elif mark == ")":
            signs.pop()
        sign, behind = -1 if mark == "/" else 1, mark not in ("*", "/", "(")
    return found if behind and len(signs) == 1 else None


@functools.lru_cache(4096)
def _read(text: str) -> tuple[Power, Decimal] | None:
    """Return the powers of the axes in a unit and its size; None where a name is not listed."""
    power, size = [0] * len(_AXES), Decimal(1)
    for name, exponent in _factors(text) or [("", 1)]:
        known = _sizes().get(name)
        if known is None:
            return None
        power = [a + exponent * b for a, b in zip(power, known[0], strict=True)]
        size *= known[1] ** exponent
    return tuple(power), size


@functools.cache
def _sizes() -> Mapping[str, tuple[Power, Decimal]]:
    """Return the powers of the axes and the size of each name that is listed."""
    known: dict[str, tuple[Power, Decimal]] = {}
    for base, units in LISTED.items():
        factors = _factors(base) or ()
        power = tuple(sum(e for name, e in factors if name == axis) for axis in _AXES)
        for names, size in units.items():
            known |= dict.fromkeys(names.split(), (power, Decimal(size)))
    return known


def _example(unit: str) -> str:
    return f"Write for example '{_UNITS[unit][3] if unit in _UNITS else f'1 {unit}'}'."
