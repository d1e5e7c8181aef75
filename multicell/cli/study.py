"""The commands ``multicell study new | run | status | report``: parse, call, print."""

from __future__ import annotations

import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

import click

from multicell.cli import options as shared
from multicell.cli.process import Group, complain, print_json, print_result
from multicell.errors import ExitCode, MulticellError, exit_code_of
from multicell.units import time_text

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.studies.cost import StudyCost
    from multicell.studies.engine import RunOutcome
    from multicell.studies.study import Study

_ASKED: Final = 3600.0  # expected time in s above which a study is asked for
_LISTED: Final = 20  # failed or running runs that are listed

folder_argument = click.argument("folder", type=click.Path(path_type=Path))
cores_option = click.option(
    "--cores", type=click.IntRange(min=1), help="Processes on this machine; by default all cores."
)
scheduler_option = click.option(
    "--scheduler", metavar="ADDRESS", help="Dask scheduler of a cluster, as tcp://host:8786."
)
free_option = shared.keyed(
    "--free",
    "free",
    "KEY=LOW:HIGH",
    "A free parameter and its range, as growth.cycle_time='8:25 h' or "
    "drag.viscosity='log 0.1:10 kPa s' (equal ratios count the same). May be given several times.",
)
yes_option = click.option(
    "--yes",
    "-y",
    is_flag=True,
    help="Start runs of more than an hour without asking.",
)
retry_option = click.option("--retry", is_flag=True, help="Repeat failed runs.")
_studied = shared.grouped(shared.loaded_law_option, shared.observable_option)
_carrying_out = shared.grouped(
    cores_option,
    scheduler_option,
    yes_option,
    retry_option,
    shared.no_report_option,
    shared.quiet_option,
    shared.as_json_option,
)
analysis_options = shared.grouped(
    shared.overwrite_option("Replace another study in the folder; its runs stay."), _carrying_out
)
"""What the commands take that carry out a study and report what follows from it."""


class _StudyGroup(Group):
    scene = "study new {} --vary KEY=VALUES -o study"
    meant: ClassVar[Mapping[str, str]] = {"plan": "study new SCENE --vary KEY=VALUES -o study"}


@click.group("study", cls=_StudyGroup)
def study_commands() -> None:
    """Run a scene many times over: plan, run, watch and report; each with --json for machines."""


