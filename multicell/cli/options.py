"""Options that commands share and how they are read, the console, and tables on it."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterable, Sequence
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from multicell.errors import OutputError, SceneError, printable
from multicell.host.files import parse_toml
from multicell.units import shown

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from multicell.scene.scene import Scene

Option = Callable[[Any], Any]  # a decorator of click
valued = partial(click.option, show_default=True)


def offering(names: Callable[[], Iterable[str]], *, several: bool = False) -> dict[str, Any]:
    """Return how an argument or option is completed in a shell: by names, or by files.

    - ``several``: whether it takes more than one name, separated by commas
    """

    def complete(_: click.Context, __: click.Parameter, begun: str) -> list[Any]:
        from click.shell_completion import CompletionItem

        before, comma, last = begun.rpartition(",") if several else ("", "", begun)
        found = [CompletionItem(f"{before}{comma}{n}") for n in names() if n.startswith(last)]
        return found or [CompletionItem(begun, type="file")]

    return {"shell_complete": complete}


def known_scenes() -> list[str]:
    """Return the names of the built-in scenes."""
    from multicell.scene.scene import scene_names

    return scene_names()


def known_methods() -> list[str]:
    """Return the names of the methods of integration."""
    from multicell.integrators.registry import METHODS

    return list(METHODS)


def known_quantities() -> list[str]:
    """Return the names of the columns that every history can have."""
    from multicell.results.measures import OBSERVABLES

    return [observable.name for observable in OBSERVABLES if "*" not in observable.name]


def known_formats() -> list[str]:
    """Return the names of the formats of an export."""
    from multicell.report.exports.files import FORMATS

    return list(FORMATS)


def complete_keys(context: click.Context, _: click.Parameter, begun: str) -> list[Any]:
    """Return the keys of the scene that a command line names, each with ``=``."""
    from click.shell_completion import CompletionItem

    from multicell.scene.scene import load_scene
    from multicell.schema import leaves

    try:
        scene = load_scene(context.params.get("scene") or "spheroid")
    except SceneError:  # there is nothing to offer for a scene that cannot be read
        return []
    names = (".".join(path) for path, _, _ in leaves(scene))
    return [CompletionItem(f"{name}=") for name in names if name.startswith(begun)]


def grouped(*options: Option) -> Option:
    """Return a decorator that adds options, the first one first in the help."""

    def add(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return add


as_json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")


def with_values(
    _: click.Context, parameter: click.Parameter, items: Sequence[str]
) -> Sequence[str]:
    """Refuse ``KEY VALUE`` in place of ``KEY=VALUE``, before the value is taken for an argument."""
    for item in items:
        key = item.partition("=")[0].strip()
        if "=" not in item or not key:
            said = f"'{item}' is not {parameter.metavar}"
            form = (parameter.metavar or "").partition("=")[2]
            form = "…" if form == "VALUE" else form
            how = f"write the value without a space, as {parameter.opts[0]} {key or 'KEY'}='{form}'"
            raise click.BadParameter(f"{said}: {how}")
    return items


def keyed(option: str, name: str, metavar: str, help: str, **more: Any) -> Option:
    """Return an option for keys with values, which may be given several times."""
    return click.option(
        option, name, multiple=True, callback=with_values, metavar=metavar, help=help, **more
    )


changes_option = keyed(
    "--set",
    "changes",
    "KEY=VALUE",
    "Change one value of the scene, for example --set duration='8 d' or "
    "--set nutrients.oxygen.boundary='0.07 mM'. An empty value removes an optional part "
    "(--set growth=). May be given several times.",
    shell_complete=complete_keys,
)
threads_option = click.option("--threads", type=click.IntRange(min=1), help="Number of threads.")
quiet_option = click.option("--quiet", is_flag=True, help="Print nothing but errors.")
law_option = click.option(
    "--law",
    "laws",
    multiple=True,
    metavar="FILE:NAME",
    help="Law or network of your own, as mine.py:Cubic; parameters of a contact or growth law "
    "follow as --set contact.KEY= or --set growth.parameters.KEY=. May be given several times.",
)
loaded_law_option = click.option(
    "--law",
    multiple=True,
    metavar="FILE:NAME",
    expose_value=False,
    callback=lambda _, __, specs: name_laws(specs),
    help="Law or network of your own that the run was made with, as mine.py:Cubic. May be given "
    "several times.",
)
section_option = click.option(
    "--section", "plane", metavar="PLANE", help="Plane of the section: x, y, z, x=0 or z='12 um'."
)
cut_option = click.option(
    "--cut",
    type=click.Choice(("none", "half", "quarter")),
    help="Part of the cells in space that is cut away.  [default: quarter]",
)


def _load_own(context: click.Context, _: click.Parameter, specs: Sequence[str]) -> list[str]:
    """Load observables of the user's own and return their names.

    :func:`scene_of` has the scene record them.
    """
    if not specs:
        return []
    from multicell.results.own_observable import load_observable

    context.meta[_OBSERVABLES] = [load_observable(spec) for spec in specs]
    return [observable.name for observable in context.meta[_OBSERVABLES]]


def observable_names(
    context: click.Context, option: click.Parameter, given: Sequence[str]
) -> list[str]:
    """Return the names of observables, after loading those given as FILE:NAME."""
    own = [text for text in given if ":" in text]
    names = dict(zip(own, _load_own(context, option, own), strict=True))
    return [names.get(text, text) for text in given]


_OBSERVABLES = "multicell.observables"
observable_option = click.option(
    "--observable",
    multiple=True,
    expose_value=False,
    callback=_load_own,
    metavar="FILE:NAME",
    help="Record an observable of your own, as mine.py:rim_area. May be given several times.",
)
no_report_option = click.option(
    "--no-report", is_flag=True, help="Write no report and no pictures."
)


columns_option = click.option(
    "--columns",
    metavar="NAMES",
    help="Meaning of the columns of a table, as 'x=POSITION_X um, radius=R um, type=class', or a "
    "TOML file with such a table.",
)


where_option = click.option(
    "--where",
    metavar="VALUES",
    help="Rows of the data to use, as 'CellLine=983b, InitialCondition=5000, Day=3..7'.",
)


specimens_option = valued(
    "--specimens",
    default="same",
    metavar="NAME",
    help="single: each row is another specimen, measured once; a column 'specimen' states it too.",
)


def with_data(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command measured ``data``, or None, and ``how`` they are read."""

    @click.option(
        "--data",
        type=click.Path(path_type=Path),
        help="Table of measured data (CSV, Excel) to show with the curves, as 'fit' takes it.",
    )
    @columns_option
    @where_option
    @specimens_option
    @wraps(command)
    def called(
        data: Path | None, columns: str | None, where: str | None, specimens: str, **options: Any
    ) -> Any:
        if data is None and (columns is not None or where is not None or specimens != "same"):
            raise click.UsageError("--columns, --where and --specimens belong to --data")
        how = {"columns": columns, "where": where, "specimens": specimens}
        return command(data=data, how=how, **options)

    decorated: Callable[..., Any] = called
    return decorated


