"""The page of indices of any kind: what those of Morris and Sobol' have in common."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from multicell.calibration.shared.wording import value_in_words
from multicell.report.html import Drawing, write_page
from multicell.studies.picture_data import key_words

if TYPE_CHECKING:
    from multicell.calibration.sensitivity.numbers import IndexTable
    from multicell.studies.axes import Range


def write_indices(
    result: IndexTable,
    folder: Path,
    template: str,
    kind: str,
    points: int,
    tiles: Mapping[str, str],
    drawings: Mapping[str, Drawing],
) -> Path:
    """Write ``report.html`` and its pictures, and return the page.

    - ``template``, ``kind``: of the page, and of the analysis in words
    - ``points``: how many points were run; ``tiles``: more numbers at the top
    - ``drawings``: observable -> its picture
    """
    names = ", ".join(key_words(free.key, free.name) for free in result.ranges)
    failed = {"runs that failed": f"{len(result.failures):,}"} if result.failures else {}
    return write_page(
        folder / "report.html",
        template,
        scene=result.scene,
        title=sensitivity_title(result),
        subtitle=f"{kind} · {names}",
        tiles={
            "free parameters": f"{len(result.ranges)}",
            "points": f"{points:,}",
            "seeds": f"{len(result.seeds)}",
            **failed,
            **tiles,
        },
        pictures={
            f"sensitivity-{name.replace('.', '_')}.png": drawing
            for name, drawing in drawings.items()
        },
        result=result,
        ends={free.key: _ends(free) for free in result.ranges},
    )


def sensitivity_title(result: IndexTable) -> str:
    """Return the title of pages and pictures."""
    return f"{result.scene.title or 'Untitled scene'}: sensitivity"


def _ends(free: Range) -> tuple[str, str]:
    """Return both ends of a range in words; long times in minutes, hours or days."""
    log = ", by ratio" if free.log else ""
    return value_in_words(free.low, free.unit), value_in_words(free.high, free.unit) + log
