"""The command ``multicell movie``: a run as a moving picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from multicell.cli import options as shared
from multicell.cli.process import print_file
from multicell.cli.progress import count_progress


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@shared.output_option("File for the movie: .gif, .webp, or .mp4 with multicell[movie].")
@shared.section_option
@click.option("--colour", "--color", metavar="NAME", help="Of the cells, as for plot.")
@shared.valued("--rate", default=8.0, help="Frames in a second, at most 60.")
@click.option("--space", is_flag=True, help="Whole cells in space instead of a section.")
@shared.cut_option
@click.option(
    "--turn",
    type=float,
    metavar="DEGREES",
    help="How far the eye swings round the cells in space.  [default: 90]",
)
@click.option(
    "--transparent", is_flag=True, help="Without background: a .webp of cells in space only."
)
@shared.loaded_law_option
@shared.overwrite_option("Replace the file.")
@shared.quiet_option
@shared.as_json_option
def movie(
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
    with count_progress("pictures", show=not quiet) as progress:
        written(run, output, progress=progress, space=space, **given)
    if as_json or not quiet:
        print_file(output, as_json)
