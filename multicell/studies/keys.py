"""Keys of a scene by their dotted paths: declaration, unit, and conversion of values.

To vary a key without effect would be to run the same thing again. The rules for that are of keys
that studies usually vary; a study of any other one runs, and shows that nothing depends on it.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from typing import Any, Final, final

from multicell.errors import SceneError
from multicell.integrators.registry import METHODS
from multicell.scene.oxygen import in_concentrations
from multicell.scene.responses import Response, in_base_units, response_unit
from multicell.scene.scene import Scene, check_dotted
from multicell.schema import Draw, Parameter, chosen, near_miss, place_of_key, specs

_TABLES: Final = ("table", "variant", "tables")
_NUMBERS: Final = ("quantities", "drawn_numbers")
"""Kinds of tables of names to numbers, each of which is a value of its own."""
_NO_AXES: Final = {
    "seed": "belongs to every run: give the number of seeds",
    "title": "changes nothing in a run",
}


@final
@dataclass(frozen=True)
class Key:
    """A value of a scene that can be varied.

    - ``name``: its dotted key
    - ``spec``: its declaration
    - ``unit``: base unit of its numbers, empty for counts and words
    - ``part``: the part of the scene that holds it; None for an entry of a table of numbers
    """

    name: str
    spec: Parameter
    unit: str
    part: Any
    scene: Scene

    def plain(self, value: Any) -> Any:
        """Return a value as a scene file in base units would have it."""
        if self.spec.kind == "measure":  # other keys of its part decide its unit
            last = self.name.rpartition(".")[2]
            try:
                part = replace(self.part, **{last: value})
                if isinstance(part, Response):
                    part = in_base_units(self.scene, part)
                return getattr(part, last)
            except SceneError as error:
                raise SceneError(self.name, error.problem, error.hint) from None
        if self.spec.kind == "variant":
            parts: Any = self.spec.parts
            return chosen(value, parts, self.name, getattr(parts, "hint", None))
        given = in_concentrations(value, tuple(self.name.split(".")), self.scene.nutrients)
        if self.spec.kind in _NUMBERS:
            last = self.name.rpartition(".")[2]
            table = self.spec.convert({last: given}, self.name.rpartition(".")[0])
            return self.spec.plain(table)[last]
        return self.spec.plain(self.spec.convert(given, self.name))


def key_of(scene: Scene, name: str) -> Key:
    """Return where a dotted key leads in a scene."""
    check_dotted(name)
    if name in _NO_AXES:
        raise SceneError(name, f"cannot be varied: it {_NO_AXES[name]}")
    absent: list[str] = []
    known = {key.name: key for key in _keys_of(scene, scene, "", absent)}
    full = _spelled_out(scene, name)
    if full not in known:
        raise _refusal(name, list(known), absent)
    return known[full]


def _spelled_out(part: Any, name: str) -> str:
    """Return a key, in place of the name of a table the one that a bare text there stands for."""
    first, _, rest = name.partition(".")
    spec = specs(part).get(first) if is_dataclass(part) else None
    value = part.get(first) if isinstance(part, Mapping) else getattr(part, first, None)
    if rest:
        return f"{first}.{_spelled_out(value, rest)}"
    return f"{name}.{spec.shorthand}" if spec is not None and spec.shorthand else name


def _keys_of(scene: Scene, part: Any, path: str, absent: list[str]) -> Iterator[Key]:
    """Yield the keys of a part and of all in it; note the tables that it does not have."""
    for name, spec in specs(part).items():
        value, where = getattr(part, name), f"{path}{name}"
        if spec.kind == "variant":
            yield Key(f"{where}.{spec.key}", spec, "", part, scene)
        if spec.kind == "tables" and value:
            for entry, inner in value.items():
                yield from _keys_of(scene, inner, f"{where}.{entry}.", absent)
        elif is_dataclass(value):
            yield from _keys_of(scene, value, f"{where}.", absent)
        elif spec.kind in _NUMBERS and value:
            for entry, number in value.items():
                if not isinstance(number, Draw):  # each cell has another one
                    yield Key(f"{where}.{entry}", spec, spec.unit, None, scene)
        elif spec.kind in (*_TABLES, *_NUMBERS):
            absent.append(where)
        elif where not in _NO_AXES:
            unit = _unit_of_measure(scene, part, name) if spec.kind == "measure" else spec.unit
            unitless = spec.kind in ("count", "choice", "text", "flag", "names")
            yield Key(where, spec, "" if unitless else unit, part, scene)


def _unit_of_measure(scene: Scene, part: Any, name: str) -> str:
    if not isinstance(part, Response):
        return str(part.unit)
    needs_signal = name in ("half", "begin", "end")
    return response_unit(scene, part, name) if part.signals or not needs_signal else ""


def _refusal(name: str, known: Sequence[str], absent: Sequence[str]) -> SceneError:
    """Return why a name is not that of a value of a scene."""
    for table in absent:
        if f"{name}.".startswith(f"{table}."):
            hint = f"Add it first: --set {name}=..., or with_changes({{'{name}': ...}})."
            return SceneError(name, f"cannot be varied: the scene has no '{table}'", hint)
    below = [key.removeprefix(f"{name}.") for key in known if key.startswith(f"{name}.")]
    if below:
        listed = ", ".join(dict.fromkeys(key.partition(".")[0] for key in below))
        return SceneError(name, f"is a table, not a value: name one of its keys ({listed})")
    hint = place_of_key(name.rpartition(".")[2]) or _near(name, known) or near_miss(name, known)
    return SceneError(name, "is not a key of this scene", hint)


def _near(name: str, known: Sequence[str]) -> str:
    """Return the likely key in words, or nothing where none is near."""
    last = name.rpartition(".")[2]
    ends = f".{last}", f".{last}.boundary"
    same = [key for key in known if key == last or key.endswith(ends)]
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.75) or (
        same if len(same) < 4 else difflib.get_close_matches(name, same, n=2, cutoff=0.0)
    )
    if not near:
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return f"Did you mean {' or '.join(map(repr, near))}?" if near else ""


def no_effect(scene: Scene, key: str) -> str:
    """Return why a key has no effect in a scene, in words; nothing where it may have one.

    The reason follows from the other keys alone; whether a run ever gets to where a key matters is
    for the run to show.
    """
    for pattern, holds, words in _PATTERNS:
        match = pattern.fullmatch(key)
        if match is not None and holds(scene, *match.groups()):
            return words.format(*match.groups(), method=scene.integrator.method)
    return ""


def refuse_ineffective(
    scenes: Iterable[tuple[Mapping[str, Any], Scene]], keys: Sequence[str]
) -> None:
    """Refuse keys that have no effect in a scene, or in some of several.

    - ``scenes``: what sets each of them apart (key -> value), and the scene
    - ``keys``: what is varied
    """
    found: dict[str, tuple[str, Mapping[str, Any]]] = {}
    effective = set()
    for changes, scene in scenes:
        for key in keys:
            reason = no_effect(scene, key)
            if reason:
                found.setdefault(key, (reason, changes))
            else:
                effective.add(key)
    for key, (reason, changes) in found.items():
        others = {name: value for name, value in changes.items() if name != key}
        if key not in effective or not others:
            raise SceneError(key, f"has no effect: {reason}", "Nothing would differ between runs.")
        where = ", ".join(f"{name} = {value!r}" for name, value in others.items())
        hint = "Vary it in a study of its own, or list the points that make sense."
        raise SceneError(key, f"has no effect where {where}: {reason}", hint)


def _controlled(scene: Scene) -> bool:
    info = METHODS.get(scene.integrator.method)
    return info is not None and info.control != "step"


def _lacks(scene: Scene, name: str) -> bool:
    """Return whether a known method does not have a setting."""
    info = METHODS.get(scene.integrator.method)
    return info is not None and name != "method" and name not in info.settings


def _scheduled(scene: Scene, field: str) -> bool:
    """Return whether the medium of a field is given from the start on."""
    media, finite = scene.nutrients[field].media, scene.nutrients[field].finite_medium
    return bool(media) and media[0][0] <= 0.0 and finite is None  # type: ignore[index]


_RULES: Final[Sequence[tuple[str, Callable[..., Any], str]]] = (
    (
        "growth.cycle_time growth.cycle_variation",
        lambda s: s.growth.phases,
        "the phases of the cycle say how long it lasts",
    ),
    (
        "growth.hypertrophy",
        lambda s: not s.growth.phases,
        "without phases a cell divides at the volume of division",
    ),
    (
        "growth.phases.*.variation",
        lambda s, name: s.growth.phases[name].distribution == "fixed",
        "the phase has a fixed duration",
    ),
    ("integrator.step", _controlled, "the method {method!r} chooses its steps"),
    ("integrator.*", _lacks, "the method {method!r} has no {0}"),
    (
        "cells.young",
        lambda s: s.types and all(k.young is not None for k in s.types.values()),
        "every type of cell has a Young's modulus of its own",
    ),
    (
        "contact.surface_energy",
        lambda s: any(k.surface_energy for k in s.types.values()),
        "every pair of types has a surface energy of its own",
    ),
    ("nutrients.*.boundary", _scheduled, "'media' says what the medium is from the start on"),
)
"""Keys, what holds where they have no effect, and that in words.

Both get the scene, and the names that stand for the stars of the key.
"""
_PATTERNS: Final = [
    (re.compile(r"([^.]+)".join(map(re.escape, key.split("*")))), holds, words)
    for keys, holds, words in _RULES
    for key in keys.split()
]
