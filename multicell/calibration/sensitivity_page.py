"""The page of an analysis of sensitivity."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from multicell.calibration.indices import CLEAR, CLEAR_SINGLE, block
from multicell.calibration.verdict import in_words
from multicell.report.html import Drawing, write_page
from multicell.studies.pictures.values import key_words, sentence, words

if TYPE_CHECKING:
    from multicell.calibration.sensitivity_result import Sensitivity
    from multicell.studies.axes import Range


def write_report(result: Sensitivity, folder: Path) -> Path:
    """Write ``report.html`` and its pictures, and return the page."""
    pictures: dict[str, Drawing] = {}
    index, first = "parts of the variance", "st"
    if result.method == "morris":
        index, first = "size of effects", "mu_star"
    for name in result.observables:
        if any(row[first] > 0.0 for row in result.ordered(name)):  # else a note says why
            caption = (
                f"{sentence(words(name))}: {index} at the end of the runs, with 95 % intervals; "
                "pale is what is not distinguishable from noise or zero."
            )
            path = f"sensitivity-{name.replace('.', '_')}.png"
            pictures[path] = partial(result.plot, name), caption
    return write_page(
        folder / "report.html",
        "sensitivity.html",
        scene=result.scene,
        title=f"{result.scene.title or 'Untitled scene'}: sensitivity",
        subtitle=_subtitle(result),
        tiles=_tiles(result),
        pictures=pictures,
        result=result,
        ends={free.key: _ends(free) for free in result.ranges},
    )


def _ends(free: Range) -> tuple[str, str]:
    """Return both ends of a range in words; long times in minutes, hours or days."""
    log = ", by ratio" if free.log else ""
    return in_words(free.low, free.unit), in_words(free.high, free.unit) + log


def _subtitle(result: Sensitivity) -> str:
    method = "Screening by Morris" if result.method == "morris" else "Indices of Sobol'"
    names = ", ".join(key_words(free.key, free.name) for free in result.ranges)
    return f"{method} · {names}"


def _tiles(result: Sensitivity) -> dict[str, str]:
    points = result.size * block(result.method, len(result.ranges))
    failed = sum(bool(row["reason"]) for row in result.runs)
    tiles = {
        "free parameters": f"{len(result.ranges)}",
        "trajectories" if result.method == "morris" else "base points": f"{result.size:,}",
        "points": f"{points:,}",
        "seeds": f"{len(result.seeds)}",
    }
    if result.runs:
        tiles["runs"] = f"{len(result.runs):,}"
    if failed:
        tiles["runs that failed"] = f"{failed:,}"
    for name in result.observables[:3]:
        first = result.ordered(name)[0]
        if first["verdict"] in (CLEAR, CLEAR_SINGLE):
            tiles[f"decides {words(name)} most"] = key_words(first["key"], first["parameter"])
    return tiles
