"""The command that makes a scene of another program's model."""

from __future__ import annotations

import shlex
import sys
from dataclasses import asdict
from pathlib import Path

import click

from multicell.cli import options as shared
from multicell.cli.process import print_json


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
        counts = ", ".join(f"{number} {fate}" for fate, number in made.counts().items())
        click.echo(f"{counts}: see '{output / 'account.md'}'.", file=sys.stdout)
        scene = shlex.quote(str(output / "scene.toml"))
        click.echo(f"To run it: multicell run {scene} -o out", file=sys.stdout)
