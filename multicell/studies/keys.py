"""Where a dotted key of a scene leads: its declaration, its unit, and what a value becomes."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, is_dataclass, replace
from typing import TYPE_CHECKING, Any, Final, final

from multicell.errors import SceneError
from multicell.scene.oxygen import in_concentrations
from multicell.scene.scene import check_dotted
from multicell.schema import Parameter, Tables, near_miss, specs

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

_TABLES: Final = ("table", "variant", "tables")
_NO_AXES: Final = {
    "seed": "belongs to every run: give the number of seeds",
    "title": "changes nothing in a run",
}


@final
@dataclass(frozen=True)
class Key:
    """A value of a scene that can be varied.

    Attributes
    ----------
    name
        Its dotted key.
    spec
        Its declaration.
    unit
        Base unit of its numbers, empty for counts and words.
    part
        The part of the scene that holds it; None for an entry of a table of numbers.
    scene
        The scene.
    """

    name: str
    spec: Parameter
    unit: str
    part: Any
    scene: Scene

    def plain(self, value: Any) -> Any:
        """Return a value as a scene file in base units would have it.

        Raises
        ------
        SceneError
            If the declaration refuses it.
        """
        if self.spec.kind == "rate_constant":  # other keys of its part decide its unit
            try:
                return replace(self.part, rate=value).rate
            except SceneError as error:
                raise SceneError(self.name, error.problem, error.hint) from None
        if self.spec.kind == "variant":
            return self._word(value)
        given = self._concentration(value)
        if self.spec.kind == "quantities":
            last = self.name.rpartition(".")[2]
            table = self.spec.convert({last: given}, self.name.rpartition(".")[0])
            return table[last]
        return self.spec.plain(self.spec.convert(given, self.name))

    def _word(self, value: Any) -> str:
        """Return the name of a part, such as that of a contact law."""
        from multicell.schema import chosen

        assert self.spec.parts is not None
        return chosen(value, self.spec.parts, self.name, getattr(self.spec.parts, "hint", None))

    def _concentration(self, value: Any) -> Any:
        """Return a value with a partial pressure of oxygen replaced by its concentration."""
        room, *inner = self.name.split(".")
        if room != "nutrients" or not isinstance(value, str):
            return value
        name, *below = inner
        entries: Any = value
        for step in reversed(below):
            entries = {step: entries}
        if below[0] != "temperature":
            entries["temperature"] = self.scene.nutrients[name].temperature
        found: Any = in_concentrations(name, entries, f"nutrients.{name}")
        for step in below:
            found = found[step]
        return found


def key_of(scene: Scene, name: str) -> Key:
    """Return where a dotted key leads in a scene.

    Raises
    ------
    SceneError
        For a key that no scene or not this one has, that of a whole table, and one that cannot be
        varied.
    """
    check_dotted(name)
    if name in _NO_AXES:
        raise SceneError(name, f"cannot be varied: it {_NO_AXES[name]}")
    steps = name.split(".")
    holder: Any = scene
    spec: Parameter | None = None
    for depth, step in enumerate(steps):
        here = ".".join(steps[:depth])
        if isinstance(holder, Tables):
            _in_table(scene, name, here, step, holder)
            holder, spec = holder[step], None
            continue
        known = specs(holder)
        if spec is not None and spec.kind == "variant" and step == spec.key:
            return _last(scene, name, steps[depth + 1 :], Key(name, spec, "", holder, scene))
        if step not in known:
            raise _unknown(scene, name, here, [*([spec.key] if spec and spec.key else []), *known])
        spec, value = known[step], getattr(holder, step)
        if spec.kind not in _TABLES:
            return _value(scene, name, steps[depth + 1 :], spec, holder, value)
        if value is None:
            raise _absent(name, ".".join(steps[: depth + 1]))
        holder = value
    if spec is not None and spec.shorthand:
        return key_of(scene, f"{name}.{spec.shorthand}")
    raise _whole_table(name, holder, spec)


def _in_table(scene: Scene, name: str, here: str, step: str, entries: Mapping[str, Any]) -> None:
    """Refuse a name that a table of named tables does not have."""
    if step in entries:
        return
    if not entries:
        raise _absent(name, here)
    problem = f"is not a key of this scene: '{here}' has no '{step}'"
    raise SceneError(name, problem, _near(scene, name) or near_miss(step, entries))


def _value(
    scene: Scene, name: str, rest: list[str], spec: Parameter, holder: Any, value: Any
) -> Key:
    """Return the key of a value, or of one entry in a table of numbers."""
    unit = spec.unit
    if spec.kind == "rate_constant":
        unit = holder.unit
    if spec.kind == "quantities":
        if not rest:
            names = ", ".join(value or ()) or "none in this scene"
            raise SceneError(name, f"is a table, not a value: name one of its entries ({names})")
        if rest[0] not in (value or {}):
            problem = f"is not a key of this scene: there is no entry '{rest[0]}'"
            raise SceneError(name, problem, near_miss(rest[0], value or ()))
        return _last(scene, name, rest[1:], Key(name, spec, unit, None, scene))
    if spec.kind in ("count", "choice", "text", "flag", "names"):
        unit = ""
    return _last(scene, name, rest, Key(name, spec, unit, holder, scene))


def _last(scene: Scene, name: str, rest: list[str], key: Key) -> Key:
    """Return a key if its path ends with it."""
    if rest:
        parent = name.removesuffix("." + ".".join(rest))
        problem = f"is not a key: '{parent}' is a value, not a table"
        raise SceneError(name, problem, _near(scene, name))
    return key


def _absent(name: str, table: str) -> SceneError:
    """Return the error of a key in a part that the scene does not have."""
    hint = f"Add it first: --set {name}=..., or with_changes({{'{name}': ...}})."
    return SceneError(name, f"cannot be varied: the scene has no '{table}'", hint)


def _unknown(scene: Scene, name: str, here: str, known: list[str]) -> SceneError:
    near = _near(scene, name)
    step = name.removeprefix(f"{here}.").split(".")[0] if here else name.split(".")[0]
    return SceneError(name, "is not a key of this scene", near or near_miss(step, known))


def _whole_table(name: str, holder: Any, spec: Parameter | None) -> SceneError:
    keys = list(holder if isinstance(holder, Tables) else specs(holder))
    if spec is not None and spec.key:
        keys = [spec.key, *keys]
    listed = ", ".join(keys[:8]) + (", ..." if len(keys) > 8 else "")
    return SceneError(name, f"is a table, not a value: name one of its keys ({listed})")


def _near(scene: Scene, name: str) -> str:
    """Return the likely key in words, or nothing where none is near."""
    keys = list(all_keys(scene))
    last = name.rpartition(".")[2]
    same = [key for key in keys if key == last or key.endswith(f".{last}")]
    near = difflib.get_close_matches(name, keys, n=1, cutoff=0.75) or (
        same if len(same) < 4 else difflib.get_close_matches(name, same, n=2, cutoff=0.0)
    )
    if not near:
        near = difflib.get_close_matches(name, keys, n=1, cutoff=0.6)
    return f"Did you mean {' or '.join(map(repr, near))}?" if near else ""


def all_keys(part: Any, path: str = "") -> Iterator[str]:
    """Yield the dotted keys of all values of a scene, also of those that are absent."""
    for name, spec in specs(part).items():
        value, where = getattr(part, name), f"{path}{name}"
        if spec.kind == "variant":
            yield f"{where}.{spec.key}"
        if spec.kind == "tables":
            for key, entry in value.items():
                yield from all_keys(entry, f"{where}.{key}.")
        elif is_dataclass(value):
            yield from all_keys(value, f"{where}.")
        elif spec.kind == "quantities":
            yield from (f"{where}.{key}" for key in value or ())
        elif spec.kind not in _TABLES and where not in _NO_AXES:
            yield where
