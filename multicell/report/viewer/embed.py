"""The view as parts of a page: data, scripts, and the policy that allows these scripts only."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from markupsafe import Markup

from multicell.errors import OutputError
from multicell.report.viewer.pack import MAX_BYTES, MAX_CELLS, pack_frames

if TYPE_CHECKING:
    from multicell.report.result import Result
    from multicell.report.tables import Frames

_SCRIPTS: Final = ("three.min.js", "viewer.js")
_PAGE_CELLS: Final = 100_000
_PAGE_BYTES: Final = 17_500_000
"""Limits of :func:`pack_frames` for a page of its own, which then has less than 25 MB."""


def view(
    result: Result, *, max_cells: int = MAX_CELLS, max_bytes: int = MAX_BYTES
) -> dict[str, Any] | None:
    """Return what ``viewer.html`` shows of a run, or None where there is nothing to see.

    ``about`` is the table of contents as JSON, ``data`` the columns of all frames as text,
    ``scripts`` are texts, ``policy`` their hashes as sources for the page's
    Content-Security-Policy, and ``note`` says what is left out.
    """
    contents = pack_frames(result, max_cells=max_cells, max_bytes=max_bytes)
    if contents is None:
        return None
    # within a script "<" must not begin a tag; in JSON it can be written otherwise
    about = json.dumps(contents.about, allow_nan=False).replace("<", "\\u003c")
    folder = files("multicell.report.viewer")
    scripts = [(folder / name).read_text(encoding="utf-8") for name in _SCRIPTS]
    hashes = (hashlib.sha256(text.encode()).digest() for text in scripts)
    return {
        "about": Markup(about),
        "data": contents.data,
        "scripts": [Markup(script) for script in scripts],
        "policy": " ".join(f"'sha256-{base64.b64encode(one).decode('ascii')}'" for one in hashes),
        "note": contents.note,
    }


def view_page(result: Result, **limits: int) -> str | None:
    """Return a page of its own with the view, or None where there is nothing to see.

    - ``limits``: as for :func:`view`
    """
    from multicell.report.html import rendered

    found = view(result, **limits)
    if found is None:
        return None
    title = result.scene.title or "Untitled run"
    return rendered("view.html", title=title, subtitle="", tiles={}, scene="", viewer=found)


def write(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write the view of all frames as one page and return its name."""
    page = view_page(run, max_cells=_PAGE_CELLS, max_bytes=_PAGE_BYTES)
    if page is None:
        raise OutputError("no frame of the run has cells: there is nothing to show")
    (folder / "view.html").write_text(page, encoding="utf-8")
    return ["view.html"]
