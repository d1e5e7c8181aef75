"""The command ``multicell dose-response``: parse, call, print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from multicell.cli.options import (
    SCENE,
    as_json_option,
    changes_option,
    console,
    law_option,
    no_report_option,
    observable_names,
    output_option,
    overwrite_option,
    quiet_option,
    scene_of,
    with_values,
)
from multicell.cli.process import complain, print_json
from multicell.cli.study import (
    confirm,
    cores_option,
    cores_wanted,
    key_values,
    planning,
    scheduler_option,
    yes_option,
)

if TYPE_CHECKING:
    from multicell.calibration.dose_response import DosePlan, Options
    from multicell.calibration.dose_response_result import DoseResponse


@click.command(name="dose-response")
@click.argument("scene", required=False, type=SCENE)
@output_option("Folder of the analysis; its runs are kept there.")
@click.option(
    "--dose",
    "drugs",
    multiple=True,
    callback=with_values,
    metavar="KEY=DOSES",
    help="A dose and its values, the control first: nutrients.drug.boundary='0, log 0.01:10:8 uM' "
    "(eight with equal ratios). KEY,KEY=DOSES: several keys that all take it. Twice: two drugs, "
    "all pairs of whose doses run.",
)
@click.option(
    "--data",
    metavar="FILE",
    help="In place of a SCENE measured responses, a CSV file with the titles 'dose / uM', response "
    "and replicate; of two drugs 'dose A / uM' and 'dose B / uM'.",
)
@click.option(
    "--observable",
    "observables",
    multiple=True,
    callback=observable_names,
    metavar="NAME",
    help="The response, at the end of the runs: a column of the history, as diameter, or one of "
    "your own, as mine.py:rim_area; given several times they are added up. By default the living "
    "cells, proliferating and quiescent.",
)
@click.option("--seeds", type=int, default=5, show_default=True, help="Runs at each dose.")
@click.option(
    "--top",
    default="control",
    show_default=True,
    metavar="NAME",
    help="control: the curve goes through the control; free: one parameter more.",
)
@changes_option
@law_option
@cores_option
@scheduler_option
@yes_option
@click.option("--retry", is_flag=True, help="Try again what has failed.")
@overwrite_option("Replace another study in the folder; its runs stay.")
@no_report_option
@quiet_option
@as_json_option
def dose_response(
    scene: str | None,
    output: Path,
    drugs: Sequence[str],
    data: str | None,
    observables: Sequence[str],
    seeds: int,
    top: str,
    changes: Sequence[str],
    law: str | None,
    no_report: bool,
    quiet: bool,
    as_json: bool,
    **how: Any,
) -> None:
    """Find the dose at which half of the cells of a SCENE are left, and what two drugs do together.

    Every number has its 95 % interval. What lies outside the doses tested is said to, never
    extrapolated. An analysis that was stopped continues with the same command; more doses or
    --seeds take the runs that are there.
    """
    if (scene is None) == (data is None):
        raise click.UsageError("Give a SCENE with --dose, or measured --data.")
    pairs = key_values(drugs, "--dose")
    if data is not None and (pairs or changes or law or observables):
        raise click.UsageError("--dose, --set, --law and --observable belong to a SCENE.")
    if scene is not None and len(pairs) not in (1, 2):
        raise click.UsageError(f"--dose is given {len(pairs)} times, must be once or twice.")
    described = None if scene is None else scene_of(scene, changes, law)
    from multicell.calibration.dose_response import LIVING, Options, of_table, plan_of

    options = Options(top)
    if described is None:
        result = replace(of_table(data, options), folder=output)
    else:
        keys, doses = list(pairs), tuple(pairs.values())
        with planning():
            plan = plan_of(
                described,
                keys[0].replace(" ", "").split(",") if len(keys) == 1 else None,
                doses[0] if len(keys) == 1 else doses,
                combine=keys if len(keys) == 2 else None,
                observable="+".join(observables) or LIVING,
                seeds=seeds,
            )
        result = _carry_out(plan, output, options, quiet, quiet or as_json, **how)
    page = None if no_report else result.report()
    if no_report:
        result.write_tables()
    if as_json:
        print_json(result.to_dict())
    elif not quiet:
        out = console()
        out.print(result.text(), markup=False, highlight=False, soft_wrap=True)
        if page is not None:
            out.print(f"The report is '{page}'.", markup=False, soft_wrap=True)
    if any(row["reason"] for row in result.table):
        raise click.exceptions.Exit(1)


def _carry_out(
    plan: DosePlan, output: Path, options: Options, quiet: bool, silent: bool, *,
    cores: int | None, scheduler: str | None, yes: bool, retry: bool, overwrite: bool,
) -> DoseResponse:  # fmt: skip
    """Do what runs are left, with progress, and return what they show."""
    from multicell.calibration.dose_response import carry_out
    from multicell.cli.study_progress import reporter
    from multicell.studies.study import write_study

    count = cores_wanted(cores, scheduler)
    study = write_study(plan.study, output, overwrite=overwrite)
    confirm(study.expected(count or 1), count, yes, silent)
    try:
        with reporter(study, count, show=not quiet) as progress:
            return carry_out(
                plan, output, options, cores=cores, scheduler=scheduler, retry=retry,
                progress=progress,
            )  # fmt: skip
    except KeyboardInterrupt:
        complain("Stopped: the same command continues with what is there.")
        raise