def cells_change(cells: str | None, columns: str | None, changes: Sequence[str]) -> list[str]:
    """Return the changes that ``--cells`` and ``--columns`` are, before those of ``--set``."""
    if cells is None:
        if columns is not None:
            raise click.UsageError("--columns names those of --cells")
        return list(changes)
    if columns is None and not any(item.startswith("initial.cells.") for item in changes):
        return [f"initial.cells={cells}", *changes]
    named = {"file": cells} if columns is None else {"file": cells, "columns": columns}
    entries = ", ".join(f"{key} = {json.dumps(text)}" for key, text in named.items())
    return [f"initial.cells={{{entries}}}", *changes]


def output_option(help: str, *, required: bool = True) -> Option:
    """Return the option for the folder to write to."""
    place = click.Path(path_type=Path)
    return click.option("-o", "--output", type=place, required=required, help=help)


def overwrite_option(help: str) -> Option:
    """Return the flag that lets a command replace what is there."""
    return click.option("--overwrite", is_flag=True, help=help)


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Raise ``OutputError`` for a file that is there already, unless it may be replaced."""
    from multicell.results.folder import file_errors

    with file_errors("use", path):
        there = path.exists() or path.is_symlink()
    if there and not overwrite:
        raise OutputError(f"'{path}' exists already: name another file (-o) or overwrite it")


def scene_of(source: str, changes: Sequence[str], laws: Sequence[str] = ()) -> Scene:
    """Return the scene that SCENE, ``--law`` and ``--set`` describe."""
    parsed = parse_changes(changes)
    named = name_laws(laws)
    from multicell.scene.bare import nested, note_written
    from multicell.scene.scene import load_scene
    from multicell.simulation.start_check import check_population

    scene = load_scene(source)
    given = scene.to_dict()
    for key, name in named.items():
        part, _, what = key.partition(".")
        if given.get(part, {}).get(what) != name:
            parsed = {key: name, **parsed}
    own = click.get_current_context().meta.get(_OBSERVABLES, ())
    described = scene.with_changes(parsed).with_observables(*own)
    note_written(described, nested(parsed), typed=True)
    check_population(described)
    return described


def of_scene(command: Callable[..., Any], *, required: bool = True) -> Callable[..., Any]:
    """Give a command the scene that SCENE, ``--law`` and ``--set`` describe.

    None where there is no SCENE and none is required.
    """

    @click.argument("scene", required=required, **offering(known_scenes))
    @law_option
    @changes_option
    @wraps(command)
    def called(
        scene: str | None, laws: Sequence[str], changes: Sequence[str], **options: Any
    ) -> Any:
        if scene is None and (laws or changes):
            raise click.UsageError("--law and --set belong to a SCENE")
        return command(None if scene is None else scene_of(scene, changes, laws), **options)

    decorated: Callable[..., Any] = called
    return decorated


of_optional_scene = partial(of_scene, required=False)


def name_laws(specs: Sequence[str]) -> dict[str, str]:
    """Load laws and networks of the user's own; return the keys that take them, and their names.

    Raises
    ------
    click.UsageError
        If two laws are for the same key.
    """
    named: dict[str, str] = {}
    for spec in specs:
        for key, name in name_law(spec).items():
            if named.setdefault(key, name) != name:
                raise click.UsageError(f"--law names two laws for {key}: {named[key]} and {name}.")
    return named


def name_law(spec: str) -> dict[str, str]:
    """Load a law or network of the user's own; return the key that takes it, and its name there."""
    from multicell.behaviours.growth_laws.laws import GrowthLaw
    from multicell.behaviours.laws import ResponseLaw
    from multicell.networks.network import Network
    from multicell.plugins.named import load_object
    from multicell.plugins.user_laws import load_law

    if isinstance(load_object(spec, "law"), Network):
        return {}  # networks of the scene name it
    law = load_law(spec)
    if issubclass(law, ResponseLaw):
        return {}  # responses of the scene name it
    key = "growth.law" if issubclass(law, GrowthLaw) else "contact.law"
    return {key: law.scene_name()}


