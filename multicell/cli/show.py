"""The commands that show a run: ``multicell view``, ``plot`` and ``movie``."""

from __future__ import annotations

import webbrowser
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from multicell.cli import options as shared
from multicell.cli.process import complain, print_result
from multicell.cli.progress import display
from multicell.errors import OutputError
from multicell.report.plots.run import PICTURES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from multicell.report.result import Result

_OPTIONS = {
    "plane": "--section",
    "colour": "--colour",
    "cut": "--cut",
    "turn": "--turn",
    "frame": "--time",
}
"""Options of pictures by the names that their methods have for them."""


@click.command("view")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--no-browser", is_flag=True, help="Write the page, and do not open it.")
@shared.with_data
@shared.loaded_law_option
@shared.as_json_option
def view_command(
    folder: Path, no_browser: bool, data: Path | None, how: Mapping[str, Any], as_json: bool
) -> None:
    """Open the page of the run in FOLDER, also during the run, with all frames so far.

    The page is written again unless it is newer than the results. A run that has no frame yet
    shows a picture of its cells that renews itself.
    """
    page = folder / "report.html"
    if data is not None or not _up_to_date(page, folder):
        from multicell.report.result import load_result
        from multicell.results.folder import LIVE, in_use

        result = load_result(folder)
        begins = not len(result.frames) and (folder / LIVE[1]).is_file() and in_use(folder)
        if begins:
            page = folder / LIVE[1]
        elif data is None:
            page = result.report()
        else:
            found = result.compare_with(data, **how)
            page = result.report(comparison=found)
    if not no_browser and not webbrowser.open(page.resolve().as_uri()):
        complain("There is no browser to open it.")
    print_result(as_json, {"file": str(page)}, page)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--bibtex", is_flag=True, help="Print BibTeX entries in place of the text.")
@shared.loaded_law_option
@shared.as_json_option
def cite_command(folder: Path, bibtex: bool, as_json: bool) -> None:
    """Print a methods section of the run in FOLDER: model, values, numerics, seed, versions."""
    from multicell.report.result import load_result

    found = load_result(folder).cite()
    shown = found.bibtex if bibtex else found.text
    print_result(as_json, {"text": found.text, "bibtex": found.bibtex}, shown.rstrip())


def _up_to_date(page: Path, folder: Path) -> bool:
    from multicell.results.folder import PASSING, file_errors

    with file_errors("read", folder):
        if not page.is_file():
            return False
        results = [folder / name for name in ("frames.h5", "summary.json", *PASSING)]
        written = page.stat().st_mtime_ns
        return all(path.stat().st_mtime_ns <= written for path in results if path.exists())


