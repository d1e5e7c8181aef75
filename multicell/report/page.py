"""The report of a run: one HTML page that holds its pictures and needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.errors import OutputError
from multicell.report.html import Drawing, write_page
from multicell.report.plots.run import PICTURES
from multicell.report.wording import cell_count, diagnostics, measures
from multicell.results.folder import LIVE, in_use, remove

if TYPE_CHECKING:
    from multicell.measured.compared import MeasuredComparison
    from multicell.report.result import Result


def write_report(
    result: Result, folder: str | Path | None = None, comparison: MeasuredComparison | None = None
) -> Path:
    """Write ``report.html`` and its pictures beside it.

    - ``result``: the run; it may be unfinished
    - ``folder``: where to write, by default the folder of the run
    - ``comparison``: with measured data, to show with it
    """
    place = result.folder if folder is None else Path(folder)
    if place is None:
        raise OutputError("the run has no output folder: say where the report shall go")
    from multicell.report.viewer.pack import pack_view

    summary, plots = result.summary(), result.plot
    drawings: dict[str, Drawing] = {
        f"{name}.png": (getattr(plots, name), kind.caption)
        for name, kind in PICTURES.items()
        if kind.on_page(plots)
    }
    phases = {k: v for k, v in (summary.get("wall") or {}).items() if k != "total"}
    page = write_page(
        place / "report.html",
        "run.html",
        scene=result.scene,
        title=result.scene.title or "Untitled run",
        subtitle=_subtitle(result, summary),
        tiles=dict(measures(summary)),
        pictures=drawings | compared_drawing(comparison),
        compared=comparison,
        viewer=pack_view(result),
        summary=summary,
        diagnostics=dict(diagnostics(summary)),
        phases=phases,
        longest=max(phases.values(), default=0.0) or 1.0,
        **_accounts(summary),
    )
    if not in_use(place):  # of a run that was killed: the report takes their place
        remove(place, LIVE)
    return page


def compared_drawing(comparison: MeasuredComparison | None) -> dict[str, Drawing]:
    """Return the picture of a comparison with data, if there is one."""
    if comparison is None:
        return {}
    caption = f"Measured data over the curves: {comparison.words}."
    return {"measured.png": (comparison.plot, caption)}


def _subtitle(result: Result, summary: Mapping[str, Any]) -> str:
    scene = result.scene
    method = (summary.get("integrator") or {}).get("method", scene.integrator.method)
    cells = result.history.get("cells", np.empty(0))
    parts = [f"from {cell_count(cells[0])}"] if len(cells) else []
    parts += [f"method {method}", f"seed {summary.get('seed', scene.seed)}"]
    if summary.get("steps") is not None:
        parts.append(f"{summary['steps']:,} coupling steps")
    return " · ".join(parts)


def _accounts(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the account of each field, and the entries that any of them has."""
    ledger = (summary.get("ledger") or {}).items()
    accounts = {name: account for name, account in ledger if isinstance(account, Mapping)}
    entries = dict.fromkeys(
        key for account in accounts.values() for key, amount in account.items() if amount != 0
    )
    return {"accounts": accounts, "entries": list(entries)}
