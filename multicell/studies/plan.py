"""The plan of a study: a scene, a design and seeds; the file ``study.toml``.

``study.toml`` stands in the folder of a study beside ``scene.toml``, the scene that is varied. Both
are written once and are the user's to edit; what is in them is checked as a whole, with every
point's scene, before anything runs.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, final

from multicell.errors import SceneError
from multicell.host.files import parse_toml, read_regular
from multicell.scene.scene import Scene, load_scene
from multicell.schema import near_miss
from multicell.studies.axes import Axis, change, parse_axis
from multicell.studies.design import Design, Point
from multicell.studies.limits import check_runs, check_seeds
from multicell.studies.runs import Run, digest
from multicell.units import BASE_UNITS, shown

NAME: Final = "study.toml"
SCENE: Final = "scene.toml"
_LARGEST: Final = 20_000_000
"""Bytes of study.toml: 1,000 for each of as many points as there may be."""
_KEYS: Final = (
    "scene", "seeds", "design", "vary", "points",
)  # fmt: skip


@final
@dataclass(frozen=True)
class Plan:
    """All that a study computes.

    - ``scene``: what is varied
    - ``design``: how
    - ``seeds``: number of runs of each point, with the scene's seed and those that follow it: the
      same at all points, so that two of them differ by their parameters alone

    Raises SceneError if anything of it cannot be: a number of seeds below one, a point that the
    scene refuses (with its values), two points that are one.
    """

    scene: Scene
    design: Design
    seeds: int = 1
    scenes: tuple[Scene, ...] = field(init=False, repr=False, compare=False)
    """Of every point, with the first seed."""

    def __post_init__(self) -> None:
        check_runs(len(self.design.points), check_seeds(self.seeds, self.scene.seed))
        scenes = tuple(change(self.scene, point.changes) for point in self.design.points)
        object.__setattr__(self, "scenes", scenes)
        self._refuse_equal_points()

    @property
    def points(self) -> tuple[Point, ...]:
        """Those of the design."""
        return self.design.points

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all runs: those of one point after the other, each with all its seeds."""
        return tuple(digest(scene) for _, scene in self._each())

    def runs(self, expected: Sequence[float]) -> list[Run]:
        """Return all runs, in the order of :attr:`names`.

        - ``expected``, per point, s: wall time that one of its runs takes
        """
        made = []
        for name, (k, scene) in zip(self.names, self._each(), strict=True):
            where = {**self.points[k].coordinates, "seed": scene.seed}
            made.append(Run(name, scene, where, expected[k]))
        return made

    def _each(self) -> Iterator[tuple[int, Scene]]:
        for k, scene in enumerate(self.scenes):
            for j in range(self.seeds):
                yield k, replace(scene, seed=scene.seed + j) if j else scene

    def _refuse_equal_points(self) -> None:
        """Refuse two points whose runs would be the same."""
        seen: dict[str, Point] = {}
        for point, scene in zip(self.points, self.scenes, strict=True):
            name = digest(scene)
            other = seen.setdefault(name, point)
            if other is not point:
                problem = f"makes no difference between {other} and {point}: the scenes are equal"
                differ = [key for key in point.changes if point.changes[key] != other.changes[key]]
                raise SceneError((differ or list(point.changes))[0], problem)

    def to_toml(self) -> str:
        """Return the text of ``study.toml``, which :func:`read_plan` reads back exactly."""
        return "\n".join(_lines(self)) + "\n"


def make_plan(
    scene: Scene,
    vary: Mapping[str, Any] | None = None,
    *,
    points: Any = None,
    seeds: int = 1,
    design: str = "grid",
) -> Plan:
    """Return a plan of what is given in Python, on the command line or in ``study.toml``.

    Parameters are those of :func:`multicell.studies.study.study`; ``design`` is ``"grid"``, or
    ``"list"`` where there are ``points``.
    """
    if points is not None:
        if vary:
            hint = "Give them as further columns, or take another design."
            raise SceneError("points", "cannot stand beside keys that are varied one by one", hint)
        axes, design = _columns(points, scene), "list"
    elif design == "list":
        raise SceneError("points", "is missing: a list needs its points")
    elif vary is None or isinstance(vary, Mapping):
        axes = tuple(parse_axis(key, given, scene) for key, given in _flat(vary or {}).items())
    else:
        raise SceneError("vary", f"is {shown(vary)}, must be a table of keys and values")
    return Plan(scene, Design(design, axes), check_seeds(seeds, scene.seed))


