"""The plan of a study: a scene, the points of a grid or a list, and seeds; ``study.toml``.

``study.toml`` stands in the folder of a study beside ``scene.toml``, the scene that is varied. Both
are written once and are the user's to edit; what is in them is checked as a whole, with every
point's scene, before anything runs.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, final

from multicell.errors import SceneError
from multicell.host.files import parse_toml, read_regular
from multicell.scene.scene import Scene, load_scene, scene_text
from multicell.schema import near_miss
from multicell.studies.axes import Axis, change, parse_axis, with_unique_names
from multicell.studies.keys import refuse_ineffective
from multicell.studies.limits import check_runs, check_seeds
from multicell.studies.runs import StudyRun, run_digest, run_digests
from multicell.units import BASE_UNITS, shown

PLAN_FILE: Final = "study.toml"
SCENE: Final = "scene.toml"
_LARGEST: Final = 20_000_000
"""Bytes of study.toml: 1,000 for each of as many points as there may be."""
END: Final = "# end"
"""Begins the last line of ``study.toml`` and of the scene beside it: where only one has it, the
other was cut or emptied. Files that a user has written have none."""
_KEYS: Final = ("scene", "seeds", "design", "vary", "points")
DESIGNS: Final = {
    "grid": "all combinations",
    "list": "the points below, one a place in the lists",
}


@final
@dataclass(frozen=True)
class StudyPoint:
    """One point of a study.

    - ``changes``: dotted key -> value, as :meth:`Scene.with_changes` takes them
    - ``coordinates``: axis name -> number in base units, or word
    """

    changes: Mapping[str, Any]
    coordinates: Mapping[str, float | str]

    def __str__(self) -> str:
        return ", ".join(f"{key} = {value!r}" for key, value in self.changes.items())


@final
@dataclass(frozen=True)
class Plan:
    """All that a study computes.

    - ``scene``: what is varied
    - ``axes``: of a grid, the last one running fastest; of a list its columns, all of one length
    - ``design``: one of :data:`DESIGNS`
    - ``seeds``: number of runs of each point, with the scene's seed and those that follow it: the
      same at all points, so that two of them differ by their parameters alone

    Raises SceneError if anything of it cannot be: a number of seeds below one, a point that the
    scene refuses (with its values), a key without effect, two points that are one.
    """

    scene: Scene
    axes: tuple[Axis, ...] = ()
    design: str = "grid"
    seeds: int = 1
    points: tuple[StudyPoint, ...] = field(init=False, repr=False, compare=False)
    scenes: tuple[Scene, ...] = field(init=False, repr=False, compare=False)
    """Of every point, with the first seed."""

    def __post_init__(self) -> None:
        count = _count(self.axes, self.design)
        check_runs(count, 1, "points" if self.design == "list" else "vary")
        check_runs(count, check_seeds(self.seeds, self.scene.seed))
        object.__setattr__(self, "axes", tuple(with_unique_names(self.axes)))
        object.__setattr__(self, "points", tuple(_points(self.axes, self.design)))
        scenes = tuple(change(self.scene, point.changes) for point in self.points)
        object.__setattr__(self, "scenes", scenes)
        cases = zip((point.changes for point in self.points), scenes, strict=True)
        refuse_ineffective(cases, [axis.key for axis in self.axes])
        self._refuse_equal_points()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all runs: those of one point after the other, each with all its seeds."""
        first = self.scene.seed
        seeds = range(first, first + self.seeds)
        return tuple(name for scene in self.scenes for name in run_digests(scene, seeds))

    def runs(self, expected: Sequence[float]) -> list[StudyRun]:
        """Return all runs, in the order of :attr:`names`.

        - ``expected``, per point, s: wall time that one of its runs takes
        """
        made, places = [], itertools.product(range(len(self.scenes)), range(self.seeds))
        for name, (k, j) in zip(self.names, places, strict=True):
            # the scene is checked already, and no check asks for the seed
            seeded = copy(self.scenes[k])
            object.__setattr__(seeded, "seed", seeded.seed + j)
            where = {**self.points[k].coordinates, "seed": seeded.seed}
            made.append(StudyRun(name, seeded, where, expected[k]))
        return made

    def _refuse_equal_points(self) -> None:
        """Refuse two points whose runs would be the same."""
        seen: dict[str, StudyPoint] = {}
        for point, scene in zip(self.points, self.scenes, strict=True):
            name = run_digest(scene)
            other = seen.setdefault(name, point)
            if other is not point:
                problem = f"makes no difference between {other} and {point}: the scenes are equal"
                differ = [key for key in point.changes if point.changes[key] != other.changes[key]]
                raise SceneError((differ or list(point.changes))[0], problem)

    def to_toml(self) -> str:
        """Return the text of ``study.toml``, which :func:`read_plan` reads back exactly."""
        return "\n".join(_lines(self)) + "\n"


