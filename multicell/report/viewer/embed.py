"""The view as parts of a page: data, scripts, and the policy that allows these scripts only."""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Final, final

from markupsafe import Markup

from multicell.report.viewer.pack import packed

if TYPE_CHECKING:
    from multicell.report.result import Result

_SCRIPTS: Final = ("three.min.js", "viewer.js")


@final
@dataclass(frozen=True)
class View:
    """What the template ``viewer.html`` needs.

    Attributes
    ----------
    about
        Table of contents, JSON.
    data
        Columns of all frames, as text.
    scripts
        Their texts.
    policy
        Sources of scripts for the page's Content-Security-Policy: these scripts, by their hashes.
    note
        What is left out.
    """

    about: Markup
    data: str
    scripts: tuple[Markup, ...]
    policy: str
    note: str


def view(result: Result) -> View | None:
    """Return the view of a run, or None where there is nothing to see."""
    contents = packed(result)
    if contents is None:
        return None
    # within a script "<" must not begin a tag; in JSON it can be written otherwise
    about = json.dumps(contents.about, allow_nan=False).replace("<", "\\u003c")
    scripts = _scripts()
    hashes = (hashlib.sha256(text.encode()).digest() for text in scripts)
    policy = " ".join(f"'sha256-{base64.b64encode(one).decode('ascii')}'" for one in hashes)
    return View(Markup(about), contents.data, tuple(map(Markup, scripts)), policy, contents.note)


@cache
def _scripts() -> tuple[str, ...]:
    """Return the texts of the scripts."""
    folder = files("multicell.report.viewer")
    return tuple((folder / name).read_text(encoding="utf-8") for name in _SCRIPTS)
