"""The page of a study: maps, curves over time, and a table of all runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell.report.html import Drawing, write_page
from multicell.report.page import compared_drawing
from multicell.report.wording import clock, time_unit
from multicell.studies import picture_data as of
from multicell.studies.pictures import StudyPlots
from multicell.studies.readings import USUAL
from multicell.studies.spheroids import last_tissues, spheroids
from multicell.studies.status import STATES

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from multicell.scene.scene import Scene
    from multicell.studies.compared import PointComparison
    from multicell.studies.runs import StudyRun
    from multicell.studies.status import RunStatus

MAX_ROWS: Final = 4000  # runs that the table of a page lists; a browser takes long over more

_MAPS: Final = 4  # observables that have a map or a response
_COURSES: Final = 3  # and of which courses
_POINTS: Final = 40  # and points of the table beside data
_COLUMNS: Final = 6  # and columns of the table
_STATE_WORDS: Final = {"waiting": "not run", "partial": "begun"}


def write_study_report(
    folder: str | Path,
    scene: Scene,
    table: xr.Dataset,
    runs: Sequence[StudyRun],
    states: Sequence[RunStatus],
    shown: Sequence[str] | None = None,
    points: Sequence[PointComparison] = (),
) -> Path:
    """Write ``report.html`` of a study and its pictures beside it.

    - ``folder``: of the study
    - ``scene``: what is varied
    - ``table``: of the study, as ``study.to_xarray()``
    - ``runs``, ``states``: all runs and how they stand, in the order of the table
    - ``shown``: observables to show, by default the usual ones that change
    - ``points``: with measured data, to show with the study; the nearest one first
    """
    names = key_observables(table) if shown is None else list(shown)
    title = f"{scene.title or 'Untitled scene'}: study"
    best = points[0].comparison if points else None
    return write_page(
        Path(folder) / "report.html",
        "study.html",
        scene=scene,
        title=title,
        subtitle=_subtitle(table),
        tiles=_tiles(table, states),
        pictures=_tissues(Path(folder), table, title, runs, states)
        | _drawings(table, title, names)
        | compared_drawing(best),
        compared=best,
        points=[point.row() for point in points[:_POINTS]],
        unfinished=_unfinished(states),
        **_run_table(table, runs, states, names[:_COLUMNS]),
    )


def key_observables(table: xr.Dataset) -> list[str]:
    """Return the observables that a page shows: those that are not the same in all runs."""
    known = of.observables(table)
    found: list[str] = [name for name in USUAL if name in known]
    found += [name for name in known if name.startswith("hypoxic_radius")]
    names: list[str] = []
    for name in found:
        values = of.at_end(table, name).values
        values = values[np.isfinite(values)]
        if values.size and (values.min() < values.max() or name in ("cells", "diameter")):
            names.append(name)
    return names


def _drawings(table: xr.Dataset, title: str, names: Sequence[str]) -> dict[str, Drawing]:
    """Return the pictures: maps of a grid or responses, then curves over time.

    Each has a caption of its own.
    """
    plots = StudyPlots(table, title)
    axes = of.axes_of(table)
    several = table.sizes[of.SEED] > 1
    draw: Callable[[str], Figure] = plots.response
    over = _listed([of.axis_scale(table, name).words for name in axes])
    kind, words = "response", f"at the end of each run over {over}: dots are single runs"
    words += ", bars one standard deviation over the seeds" if several else " of the only seed"
    if not of.is_list(table) and len(axes) > 1:
        scatter = "mean ± standard deviation over the seeds" if several else "of the only seed"
        draw, kind = plots.heatmap, "map"
        words = f"at the end of each run, one tile for each pair of values of {over}: {scatter}"
    found: dict[str, Drawing] = {
        f"{kind}-{name}.png": (partial(draw, name), f"{of.sentence(of.words(name))} {words}.")
        for name in (names[:_MAPS] if axes else ())
    }
    bands = "with bands of one standard deviation over the seeds" if several else "of the only seed"
    panels = f", one panel for each of {over}" if len(axes) > 1 else f", by {over}" if axes else ""
    courses = [name for name in names if of.TIME in table[name].dims and table.sizes[of.TIME] > 1]
    return found | {
        f"curves-{name}.png": (
            partial(plots.curves, name),
            f"{of.sentence(of.words(name))} over time{panels}, {bands}.",
        )
        for name in courses[:_COURSES]
    }


def _tissues(
    folder: Path,
    table: xr.Dataset,
    title: str,
    runs: Sequence[StudyRun],
    states: Sequence[RunStatus],
) -> dict[str, Drawing]:
    """Return the picture of all tissues; none where no run is done."""
    tissues = last_tissues(folder, runs, states)
    if not tissues:
        return {}
    points = len(runs) // table.sizes[of.SEED]
    flat = tissues[0][0].scene.dimensions == 2
    what = "The tissue" if flat else "A section through the centre of the tissue"
    seeds = " of the first seed that is done" if table.sizes[of.SEED] > 1 else ""
    caption = f"{what} at the end of each run{seeds}, on one scale."
    return {"tissues.png": (partial(spheroids, table, title, tissues, points), caption)}


def _listed(names: Sequence[str]) -> str:
    """Return names as a list in words."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def _subtitle(table: xr.Dataset) -> str:
    sizes = [
        f"{of.axis_scale(table, name).words} ({len(of.axis_scale(table, name).values)})"
        for name in of.axes_of(table)
    ]
    seeds = table.sizes[of.SEED]
    points = f"{table.sizes['point']} points" if of.is_list(table) else " × ".join(sizes)
    return f"{points} × {seeds} seed{'' if seeds == 1 else 's'}"


