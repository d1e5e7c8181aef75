"""Pages load nothing from other servers: the build fails where one would.

Links that a reader follows may lead anywhere; what a browser loads by itself may not.
"""

import re
from html.parser import HTMLParser
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

LOADED = {
    "audio": "src", "embed": "src", "iframe": "src", "img": "src", "input": "src", "link": "href",
    "object": "data", "script": "src", "source": "src", "track": "src", "video": "src",
}  # fmt: skip
"""The attribute that names what a browser loads, by element."""
NOT_LOADED = {"alternate", "author", "canonical", "help", "license", "next", "prev", "search"}
"""Relations of a ``<link>`` that name a page and load nothing."""
_ELSEWHERE = re.compile(r"^\s*(https?:)?//", re.IGNORECASE)
_IN_STYLE = re.compile(r"""(?:url\(|@import)\s*['"]?\s*((?:https?:)?//[^'")\s]+)""", re.IGNORECASE)


class Loads(HTMLParser):
    """Collects addresses of other servers that a page loads from."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.style = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """See what an element loads."""
        self.style = tag == "style"
        given = {name: value or "" for name, value in attrs}
        relations = set(given.get("rel", "").lower().split())
        if tag == "link" and relations and relations <= NOT_LOADED:
            return
        for name in (LOADED.get(tag, ""), "poster"):
            if _ELSEWHERE.match(given.get(name, "")):
                self.found.append(given[name])
        self.found += [
            part.split()[0] for part in given.get("srcset", "").split(",") if _ELSEWHERE.match(part)
        ]
        self.found += _IN_STYLE.findall(given.get("style", ""))

    def handle_endtag(self, tag: str) -> None:
        """Leave a style sheet."""
        self.style = self.style and tag != "style"

    def handle_data(self, data: str) -> None:
        """See what a style sheet loads."""
        if self.style:
            self.found += _IN_STYLE.findall(data)


def loads_of(page: str) -> list[str]:
    """Return the addresses on other servers that the HTML of a page has a browser load."""
    parser = Loads()
    parser.feed(page)
    parser.close()
    return parser.found


def check(app: Sphinx, error: Exception | None) -> None:
    """Warn of each page or style sheet that loads from another server."""
    if error is not None or app.builder.format != "html":
        return
    top = Path(app.outdir)
    found = [(file, loads_of(file.read_text("utf-8"))) for file in sorted(top.rglob("*.html"))]
    for file in sorted(top.rglob("*.css")):
        found.append((file, _IN_STYLE.findall(file.read_text("utf-8"))))
    for file, addresses in found:
        for address in addresses:
            place = file.relative_to(top)
            logging.getLogger(__name__).warning("%s loads %s from a network", place, address)


def setup(app: Sphinx) -> dict[str, bool]:
    """Tell Sphinx when to do it."""
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