integrator_option = click.option(
    "--integrator",
    metavar="NAME",
    **offering(known_methods),
    help="Method, for example cvode or euler; or one of your own, as mine.py:Midpoint.",
)


def parse_changes(items: Sequence[str]) -> dict[str, Any]:
    """Return the values of ``KEY=VALUE`` items.

    A value that is valid TOML (number, true, quoted text, table) is taken as such, any other
    text as a string; an empty one becomes None.
    """
    changes: dict[str, Any] = {}
    for item in items:
        key, equals, text = item.partition("=")
        key = key.strip()
        if not equals or not key:
            raise click.BadParameter(f"'{item}' is not KEY=VALUE", param_hint="'--set'")
        # the last one of a key counts, at its place among the others
        changes.pop(key, None)
        changes[key] = _value(key, text.strip())
    return changes


def _value(key: str, text: str) -> Any:
    """Return a TOML value, or the text itself where it is none."""
    if not text:
        return None
    try:
        text.encode()
    except UnicodeEncodeError:
        raise SceneError(key, "is not UTF-8 text") from None
    try:
        parsed = parse_toml(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    except ValueError as error:  # nested too deeply, integers of thousands of digits
        raise SceneError(key, f"is {shown(text)}, which cannot be read: {error}") from None
    value = parsed["value"]
    known = isinstance(value, bool | int | float | str | list | dict)
    # a line break would smuggle in a second key; a date is no value of a scene
    return value if known and set(parsed) == {"value"} else text


def console() -> Console:
    """Return the console on stdout; plain text where it is no terminal."""
    from rich.console import Console

    return Console(highlight=False)


def filled_table(columns: Sequence[str], rows: Iterable[Sequence[object]], **options: Any) -> Table:
    """Return a table without lines.

    - ``columns``: their titles; one that ends in ``" >"`` is set to the right
    - ``rows``: of texts, in which square brackets are no markup
    """
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold", **options)
    for title in columns:
        name, right, _ = title.partition(" >")
        table.add_column(name, justify="right" if right else "left")
    for row in rows:
        shown: list[Any] = [text if hasattr(text, "plain") else escape_markup(text) for text in row]
        table.add_row(*shown)
    return table


def key_table(rows: Iterable[tuple[str, object]], *, justify: Any = "left") -> Table:
    """Return a table of names in bold and what belongs to them, without a header."""
    table = filled_table(("", ""), rows, show_header=False)
    table.columns[0].style = "bold"
    table.columns[1].justify = justify
    return table


def escape_markup(text: object) -> Any:
    """Return text in which square brackets are no markup, and nothing a command of a terminal."""
    from rich.text import Text

    return Text(printable(str(text), lines=True))