def _columns(points: Any, scene: Scene) -> tuple[Axis, ...]:
    to_dict = getattr(points, "to_dict", None)
    if to_dict is not None:  # a pandas DataFrame
        points = to_dict("list")
    if isinstance(points, Mapping):
        table = _flat(points)
    else:
        rows = list(points) if isinstance(points, Iterable) else []
        if not rows or not all(isinstance(row, Mapping) for row in rows):
            raise SceneError("points", f"is {shown(points)}, must be a table or its rows")
        flat = [_flat(row) for row in rows]
        for k, row in enumerate(flat):
            if set(row) != set(flat[0]):
                problem = f"has other keys in row {k + 1} than in row 1"
                raise SceneError("points", problem, "Every point needs a value of every key.")
        table = {key: [row[key] for row in flat] for key in flat[0]}
    return tuple(parse_axis(key, table[key], scene) for key in table)


def _flat(entries: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return a table with dotted keys, as they stand with and without quotes in TOML."""
    result: dict[str, Any] = {}
    for key, value in entries.items():
        name = f"{path}{key}"
        inner = _flat(value, f"{name}.") if isinstance(value, Mapping) else {name: value}
        for found, entry in inner.items():
            if found in result:
                raise SceneError(found, "is varied twice", "Give all its values at once.")
            result[found] = entry
    return result


def read_plan(folder: str | Path) -> Plan:
    """Return the plan in the folder of a study.

    - ``folder``: with ``study.toml``, and the scene that it names
    """
    folder = Path(folder)
    path = folder / NAME
    entries = _entries(path)
    for key in entries:
        if key not in _KEYS:
            raise SceneError(key, f"is not a known key of '{path}'", near_miss(key, _KEYS))
    source = entries.pop("scene", SCENE)
    if not isinstance(source, str):
        raise SceneError("scene", f"is {shown(source)}, must be the path of a scene file")
    scene = load_scene(folder / source)
    return make_plan(scene, entries.pop("vary", None), **entries)


def _entries(path: Path) -> dict[str, Any]:
    try:
        text = read_regular(path, _LARGEST).decode("utf-8").replace("\r\n", "\n")
    except FileNotFoundError:
        hint = "'multicell study new SCENE -o FOLDER' makes one."
        raise SceneError("", f"'{path.parent}' holds no study: there is no {NAME}", hint) from None
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise SceneError("", f"'{path}' cannot be read: {reason}") from None
    try:
        return parse_toml(text)
    except ValueError as error:
        raise SceneError("", f"'{path}' is not valid TOML: {error}") from None


def _lines(plan: Plan) -> Iterator[str]:
    """Yield the lines of ``study.toml``."""
    design, seed = plan.design, plan.scene.seed
    last = "" if plan.seeds == 1 else f" to {seed + plan.seeds - 1}"
    yield "# A study of multicell: what is varied, and how. 'multicell study run' with the name of"
    yield "# this folder computes what is missing; after any change here it keeps what fits."
    yield f"# Numbers without a unit: {BASE_UNITS}"
    yield ""
    yield f'scene = "{SCENE}"  # what is varied, in this folder'
    yield f"seeds = {plan.seeds}  # runs of each point; seed {seed}{last}, the same at all points"
    yield f'design = "{design.kind}"  # {_WORDS[design.kind]}'
    table = "points" if design.kind == "list" else "vary"
    yield ""
    yield f"[{table}]  # key = values"
    for axis in design.axes:
        yield axis_line(axis)


_WORDS: Final = {
    "grid": "all combinations",
    "list": "the points below, one a place in the lists",
}


def axis_line(axis: Axis) -> str:
    """Return what stands for an axis in ``study.toml``."""
    unit = f"  # {axis.unit}" if axis.unit else ""
    return f"{_dotted(axis.key)} = [{', '.join(map(_toml, axis.values))}]{unit}"


def _dotted(key: str) -> str:
    """Return a dotted key as TOML has it: parts such as the side ``*`` need quotes."""
    bare = re.compile(r"[A-Za-z0-9_-]+")
    parts = (part if bare.fullmatch(part) else json.dumps(part) for part in key.split("."))
    return ".".join(parts)


def _toml(value: Any) -> str:
    """Return a value as TOML has it, on one line."""
    if isinstance(value, Mapping):
        entries = (f"{json.dumps(str(key))} = {_toml(entry)}" for key, entry in value.items())
        return f"{{ {', '.join(entries)} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return repr(value).lower() if isinstance(value, bool) else repr(value)
