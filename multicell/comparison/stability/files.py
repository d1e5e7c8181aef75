"""The page of a study of stability: one HTML file that holds its pictures."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Final

from multicell.comparison.stability.charts import COLOURS
from multicell.comparison.stability.trial import KINDS, STABLE
from multicell.report.page import _CSS, _POLICY, _settings, _table, clock
from multicell.results.folder import package_version, words

if TYPE_CHECKING:
    from multicell.comparison.measure import Row
    from multicell.comparison.stability.result import StabilityMap


_CAPTIONS: Final = {
    "stability": "What happens at each step or tolerance. Each dot is one trial; a bar is the "
    "limit in theory.",
    "sweeps": "The largest stable step as one parameter changes. Lines are the theory, from the "
    "largest decay rate of each state.",
}
_EXTRA: Final = """
th.head { color:var(--quiet); font-size:.85rem; }
td.words { white-space:normal; min-width:14rem; font-size:.88rem; }
.kind { display:inline-block; width:.8rem; height:.8rem; margin-right:.45rem; border-radius:3px;
  vertical-align:-.05rem; border:1px solid rgb(0 0 0 / .15); }
"""
_HEADS: Final = ("largest stable", "fails at", "theory", "of theory", "of Euler's limit")


def page(result: StabilityMap, pictures: Sequence[Path]) -> str:
    """Return the page; the pictures have been written before.

    Raises
    ------
    OutputError
        If a picture cannot be read.
    """
    title = escape(f"{result.scene.title or 'Untitled scene'}: stability")
    sweeps = "".join(_sweep(result, sweep) for sweep in result.sweeps())
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
<header><div><h1>{title}</h1><p>The cells settle, are pushed a little along their stiffest mode,
and must come to rest again.</p></div></header>
<main>
<div class="tiles">{"".join(_tiles(result))}</div>
{_picture(pictures[0])}
{_limits(result)}
{_legend(result)}
{"".join(map(_picture, pictures[1:]))}
{sweeps}
{_trials(result)}
<div class="columns">{_table("Points that could not be settled", result.facts["skipped"])}
{_table("Versions", result.facts["versions"])}</div>
{_settings(result.scene)}
<footer>multicell {escape(package_version())}</footer>
</main>
</body>
</html>
"""


def _tiles(result: StabilityMap) -> Iterator[str]:
    first = result.table[0]
    failed = sum(row["kind"] != STABLE for row in result.table)
    entries = {
        "cells": f"{first['cells']:,}",
        "largest decay rate λmax": f"{first['rate']:.3g}/s",
        "Euler's limit 2/λmax": f"{2.0 / first['rate']:.3g} s",
        "methods": f"{len(result.methods)}",
        "trials that failed": f"{failed} of {len(result.table):,}",
        "wall time": clock(result.facts["wall"]),
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


def _limits(result: StabilityMap) -> str:
    """Return a card with the limit of each method at the scene itself."""
    precision = 100.0 * result.facts["precision"]
    return (
        f'<section><h2>Limits</h2><p class="note">Found by bisection, to {precision:.2g} %. Of a '
        "method under error control the loosest tolerance in mean radii is given, and its mean "
        f"step there over Euler's limit.</p>{_limit_table(result.limits())}</section>"
    )


def _sweep(result: StabilityMap, sweep: str) -> str:
    """Return a card with the limits along one sweep."""
    return f"<section><h2>{escape(sweep)}</h2>{_limit_table(result.limits(sweep), True)}</section>"


def _limit_table(limits: Sequence[Row], valued: bool = False) -> str:
    names = (*(("value",) if valued else ()), *_HEADS)
    head = "".join(f'<td class="number">{escape(name)}</td>' for name in names)
    rows = "".join(_limit_row(row, valued) for row in limits)
    return (
        f'<div class="scroll"><table><tr><th class="head">method</th>{head}<td>how</td></tr>'
        f"{rows}</table></div>"
    )


def _limit_row(row: Row, valued: bool) -> str:
    unit = _unit(row)
    values = [
        *([f"{row['value']:.4g}"] if valued else []),
        _number(row["limit"], unit, "none"),
        _number(row["beyond"], unit),
        _number(row["theory"], " s") if row["control"] == "step" else "",
        _number(row["of_theory"]) if math.isfinite(row["theory"]) else "",
        _number(row["of_euler"]),
    ]
    cells = "".join(f'<td class="number">{escape(value)}</td>' for value in values)
    kinds = [kind for kind in row["kinds"].split("; ") if kind]
    how = ", ".join(_swatch(kind) for kind in kinds) or "never"
    return f"<tr><th>{escape(row['method'])}</th>{cells}<td>{how}</td></tr>"


def _legend(result: StabilityMap) -> str:
    """Return a card that says what the kinds mean."""
    rows = "".join(
        f'<tr><th>{_swatch(kind)}</th><td class="words">{escape(KINDS[kind])}</td></tr>'
        for kind in KINDS
    )
    return f'<section><h2>How methods fail</h2><div class="scroll"><table>{rows}</table></div>' + (
        '<p class="note">Where several apply the first in this order counts: blow-up or stall, '
        "cells passing through each other, alternating displacements, a lost bond, the others. "
        "After a division another pocket of no higher energy than that of the reference is right."
        "</p></section>"
    )


def _trials(result: StabilityMap) -> str:
    """Return a card with all trials at the scene itself that failed."""
    rows = "".join(
        _trial(row)
        for method in result.methods
        for row in result.rows(method)
        if row["kind"] != STABLE
    )
    if not rows:
        return ""
    return (
        "<section><h2>Trials that failed</h2>"
        f'<div class="scroll"><table>{rows}</table></div></section>'
    )


def _trial(row: Row) -> str:
    also = f" (also: {row['also']})" if row["also"] else ""
    return (
        f"<tr><th>{escape(row['method'])}</th>"
        f'<td class="number">{_number(row["setting"], _unit(row))}</td>'
        f'<td>{_swatch(row["kind"])}</td><td class="words">{escape(row["words"] + also)}</td></tr>'
    )


def _unit(row: Row) -> str:
    return " s" if row["control"] == "step" else ""


def _swatch(kind: str) -> str:
    return f'<span class="kind" style="background:{COLOURS[kind]}"></span>{escape(kind)}'


def _number(value: float, unit: str = "", missing: str = "") -> str:
    if math.isnan(value):
        return missing
    return "no limit" if math.isinf(value) else f"{value:.3g}{unit}"
