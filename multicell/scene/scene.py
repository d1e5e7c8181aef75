"""The typed description of a scene, read from TOML or a dict.

Every part is a frozen dataclass whose attributes are the keys of the TOML file. Quantities are
numbers in base units (µm, s, nN, amol; kPa, mM) or strings with units; inside they are floats.
``growth``, ``death`` and ``nutrients`` are optional: an absent part costs nothing.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import is_dataclass
from difflib import get_close_matches
from functools import lru_cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from multicell.behaviours.catalogue import SURFACE_ENERGY
from multicell.contact.law import PairLaw
from multicell.contact.registry import CONTACT_LAWS
from multicell.errors import SceneError
from multicell.host.files import DEEPEST, name_beside, parse_toml, read_text
from multicell.plugins.laws import OwnLaw
from multicell.plugins.named import OWN_OBJECT
from multicell.scene.bare import note_written
from multicell.scene.checks import (
    check_diffusion,
    check_flat,
    check_method,
    check_nutrients,
    check_reactions,
    check_towards,
    check_types,
)
from multicell.scene.conditions import conditions
from multicell.scene.domain import check_domain
from multicell.scene.driven import PrescribedMotion, check_driven
from multicell.scene.energy import Energy, check_energy
from multicell.scene.networks import CellNetwork, check_networks
from multicell.scene.nutrient import Nutrient
from multicell.scene.own_files import place_files
from multicell.scene.own_units import enter_units
from multicell.scene.oxygen import in_concentrations
from multicell.scene.parts import (
    Adhesion,
    CellParameters,
    CellType,
    Chemotaxis,
    Compression,
    Death,
    Domain,
    Drag,
    Friction,
    Growth,
    IntegratorOptions,
    Motility,
    OutputOptions,
    Pull,
    Surface,
)
from multicell.scene.radiation import Radiation, check_radiation
from multicell.scene.ranges import check_sizes
from multicell.scene.reactions import Reaction
from multicell.scene.responses import (
    Response,
    check_responses,
    check_signal,
    largest_factor,
    relevant_fields,
)
from multicell.scene.start_table import Initial
from multicell.schema import (
    build_part,
    count,
    leaves,
    near_miss,
    number,
    parameters,
    part_as_dict,
    place_of_key,
    quantity,
    specs,
    table,
    tables,
    text,
    variant,
)
from multicell.units import BASE_UNITS, shown

if TYPE_CHECKING:
    from multicell.results.observable import Observable

_WRITTEN = "# A scene of multicell"
"""What the files begin with that :meth:`Scene.to_toml` makes."""
LONGEST: Final = 2400.0
"""Longest step in s of ``coupling_step = "auto"``; longer ones cost hardly less."""
TOLERANCE: Final = 1e-3
"""Its tolerance, about the error of 10 min in tissue that presses itself."""
_MAX_FILE_BYTES = 10_000_000
"""Bytes of a scene file; those with thousands of media changes have less than one million."""


@final
@parameters
class Scene:
    """Description of a simulation: cells, mechanics, fields, biology; dicts are converted to parts.

    Each scene has the parts ``initial``, ``cells``, ``contact``, ``drag``, ``integrator`` and
    ``output``. Others are None where it has none: ``growth``, ``death``, ``adhesion``,
    ``friction``, ``compression``, ``motility``, ``surface``, ``pull``, ``domain``, ``energy``.

    Attributes
    ----------
    title : str
    duration : float, s
    coupling_step : float, s
        With ``coupling_tolerance`` that of the longest steps.
    coupling_tolerance : float or None
        Part of the volume for which the run chooses the lengths of its steps.
    seed : int
        The same seed gives the same run.
    stop_cells : int or None
        The run ends after the coupling step in which this many cells exist.
    motions : mapping of name to PrescribedMotion, read-only
        What drives named cells from outside.
    types : mapping of name to CellType, read-only
        Empty where all cells are alike.
    nutrients : mapping of name to Nutrient, read-only
    reactions : mapping of name to Reaction, read-only
    responses : mapping of name to Response, read-only
    networks : mapping of name to CellNetwork, read-only
    radiation : mapping of name to Radiation, read-only

    Raises
    ------
    SceneError
        For any value that cannot be accepted, with its dotted path.
    """

    title: str = text(default="", doc="one line about the scene")
    duration: float = quantity("s", above=0, doc="Simulated time, for example duration = '11 d'.")
    seed: int = count(default=0, at_least=0, at_most=2**63 - 1, doc="of the random number streams")
    coupling_step: float = quantity(
        "s",
        default=600.0,
        above=0,
        doc="between exchanges of parts; 'auto': up to 40 min, for an error of 0.1 % of the volume",
        words=("auto",),
    )
    coupling_tolerance: float | None = number(
        default=None,
        at_least=1e-6,
        at_most=0.1,
        doc="part of the volume for which steps up to coupling_step are chosen; absent: all alike",
    )
    dimensions: int = count(default=3, at_least=2, at_most=3, doc="2: all cells in one plane")
    stop_cells: int | None = count(default=None, at_least=1, doc="the run ends at so many cells")
    initial: Initial = table(Initial, default_factory=Initial, doc="the cells at the start")
    cells: CellParameters = table(CellParameters, default_factory=CellParameters, doc="the cells")
    contact: PairLaw = variant(
        CONTACT_LAWS,
        key="law",
        usual="jkr",
        default_factory=CONTACT_LAWS["jkr"],
        doc="the law of touching cells",
        hint=CONTACT_LAWS.hint,
        further=OWN_OBJECT,
    )
    drag: Drag = table(Drag, default_factory=Drag, doc="friction with the medium")
    growth: Growth | None = table(Growth, default=None, doc="absent: no growth, no division")
    death: Death | None = table(Death, default=None, doc="absent: necrotic cells stay")
    types: Mapping[str, CellType] = tables(CellType, doc="absent: all cells are alike")
    adhesion: Adhesion | None = table(Adhesion, default=None, doc="absent: no receptors")
    friction: Friction | None = table(Friction, default=None, doc="absent: only Stokes drag")
    compression: Compression | None = table(
        Compression, default=None, doc="absent: contacts of pairs alone resist compression"
    )
    motility: Motility | None = table(Motility, default=None, doc="absent: no active motion")
    chemotaxis: Mapping[str, Chemotaxis] = tables(
        Chemotaxis, doc="by field; absent: no force along gradients"
    )
    surface: Surface | None = table(Surface, default=None, doc="absent: only contacts hold tissue")
    pull: Pull | None = table(Pull, default=None, doc="absent: no external force")
    motions: Mapping[str, PrescribedMotion] = tables(
        PrescribedMotion, doc="of named cells; absent: all move freely"
    )
    domain: Domain | None = table(Domain, default=None, doc="absent: fields follow the cells")
    nutrients: Mapping[str, Nutrient] = tables(Nutrient, doc="absent: no cell ever starves")
    energy: Energy | None = table(Energy, default=None, doc="absent: fields act each by itself")
    reactions: Mapping[str, Reaction] = tables(Reaction, doc="between fields; absent: none")
    responses: Mapping[str, Response] = tables(
        Response,
        listed="response",
        doc="of behaviours of cells to signals; absent: those of single keys only",
    )
    networks: Mapping[str, CellNetwork] = tables(
        CellNetwork, doc="networks of reactions inside cells; absent: none"
    )
    radiation: Mapping[str, Radiation] = tables(
        Radiation, doc="courses of irradiation; absent: none"
    )
    integrator: IntegratorOptions = table(
        IntegratorOptions, default_factory=IntegratorOptions, shorthand="method", doc="the method"
    )
    output: OutputOptions = table(OutputOptions, default_factory=OutputOptions, doc="the record")

    def prepare(self) -> None:
        """Turn oxygen's partial pressures into concentrations, before the parts are read."""
        object.__setattr__(self, "_written", {name: getattr(self, name) for name in specs(self)})
        word = self.coupling_step
        if isinstance(word, str) and word.strip().isalpha():
            if word.strip().lower() != "auto":
                hint = near_miss(word, ("auto",), listed=False)
                problem = f"is {shown(word)}, must be a time or 'auto'"
                raise SceneError("coupling_step", problem, hint)
            object.__setattr__(self, "coupling_step", LONGEST)
            if self.coupling_tolerance is None:
                object.__setattr__(self, "coupling_tolerance", TOLERANCE)
        for name in ("nutrients", "reactions"):
            value = in_concentrations(getattr(self, name), (name,), self.nutrients)
            object.__setattr__(self, name, value)

    def check(self) -> None:
        """Raise ``SceneError`` for parts that do not fit together."""
        check_sizes(self)
        if self.initial.cells is not None and self.initial.cells.at_hand:
            from multicell.scene.start_checks import check_start_table

            check_start_table(self)
        if self.dimensions == 2:
            check_flat(self)
        check_types(self)
        check_method(self)
        check_towards(self)
        check_diffusion(self)
        if self.networks:
            check_networks(self, check_signal)
        if self.responses:
            check_responses(self)
        conditions(self)
        self.contact.check_scene(self)
        sticky = largest_factor(self, SURFACE_ENERGY)[0] if self.responses else 1.0
        check_domain(self, sticky)
        check_driven(self)
        check_nutrients(self)
        check_energy(self)
        check_reactions(self, self.reactions)
        check_radiation(self)
        note_written(self, self.__dict__.pop("_written"))
        enter_units(self.output.observables)

    @property
    def box(self) -> Domain | None:
        """The domain if it is a box, which fields live on; None without one."""
        return None if self.domain is None or self.domain.shape != "box" else self.domain

    @classmethod
    def from_dict(cls, entries: Mapping[str, Any]) -> Scene:
        """Return the scene that a dict with the keys of the TOML file describes.

        Without a ``contact`` the law is JKR, with which the other parts are checked at once: a law
        that they need is named here, not in a :meth:`with_changes` that follows.

        Raises
        ------
        SceneError
            For an unknown or missing key and for any value that is refused.
        """
        return build_part(cls, entries)

    def to_dict(self) -> dict[str, Any]:
        """Return the scene as nested dicts of base-unit numbers, without absent parts."""
        return part_as_dict(self)

    def __repr__(self) -> str:
        facts = ", ".join(f"{name}: {text}" for name, text in key_facts(self).items())
        return f"<Scene {self.title!r}, {facts}>"

    def _repr_html_(self) -> str:
        """Return the display of a notebook: key facts, and all keys where one opens them."""
        rows = "".join(
            f"<tr><th style='text-align:left'>{name}</th><td style='text-align:left'>"
            f"{escape(text)}</td></tr>"
            for name, text in key_facts(self).items()
        )
        return (
            f"<div><b>{escape(self.title or 'Untitled scene')}</b><table>{rows}</table><details>"
            f"<summary>All keys</summary><pre>{escape(self.to_toml())}</pre></details></div>"
        )

    def with_changes(self, changes: Mapping[str, Any] | None = None, /, **keys: Any) -> Scene:
        """Return a scene with other values.

        Parameters
        ----------
        changes
            Dotted key -> value, as in ``{"nutrients.oxygen.boundary": "0.07 mM"}``, applied in
            order. An optional table is made when a key in it is set. A dict or a part, such as
            a law made by :func:`multicell.pair_law`, replaces a whole table, None removes an
            optional part. ``"integrator": "euler"`` changes the method and keeps the rest. A new
            ``contact.law`` drops the parameters that it does not have.
        **keys
            Further changes as keywords: ``duration="8 d"``. A dict changes the keys of a table
            that it has and keeps the others: ``nutrients={"oxygen": {"boundary": "5 %"}}``.

        Raises
        ------
        SceneError
            For a key that does not exist and for any value that is refused.
        """
        if not isinstance(changes, Mapping | None):
            hint = "For example with_changes(duration='8 d') or with_changes({'duration': '8 d'})."
            raise SceneError("changes", f"are {shown(changes)}, must be keys with values", hint)
        changes = {**(changes or {}), **_nested(keys, self.to_dict() if keys else {})}
        changed = {str(key).partition(".")[0] for key in changes}
        # the other parts are checked already; an unknown key is looked for in all
        entries = part_as_dict(self, changed if changed <= specs(Scene).keys() else None)
        if changes.get("coupling_step", "auto") != "auto" and "coupling_tolerance" not in changes:
            entries.pop("coupling_tolerance", None)  # one length for all
        for key, value in changes.items():
            check_dotted(key)
            if "." not in key and key not in specs(Scene) and (hint := _meant(self, key)):
                raise SceneError(key, "is not a key at the top of a scene", hint)
            _change(entries, key, value)
            if key.startswith("nutrients."):
                _set_free(entries, key)
        made = build_part(type(self), entries)
        _refuse_unused(made, changes, self.nutrients)
        return made

    def with_observables(self, *own: Observable) -> Scene:
        """Return a scene whose runs also record observables of the user's own.

        Parameters
        ----------
        *own
            Made by :func:`multicell.observable`.
        """
        return self.with_changes({f"output.observables.{o.name}": o.stated() for o in own})

    def to_toml(self, extra: Mapping[str, Any] | None = None, *, beside: Path | None = None) -> str:
        """Return the scene as a TOML file that :func:`load_scene` reads back exactly.

        Parameters
        ----------
        extra
            Facts for the header, such as the versions of packages; one comment line each.
        beside
            Folder of the file: a table of the cells at the start, and files of networks and
            fields, that are there too are named without their folder.
        """
        import tomli_w

        entries = self.to_dict()
        if beside is not None:
            cells = [entries["initial"]["cells"]] if self.initial.cells is not None else []
            fields = [x.get("initial_file", {}) for x in entries.get("nutrients", {}).values()]
            for table in (*cells, *fields, *entries.get("networks", {}).values()):
                if "file" in table:
                    table["file"] = name_beside(table["file"], beside)

        facts = {"units": BASE_UNITS, "seed": self.seed, **(extra or {})}
        header = [f"# {name}: {value}" for name, value in facts.items()]
        lines = [" ".join(line.split()) for line in [_WRITTEN, *header]]
        safe = [line.encode("ascii", "backslashreplace").decode() for line in lines]
        return "\n".join([*safe, with_units(self, tomli_w.dumps(entries))])


