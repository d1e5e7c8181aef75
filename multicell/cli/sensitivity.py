"""The command ``multicell sensitivity``: parse, call, print."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from multicell.cli import options as shared
from multicell.cli import study as studies


@click.command()
@click.argument("scene", type=shared.SCENE)
@shared.output_option("Folder of the analysis; its runs are kept there.")
@studies.free_option
@shared.valued(
    "--method",
    default="morris",
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
@shared.valued(
    "--seeds",
    default=1,
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
@studies.analysis_options
def sensitivity(
    scene: str,
    output: Path,
    free: Sequence[str],
    method: str,
    size: int | None,
    seeds: int,
    observables: Sequence[str],
    changes: Sequence[str],
    law: str | None,
    **how: Any,
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

    with studies.planning():
        plan = plan_of(
            described, pairs, observables=observables or None, method=method, size=size, seeds=seeds
        )
    result = studies.carry_out_study(plan, output, carry_out, how)
    studies.print_analysis(result, result.runs, how)
