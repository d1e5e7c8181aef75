"""The commands about scenes: list, print, copy, coarsen and import them, describe their keys."""

from __future__ import annotations

import shlex
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from multicell.cli import options as shared
from multicell.cli.options import filled_table
from multicell.cli.process import print_json, print_result
from multicell.errors import OutputError
from multicell.host.files import parse_toml
from multicell.schema import near_miss
from multicell.units import time_text

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


@click.command()
@click.argument("name", required=False)
@click.option("--full", is_flag=True, help="Print all keys, those with default values included.")
@shared.as_json_option
def scenes(name: str | None, full: bool, as_json: bool) -> None:
    """List the built-in scenes, or print the one called NAME as TOML, with units and remarks."""
    from multicell.scene.scene import scene_names

    if name is None and full:
        raise click.UsageError("--full needs the NAME of a scene")
    if name is not None:
        _print_scene(name, full, as_json)
        return
    rows = [_scene_row(name) for name in scene_names()]
    if as_json:
        print_json(rows)
        return
    table = filled_table(
        ("scene", "duration", "parts", "title"),
        [(r["name"], time_text(r["duration"]), ", ".join(r["parts"]), r["title"]) for r in rows],
    )
    for column in table.columns[:2]:
        column.no_wrap = True
    shared.console().print(table)


def _print_scene(name: str, full: bool, as_json: bool) -> None:
    from multicell.scene.scene import load_scene, scene_text

    if as_json:
        print_json(load_scene(name).to_dict())
        return
    click.echo(load_scene(name).to_toml() if full else scene_text(name), nl=False, file=sys.stdout)


@click.command()
@click.argument("name")
@shared.output_option("File to write, by default NAME.toml here.", required=False)
@shared.overwrite_option("Replace the file.")
@shared.as_json_option
def init(name: str, output: Path | None, overwrite: bool, as_json: bool) -> None:
    """Write a copy of the built-in scene NAME, to edit and run as a scene of your own."""
    from multicell.results.folder import write_text
    from multicell.scene.scene import scene_files, scene_names, scene_text

    if name not in scene_names():
        raise OutputError(f"there is no built-in scene {name!r}. {near_miss(name, scene_names())}")
    path = output or Path(f"{name}.toml")
    written = {path: scene_text(name)}
    written |= {path.with_name(other): text for other, text in scene_files(name).items()}
    for file in written:
        shared.refuse_existing(file, overwrite=overwrite)
    for file, text in written.items():
        write_text(file, text)
    others = [str(file) for file in written if file != path]
    said = f"'{path}' is written. Edit it, then: multicell run {path} -o out"
    print_result(as_json, {"file": str(path), "others": others}, said)


@click.command("coarsen")
@shared.of_scene
@shared.output_option("File to write.")
@shared.valued("--factor", default=2.0, help="Ratio of coarse to original cell widths.")
@shared.overwrite_option("Replace the file.")
@shared.as_json_option
def coarsen_command(
    scene: Scene, output: Path, factor: float, overwrite: bool, as_json: bool
) -> None:
    """Write SCENE with fewer, larger cells and the same tissue, for any other command."""
    from multicell.results.folder import write_text
    from multicell.scene.coarsening import coarsen as coarse_scene

    made = coarse_scene(scene, factor)
    shared.refuse_existing(output, overwrite=overwrite)
    write_text(output, made.to_toml())
    each = made.cells.represents
    said = f"'{output}' is written: each cell stands for {each:g}."
    print_result(as_json, {"file": str(output), "represents": each}, said)


@click.command()
@shared.as_json_option
def schema(as_json: bool) -> None:
    """Print the JSON Schema of scene files, for editors that complete and check them.

    It is a JSON document with and without --json.
    """
    from multicell.scene.json_schema import json_schema

    print_json(json_schema())


def _known_program(_: click.Context, __: click.Parameter, value: str) -> str:
    if value != "physicell":
        hint = f"multicell import physicell {value} -o out"
        if value.lower() in ("sbml", "antimony") or value.endswith((".sbml", ".ant")):
            hint = "a scene reads a network by --set networks.NAME.file=FILE"
        raise click.BadParameter(f"{value!r} is no program whose models are read: {hint}")
    return value


@click.command("import")
@click.argument("program", metavar="physicell", callback=_known_program)
@click.argument("settings", type=click.Path(path_type=Path))
@shared.output_option("Folder for scene.toml, cells.csv and account.md.")
@shared.overwrite_option("Replace files of these names.")
@shared.quiet_option
@shared.as_json_option
def importing(
    program: str, settings: Path, output: Path, overwrite: bool, quiet: bool, as_json: bool
) -> None:
    """Make a scene of the model of another program: SETTINGS is PhysiCell_settings.xml.

    account.md lists the fate of each element of the file: mapped, approximated (and how), left out
    (and why), or off, because it has no effect in the model either. Tables of cells and of rules
    that the settings name are read as well, C++ code is not.
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


def _scene_row(name: str) -> dict[str, Any]:
    from multicell.scene.scene import Scene, scene_text

    entries = parse_toml(scene_text(name))
    # a list needs no network: to read one takes a second, and packages that may not be here
    networks = entries.pop("networks", None)
    if networks:
        del entries["responses"]
    scene = Scene.from_dict(entries)
    parts = ["growth"] if scene.growth else []
    parts += ["death"] if scene.death else []
    parts += list(scene.nutrients)
    parts += ["networks"] if networks else []
    return {
        "name": name,
        "title": scene.title,
        "duration": scene.duration,
        "initial_cells": scene.initial.count,
        "parts": parts or ["mechanics only"],
    }