def scene_names() -> list[str]:
    """Return the names of the built-in scenes."""
    found = (entry.name for entry in files("multicell.scenes").iterdir())
    return sorted(name.removesuffix(".toml") for name in found if name.endswith(".toml"))


def _toml_hint(content: str, error: ValueError) -> str:
    """Return advice about a text that is not TOML; empty where the message needs none."""
    if bare := _BARE.search(content):
        return f"A value with a unit stands in quotes: '{bare[1]}'."
    if content.lstrip().startswith("{"):
        return "A scene is TOML, not JSON: duration = '1 d'."
    found = re.search(r"\(at line (\d+), column \d+\)", str(error))
    lines = content.splitlines()
    number = int(found[1]) if found else 0
    line = lines[number - 1].strip() if 0 < number <= len(lines) else ""
    if re.match(r"[\w.]+\s*:(\s|$)", line):
        return "A scene is TOML, not YAML: duration = '1 d'."
    if re.match(r"(import|from|def|class)\s|@|\"\"\"", line):
        return "Python files are for --law, --observable and --integrator."
    if "Cannot overwrite" in str(error):
        return f"The key of {line!r} stands there twice."
    if "Illegal character '\\n'" in str(error):
        return f"A text ends with its quote on the same line: {line!r}."
    return "No comma stands at the end of a line." if line.endswith(",") else ""


