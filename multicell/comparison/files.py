"""The page of a comparison: one HTML file that holds its pictures and needs nothing else."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Final

from multicell.comparison.measure import CLOCKS
from multicell.report.page import _CSS, _POLICY, _settings, _table, clock
from multicell.report.plots.style import time_unit
from multicell.results.folder import package_version, words

if TYPE_CHECKING:
    from multicell.comparison.measure import Row
    from multicell.comparison.result import WorkPrecision


VERDICT_NORMS: Final = ("position", "position_median", "energy", "gyration")
"""Norms in which the page gives the time to reach an error."""

TARGETS: Final = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6)
"""Errors for which the page names the fastest setting of each method."""

_CAPTIONS: Final = {
    "workprecision": "Error over cost; lower and further left is better. Each point is one "
    "tolerance or step, a cross is a solve that failed, placed at the time it had taken.",
    "norms": "The same solves in every norm. Where single cells settle in another pocket the "
    "positions differ, while size, energy and pair distances may still be right.",
}
_EXTRA: Final = """
th.head { color:var(--quiet); font-size:.85rem; }
td.best { font-weight:700; color:var(--green); }
td.number small { display:block; color:var(--quiet); font-weight:400; }
tr.failed td { color:#b5432f; }
td.words { white-space:normal; min-width:16rem; font-size:.88rem; }
"""


def page(result: WorkPrecision, pictures: Sequence[Path]) -> str:
    """Return the page; the pictures have been written before.

    Raises
    ------
    OutputError
        If a picture cannot be read.
    """
    title = escape(f"{result.scene.title or 'Untitled scene'}: work and precision")
    facts = result.facts
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<title>{title}</title>
<style>{_CSS}{_EXTRA}</style>
</head>
<body>
<header><div><h1>{title}</h1><p>{escape(_subtitle(result))}</p></div></header>
<main>
<div class="tiles">{"".join(_tiles(result))}</div>
{"".join(map(_picture, pictures))}
{_verdict(result)}
{_failures(result)}
<div class="columns">{_uncertainty(result)}{_orders(result)}
{_table("Versions", facts["versions"])}</div>
{_points(result)}
{_settings(result.scene)}
<footer>multicell {escape(package_version())}</footer>
</main>
</body>
</html>
"""


def _subtitle(result: WorkPrecision) -> str:
    facts = result.facts
    if result.stepwise:
        compared = f"{facts['mode']}, each from the same recorded state for every method"
    else:
        compared = (
            f"{facts['coupling_steps']:,} common times, events at "
            f"{facts['steps_with_events']:,} of them"
        )
    return f"{compared} · reference: {facts['reference']} · threads: {facts['threads']}"


def _tiles(result: WorkPrecision) -> Iterator[str]:
    facts = result.facts
    first, last = facts["cells"]
    entries = {
        "cells": f"{last:,}" if first == last else f"{first:,} → {last:,}",
        "simulated time": time_unit(facts["time"]).text(facts["time"]),
        "methods": f"{len(result.methods)}",
        "solves that failed": f"{len(result.failures())} of {len(result.table)}",
        "largest decay rate × time": f"{facts['largest_decay_rate'] * facts['time']:,.0f}",
        "uncertainty of positions": f"{result.uncertainty['position']:.1e}",
    }
    for name, value in entries.items():
        yield f'<div class="tile"><b>{escape(value)}</b><span>{escape(name)}</span></div>'


def _picture(path: Path) -> str:
    with words("read", path):
        data = base64.b64encode(path.read_bytes()).decode("ascii")
    caption = escape(_CAPTIONS[path.stem])
    return (
        f'<section><figure><img alt="{caption}" src="data:image/png;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure></section>\n"
    )


def _verdict(result: WorkPrecision) -> str:
    """Return a card: for each method the least wall time that reaches an error."""
    tables = "".join(
        f"<h3>{escape(result.norms[norm])}</h3>{_times(result, norm)}" for norm in VERDICT_NORMS
    )
    return (
        f"<section><h2>Time to reach an error</h2><p class='note'>Judged by "
        f"{CLOCKS[result.clock]}. The uncertainty of the "
        "reference is added to each error. Only measured points count, with the tolerance or "
        f"step below the time; the fastest of each column is bold.</p>{tables}</section>"
    )


def _times(result: WorkPrecision, norm: str) -> str:
    """Return the table of one norm."""
    reached = {target: result.within(target, norm) for target in TARGETS}
    head = "".join(f'<td class="number">{target:.4g}</td>' for target in TARGETS)
    rows = []
    for method in result.methods:
        cells = []
        for target in TARGETS:
            row = reached[target].get(method)
            best = method == next(iter(reached[target]), None)
            text = (
                "—" if row is None else f"{clock(row[result.clock])}<small>{_set_to(row)}</small>"
            )
            cells.append(f'<td class="number{" best" if best else ""}">{text}</td>')
        rows.append(f"<tr><th>{escape(method)}</th>{''.join(cells)}</tr>")
    return (
        f'<div class="scroll"><table><tr><th class="head">error at most</th>{head}</tr>'
        f"{''.join(rows)}</table></div>"
    )


def _failures(result: WorkPrecision) -> str:
    """Return a card with the words of every failure."""
    if not result.failures():
        return ""
    rows = "".join(
        f"<tr><th>{escape(row['method'])}</th><td class='number'>{_set_to(row)}</td>"
        f"<td class='words'>{escape(row['words'])}</td></tr>"
        for row in result.failures()
    )
    return (
        "<section><h2>Solves that failed</h2>"
        f'<div class="scroll"><table>{rows}</table></div></section>'
    )


def _uncertainty(result: WorkPrecision) -> str:
    rows = {result.norms[norm]: f"{value:.2e}" for norm, value in result.uncertainty.items()}
    return _table("Uncertainty of the reference", rows)


def _orders(result: WorkPrecision) -> str:
    """Return a card with the measured order of the methods with a fixed step."""
    fixed = dict.fromkeys(r["method"] for r in result.table if r["control"] == "step")
    orders = {method: result.order(method, finest=5) for method in fixed}
    known = {m: f"{order:.2f}" for m, order in orders.items() if math.isfinite(order)}
    return _table("Order on this scene (five finest steps)", known)


def _points(result: WorkPrecision) -> str:
    """Return a card with the whole table."""
    names = ["setting", "wall", "processor", "error", "cost", "evaluations", "linearisations"]
    names += ["J·v", "steps"]
    head = "".join(f'<td class="number">{escape(name)}</td>' for name in names)
    rows = "".join(map(_point, result.table))
    return (
        '<section><h2>All solves</h2><p class="note">Times in s; error of the positions; cost '
        "in evaluations, where a linearisation counts 2 and a product J·v 0.65.</p>"
        f'<div class="scroll"><table><tr><th class="head">method</th>{head}</tr>{rows}</table>'
        "</div></section>"
    )


def _point(row: Row) -> str:
    values = [
        f"{row['wall']:.3g}",
        f"{row['cpu']:.3g}",
        f"{row['error_position']:.2e}",
        *(
            f"{row[name]:,.0f}"
            for name in ("cost", "evaluations", "linearisations", "jacobian_products", "steps")
        ),
    ]
    if row["status"] != "done":
        values = [row["status"], *[""] * 7]
    cells = "".join(f'<td class="number">{escape(value)}</td>' for value in values)
    kind = ' class="failed"' if row["status"] == "failed" else ""
    return (
        f"<tr{kind}><th>{escape(row['method'])}</th>"
        f'<td class="number">{_set_to(row)}</td>{cells}</tr>'
    )


def _set_to(row: Row) -> str:
    """Return the setting of a row in words."""
    unit = " s" if row["control"] == "step" else ""
    return f"{row['setting']:.2g}{unit}"
