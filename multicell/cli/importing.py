"""The command that makes a scene of another program's model."""

from __future__ import annotations

import re
import shlex
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from multicell.cli import options as shared
from multicell.cli.process import print_json
from multicell.cli.tables import filled_table

if TYPE_CHECKING:
    from multicell.importing.imported import Imported


@click.command("import")
@click.argument("program", type=click.Choice(["physicell"]))
@click.argument("settings", type=click.Path(path_type=Path))
@shared.output_option("Folder for scene.toml, cells.csv and account.md.")
@shared.overwrite_option("Replace files of these names.")
@shared.quiet_option
@shared.as_json_option
def importing(
    program: str, settings: Path, output: Path, overwrite: bool, quiet: bool, as_json: bool
) -> None:
    """Make a scene of the model of another program: SETTINGS is PhysiCell_settings.xml.

    What a scene can say is mapped, and account.md lists for each element of the file what became of
    it: mapped, approximated (with how), left out (with why), or off because it has no effect in the
    model either. Tables of cells and of rules that the settings name are read as well, C++ code is
    not.
    """
    from multicell.importing.physicell.reader import import_physicell

    made = import_physicell(settings)
    paths = made.write(output, overwrite=overwrite)
    if as_json:
        files = [str(path) for path in paths]
        entries = [asdict(entry) for entry in made.entries]
        print_json({"files": files, "counts": made.counts(), "entries": entries})
    elif not quiet:
        _print(made, output)


def _print(made: Imported, output: Path) -> None:
    for fate in ("approximated", "left out"):
        rows = [
            (
                "" if entry.line is None else entry.line,
                _short(entry.path),
                entry.value[:20],
                entry.note,
            )
            for entry in made.of(fate)
        ]
        title = {"title": fate.capitalize(), "title_justify": "left"}
        table = filled_table(("line >", "element", "value", "note"), rows, **title)
        shared.console().print(table)
    counts = ", ".join(f"{number} {fate}" for fate, number in made.counts().items())
    click.echo(f"\n{counts}: see '{output / 'account.md'}'.", file=sys.stdout)
    scene = shlex.quote(str(output / "scene.toml"))
    click.echo(f"To run it: multicell run {scene} -o out", file=sys.stdout)


_OF_A_TYPE = re.compile(
    r"cell_definitions/cell_definition\[(?P<name>.*?)\]/(phenotype/)?(?P<rest>.*)"
)


def _short(path: str) -> str:
    """Return the end of the path of an element, with the type of cells that it belongs to."""
    found = _OF_A_TYPE.fullmatch(path)
    if found is None:
        return path.removeprefix("microenvironment_setup/")
    return f"{found['name']}: {'/'.join(found['rest'].split('/')[-2:])}"