def _count(axes: Sequence[Axis], design: str) -> int:
    """Return the number of points of axes; refuse those that do not go together."""
    if design not in list(DESIGNS):
        problem = f"is {shown(design)}, must be one of {', '.join(DESIGNS)}"
        raise SceneError("design", problem, near_miss(design, DESIGNS, listed=False))
    keys = [axis.key for axis in axes]
    for key in keys:
        if keys.count(key) > 1:
            raise SceneError(key, "is varied twice", "Give all its values at once.")
    lengths = [len(axis.values) for axis in axes]
    if design == "grid":
        return math.prod(lengths)
    if not keys:
        raise SceneError("points", "is empty", "A list needs a column for each key.")
    if len(set(lengths)) > 1:
        words = ", ".join(f"{key} has {n}" for key, n in zip(keys, lengths, strict=True))
        hint = "The values of a point stand at the same places of their lists."
        raise SceneError(keys[0], f"goes with lists of other lengths: {words}", hint)
    return lengths[0]


def _points(axes: Sequence[Axis], design: str) -> Iterator[StudyPoint]:
    """Yield all points, the last axis running fastest."""
    sides = [range(len(axis.values)) for axis in axes]
    for row in zip(*sides, strict=True) if design == "list" else itertools.product(*sides):
        chosen = list(zip(axes, row, strict=True))
        yield StudyPoint(
            {axis.key: axis.values[place] for axis, place in chosen},
            {axis.name: axis.coordinates[place] for axis, place in chosen},
        )


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
    return Plan(scene, axes, design, check_seeds(seeds, scene.seed))


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
    path = folder / PLAN_FILE
    entries, marked = _entries(path)
    for key in entries:
        if key not in _KEYS:
            raise SceneError(key, f"is not a known key of '{path}'", near_miss(key, _KEYS))
    source = entries.pop("scene", SCENE)
    if not isinstance(source, str):
        raise SceneError("scene", f"is {shown(source)}, must be the path of a scene file")
    scene = load_scene(folder / source)
    if source == SCENE and marked != _has_end(scene_text(folder / SCENE)):
        cut = folder / SCENE if marked else path
        raise SceneError(
            "",
            f"'{cut}' is cut short: its last line '{END}' is missing",
            "The 'multicell study new' that made it writes it again with --overwrite: runs that "
            "are there stay. If nothing is missing, add the line.",
        )
    return make_plan(scene, entries.pop("vary", None), **entries)


def scene_with_end(scene: Scene, folder: Path) -> str:
    """Return the text of the scene that stands beside ``study.toml``."""
    return f"{scene.to_toml(beside=folder)}\n{END}\n"


def _has_end(text: str) -> bool:
    return any(line.startswith(END) for line in text.splitlines())


def _entries(path: Path) -> tuple[dict[str, Any], bool]:
    """Return the entries of ``study.toml``, and whether it has its last line."""
    try:
        text = read_regular(path, _LARGEST).decode("utf-8").replace("\r\n", "\n")
    except FileNotFoundError:
        hint = "'multicell study new SCENE -o FOLDER' makes one."
        raise SceneError(
            "", f"'{path.parent}' holds no study: there is no {PLAN_FILE}", hint
        ) from None
    except NotADirectoryError:
        raise SceneError("", f"'{path.parent}' is a file, not the folder of a study") from None
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise SceneError("", f"'{path}' cannot be read: {reason}") from error
    try:
        return parse_toml(text), _has_end(text)
    except ValueError as error:
        raise SceneError("", f"'{path}' is not valid TOML: {error}") from None


def _lines(plan: Plan) -> Iterator[str]:
    """Yield the lines of ``study.toml``."""
    seed = plan.scene.seed
    last = "" if plan.seeds == 1 else f" to {seed + plan.seeds - 1}"
    yield "# A study of multicell: what is varied, and how. 'multicell study run' with the name of"
    yield "# this folder computes what is missing; after any change here it keeps what fits."
    yield f"# Its last line, and that of {SCENE}, shows that nothing was cut off."
    yield f"# Numbers without a unit: {BASE_UNITS}"
    yield ""
    yield f'scene = "{SCENE}"  # what is varied, in this folder'
    yield f"seeds = {plan.seeds}  # runs of each point; seed {seed}{last}, the same at all points"
    yield f'design = "{plan.design}"  # {DESIGNS[plan.design]}'
    table = "points" if plan.design == "list" else "vary"
    yield ""
    yield f"[{table}]  # key = values"
    for axis in plan.axes:
        yield axis_line(axis)
    yield ""
    yield f"{END}: {len(plan.points) * plan.seeds} runs"


def axis_line(axis: Axis) -> str:
    """Return the line of an axis in ``study.toml``."""
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