def _tiles(table: xr.Dataset, states: Sequence[RunStatus]) -> dict[str, str]:
    """Return the key figures: runs by state, seeds, time that it took."""
    count = {name: sum(state.state == name for state in states) for name in STATES}
    wall = float(sum(state.wall for state in states if np.isfinite(state.wall)))
    tiles = {"runs": f"{len(states):,}"}
    tiles |= {f"runs {_STATE_WORDS.get(name, name)}": f"{n:,}" for name, n in count.items() if n}
    tiles["seeds"] = f"{table.sizes[of.SEED]}"
    if table.sizes[of.TIME] > 1:
        last = float(table[of.TIME].max())
        tiles["simulated time, at most"] = time_unit(last).text(last)
    if wall > 0.0:
        tiles["wall time of all runs"] = clock(wall)
    return tiles


def _unfinished(states: Sequence[RunStatus]) -> str:
    """Return the warning at the head of the page about runs that are not done."""
    failed = sum(state.state == "failed" for state in states)
    open_ = sum(state.state not in ("done", "failed") for state in states)
    parts = [f"{failed:,} failed"] if failed else []
    parts += [f"{open_:,} not finished"] if open_ else []
    return f"Of {len(states):,} runs {' and '.join(parts)}" if parts else ""


def _run_table(
    table: xr.Dataset, runs: Sequence[StudyRun], states: Sequence[RunStatus], names: Sequence[str]
) -> dict[str, Any]:
    axes = [(name, of.axis_scale(table, name)) for name in of.axes_of(table)]
    ends = [of.at_end(table, name).values.ravel() for name in names]
    chosen = _rows_shown(states)
    rows = []
    for k in chosen:
        run, state = runs[k], states[k]
        values = [float(end[k]) if state.state == "done" else np.nan for end in ends]
        cells = [
            *(_coordinate_text(run.coordinates.get(name), own.factor) for name, own in axes),
            f"{run.coordinates.get(of.SEED, run.scene.seed)}",
            _STATE_WORDS.get(state.state, state.state),
            *(of.number_text(value, 4) if np.isfinite(value) else "—" for value in values),
            clock(state.wall) if np.isfinite(state.wall) else "—",
        ]
        rows.append(
            {"name": run.name, "state": state.state, "reason": state.reason, "cells": cells}
        )
    heads = [
        *(own.label for _, own in axes),
        "seed",
        "state",
        *(of.label(table, name) for name in names),
        "wall time",
    ]
    return {"heads": heads, "rows": rows, "left_out": len(states) - len(chosen)}


def _rows_shown(states: Sequence[RunStatus]) -> list[int]:
    """Return which runs are listed: all, or of very many those that failed, then the first ones."""
    if len(states) <= MAX_ROWS:
        return list(range(len(states)))
    order = sorted(range(len(states)), key=lambda k: states[k].state != "failed")
    return sorted(order[:MAX_ROWS])


def _coordinate_text(value: Any, factor: float) -> str:
    if isinstance(value, str):
        return value
    return "—" if value is None else of.number_text(float(value) / factor, 4)
