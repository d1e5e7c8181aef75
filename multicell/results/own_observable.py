"""Observables of the user's own: a Python function of the state of a run becomes an observable.

>>> import multicell as mc
>>> @mc.observable(name="rim area", unit="um^2")
... def rim_area(state):
...     living = state.cells.radius[~state.cells.dead]
...     return 3.14159 * (living**2).sum()
>>> scene = mc.load_scene("growth").with_observables(rim_area)
"""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from numbers import Real
from typing import Any

from multicell.contact.constants import fingerprint
from multicell.errors import SceneError
from multicell.plugins.named import load_object, origin, own_code
from multicell.results.observable import OWN_OBSERVABLES, Observable, TissueState
from multicell.results.quantities import is_taken
from multicell.scene.scene import Scene
from multicell.units import shown

Function = Callable[[TissueState], float]

_NAME = re.compile(r"[a-z][a-z0-9_]{0,59}")
_POWER = r"(um|s|nN|amol|kPa|mM)(\^[1-9])?"
_UNIT = re.compile(rf"(1|{_POWER})([ /]{_POWER})*|")


def observable(
    *, name: str, unit: str = "", needs: Sequence[str] = (), absent: str = "", signed: bool = False
) -> Callable[[Function], Observable]:
    """Make an observable of a function of the state of a run.

    The function is called as ``function(state)`` once a coupling step and returns one number. The
    state is a :class:`multicell.results.observable.TissueState` in arrays that cannot be written
    into. A scene records the observable once :meth:`Scene.with_observables` has named it; then it
    is a column of the history, an entry of the summary, and what fits, studies and analyses of
    sensitivity may ask for.

    Parameters
    ----------
    name
        Words in lower case; the column has ``_`` for spaces.
    unit
        A product of the base units um, s, nN, amol, kPa and mM such as ``"um^2"`` or ``"1/s"``;
        absent: a count or a ratio.
    needs
        Dotted keys that a scene must have, such as ``"nutrients.oxygen"``; others refuse it.
    absent
        When the number does not exist, in words; the function returns NaN then.
    signed
        Whether it may be negative.

    Raises
    ------
    ValueError
        For a name or a unit that it cannot have.
    TypeError
        For what is no function.
    """
    column = name.replace(" ", "_")
    if not _NAME.fullmatch(column):
        raise ValueError(f"{name!r} is no name of an observable: letters a-z, digits and spaces")
    if is_taken(column):
        raise ValueError(f"{name!r} is the name of a number that runs have already")
    if not _UNIT.fullmatch(unit):
        raise ValueError(f"{unit!r} is no product of um, s, nN, amol, kPa and mM such as 'um^2'")

    def make(function: Function) -> Observable:
        code = getattr(function, "__code__", None)
        if code is None:
            raise TypeError(f"{shown(function)} is no function")
        source: Any = function
        file = os.path.basename(code.co_filename)
        mark = hashlib.sha256(f"{fingerprint(function)} {column} {unit}".encode()).hexdigest()[:12]
        made = Observable(
            column,
            _guard(function, column),
            unit=unit,
            exists=partial(_exists, column, needs),
            absent=absent,
            signed=signed,
            function=f"{file}:{source.__qualname__}@{mark}",
            source=origin(source),
        )
        OWN_OBSERVABLES[made.function] = made
        return made

    return make


def load_observable(spec: str) -> Observable:
    """Return the observable that ``file.py:Name`` names, after which scenes may name it as well.

    Raises
    ------
    SceneError
        If it cannot be loaded, or is none made by :func:`observable`.
    """
    found = load_object(spec, "output.observables")
    if not isinstance(found, Observable):
        hint = "A function becomes one by the decorator multicell.observable."
        raise SceneError("output.observables", f"{spec!r} is not an observable", hint)
    OWN_OBSERVABLES[found.function] = found
    return found


def _exists(name: str, needs: Sequence[str], scene: Scene) -> bool:
    """Return True, or refuse a scene that lacks a part or a value by its dotted key."""
    for key in needs:
        found: Any = scene
        for part in key.split("."):
            found = found.get(part) if isinstance(found, Mapping) else getattr(found, part, None)
        if not found:
            problem = f"needs '{key}', which the scene does not have"
            raise SceneError(f"output.observables.{name}", problem)
    return True


def _guard(function: Function, name: str) -> Callable[[TissueState], float]:
    """Return a function that refuses what is no number, in words with file and line."""
    path = f"output.observables.{name}"

    def measure(state: TissueState) -> float:
        with own_code(path):
            value = function(state.sealed)
        if not isinstance(value, Real) or isinstance(value, bool) or math.isinf(value):
            code = function.__code__
            place = f"'{code.co_filename}', line {code.co_firstlineno}"
            raise SceneError(path, f"{place}, returns {shown(value)}, must be a finite number")
        return float(value)

    return measure
