"""The commands ``multicell sensitivity`` and ``multicell dose-response``: parse, call, print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from multicell.cli import options as shared
from multicell.cli import study as studies

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.studies.engine import RunOutcome


def _observables(what: str, several: str) -> shared.Option:
    help = (
        f"{what}, at the end of the runs: a column of the history, as diameter, or one of your "
        f"own, as mine.py:rim_area. {several}"
    )
    return click.option(
        "--observable",
        "observables",
        multiple=True,
        callback=shared.observable_names,
        metavar="NAME",
        help=help,
    )


@click.command("sensitivity")
@shared.of_scene
@shared.output_option("Folder of the analysis; its runs are kept there.")
@studies.free_option
@shared.valued(
    "--method", default="morris", metavar="NAME", help="morris, or sobol: parts of the variance."
)
@click.option(
    "--size",
    type=int,
    help="Trajectories of Morris; each takes a run more than there are parameters. Points of "
    "Sobol', a power of two; each takes two more.  [default: 10, 64]",
)
@shared.valued(
    "--seeds",
    default=1,
    help="Runs at each point, with the same seeds at all points; from two on indices are set "
    "against the noise.",
)
@_observables(
    "What the indices are of",
    "May be given several times; by default the usual ones of the scene.",
)
@studies.analysis_options
def sensitivity_command(
    scene: Scene,
    output: Path,
    free: Sequence[str],
    method: str,
    size: int | None,
    seeds: int,
    observables: Sequence[str],
    **how: Any,
) -> None:
    """Find out which parameters of a SCENE decide its observables.

    Every index has its 95 % interval, and states whether it is distinguishable from the noise over
    seeds.
    An analysis that was stopped continues with the same command; a larger --size or more --seeds
    take the runs that are there.
    """
    pairs = studies.key_values(free, "--free")
    from multicell.calibration.sensitivity.analysis import plan_sensitivity, run_sensitivity_plan

    plan = plan_sensitivity(
        scene, pairs, method=method, observables=observables or None, size=size, seeds=seeds
    )
    result, failed = studies.carry_out_study(plan, output, run_sensitivity_plan, how)
    studies.print_analysis(result, bool(result.failures), failed, how)


@click.command(name="dose-response")
@click.argument("scene", required=False, **shared.offering(shared.known_scenes))
@shared.output_option("Folder of the analysis; its runs are kept there.")
@shared.keyed(
    "--dose",
    "drugs",
    "KEY=DOSES",
    "A dose and its values, the control first: nutrients.drug.boundary='0, log 0.01:10:8 uM' "
    "(eight with equal ratios). Twice: two drugs, all pairs of whose doses run.",
)
@click.option(
    "--data",
    metavar="FILE",
    help="In place of a SCENE measured responses, a CSV file with the titles 'dose / uM', response "
    "and replicate; of two drugs 'dose A / uM' and 'dose B / uM'.",
)
@shared.columns_option
@shared.where_option
@_observables(
    "The response",
    "Given several times they are added up. By default the living cells, proliferating and "
    "quiescent.",
)
@shared.valued("--seeds", default=5, help="Runs at each dose.")
@shared.changes_option
@shared.law_option
@studies.analysis_options
def dose_response_command(
    scene: str | None,
    output: Path,
    drugs: Sequence[str],
    data: str | None,
    columns: str | None,
    where: str | None,
    observables: Sequence[str],
    seeds: int,
    changes: Sequence[str],
    laws: tuple[str, ...],
    **how: Any,
) -> None:
    """Find the dose that leaves half of the cells of a SCENE, and the joint effect of drugs.

    Every number has its 95 % interval. Values outside the doses tested are reported as such, never
    extrapolated. An analysis that was stopped continues with the same command; more doses or
    --seeds reuse the existing runs.
    """
    if (scene is None) == (data is None):
        raise click.UsageError("Give a SCENE with --dose, or measured --data.")
    pairs = studies.key_values(drugs, "--dose")
    if data is None and (columns or where):
        raise click.UsageError("--columns and --where belong to --data.")
    if data is not None and (pairs or changes or laws or observables):
        raise click.UsageError("--dose, --set, --law and --observable belong to a SCENE.")
    if scene is not None and len(pairs) not in (1, 2):
        example = "--dose nutrients.drug.boundary='0,1,3,10 uM'"
        raise click.UsageError(
            f"--dose is given {len(pairs)} times, must be once or twice, for example {example}."
        )
    described = None if scene is None else shared.scene_of(scene, changes, laws)
    from multicell.calibration.dose_response.analysis import (
        LIVING,
        of_table,
        plan_dose_response,
        run_dose_plan,
    )

    failed: list[RunOutcome] = []
    if described is None:
        result = replace(of_table(data, columns, where), folder=output)
        result.write_tables()
    else:
        keys, doses = list(pairs), tuple(pairs.values())
        plan = plan_dose_response(
            described,
            keys[0] if len(keys) == 1 else None,
            doses[0] if len(keys) == 1 else doses,
            combine=keys if len(keys) == 2 else None,
            observable="+".join(observables) or LIVING,
            seeds=seeds,
        )
        result, failed = studies.carry_out_study(plan, output, run_dose_plan, how)
    studies.print_analysis(result, any(row["reason"] for row in result.table), failed, how)