@study_commands.command()
@shared.of_scene
@shared.output_option("Folder of the study.")
@shared.keyed(
    "--vary",
    "vary",
    "KEY=VALUES",
    "Values of a key, as nutrients.oxygen.boundary='0.07,0.14,0.28 mM', '0.05:0.3:6 mM' (six "
    "of them) or contact.law=jkr,hertz; all combinations run. May be given several times.",
)
@shared.valued(
    "--seeds",
    default=1,
    help="Runs of each point, with the same seeds at all points.",
)
@shared.observable_option
@shared.as_json_option
@shared.overwrite_option("Replace the plan of another study; its runs stay.")
@shared.quiet_option
def new(
    scene: Scene,
    output: Path,
    vary: Sequence[str],
    quiet: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Plan a study of a SCENE: write study.toml to a folder, and run nothing yet.

    A folder that holds the same study, or a part of it, is extended: finished runs stay.
    """
    from multicell.studies.study import study as planned

    made = planned(scene, key_values(vary, "--vary"), output=output, **options)
    _print_plan(made, quiet, as_json)


def key_values(items: Sequence[str], option: str) -> dict[str, str]:
    """Return the values of ``KEY=VALUES`` items by their keys."""
    pairs: dict[str, str] = {}
    for item in items:
        key, _, text = (part.strip() for part in item.partition("="))
        if key in pairs:
            problem = f"{key} is given twice: write all its values behind one {option}"
            raise click.BadParameter(problem, param_hint=f"'{option}'")
        pairs[key] = text
    return pairs


def _print_plan(made: Study, quiet: bool, as_json: bool) -> None:
    cores = cores_wanted(None, None)
    assert cores is not None
    cost, states = made.expected(cores), made.status()
    done = sum(state.state == "done" for state in states)
    if as_json:
        print_json(
            {
                "folder": str(made.folder),
                "points": len(made.plan.points),
                "seeds": made.plan.seeds,
                "runs": len(states),
                "done": done,
                "cores": cores,
                "expected": asdict(cost),
            }
        )
        return
    if quiet:
        return
    from multicell.studies.plan import axis_line

    plan = made.plan
    for axis in plan.axes:
        say(textwrap.shorten(axis_line(axis), 200, placeholder=" ..."))
    points, seeds = _count(len(plan.points), "point"), _count(plan.seeds, "seed")
    known = f", {done:,} of them done" if done else ""
    say(f"{points} x {seeds} = {_count(len(states), 'run')}{known}")
    say(f"{_cost_words(cost, cores)}.")
    say(
        f"Written to '{made.folder / 'study.toml'}': read it, edit it, then "
        f"'multicell study run {made.folder}'."
    )


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def _cost_words(cost: StudyCost, cores: int | None) -> str:
    if not cost.runs:
        return "Nothing is left to run"
    alone = f"{time_text(cost.core_seconds, 2)} of one core"
    time = alone if cores is None else f"{time_text(cost.seconds, 2)} on {_count(cores, 'core')}"
    extra = "" if cores in (None, 1) else f" ({alone})"
    from rich.filesize import decimal

    memory = f"{decimal(round(cost.memory))} of memory" + (" a process" if cores is None else "")
    return (
        f"{_count(cost.runs, 'run')} left, expected to take about {time}{extra}, {memory} and "
        f"{decimal(round(cost.disk))} of the disk; compilation is not counted"
    )


@study_commands.command("run")
@folder_argument
@_studied
@_carrying_out
def study_run_command(folder: Path, **how: Any) -> None:
    """Compute all runs of the study in FOLDER that are not done.

    You can stop it at any time, by Ctrl-C or a kill, and start it again: nothing is computed twice,
    and unfinished runs continue from their last frame. A run that fails is reported with its
    reason, and the others continue.
    """
    made = _open_study(folder)
    from multicell.host.extras import needs

    reported = not how["no_report"]
    needs("dask", "distributed", "xarray", "h5netcdf", "pandas")
    outcomes = _carry_out(made, made.run, how)
    page, table = made.folder / "report.html", made.folder / "study.nc"
    trouble: MulticellError | None = None
    made_from = (page, table) if reported else (table,)
    if not (all(path.exists() for path in made_from) and all(o.reused for o in outcomes)):
        try:
            if reported:
                made.report()
            else:
                made.write_tables()
        except MulticellError as error:  # how the runs ended comes first
            trouble, reported = error, False
    _print_outcomes(
        made, outcomes, page if reported else None, trouble, how["quiet"], how["as_json"]
    )


def _open_study(folder: Path) -> Study:
    from multicell.studies.study import load_study

    return load_study(folder)


def cores_wanted(cores: int | None, scheduler: str | None) -> int | None:
    """Return on how many cores runs go; None if a cluster decides."""
    from multicell.studies.workers import own_cores

    if scheduler is None:
        return cores or own_cores()
    if cores is not None:
        raise click.UsageError("--cores has no meaning with --scheduler: it has its workers.")
    return None


def confirm(cost: StudyCost, cores: int | None, yes: bool, silent: bool) -> None:
    """Report what is expected, and ask for confirmation above an hour."""
    seconds = cost.core_seconds if cores is None else cost.seconds
    words = _cost_words(cost, cores)
    if not silent and cost.runs:
        complain(f"{words}.")
    if seconds <= _ASKED or yes:
        return
    if not _terminal():
        raise click.UsageError(f"{words}. There is no terminal to ask at: --yes confirms.")
    if not click.confirm("Go on?", err=True):
        complain("Nothing has run.")
        raise click.exceptions.Exit(ExitCode.INTERRUPTED)


def _terminal() -> bool:
    return sys.stdin is not None and sys.stdin.isatty()


def carry_out_study(
    plan: Any, output: Path, carry_out: Callable[..., Any], how: Mapping[str, Any]
) -> tuple[Any, list[RunOutcome]]:
    """Do the missing runs of an analysis; return its result, and the runs that failed.

    - ``plan``: with the study to run
    - ``carry_out``: called with it, the folder, what says where runs go, and ``progress``
    - ``how``: the values of ``analysis_options``
    """
    from multicell.studies.study import write_study

    study = write_study(plan.study, output, overwrite=how["overwrite"])
    failed = []

    def noted(progress: Callable[[RunOutcome], None] | None, **workers: Any) -> Any:
        def note(outcome: RunOutcome) -> None:
            failed.extend([outcome] if outcome.state == "failed" else [])
            if progress is not None:  # nobody looks with --quiet
                progress(outcome)

        return carry_out(plan, output, progress=note, **workers)

    return _carry_out(study, noted, how), failed


def _carry_out(study: Study, carry_out: Callable[..., Any], how: Mapping[str, Any]) -> Any:
    """Do what runs of a study are left, after a question where they take long."""
    from multicell.cli.progress import study_reporter

    workers = {name: how[name] for name in ("cores", "scheduler", "retry")}
    count = cores_wanted(how["cores"], how["scheduler"])
    confirm(study.expected(count or 1), count, how["yes"], how["quiet"] or how["as_json"])
    try:
        with study_reporter(study, count, show=not how["quiet"]) as progress:
            return carry_out(progress=progress, **workers)
    except KeyboardInterrupt:
        complain("Stopped: the same command continues with what is there.")
        raise


def print_analysis(
    result: Any, lacking: bool, failed: Sequence[RunOutcome], how: Mapping[str, Any]
) -> None:
    """Report an analysis, and end as failed if it lacks one of its runs."""
    page = None if how["no_report"] else result.report()
    if how["as_json"]:
        print_json(result.to_dict())
    elif not how["quiet"]:
        say(result.text())
        _print_page(page)
    if lacking:
        code = _code_of(failed)
        if code == ExitCode.MACHINE:
            complain(f"Error: {_count(len(failed), 'run')} failed, the first: {failed[0].reason}")
        raise click.exceptions.Exit(code)


def _code_of(failed: Sequence[RunOutcome]) -> ExitCode:
    """Return how a command ends some of whose runs failed."""
    machine = {run.kind for run in failed} <= {"machine", "unreadable"}
    return ExitCode.MACHINE if failed and machine else ExitCode.FAILED


def say(text: str) -> None:
    """Print a line on stdout, wrapped by the terminal only."""
    shared.console().print(text, markup=False, highlight=False, soft_wrap=True)


def _print_page(page: Path | None) -> None:
    if page is not None:
        say(f"The report is '{page}'.")


def _print_outcomes(
    made: Study,
    outcomes: Sequence[RunOutcome],
    page: Path | None,
    trouble: MulticellError | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Print what the runs came to, and then ``trouble``; end with the code of the worst."""
    failed = [k for k, outcome in enumerate(outcomes) if outcome.state != "done"]
    if as_json:
        runs = [
            {**asdict(outcome), "coordinates": dict(run.coordinates)}
            for outcome, run in zip(outcomes, made.runs, strict=True)
        ]
        print_json(
            {
                "folder": str(made.folder),
                "failed": len(failed),
                "runs": runs,
                "others": made.others(),
                **({} if trouble is None else {"error": str(trouble)}),
            }
        )
    elif not quiet:
        reused = sum(outcome.reused for outcome in outcomes)
        say(
            f"{_count(len(outcomes), 'run')}: {len(outcomes) - len(failed):,} done"
            f"{f', {len(failed):,} failed' if failed else ''}"
            f"{f'; {reused:,} of them were there' if reused else ''}."
        )
        _list_failed([(made.runs[k].coordinates, outcomes[k].reason) for k in failed], made)
        _name_others(made)
        _print_page(page)
    if failed and quiet and not as_json:
        reason = outcomes[failed[0]].reason
        complain(f"{_count(len(failed), 'run')} failed, the first of them: {reason}")
    if trouble is not None:
        complain(f"Error: {trouble}")
    codes = [] if trouble is None else [exit_code_of(trouble)]
    if failed:
        codes.append(_code_of([outcomes[k] for k in failed]))
    if codes:
        raise click.exceptions.Exit(min(codes))


def _list_failed(failed: Sequence[tuple[Any, str]], made: Study) -> None:
    for coordinates, reason in failed[:_LISTED]:
        say(f"  failed at {_where(coordinates, made)}: {reason}")
    if len(failed) > _LISTED:
        say(f"  and {len(failed) - _LISTED:,} more")


def _name_others(made: Study) -> None:
    """Say what is in the folder of runs that belongs to no point of the study."""
    others = made.others()
    if others:
        names = textwrap.shorten(", ".join(others), 200, placeholder=" ...")
        where, what = made.folder / "runs", _count(len(others), "folder")
        say(f"{what} in '{where}' belong to no point of this study, and stay: {names}")


def _where(coordinates: Mapping[str, Any], made: Study) -> str:
    units = {axis.name: axis.unit for axis in made.plan.axes}
    parts = []
    for name, value in coordinates.items():
        shown = f"{value:g}" if isinstance(value, float) else str(value)
        parts.append(f"{name} = {shown} {units.get(name, '')}".rstrip())
    return ", ".join(parts)


@study_commands.command("status")
@folder_argument
@_studied
@shared.as_json_option
def study_status_command(folder: Path, as_json: bool) -> None:
    """Report the state of all runs of the study in FOLDER, why runs failed, and the time left."""
    from multicell.studies.status import STATES

    made = _open_study(folder)
    states = made.status()
    counts = Counter(state.state for state in states)
    left = made.expected().core_seconds
    if as_json:
        runs = [
            {**asdict(state), "coordinates": dict(run.coordinates), "expected": run.expected}
            for state, run in zip(states, made.runs, strict=True)
        ]
        print_json(
            {
                "folder": str(folder),
                "counts": counts,
                "core_seconds_left": left,
                "runs": runs,
                "others": made.others(),
            }
        )
        return
    words = {"partial": "begun"}
    shown = [f"{counts[name]:,} {words.get(name, name)}" for name in STATES if counts[name]]
    say(f"{_count(len(states), 'run')}: {', '.join(shown)}")
    failed = []
    for run, state in zip(made.runs, states, strict=True):
        if state.state == "running":
            share = 100.0 * state.time / run.scene.duration
            where, cells = _where(run.coordinates, made), _count(state.cells, "cell")
            say(f"  running at {where}: {share:.0f} % of the time, {cells}")
        elif state.state == "failed":
            failed.append((run.coordinates, state.reason))
    if left > 0.0:
        say(f"About {time_text(left, 2)} of one core left.")
    _list_failed(failed, made)
    _name_others(made)


@study_commands.command()
@folder_argument
@_studied
@shared.with_data
@shared.as_json_option
def report(folder: Path, data: Path | None, how: Mapping[str, Any], as_json: bool) -> None:
    """Write the report of the study in FOLDER: pictures, table, and all numbers as files.

    That is report.html, study.nc (netCDF, for xarray) and study.csv. Runs that are missing or
    have failed are marked.
    """
    made = _open_study(folder)
    points = None if data is None else made.compare_with(data, **how)
    page = made.report(points)
    files, nearest = [str(page), str(folder / "study.nc"), str(folder / "study.csv")], []
    document: dict[str, Any] = {"files": files}
    if points is not None:
        document["points"] = [point.row() for point in points]
        nearest = [f"Nearest point: {points[0].comparison.words}."]
    print_result(as_json, document, *files, *nearest)
