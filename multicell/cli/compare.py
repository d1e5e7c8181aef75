"""The commands ``multicell compare`` and ``multicell stability``: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from multicell.cli import options as shared
from multicell.cli.process import complain, print_json
from multicell.schema import separated

if TYPE_CHECKING:
    from collections.abc import Sequence

    from multicell.comparison.precision import Precision
    from multicell.comparison.stability_limits.failure_map import FailureMap
    from multicell.comparison.stability_limits.result import StabilityMap
    from multicell.scene.scene import Scene


def _positive(context: click.Context, option: click.Parameter, value: float | None) -> float | None:
    """Refuse a time that is none; infinity is one."""
    if value is not None and not value > 0.0:
        raise click.BadParameter(f"{value:g} is not above 0 s.", context, option)
    return value


def _names(context: click.Context, option: click.Parameter, text: str | None) -> list[str] | None:
    names = None if text is None else list(separated(text))
    if names == []:
        raise click.BadParameter("no method is named", param_hint="'--methods'")
    return names


_comparing = shared.grouped(
    shared.output_option("Folder for the results; it must be empty or new."),
    click.option(
        "--methods",
        metavar="NAMES",
        callback=_names,
        **shared.offering(shared.known_methods, several=True),
        help="Methods to compare, separated by commas; by default all that can run the scene. "
        "One of your own is named as mine.py:Midpoint.",
    ),
    click.option(
        "--networks",
        "network",
        metavar="[NAME]",
        is_flag=False,
        flag_value="",
        help="Compare methods for network NAME inside the cells instead of those for positions; "
        "without NAME for the only one.",
    ),
    shared.threads_option,
    shared.overwrite_option("Replace earlier results."),
    shared.quiet_option,
    shared.as_json_option,
)
"""What both commands take."""


@click.command("compare")
@shared.of_scene
@_comparing
@click.option(
    "--stepwise",
    type=click.IntRange(min=1),
    metavar="[N]",
    is_flag=False,
    flag_value=24,
    help="Compare N coupling steps of the run (24 if no number is given), each from its own "
    "recorded state: for scenes whose trajectories diverge.",
)
@shared.valued(
    "--clock",
    type=click.Choice(["cpu", "wall"]),
    default="cpu",
    help="Rank methods by CPU time or wall time.",
)
@click.option(
    "--fields",
    "field",
    metavar="[NAME]",
    is_flag=False,
    flag_value="",
    help="Compare solvers of field NAME (nutrients.NAME.solver) on the run's last coupling step; "
    "without NAME of the first field.",
)
@click.option("--repeats", type=click.IntRange(min=1), default=3, help="Timed solves per point.")
@click.option(
    "--budget", type=float, callback=_positive, help="Time for all methods together in s."
)
def compare_command(
    scene: Scene,
    stepwise: int | None,
    network: str | None,
    field: str | None,
    quiet: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Chart error against cost of integration methods on a SCENE.

    All methods replay the same events at the same times. The reference is computed twice, and
    its uncertainty is part of the chart. Trajectories of a growing or driven population diverge
    with any method: compare those with --stepwise. Networks are always compared step by step, and
    fields on the last coupling step.
    """
    options["progress"] = None if quiet else complain
    if field is not None and (network is not None or stepwise is not None):
        raise click.UsageError("--fields takes one coupling step: leave out --networks, --stepwise")
    result: Precision
    if field is not None:
        from multicell.comparison.field_precision import compare_fields

        result = compare_fields(scene, field, **options)
    elif network is None:
        from multicell.comparison.work_precision import compare as compared

        result = compared(scene, stepwise=stepwise or False, **options)
    else:
        from multicell.comparison.network_precision import compare_networks

        result = compare_networks(scene, network, stepwise=stepwise or True, **options)
    _show(result, options["output"], quiet, as_json, result.verdict())


@click.command("stability")
@shared.of_optional_scene
@_comparing
@click.option(
    "--state",
    "states",
    multiple=True,
    metavar="RUN:TIME",
    help="Coupling step to start from, in place of a SCENE: the folder of a run, and a time in it. "
    "May be repeated, for a map of several states.",
)
def stability_command(
    scene: Scene | None,
    states: Sequence[str],
    network: str | None,
    quiet: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Find the largest stable step of each method on a SCENE, and how it fails beyond.

    Limits are compared with theory; the cells settle first. With --state each method solves
    coupling steps of runs, in which cells move, and failures are named. Networks inside cells start
    from the states of the run.
    """
    options["progress"] = None if quiet else complain
    if states and (scene is not None or network is not None):
        raise click.UsageError("--state has a run's own scene: leave out SCENE and --networks")
    result: StabilityMap | FailureMap
    if states:
        from multicell.comparison.stability_limits.moving import moving_stability

        result = moving_stability(states, **options)
    elif scene is None:
        raise click.UsageError("Missing argument 'SCENE', or --state RUN:TIME")
    elif network is None:
        from multicell.comparison.stability_limits.search import stability as limits_of

        result = limits_of(scene, **options)
    else:
        from multicell.comparison.stability_limits.networks import network_stability

        result = network_stability(scene, network, **options)
    _show(result, options["output"], quiet, as_json)


def _show(
    result: Precision | StabilityMap | FailureMap,
    output: Path,
    quiet: bool,
    as_json: bool,
    verdict: str = "",
) -> None:
    if as_json:
        print_json(result.table)
    elif not quiet:
        if verdict:
            shared.console().print(verdict, markup=False)
        shared.console().print(f"Results are in '{output}'.", markup=False)