def scene_files(name: str) -> dict[str, str]:
    """Return the files that a built-in scene names beside itself, by name, and their content."""
    entries = parse_toml(scene_text(name))
    named = [table["file"] for table in entries.get("networks", {}).values() if "file" in table]
    return {x: _built_in(name).with_name(x).read_text(encoding="utf-8") for x in named}


def load_scene(source: str | Path) -> Scene:
    """Return a built-in scene or one that is read from a TOML file.

    Parameters
    ----------
    source
        Name of a built-in scene (see :func:`scene_names`) or path of a file. A built-in name
        wins; ``Path(...)`` or a suffix always means a file.

    Raises
    ------
    SceneError
        For an unknown name, a file that is missing or cannot be read, broken TOML (with its
        line) and for any value that is refused.
    """
    content = scene_text(source)
    try:
        entries = parse_toml(content)
    except ValueError as error:  # also integers of thousands of digits
        problem = f"{str(source)!r} is not valid TOML: {error}"
        raise SceneError("", problem, _toml_hint(content, error)) from None
    built_in = isinstance(source, str) and source in scene_names()
    file = _built_in(str(source)) if built_in else source
    scene = Scene.from_dict(place_files(entries, file))
    if not content.startswith(_WRITTEN):  # whose numbers are those of its author
        note_written(scene, entries, typed=True)
    return scene


