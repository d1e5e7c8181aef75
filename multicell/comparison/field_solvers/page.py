"""Contents of the page of a comparison of field solvers, and its report for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from multicell.comparison.field_solvers.charts import COLOURS, state
from multicell.comparison.field_solvers.measure import KINDS
from multicell.comparison.files import CLOCKS, FAILED

if TYPE_CHECKING:
    from multicell.comparison.field_solvers.result import FieldComparison
    from multicell.comparison.files import Row

TARGETS: Final = (1e-2, 1e-3)
"""Errors for which the report names the cheapest solver."""

CAPTIONS: Final = {
    "field-solvers.png": "Error of the solver over cost, against the same equation on the same "
    "grid; lower and further left is better. Each point is one tolerance, step or length of the "
    "march to rest, and errors below 1e-9 are drawn there; crosses are solves that failed, at the "
    "time they had taken. Below the dotted line the grid itself is the larger error.",
    "field-spacings.png": "Error of grid and solver together along the ladder of spacings: the "
    "cheapest solve of ours and of py-pde's whose own error is below half of the grid's.",
    "field-stability.png": "How a transient ends, over the step (or the tolerance) and the "
    "strength of uptake. Steps are relative to the largest stable one of explicit Euler without "
    "uptake; of implicit solvers of py-pde's the line is where their iterations stop converging.",
}


def context(result: FieldComparison) -> dict[str, Any]:
    """Return what ``fields.html`` asks for."""
    facts = result.facts
    return {
        "title": f"{result.title}: solvers of fields",
        "subtitle": f"{state(facts)} · {facts['backend_words']}",
        "tiles": {
            "fields": ", ".join(result.fields),
            "solvers": f"{len(result.solvers)}",
            "solves": f"{len(result.table):,}",
            "solves that failed": f"{sum(r['status'] == FAILED for r in result.table)}",
        },
        "cheapest": verdicts(result),
        "targets": [f"{100.0 * target:g} %" for target in TARGETS],
        "kinds": KINDS,
        "colours": COLOURS,
        "failed": result.failed(),
        "judge": CLOCKS[result.clock],
    }


def verdicts(result: FieldComparison) -> list[dict[str, Any]]:
    """Return for each problem on each grid the cheapest solve of each target, and py-pde's."""
    problems = dict.fromkeys(
        (r["field"], r["problem"], r["geometry"], r["spacing"]) for r in result.table
    )
    found = []
    for field, problem, geometry, spacing in problems:
        where = {"field": field, "problem": problem, "geometry": geometry, "spacing": spacing}
        rows = result.rows(**where)
        best = [result.cheapest(target, **where) for target in TARGETS]
        found.append(
            {
                **where, "nodes": rows[0]["nodes"], "space_error": rows[0]["space_error"],
                "uncertainty": rows[0]["uncertainty"], "best": [_said(row, result) for row in best],
            }
        )  # fmt: skip
    return found


def _said(row: Row | None, result: FieldComparison) -> str:
    if row is None:
        return "none"
    turned = "" if row["control"] == "once" else f" ({row['control']} {row['setting']:.2g})"
    return f"{row['solver']}{turned}, {1e3 * row[result.clock]:.3g} ms"


def report(result: FieldComparison) -> str:
    """Return the report for the terminal."""
    lines = []
    for verdict in verdicts(result):
        head = f"{verdict['field']}, {verdict['problem']}, {verdict['geometry']}"
        lines.append(f"{head} of {verdict['spacing']:.3g} µm ({verdict['nodes']:,} nodes)")
        for target, said in zip(TARGETS, verdict["best"], strict=True):
            lines.append(f"  within {100.0 * target:g} %: {said}")
        lines.append(f"  the grid itself: {100.0 * verdict['space_error']:.2g} %")
    failed = result.failed()
    if failed:
        kinds: dict[str, set[str]] = {}
        for row in failed:
            kinds.setdefault(row["kind"], set()).add(row["solver"])
        lines.append(f"{len(failed)} of {len(result.table)} solves failed:")
        lines += [f"  {kind}: {', '.join(sorted(names))}" for kind, names in kinds.items()]
    lines += [f"Note: {note}" for note in result.facts["notes"]]
    lines.append(f"{CLOCKS[result.clock]}; rates for py-pde's solvers: "
                 f"{result.facts['backend_words']}")  # fmt: skip
    return "\n".join(lines)
