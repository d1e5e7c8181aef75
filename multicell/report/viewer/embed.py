"""The view as parts of a page: data, scripts, and the policy that allows these scripts only."""

from __future__ import annotations

import base64
import hashlib
import json
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Final

from markupsafe import Markup

from multicell.report.viewer.pack import pack_frames

if TYPE_CHECKING:
    from multicell.report.result import Result

_SCRIPTS: Final = ("three.min.js", "viewer.js")


def view(result: Result) -> dict[str, Any] | None:
    """Return what ``viewer.html`` shows of a run, or None where there is nothing to see.

    ``about`` is the table of contents as JSON, ``data`` the columns of all frames as text,
    ``scripts`` are texts, ``policy`` their hashes as sources for the page's
    Content-Security-Policy, and ``note`` says what is left out.
    """
    contents = pack_frames(result)
    if contents is None:
        return None
    # within a script "<" must not begin a tag; in JSON it can be written otherwise
    about = json.dumps(contents.about, allow_nan=False).replace("<", "\\u003c")
    scripts = _scripts()
    hashes = (hashlib.sha256(text.encode()).digest() for text in scripts)
    return {
        "about": Markup(about),
        "data": contents.data,
        "scripts": [Markup(script) for script in scripts],
        "policy": " ".join(f"'sha256-{base64.b64encode(one).decode('ascii')}'" for one in hashes),
        "note": contents.note,
    }


@cache
def _scripts() -> tuple[str, ...]:
    """Return the texts of the scripts."""
    folder = files("multicell.report.viewer")
    return tuple((folder / name).read_text(encoding="utf-8") for name in _SCRIPTS)