@click.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path))
@shared.output_option("File for the picture: .png, .svg or .pdf.")
@click.option(
    "--picture",
    type=click.Choice(list(PICTURES)),
    help="One of the report's pictures.  [default: section]",
)
@shared.section_option
@click.option(
    "--colour",
    "--color",
    metavar="NAME",
    help="Colour of the cells in a section or in space: state, type, phase, clone, doomed, a "
    "quantity such as pressure, radius or age, or the name of a field.",
)
@shared.cut_option
@click.option(
    "--turn", type=float, metavar="DEGREES", help="Viewing angle round the cells in space."
)
@click.option(
    "--time",
    "frame",
    metavar="TIME",
    help="Time of the frame, as '6 d' (the nearest one); by default the last.",
)
@click.option(
    "--quantity",
    metavar="NAME",
    **shared.offering(shared.known_quantities),
    help="Draw a column of the history against time, such as diameter; of several runs in one.",
)
@shared.with_data
@shared.loaded_law_option
@shared.overwrite_option("Replace the file.")
@shared.as_json_option
def plot(
    folders: Sequence[Path],
    output: Path,
    picture: str | None,
    quantity: str | None,
    data: Path | None,
    how: Mapping[str, Any],
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Draw a picture of the run in FOLDERS, or a quantity of the runs in several of them.

    With --data: measured data over the curves of all observables that both have.
    """
    given = {name: value for name, value in options.items() if value is not None}
    if data is not None and (len(folders) > 1 or picture or quantity or given):
        raise click.UsageError("--data makes a picture of its own, of one run")
    _refuse_mixed(folders, picture, quantity, given)
    from multicell.report.plots.style import save_figure
    from multicell.report.result import load_result

    shared.refuse_existing(output, overwrite=overwrite)
    runs = [load_result(folder) for folder in folders]
    words = ""
    if data is not None:
        found = runs[0].compare_with(data, **how)
        figure, words = found.plot(), ". ".join([found.words, *found.notes])
    elif quantity is not None:
        figure = _quantity(folders, runs, quantity)
    else:
        if "frame" in given:
            given["frame"] = runs[0].number_at(given["frame"], "--time")
        try:
            figure = getattr(runs[0].plot, picture or "section")(**given)
        except ValueError as error:  # there is nothing to draw
            raise OutputError(f"no picture of '{runs[0].folder}': {error}") from error
    save_figure(figure, output)
    if words:
        complain(f"{words}.")
    print_result(as_json, {"file": str(output)}, output)


def _refuse_mixed(
    folders: Sequence[Path], picture: str | None, quantity: str | None, given: Iterable[str]
) -> None:
    """Refuse options that the picture does not take."""
    if len(folders) > 1 and quantity is None:
        raise click.UsageError("several runs go into one picture with --quantity only")
    if picture is not None and quantity is not None:
        raise click.UsageError("--picture has no meaning with --quantity")
    what = "--quantity" if quantity is not None else f"--picture {picture or 'section'}"
    taken = () if quantity is not None else PICTURES[picture or "section"].options
    for name in given:
        if name not in taken:
            raise click.UsageError(f"{_OPTIONS[name]} has no meaning with {what}")


def _quantity(folders: Sequence[Path], runs: Sequence[Result], quantity: str) -> Figure:
    """Return a quantity of all runs, named by the parts of their paths that differ."""
    from multicell.report.plots.growth import overlay

    short = [folder.name or str(folder) for folder in folders]
    labels = short if len(set(short)) == len(short) else [str(folder) for folder in folders]
    if len(set(labels)) < len(labels):
        raise OutputError("a run is named twice")
    return overlay({label: run.history for label, run in zip(labels, runs, strict=True)}, quantity)


@click.command("movie")
@click.argument("folder", type=click.Path(path_type=Path))
@shared.output_option("File for the movie: .gif, .webp, or .mp4 with multicell[movie].")
@shared.section_option
@click.option("--colour", "--color", metavar="NAME", help="Colour of the cells, as for plot.")
@shared.valued("--rate", default=8.0, help="Frames in a second, at most 60.")
@click.option("--space", is_flag=True, help="Whole cells in space instead of a section.")
@shared.cut_option
@click.option(
    "--turn",
    type=float,
    metavar="DEGREES",
    help="Range of the viewing angle round the cells in space.  [default: 90]",
)
@click.option(
    "--transparent", is_flag=True, help="Without background: a .webp of cells in space only."
)
@shared.loaded_law_option
@shared.overwrite_option("Replace the file.")
@shared.quiet_option
@shared.as_json_option
def movie_command(
    folder: Path,
    output: Path,
    space: bool,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Write all frames of the run in FOLDER as a moving picture: sections, or cells in space."""
    given = {name: value for name, value in options.items() if value is not None}
    if not space and given.keys() & {"cut", "turn"}:
        raise click.UsageError("--cut and --turn have a meaning with --space only")
    from multicell.report.plots.movie import movie as written
    from multicell.report.result import load_result

    shared.refuse_existing(output, overwrite=overwrite)
    run = load_result(folder)
    with display(
        lambda: ["pictures"], lambda done, of: done / of, lines=0, show=not quiet
    ) as progress:
        written(run, output, progress=progress, space=space, **given)
    if as_json or not quiet:
        print_result(as_json, {"file": str(output)}, output)
