"""The command ``multicell sensitivity``: parse, call, print."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from multicell.cli import options as shared
from multicell.cli import study as studies
from multicell.cli.process import complain, print_json


@click.command()
@click.argument("scene", type=shared.SCENE)
@shared.output_option("Folder of the analysis; its runs are kept there.")
@studies.free_option
@click.option(
    "--method",
    default="morris",
    show_default=True,
    metavar="NAME",
    help="morris: which parameters matter, in few runs; sobol: which part of the variance each one "
    "makes.",
)
@click.option(
    "--size",
    type=int,
    help="Trajectories of Morris (10; each takes a run more than there are parameters) or base "
    "points of Sobol' (64; each takes two more), a power of two.",
)
@click.option(
    "--seeds",
    type=int,
    default=1,
    show_default=True,
    help="Runs at each point, with the same seeds at all points; from two on indices are set "
    "against the noise.",
)
@click.option(
    "--observable",
    "observables",
    multiple=True,
    callback=shared.observable_names,
    metavar="NAME",
    help="What the indices are of, at the end of the runs: a column of the history, as diameter, "
    "or one of your own, as mine.py:rim_area. May be given several times; by default the usual "
    "ones of the scene.",
)
@shared.changes_option
@shared.law_option
@studies.cores_option
@studies.scheduler_option
@studies.yes_option
@click.option("--retry", is_flag=True, help="Try again what has failed.")
@shared.overwrite_option("Replace another analysis in the folder; its runs stay.")
@shared.no_report_option
@shared.quiet_option
@shared.as_json_option
def sensitivity(
    scene: str,
    output: Path,
    free: Sequence[str],
    changes: Sequence[str],
    law: str | None,
    observables: Sequence[str],
    cores: int | None,
    scheduler: str | None,
    yes: bool,
    retry: bool,
    overwrite: bool,
    no_report: bool,
    quiet: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Find out which parameters of a SCENE decide its observables.

    Every index has its 95 % interval, and states whether it is distinguishable from the noise over
    seeds.
    An analysis that was stopped continues with the same command; a larger --size or more --seeds
    take the runs that are there.
    """
    pairs = studies.key_values(free, "--free")
    described = shared.scene_of(scene, changes, law)
    from multicell.calibration.sensitivity import carry_out, plan_of
    from multicell.studies.study import write_study

    with studies.planning():
        plan = plan_of(described, pairs, observables=observables or None, **options)
    count = studies.cores_wanted(cores, scheduler)
    study = write_study(plan.study, output, overwrite=overwrite)
    studies.confirm(study.expected(count or 1), count, yes, quiet or as_json)
    from multicell.cli.study_progress import reporter

    try:
        with reporter(study, count, show=not quiet) as progress:
            result = carry_out(
                plan, output, cores=cores, scheduler=scheduler, retry=retry, progress=progress
            )
    except KeyboardInterrupt:
        complain("Stopped: the same command continues with what is there.")
        raise
    page = None if no_report else result.report()
    if as_json:
        print_json(result.to_dict())
    elif not quiet:
        out = shared.console()
        out.print(result.text(), markup=False, highlight=False, soft_wrap=True)
        if page is not None:
            out.print(f"The report is '{page}'.", markup=False, soft_wrap=True)
    if any(row["reason"] for row in result.runs):
        raise click.exceptions.Exit(1)
