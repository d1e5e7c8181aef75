"""The commands ``multicell compare`` and ``multicell stability``: parse, call, print."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from multicell.cli.options import as_json_option, changes_option, console, errors, scene_of
from multicell.cli.process import complain, print_json


def _positive(context: click.Context, option: click.Parameter, value: float | None) -> float | None:
    """Refuse a time that is none; infinity is one."""
    if value is not None and not value > 0.0:
        raise click.BadParameter(f"{value:g} is not above 0 s.", context, option)
    return value


_output = click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder for the results; it must be empty or new.",
)
_methods = click.option(
    "--methods",
    metavar="NAMES",
    help="Methods to compare, separated by commas; by default all.",
)
_overwrite = click.option("--overwrite", is_flag=True, help="Replace earlier results.")
_quiet = click.option("--quiet", is_flag=True, help="Print nothing but errors.")


@click.command()
@click.argument("scene")
@_output
@changes_option
@_methods
@click.option(
    "--stepwise",
    type=click.IntRange(min=1),
    metavar="[N]",
    is_flag=False,
    flag_value=24,
    help="Compare N coupling steps of the run (24 if no number is given), each from its own "
    "recorded state: for scenes whose trajectories part.",
)
@click.option(
    "--clock",
    type=click.Choice(["wall", "cpu"]),
    default="wall",
    help="The time that judges; that of the processors suffers less from other load.",
)
@click.option("--repeats", type=click.IntRange(min=1), default=3, help="Timed solves per point.")
@click.option(
    "--patience", type=float, default=10.0, callback=_positive, help="Longest solve in s."
)
@click.option(
    "--budget", type=float, callback=_positive, help="Time for all methods together in s."
)
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads.")
@_overwrite
@_quiet
@as_json_option
def compare(
    scene: str,
    output: Path,
    changes: Sequence[str],
    methods: str | None,
    stepwise: int | None,
    clock: str,
    repeats: int,
    patience: float,
    budget: float | None,
    threads: int | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Chart error against cost of integration methods on a SCENE.

    All methods replay the same events at the same times; the reference is computed twice, and
    its own uncertainty is part of the chart. Trajectories of a growing or driven population part
    whatever the method: compare those with --stepwise.
    """
    with errors(as_json):
        described = scene_of(scene, changes)
        from multicell import comparison

        result = comparison.compare(
            described,
            _names(methods),
            output=output,
            stepwise=False if stepwise is None else stepwise,
            clock=clock,
            repeats=repeats,
            patience=patience,
            budget=budget,
            threads=threads,
            overwrite=overwrite,
            progress=None if quiet else _say,
        )
        if as_json:
            print_json(result.table)
        elif not quiet:
            console().print(f"Results are in '{output}'.", markup=False)


@click.command()
@click.argument("scene")
@_output
@changes_option
@_methods
@click.option("--no-sweeps", is_flag=True, help="Only the scene as it is.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads.")
@_overwrite
@_quiet
@as_json_option
def stability(
    scene: str,
    output: Path,
    changes: Sequence[str],
    methods: str | None,
    no_sweeps: bool,
    threads: int | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Find the largest stable step of each method on a SCENE, and how it fails beyond.

    Parameters of the scene are swept one at a time; limits stand beside theory.
    """
    with errors(as_json):
        described = scene_of(scene, changes)
        from multicell import comparison

        result = comparison.stability(
            described,
            _names(methods),
            output=output,
            sweeps={} if no_sweeps else None,
            threads=threads,
            overwrite=overwrite,
            progress=None if quiet else _say,
        )
        if as_json:
            print_json(result.table)
        elif not quiet:
            console().print(f"Results are in '{output}'.", markup=False)


def _names(methods: str | None) -> list[str] | None:
    """Return the methods of a comma-separated list."""
    if methods is None:
        return None
    names = [name.strip() for name in methods.split(",") if name.strip()]
    if not names:
        raise click.BadParameter("no method is named", param_hint="'--methods'")
    return names


_say: Callable[[Any], None] = lambda text: complain(str(text))  # noqa: E731
