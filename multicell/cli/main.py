"""The command ``multicell``: parse, call, print.

Exit codes are those of :class:`multicell.errors.ExitCode`. Errors are one sentence on stderr.
With ``--json`` stdout holds exactly one JSON document.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from multicell import __version__
from multicell.cli import options as shared
from multicell.cli.options import escape_markup, filled_table, key_table
from multicell.cli.process import Commands, complain, print_json, print_result
from multicell.errors import OutputError, StepFailed
from multicell.units import time_text

if TYPE_CHECKING:
    from rich.console import Console

    from multicell.report.result import Result
    from multicell.scene.scene import Scene


_ELSEWHERE = {
    "compare": "compare:compare_command",
    "stability": "compare:stability_command",
    "dose-response": "analyses:dose_response_command",
    "sensitivity": "analyses:sensitivity_command",
    "fit": "fit:fit_command",
    "profile": "fit:profile_command",
    "import": "scenes:importing",
    "play": "play:play",
    "study": "study:study_commands",
    "scenes": "scenes:scenes",
    "init": "scenes:init",
    "coarsen": "scenes:coarsen_command",
    "schema": "scenes:schema",
    "plot": "show:plot",
    "view": "show:view_command",
    "cite": "show:cite_command",
    "movie": "show:movie_command",
}
"""Commands of other modules, which are loaded with them."""

_TASKS = {
    "Run a scene": ("run", "resume", "play", "explain"),
    "See and export a run": ("view", "plot", "movie", "export", "cite"),
    "Find and make scenes": ("scenes", "init", "import", "coarsen", "schema"),
    "Run studies and use data": ("study", "sensitivity", "dose-response", "fit", "profile"),
    "Compare integrators": ("compare", "stability"),
    "Get help": ("doctor",),
}
"""The commands as the help lists them, by what they are for."""


@click.group(
    cls=Commands,
    elsewhere=_ELSEWHERE,
    tasks=_TASKS,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, message="multicell %(version)s")
def main() -> None:
    """Simulate multicellular tissue cell by cell.

    SCENE is the name of a built-in scene ("multicell scenes" lists them) or the path of a TOML
    file.
    """


@main.command("explain")
@shared.of_scene
@shared.as_json_option
def explain_command(scene: Scene, as_json: bool) -> None:
    """Explain what a SCENE uses and why, without running it."""
    from multicell.report.explain.scene import explain as explained

    facts, name = explained(scene), click.get_current_context().params["scene"]
    if as_json:
        print_json({"scene": name, **facts})
    else:
        _print_facts(shared.console(), name, facts)


_run_options = shared.grouped(
    shared.observable_option,
    shared.changes_option,
    shared.integrator_option,
    shared.overwrite_option("Replace the results of an earlier run."),
    shared.threads_option,
    shared.no_report_option,
    shared.quiet_option,
    shared.as_json_option,
)
"""What ``run`` and ``resume`` take."""


@main.command("run")
@click.argument("scene", **shared.offering(shared.known_scenes))
@shared.output_option("Folder for the results; it must be empty or new.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the random number streams.")
@click.option(
    "--cells",
    metavar="FILE",
    help="Cells to start with: a table of multicell or of another program, an image of labels, or "
    ".h5ad (--set initial.cells=FILE).",
)
@shared.columns_option
@shared.law_option
@_run_options
def run_command(
    scene: str,
    output: Path,
    seed: int | None,
    cells: str | None,
    columns: str | None,
    laws: tuple[str, ...],
    changes: Sequence[str],
    integrator: str | None,
    **options: Any,
) -> None:
    """Run a SCENE and write frames, summary, pictures and a report to a folder."""
    described = shared.scene_of(scene, shared.cells_change(cells, columns, changes), laws)
    table = described.initial.cells
    if table is not None and table.said and not options["quiet"]:
        complain(table.said)
    if seed is not None:
        described = described.with_changes({"seed": seed})
    from multicell.results.folder import refuse_results

    own = None
    if integrator is not None:
        from multicell.runner import integrated_by

        described, own = integrated_by(described, integrator)

    if (output / "summary.json").exists():  # of a whole run: refused before anything is predicted
        refuse_results(output, overwrite=options["overwrite"])

    def simulate(**how: Any) -> Result:
        # loaded after the first words: it takes as long as all before
        from multicell.runner import run as simulated

        return simulated(described, output=output, integrator=own, **how)

    _simulate(simulate, described, output, **options)


@main.command("resume")
@click.argument("folder", type=click.Path(path_type=Path))
@shared.valued("--frame", type=int, default=-1, help="Frame to resume from.")
@shared.output_option("Folder for the whole run; by default FOLDER itself.", required=False)
@shared.loaded_law_option
@_run_options
def resume_command(
    folder: Path,
    frame: int,
    output: Path | None,
    changes: Sequence[str],
    integrator: str | None,
    **options: Any,
) -> None:
    """Resume the run in FOLDER from its last frame or an earlier one.

    Without changes the result is bitwise identical to one longer run on the same machine. --set
    may change what can change during a run: duration, stop_cells, output and the medium.
    """
    parsed = shared.parse_changes(changes)
    from multicell.scene.scene import load_scene

    if not (folder / "scene.toml").exists():
        why = "it is a file, not a folder" if folder.is_file() else "scene.toml is missing"
        raise OutputError(f"there are no results in '{folder}': {why}")
    scene = load_scene(folder / "scene.toml").with_changes(parsed)

    def simulate(**how: Any) -> Result:
        from multicell.runner import resume as resumed

        return resumed(folder, frame, output=output, changes=parsed, integrator=integrator, **how)

    _simulate(simulate, scene, output or folder, **options)


@main.command("export")
@click.argument("folder", type=click.Path(path_type=Path))
@shared.output_option("Folder for the files.")
@shared.valued(
    "--format",
    metavar="NAME",
    default="csv",
    **shared.offering(shared.known_formats),
    help="Format of the files: csv or parquet tables, vtk for ParaView, anndata (.h5ad) for "
    "scverse, netcdf, openvt, simularium, ro-crate for repositories.",
)
@click.option(
    "--tables",
    metavar="NAMES",
    help="Which tables of csv and parquet, separated by commas: lineage, history, cells, contacts; "
    "by default all.",
)
@click.option("--frame", type=int, help="This frame only; -1 is the last.")
@shared.loaded_law_option
@shared.overwrite_option("Replace files of the same names.")
@shared.as_json_option
def export_command(
    folder: Path, output: Path, tables: str | None, as_json: bool, **options: Any
) -> None:
    """Write the results in FOLDER as files for other programs, with units in their names."""
    from multicell.report.exports.files import export as write

    chosen = None if tables is None else [name.strip() for name in tables.split(",")]
    paths = write(folder, output, tables=chosen, **options)
    print_result(as_json, {"files": [str(path) for path in paths]}, *paths)


@main.command()
@shared.as_json_option
def doctor(as_json: bool) -> None:
    """Report the installation: versions, cores, memory, cache, missing packages.

    Include it when you report a problem.
    """
    from multicell.compiling.numba_068 import installed_pack, processor
    from multicell.host.extras import checkup

    found, pack = checkup(), installed_pack(processor())
    if pack is not None:
        unused = f", not used: {pack.refusal}" if pack.refusal else ""
        found["pack"] = f"{pack.folder}{unused}"
    if as_json:
        print_json(found)
        return
    rows = {"system": found["system"], "Python": found["python"], **found["versions"]}
    rows["cores"] = f"{found['cores']}, of which multicell uses {found['threads']}"
    if found["memory_GiB"] is not None:
        rows["memory"] = f"{found['memory_GiB']:g} GiB"
    hint = " (cannot be written to: set NUMBA_CACHE_DIR to a folder of your own)"
    kept = "" if found["cache_writable"] else hint
    rows["compiled code"] = f"{found['cache']}{kept}"
    if pack is not None:
        rows["compiled pack"] = found["pack"]
    for extra, names in found["missing"].items():
        rows[f"extra '{extra}'"] = f'lacks {", ".join(names)}: pip install ".[{extra}]"'
    shared.console().print(key_table(rows.items()))


def _simulate(
    simulate: Callable[..., Result],
    scene: Scene,
    output: Path,
    *,
    overwrite: bool,
    threads: int | None,
    no_report: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Run, with progress on stderr, and print what it came to."""
    from multicell.cli.progress import reporter
    from multicell.results.folder import LIVE

    page = None if no_report else output / LIVE[1]
    try:
        with reporter(scene, show=not quiet, page=page) as progress:
            result = simulate(
                overwrite=overwrite, threads=threads, progress=progress, report=not no_report
            )
    except (KeyboardInterrupt, StepFailed) as error:
        _finish_early(error, output, no_report, as_json)
        raise
    if as_json:
        print_json(result.summary())
    elif not quiet:
        _print_summary(shared.console(), result.summary(), output)


