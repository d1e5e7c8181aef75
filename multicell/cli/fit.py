"""The command ``multicell fit``: parse, call, print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from itertools import zip_longest
from math import isfinite
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

    from multicell.calibration.fitting.plan import FitPlan
    from multicell.calibration.fitting.profile_check import ProfileEnd
    from multicell.calibration.fitting.result import Fit
    from multicell.scene.scene import Scene


@click.command("fit")
@shared.of_scene
@click.option(
    "--data",
    required=True,
    type=click.Path(path_type=Path),
    help="Table (CSV, Excel) with a column for each quantity and its unit in the title, as "
    "'time / h', 'diameter / um', 'diameter sd / um', 'nutrients.oxygen.boundary / mM'.",
)
@shared.columns_option
@shared.where_option
@studies.free_option
@shared.output_option("Folder of the fit; the same fit there is continued.")
@shared.valued(
    "--seeds",
    default=2,
    help="Runs for each set of parameters in the search; all sets use the same seeds.",
)
@shared.valued(
    "--repeats",
    default=12,
    help="Runs with fresh seeds at the best point; intervals take their scatter from these runs.",
)
@click.option("--budget", type=int, metavar="RUNS", help="Number of runs in all.")
@shared.valued(
    "--sd",
    default=0.1,
    help="Relative standard deviation of data that come without one.",
)
@shared.specimens_option
@shared.valued(
    "--scatter",
    default="stated",
    metavar="NAME",
    help="unknown: fit the size of the errors of each observable too, as a factor on stated ones.",
)
@click.option(
    "--constraint",
    "constraints",
    multiple=True,
    metavar="A < B",
    help="An order of two free parameters, as 'necrosis < quiescence'. May be given several times.",
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
    from multicell.calibration.fitting.fit import plan_fit, run_fit_plan

    plan = plan_fit(scene, data, pairs, **options)
    if plan.table.said and not quiet:
        complain(plan.table.said)
    count, words = studies.cores_wanted(cores, scheduler), "starting"

    def note(what: str, done: int, wanted: int) -> float:
        nonlocal words
        words = f"{what}: {done:,} of {wanted:,}"
        return done / max(wanted, 1)

    studies.confirm(_cost(plan, None if overwrite else output, count), count, yes, quiet or as_json)
    try:
        with display(lambda: [words], note, show=not quiet) as progress:
            found = run_fit_plan(
                plan,
                output=output,
                cores=cores,
                scheduler=scheduler,
                overwrite=overwrite,
                progress=progress,
            )
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
    from multicell.calibration.fitting.page import parameters_in_words

    if found.misfit:
        out.print(escape_markup(found.misfit), style="yellow")
    rows = parameters_in_words(found)
    cells = [[row[key] for key in ("key", "best", "interval", "part")] for row in rows]
    out.print(filled_table(("parameter", "best >", "95 % interval >", "of its range >"), cells))
    data = found.best
    for name, one in found.scatter.items():
        said = f"errors of {name}: {one.words}, {one.low:.3g} to {one.high:.3g} times the stated"
        out.print(escape_markup(f"{said} (95 %)"))
    out.print(escape_markup(f"χ² = {data.chi_squared:.3g} for {len(data.residuals)} data"))
    for entry in found.undetermined:
        out.print(escape_markup(f"{entry}."), style="yellow")
    for note in found.notes[1 if found.misfit else 0 :]:
        out.print(escape_markup(f"Note: {note}"), style="dim")
    out.print(escape_markup(f"Results are in '{output}'."))


def _checked(found: Fit, name: str, quiet: bool, **options: Any) -> list[ProfileEnd]:
    """Run the ends of an interval, with progress."""
    words = f"ends of {name}"

    def note(done: int, wanted: int) -> float:
        nonlocal words
        words = f"ends of {name}: {done:,} of {wanted:,} runs"
        return done / max(wanted, 1)

    with display(lambda: [words], note, show=not quiet) as progress:
        return found.check_profile(name, progress=progress, **options)


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@shared.output_option("File for the picture: .png, .svg or .pdf.", required=False)
@shared.valued("--level", default=0.95, help="Confidence of the intervals.")
@click.option(
    "--check", "check", is_flag=True, help="Run both ends of each interval, to check the emulator."
)
@shared.valued("--repeats", default=6, help="Runs with fresh seeds at each end, with --check.")
@studies.cores_option
@shared.overwrite_option("Replace the file.")
@shared.quiet_option
@shared.as_json_option
def profile_command(
    folder: Path,
    output: Path | None,
    level: float,
    check: bool,
    repeats: int,
    cores: int | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Print profile likelihoods of the parameters of the fit in FOLDER, and which are identified.

    An interval that reaches an end of the searched range is not bounded by the data.
    """
    from multicell.calibration.fitting.stored import load_fit
    from multicell.calibration.shared.wording import value_in_words
    from multicell.report.plots.style import save_figure

    if output is not None:
        shared.refuse_existing(output, overwrite=overwrite)
    found = load_fit(folder)
    profiles = [found.profile(free.name) for free in found.problem.ranges]
    ends = [one.interval(level) for one in profiles]
    options = {"level": level, "repeats": repeats, "cores": cores}
    checks = [_checked(found, x.name, quiet, **options) for x in profiles] if check else []
    if output is not None:
        save_figure(found.plot.profile(), output)
    if as_json:
        print_json(
            [
                {
                    "name": one.name,
                    "unit": one.unit,
                    "best": one.best,
                    "level": level,
                    "interval": [x if isfinite(x) else None for x in pair],
                    "values": one.values.tolist(),
                    "loss": one.loss.tolist(),
                    **(
                        {"ends": [{**asdict(e), "confirmed": e.confirmed} for e in runs]}
                        if check
                        else {}
                    ),
                }
                for one, pair, runs in zip_longest(profiles, ends, checks)
            ]
        )
        return
    rows = []
    for one, pair in zip(profiles, ends, strict=True):
        low, high = (value_in_words(x, one.unit) if isfinite(x) else "open" for x in pair)
        rows.append((one.name, value_in_words(one.best, one.unit), f"{low} to {high}"))
    title = f"{100.0 * level:g} % interval >"
    shared.console().print(filled_table(("parameter", "best >", title), rows))
    for one, runs in zip(profiles, checks, strict=False):
        for end in runs:
            said = "confirmed" if end.confirmed else "denied: a larger budget for the fit helps"
            text = (
                f"{one.name} = {value_in_words(end.value, one.unit)}: loss {end.loss:.3g}, by "
                f"{end.runs} runs {end.by_runs:.3g} ± {end.error:.2g}: {said}"
            )
            shared.console().print(escape_markup(text), style="" if end.confirmed else "yellow")
    for one in profiles:
        if not one.identified(level):
            shared.console().print(
                escape_markup(f"The data do not bound {one.name}."), style="yellow"
            )
