"""The stability map of field solvers: kinds of end over steps and strength of uptake."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullFormatter

from multicell.comparison.field_solvers.measure import (
    KINDS,
    NEGATIVE,
    NO_CONVERGENCE,
    NOT_FINITE,
    OFF,
    RAISES,
    RIGHT,
    RUNS_AWAY,
    TOO_SLOW,
)
from multicell.comparison.field_solvers.solvers import SOLVERS
from multicell.report.plots.style import INK, blank, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multicell.comparison.field_solvers.result import FieldComparison
    from multicell.comparison.files import Row

COLOURS: Final = {
    RIGHT: "#cfe8dc",
    OFF: "#f3d27a",
    NEGATIVE: "#e69f00",
    RUNS_AWAY: "#c2452d",
    NOT_FINITE: "#7a1009",
    NO_CONVERGENCE: "#56789c",
    RAISES: "#1b2a49",
    TOO_SLOW: "#9aa0a6",
}
"""Kind of end -> its colour."""

_COLUMNS, _WIDE, _HIGH = 5, 1.85, 1.7  # panels in a row, inches of a panel


@styled
def stability_map(result: FieldComparison) -> Figure:
    """Draw one panel for each solver, coloured by what happens."""
    first = result.failures[0]
    names = list(dict.fromkeys(row["solver"] for row in result.failures))
    groups = [
        [n for n in names if _rows(result, n)[0]["control"] == control]
        for control in ("step", "tolerance")
    ]
    lines = [group[k : k + _COLUMNS] for group in groups for k in range(0, len(group), _COLUMNS)]
    wide = max(0.85 + max(map(len, lines)) * (_WIDE + 0.28), 10.0)
    tall = 1.0 + len(lines) * (_HIGH + 0.95) + 0.85
    where = f"{first['nodes']:,} {first['geometry']} of {first['spacing']:.3g} µm"
    figure = blank(
        result.scene.title or "Untitled scene",
        f"{first['field']}: where solvers fail in a transient · {where}", (wide, tall),
    )  # fmt: skip
    for row, line in enumerate(lines):
        for column, name in enumerate(line):
            left = 0.85 + column * (_WIDE + 0.28)
            base = tall - 1.0 - (row + 1) * (_HIGH + 0.95) + 0.65
            place = (left / wide, base / tall, _WIDE / wide, _HIGH / tall)
            axes = figure.add_axes(place, label=name)
            _map(axes, _rows(result, name), name)
            if column:
                axes.tick_params(labelleft=False)
            else:
                axes.set_ylabel("Thiele modulus", fontsize=10.5)
    _legend(figure, result)
    return figure


def _rows(result: FieldComparison, name: str) -> list[Row]:
    return [row for row in result.failures if row["solver"] == name]


def _map(axes: Axes, rows: Sequence[Row], name: str) -> None:
    """Draw the ends of one solver."""
    settings = sorted({row["setting"] for row in rows})
    moduli = sorted({row["thiele"] for row in rows})
    kinds = list(COLOURS)
    table = np.zeros((len(moduli), len(settings)))
    for row in rows:
        table[moduli.index(row["thiele"]), settings.index(row["setting"])] = kinds.index(
            row["kind"]
        )
    norm = BoundaryNorm(np.arange(len(kinds) + 1) - 0.5, len(kinds))
    axes.pcolormesh(
        _edges(settings), _edges(moduli), table, cmap=ListedColormap(list(COLOURS.values())),
        norm=norm, edgecolors="white", linewidth=0.6,
    )  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    stepping = rows[0]["control"] == "step"
    if stepping:
        limits = {row["thiele"]: row["limit"] * SOLVERS[name].stable for row in rows}
        axes.plot([limits[m] for m in moduli], moduli, color=INK, lw=1.6)
        axes.set_xlim(_edges(settings)[[0, -1]])
    else:
        axes.invert_xaxis()
    axes.set_xlabel("step / Euler's limit" if stepping else "tolerance / scale", fontsize=10)
    axes.set_title(name, fontsize=10.5, pad=4)
    axes.grid(visible=False)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(numticks=5))
        axis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelsize=9)


def _edges(values: Sequence[float]) -> Any:
    """Return where fields begin and end: midway between values on a logarithmic axis."""
    logs = np.log10(values)
    middles = 0.5 * (logs[1:] + logs[:-1])
    first, last = 2.0 * logs[0] - middles[0], 2.0 * logs[-1] - middles[-1]
    return 10.0 ** np.concatenate([[first], middles, [last]])


def _legend(figure: Figure, result: FieldComparison) -> None:
    seen = {row["kind"] for row in result.failures}
    handles: list[Any] = [
        Patch(color=colour, label=kind if kind != TOO_SLOW else _too_slow(result))
        for kind, colour in COLOURS.items()
        if kind in seen
    ]
    stepping = any(row["control"] == "step" and math.isfinite(row["limit"])
                   for row in result.failures)  # fmt: skip
    if stepping:
        handles.append(Line2D([], [], color=INK, lw=1.6, label="safe in theory up to here"))
    assert set(COLOURS) == set(KINDS)
    figure.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0.06, 0.01), ncols=5, fontsize=10,
        columnspacing=1.5, handlelength=1.4,
    )  # fmt: skip


def _too_slow(result: FieldComparison) -> str:
    return f"{TOO_SLOW} (over {result.facts['trial_patience']:.2g} s)"