def _nested(keys: Mapping[str, Any], entries: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return keywords as dotted keys; a dict goes into a table that is there and keeps the rest."""
    found: dict[str, Any] = {}
    for key, value in keys.items():
        name = f"{path}{key}"
        there = entries.get(key)
        if isinstance(value, Mapping) and isinstance(there, Mapping):
            found |= _nested(value, there, f"{name}.")
        else:
            found[name] = value
    return found


_BARE = re.compile(r"^[ \t]*[\w.]+[ \t]*=[ \t]*([\d.]+ *[A-Za-zµ%][^\s#]*)", re.MULTILINE)
"""A quantity without quotes in a scene file."""


def _built_in(name: str) -> Path:
    """Return the file of a built-in scene."""
    return Path(str(files("multicell.scenes") / f"{name}.toml"))


def scene_text(source: str | Path) -> str:
    """Return a scene as its author wrote it: the TOML of a built-in scene or of a file."""
    if isinstance(source, Mapping):
        hint = "A dict becomes one by mc.Scene.from_dict({...})."
        raise SceneError("", "a table of values is no name and no path of a scene", hint)
    if not isinstance(source, str | Path):
        raise SceneError("", f"{shown(source)} is no name and no path of a scene")
    if isinstance(source, str) and source in (names := scene_names()):
        return _built_in(source).read_text(encoding="utf-8")
    if not str(source):
        raise SceneError("", "a scene without a name", f"For example {scene_names()[0]!r}.")
    path = Path(os.path.expanduser(source))
    bare = isinstance(source, str) and not path.suffix and path.name == source
    try:
        return read_text(path, _MAX_FILE_BYTES)
    except FileNotFoundError:
        if bare:
            hint = near_miss(str(source), names)
            raise SceneError("", f"there is no scene named {source!r}", hint) from None
        hint = f"The built-in scenes are {', '.join(scene_names())}."
        raise SceneError("", f"the scene file {str(source)!r} does not exist", hint) from None
    except IsADirectoryError:
        hint = "Name a file in it."
        if (path / "scene.toml").is_file():
            again = f"its scene is '{path / 'scene.toml'}'"
            hint = f"It holds a run: {again}, and 'multicell resume {path}' continues it."
        raise SceneError("", f"{str(source)!r} is a folder, not a scene", hint) from None
    except UnicodeDecodeError as error:
        problem = f"the scene file {str(source)!r} is not UTF-8 text (byte {error.start})"
        of_run = path.parent / "scene.toml"
        hint = f"The scene of that run is '{of_run}'." if of_run.is_file() else ""
        raise SceneError("", problem, hint) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SceneError("", f"the scene file {str(source)!r} cannot be read: {reason}") from error


def check_dotted(key: object) -> None:
    """Refuse what is no dotted key; raises SceneError."""
    if not isinstance(key, str) or not all(key.split(".")):
        raise SceneError("", f"{shown(key)} is not a dotted key such as 'drag.viscosity'")
    if key.count(".") >= DEEPEST:
        raise SceneError("", f"{shown(key)} is no key of a scene: it has more than {DEEPEST} parts")


def _set_free(entries: dict[str, Any], key: str) -> None:
    """Forget that a concentration is a part of another one, if a change has set it."""
    path = key.split(".")
    field = entries.get("nutrients", {}).get(path[1])
    if len(path) == 3 and isinstance(field, dict) and path[2] in field.get("relative", {}):
        del field["relative"][path[2]]


def _change(entries: dict[str, Any], key: str, value: Any) -> None:
    """Set (or with None remove) one dotted key in a scene's dict."""
    check_dotted(key)
    spec = specs(Scene).get(key)
    if spec is not None and spec.shorthand and isinstance(value, str):
        key = f"{key}.{spec.shorthand}"
    *parents, last = key.split(".")
    if key.partition(".")[0] not in specs(Scene):
        _refuse_unknown(entries, key)
    node = entries
    for depth, name in enumerate(parents, start=1):
        if value is None and name not in node:
            problem = f"cannot be removed: the scene has no '{'.'.join(parents[:depth])}'"
            raise SceneError(key, problem)
        declared = specs(Scene).get(parents[0])
        if depth == 2 and declared is not None and declared.kind == "tables":
            _refuse_misspelt(node, key)
        node = node.setdefault(name, {})
        if not isinstance(node, dict):
            problem = f"is not a key: '{'.'.join(parents[:depth])}' is a value, not a table"
            raise SceneError(key, problem)
    if key == "growth.law" and isinstance(value, OwnLaw):
        node["parameters"], value = part_as_dict(value), value.scene_name()
    if spec is not None and is_dataclass(value):
        value = spec.plain(value)
    inside = node.get(last)
    if (
        isinstance(value, str)
        and isinstance(inside, dict)
        and spec is None
        and key != "initial.cells"
        and last != "initial_file"
    ):
        names = ", ".join(list(inside)[:8])
        raise SceneError(key, f"is a table, not {shown(value)}", f"Name one of its keys: {names}.")
    if value is None and last in node:
        del node[last]
    else:
        try:
            node[last] = deepcopy(value)  # a later key may write into it
        except RecursionError:
            raise SceneError(key, "is nested too deeply") from None
    if last == "file" and (parents[:1] == ["networks"] or parents[-1:] == ["initial_file"]):
        node.pop("sha256", None)  # that of the file before
    if key in ("initial.cells", "initial.cells.file") and value is not None:
        # the new table says how many cells there are, and where
        table = node[last] if key == "initial.cells" else {"file": node[last]}
        stage = {k: v for k, v in entries["initial"].items() if k == "stage"}
        entries["initial"] = {"cells": table, **stage}
    if key == "contact.law" and isinstance(value, str) and value in CONTACT_LAWS:
        allowed = {"law", *specs(CONTACT_LAWS[value])}
        entries["contact"] = {k: v for k, v in node.items() if k in allowed}


def _meant(scene: Scene, key: str) -> str:
    """Return the full key that a short one may mean in a scene, as a hint."""
    word = _NAMES.get(key.lower(), key)
    fields = {name.lower(): name for name in scene.nutrients}
    if word.lower() in fields:
        return f"Did you mean 'nutrients.{fields[word.lower()]}.boundary'?"
    known = [".".join(path) for path, _, _ in leaves(scene)]
    near = [name for name in known if name.rpartition(".")[2] == word]
    for name, spec in specs(Scene).items():
        if spec.table is None or word not in specs(spec.table):
            continue
        if spec.kind != "tables":
            near.append(f"{name}.{word}")
        elif not any(key.startswith(f"{name}.") for key in near):
            near.append(f"{name}.NAME.{word}")
    near = list(dict.fromkeys(near))
    return f"Did you mean {' or '.join(map(repr, near[:3]))}?" if near else place_of_key(key)


_NAMES: Final = {"o2": "oxygen", "glc": "glucose", "gluc": "glucose", "glutamin": "glutamine"}
"""Short names of nutrients."""


def _refuse_unknown(entries: Mapping[str, Any], key: str) -> None:
    """Refuse a key that stands in one of a scene's tables under the same name."""
    first = key.partition(".")[0]
    for name, inside in entries.items():
        if isinstance(inside, dict) and first in inside:
            inner = ".boundary" if name == "nutrients" and "." not in key else ""
            hint = f"Did you mean '{name}.{key}{inner}'?"
            raise SceneError(key, "is not a key at the top of a scene", hint)


def _refuse_misspelt(named: Mapping[str, Any], key: str) -> None:
    """Refuse a key in a table whose name is nearly that of another one.

    It would make a second field beside ``oxygen``. A number at the end is no slip.
    """
    first, name, rest = key.split(".", 2)
    words = [] if name in named else [known for known in named if known[-1:].isalpha()]
    for known in get_close_matches(name, words, 1, 0.8) if name[-1:].isalpha() else ():
        hint = f"Did you mean '{first}.{known}.{rest}'? A further one is added by its whole table."
        raise SceneError(f"{first}.{name}", "is not there", hint)


def _refuse_unused(
    scene: Scene, changes: Mapping[str, Any], before: Mapping[str, Nutrient]
) -> None:
    """Refuse a field that a change of one of its keys has made, and that has no effect on cells."""
    tables = {key: value for key, value in changes.items() if key.split(".")[0] == "nutrients"}
    for name in scene.nutrients.keys() - before.keys():
        whole = f"nutrients.{name}" in tables or name in (tables.get("nutrients") or ())
        if tables and not whole and name not in relevant_fields(scene):
            hint = near_miss(name, before, listed=False)
            further = "A further one needs thresholds, or is added by its whole table."
            problem = "is no field of the scene, and no cell would respond to it"
            raise SceneError(f"nutrients.{name}", problem, f"{hint} {further}".strip())


_KEY = re.compile(r'("(?:[^"\\]|\\.)*"|[\w-]+) = ')


def with_units(scene: Scene, toml: str) -> str:
    """Return TOML text with the unit of each quantity as a comment behind it."""
    units = {path: spec.units for path, _, spec in leaves(scene)}
    lines: list[str] = []
    table: tuple[str, ...] = ()
    for line in toml.splitlines():
        if line.startswith("["):
            table = _path(line)
        key = _KEY.match(line)
        unit = units.get((*table, *_path(f"{key[0]}0")), "") if key else ""
        if unit.startswith("[") and not line.endswith("["):
            unit = ""  # a course that is one number
        lines.append(f"{line}  # {unit}" if unit else line)
    return "\n".join(lines) + "\n"


@lru_cache(maxsize=1024)  # the runs of a study have the same keys
def _path(line: str) -> tuple[str, ...]:
    """Return the path of the keys of a line of TOML."""
    import tomllib

    return _keys(tomllib.loads(line))


def _keys(entries: Any) -> tuple[str, ...]:
    """Return the path of keys to the innermost of tables that hold one entry each."""
    if not isinstance(entries, dict) or not entries:
        return ()
    ((key, inner),) = entries.items()
    return (key, *_keys(inner))


def key_facts(scene: Scene) -> dict[str, str]:
    """Return the key facts of a scene, in words."""
    hours = scene.duration / 3600.0
    facts = {
        "cells at the start": f"{scene.initial.count:,}",
        "duration": f"{hours / 24.0:g} d" if hours >= 72.0 else f"{hours:g} h",
        "types": ", ".join(scene.types),
        "fields": ", ".join(scene.nutrients),
        "integrator": scene.integrator.method,
        "seed": str(scene.seed),
    }
    return {name: text for name, text in facts.items() if text}
