"""The command ``multicell fit``: parse, call, print."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from multicell.cli import options as shared
from multicell.cli import study as studies
from multicell.cli.options import escape_markup, filled_table
from multicell.cli.process import complain, print_json
from multicell.cli.progress import display

if TYPE_CHECKING:
    from rich.console import Console

    from multicell.calibration.fit_plan import FitPlan
    from multicell.calibration.fitted import Fit
    from multicell.scene.scene import Scene


@click.command("fit")
@shared.of_scene
@click.option(
    "--data",
    required=True,
    type=click.Path(path_type=Path),
    help="CSV file with a column for each quantity and its unit in the title, as 'time / h', "
    "'diameter / um', 'diameter sd / um', 'nutrients.oxygen.boundary / mM'.",
)
@studies.free_option
@shared.output_option("Folder of the fit; the same fit there is continued.")
@shared.valued(
    "--seeds",
    default=2,
    help="Runs of each set of parameters in the search, with the same seeds for all.",
)
@shared.valued(
    "--repeats",
    default=12,
    help="Runs with fresh seeds at the best point, from which intervals have the scatter of runs.",
)
@click.option("--budget", type=int, metavar="RUNS", help="Number of runs in all.")
@shared.valued(
    "--sd",
    default=0.1,
    help="Relative standard deviation of data that come without one.",
)
@shared.valued(
    "--specimens",
    default="same",
    metavar="NAME",
    help="single: each row is another specimen, measured once, as the column 'specimen' says too.",
)
@shared.observable_option
@studies.cores_option
@studies.scheduler_option
@studies.yes_option
@shared.overwrite_option("Replace another fit in the folder.")
@shared.quiet_option
@shared.as_json_option
def fit_command(
    scene: Scene,
    data: Path,
    free: Sequence[str],
    output: Path,
    cores: int | None,
    scheduler: str | None,
    yes: bool,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Fit free parameters of a SCENE to measured data.

    --free takes distributions too, as growth.cycle_time='norm(18 h, 2 h) in 10:30 h'.

    The result states how far each parameter is determined, and what the data leave open. A fit that
    was stopped continues with the same command; a larger --budget adds to it.
    """
    pairs = studies.key_values(free, "--free")
    from multicell.calibration.fit import plan_fit, run_fit_plan

    plan = plan_fit(scene, data, pairs, **options)
    count, words = studies.cores_wanted(cores, scheduler), "starting"

    def note(what: str, done: int, wanted: int) -> float:
        nonlocal words
        words = f"{what}: {done:,} of {wanted:,}"
        return done / max(wanted, 1)

    studies.confirm(_cost(plan, None if overwrite else output, count), count, yes, quiet or as_json)
    try:
        with display(lambda: [words], note, show=not quiet) as progress:
            found = run_fit_plan(
                plan, output=output, cores=cores, scheduler=scheduler, overwrite=overwrite,
                progress=progress,
            )  # fmt: skip
    except KeyboardInterrupt:
        complain(f"What has run is kept in '{output}'; the same command continues with it.")
        raise
    if as_json:
        print_json(found.summary())
    elif not quiet:
        _print(shared.console(), found, found.folder or output)


def _cost(plan: FitPlan, folder: Path | None, cores: int | None) -> Any:
    """Return the rest of a fit, and its expected cost at most."""
    from multicell.studies.cost import StudyCost, cost_of

    runs, core_seconds = plan.left(folder)
    memory = max(cost_of(c.scene).memory for c in plan.problem.measured.conditions)
    many = cores or 1
    return StudyCost(runs, core_seconds, core_seconds / many, memory * many, disk=0.0)


def _print(out: Console, found: Fit, output: Path) -> None:
    from multicell.calibration.fit_page import parameters_in_words

    rows = parameters_in_words(found)
    cells = [[row[key] for key in ("key", "best", "interval", "part")] for row in rows]
    out.print(filled_table(("parameter", "best >", "95 % interval >", "of its range >"), cells))
    data = found.best
    out.print(escape_markup(f"χ² = {data.chi_squared:.3g} for {len(data.residuals)} data"))
    for entry in found.undetermined:
        out.print(escape_markup(f"{entry}."), style="yellow")
    for note in found.notes:
        out.print(escape_markup(f"Note: {note}"), style="dim")
    out.print(escape_markup(f"Results are in '{output}'."))
