"""What all commands share: options, errors and exit codes, printing."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from multicell.errors import MulticellError

if TYPE_CHECKING:
    from rich.console import Console

INTERRUPTED = 130
"""Exit code after Ctrl-C."""

as_json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
changes_option = click.option(
    "--set",
    "changes",
    multiple=True,
    metavar="KEY=VALUE",
    help="Change one value of the scene, for example --set duration='8 d' or "
    "--set nutrients.oxygen.boundary='0.07 mM'. An empty value removes an optional part "
    "(--set growth=). May be given several times.",
)


def parse_changes(items: Sequence[str]) -> dict[str, Any]:
    """Return the values of ``KEY=VALUE`` items.

    A value that is valid TOML (number, true, quoted text, table) is taken as such, any other
    text as a string; an empty one becomes None.

    Raises
    ------
    click.BadParameter
        If an item has no ``=`` or no key.
    """
    changes: dict[str, Any] = {}
    for item in items:
        key, equals, text = item.partition("=")
        if not equals or not key.strip():
            raise click.BadParameter(f"'{item}' is not KEY=VALUE", param_hint="'--set'")
        changes[key.strip()] = _value(text.strip())
    return changes


def _value(text: str) -> Any:
    """Return a TOML value, or the text itself where it is none."""
    if not text:
        return None
    try:
        parsed = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    value = parsed["value"]
    known = isinstance(value, bool | int | float | str | list | dict)
    # a line break would smuggle in a second key; a date is no value of a scene
    return value if known and set(parsed) == {"value"} else text


@contextmanager
def errors(as_json: bool) -> Iterator[None]:
    """End with one sentence and the exit code of the error, without traceback."""
    try:
        yield
    except MulticellError as error:
        if as_json:
            print_json({"error": str(error), "kind": type(error).__name__})
        click.echo(f"Error: {error}", err=True)
        raise click.exceptions.Exit(error.exit_code) from None
    except KeyboardInterrupt:
        click.echo("Interrupted.", err=True)
        raise click.exceptions.Exit(INTERRUPTED) from None


def console() -> Console:
    """Return the console on stdout; plain text where it is no terminal."""
    from rich.console import Console

    return Console(highlight=False)


def print_json(document: Any) -> None:
    """Print one JSON document."""
    from multicell.folder import to_json

    click.echo(to_json(document))