def _finish_early(error: BaseException, output: Path, no_report: bool, as_json: bool) -> None:
    """Report on what a run that was interrupted or failed has done so far."""
    from multicell.report.result import load_result

    try:
        result = load_result(output)
        if not no_report:
            result.report()
    except OutputError as trouble:
        # the first error is the one that counts: it follows
        complain(f"Nothing could be reported: {trouble}")
        return
    count = len(result.frames)
    last = result.frames[-1].time if count else 0.0
    complain(f"{count} frame(s) up to {time_text(last)} are kept in '{output}'.")
    if isinstance(error, KeyboardInterrupt):
        complain(f"To continue from there: multicell resume {shlex.quote(str(output))}")
    if as_json and isinstance(error, KeyboardInterrupt):
        print_json({**result.summary(), "interrupted": True})


def _print_facts(console: Console, scene: str, facts: dict[str, Any]) -> None:
    console.print(
        escape_markup(f"{scene}: {facts['title']}" if facts["title"] else scene), style="bold"
    )
    from rich.text import Text

    marks = {True: Text("used", "green"), False: Text("absent", "dim")}
    parts = [(marks[part["used"]], part["part"], part["what"]) for part in facts["parts"]]
    numbers = []
    for entry in facts["numbers"]:
        value = entry["value"]
        shown = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
        numbers.append((entry["name"], shown, entry["unit"], entry["meaning"]))
    console.print()
    console.print(filled_table(("", "part", "meaning"), parts))
    console.print()
    console.print(filled_table(("derived number", "value >", "unit", "meaning"), numbers))
    for note in facts["notes"]:
        console.print(escape_markup(f"\nNote: {note}"), style="yellow")


def _print_summary(console: Console, summary: dict[str, Any], output: Path) -> None:
    from multicell.report.wording import diagnostics, measures

    rows = [*measures(summary), *diagnostics(summary)]
    counts = summary.get("states", {}).items()
    rows.append(("states", ", ".join(f"{n:,} {name}" for name, n in counts if n)))
    work = summary.get("integrator", {})
    if "evaluations" in work:
        rows.append(("force evaluations", f"{work['evaluations']:,}"))
    console.print(key_table(rows, justify="right"))
    for note in summary.get("notes", ()):
        console.print(escape_markup(f"Note: {note}"), style="yellow")
    console.print(escape_markup(f"Results are in '{output}'."))
    longer = f"multicell resume {shlex.quote(str(output))} --set duration='…'"
    console.print(escape_markup(f"To continue the run: {longer}"))
