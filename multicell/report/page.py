"""The report of a run: one HTML page that holds its pictures and needs nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell.errors import OutputError
from multicell.report.html import write_page
from multicell.report.wording import cell_count, measures, percent
from multicell.results.folder import file_errors
from multicell.results.quantities import title_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from multicell.report.result import Result


_CROWD: Final = 10  # cells, below which averages over shells say nothing
_CAPTIONS: Final = {
    "growth": "The population in the course of the run.",
    "section": "Cells that a plane through the centre cuts, each drawn with the radius of its cut.",
    "fields": "A map of every field in the plane of the section, each over its own range.",
    "profiles": "Averages over spherical shells about the centre.",
    "contacts": "Contacts between cells of different types, and where each type is.",
    "pull": "Force that pulls the cells apart, beside what their contact can bear.",
}
_FLAT_CAPTIONS: Final = {
    **_CAPTIONS,
    "section": "The cells, all in one plane.",
    "fields": "A map of every field in the plane of the cells, each over its own range.",
    "profiles": "Averages over rings about the centre.",
}


def write_report(result: Result, folder: str | Path | None = None) -> Path:
    """Write ``report.html`` and its pictures beside it.

    Parameters
    ----------
    result
        The run; it may be unfinished.
    folder
        Where to write, by default the folder of the run.

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    OutputError
        If there is no folder to write to, or it cannot be written to.
    """
    place = result.folder if folder is None else Path(folder)
    if place is None:
        raise OutputError("the run has no output folder: say where the report shall go")
    with file_errors("use the output folder", place):
        place.mkdir(parents=True, exist_ok=True)
    from multicell.report.viewer.embed import view

    captions = _CAPTIONS if result.scene.dimensions == 3 else _FLAT_CAPTIONS
    pictures = {place / f"{name}.png": (draw, captions[name]) for name, draw in _drawings(result)}
    summary = result.summary()
    return write_page(
        place / "report.html",
        "run.html",
        scene=result.scene,
        title=result.scene.title or "Untitled run",
        subtitle=_subtitle(result, summary),
        tiles=dict(measures(summary)) | dict(_contact_measures(result)),
        pictures=pictures,
        viewer=view(result),
        summary=summary,
        **_phases(summary),
        **_accounts(summary),
    )


def _contact_measures(result: Result) -> Iterator[tuple[str, str]]:
    """Yield the key figures of contact that a summary alone does not tell."""
    from multicell.report.plots.contacts import separation_theory

    separation = result.summary().get("separation")
    if separation:
        theory = separation_theory(result.frames, result.scene, separation["time"])
        if theory is not None:
            yield (
                title_of("separation.force"),
                f"{separation['force']:.4g} nN (theory {theory:.4g})",
            )
    mixed = result.history.get("heterotypic_fraction", ())
    known = [float(part) for part in mixed if part == part]
    if known:
        yield title_of("heterotypic_fraction"), f"{percent(known[0])} → {percent(known[-1])}"


def _drawings(result: Result) -> Iterator[tuple[str, Callable[[], Figure]]]:
    """Yield the pictures that this run has enough data for."""
    if len(result.history.get("time", ())):
        yield "growth", result.plot.growth
    if len(result.frames) and len(result.frames[-1].cells):
        yield "section", result.plot.section
        if len(result.frames[-1].fields) > 1:
            yield "fields", result.plot.fields
        if len(result.frames[-1].cells) >= _CROWD:
            yield "profiles", result.plot.profiles
    if len(result.frames) and len(result.history.get("heterotypic_fraction", ())):
        yield "contacts", result.plot.contacts
    if len(result.frames) and len(result.history.get("pull", ())):
        yield "pull", result.plot.pull


def _subtitle(result: Result, summary: Mapping[str, Any]) -> str:
    """Return one line: number of cells at the start, method, seed, steps."""
    scene = result.scene
    method = (summary.get("integrator") or {}).get("method", scene.integrator.method)
    cells = result.history.get("cells", np.empty(0))
    parts = [f"from {cell_count(cells[0])}"] if len(cells) else []
    parts += [f"method {method}", f"seed {summary.get('seed', scene.seed)}"]
    if summary.get("steps") is not None:
        parts.append(f"{summary['steps']:,} coupling steps")
    return " · ".join(parts)


def _phases(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the wall time of each phase, and the longest as a scale."""
    phases = {k: v for k, v in (summary.get("wall") or {}).items() if k != "total"}
    return {"phases": phases, "longest": max(phases.values(), default=0.0) or 1.0}


def _accounts(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the account of each field, and the entries that any of them has."""
    ledger = (summary.get("ledger") or {}).items()
    accounts = {name: account for name, account in ledger if isinstance(account, Mapping)}
    entries = dict.fromkeys(
        key for account in accounts.values() for key, amount in account.items() if amount != 0
    )
    return {"accounts": accounts, "entries": list(entries)}
