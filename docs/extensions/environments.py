"""Environments of executed tutorials: kernels import what the page tells readers to install.

A build has the packages of all pages. Each tutorial names the environment that its notebook needs
(:mod:`notebooks`); its kernel, and every process that its cells start, find no other package, but
for those that make up the kernel. A tutorial that needs more than it names fails the build.
"""

import os
import tempfile
from pathlib import Path

from notebooks import environment, tutorials
from requirements import REFUSED, refused, variables
from sphinx.application import Sphinx

KERNEL = "myst-nb"
"""Brings kernels and what puts pictures elsewhere on a page; no code of readers uses it."""


def asked(page: Path) -> list[str]:
    """Return the requirements of a page, as ``pip install`` is given them."""
    return environment(page).replace('"', "").split()


class Environments:
    """Modules that are refused to kernels, by page."""

    def __init__(self, app: Sphinx) -> None:
        self.folder = tempfile.TemporaryDirectory(prefix="pages-", ignore_cleanup_errors=True)
        self.refused = {
            f"tutorials/{page.stem}": refused([*asked(page), KERNEL])
            for page in tutorials(Path(app.srcdir))
        }
        os.environ.update(variables(Path(self.folder.name), set()))
        app.connect("source-read", self.choose)
        app.connect("build-finished", lambda *_: self.folder.cleanup())

    def choose(self, _app: Sphinx, name: str, _source: list[str]) -> None:
        """Choose for the page that is read, and executed, next."""
        os.environ[REFUSED] = ",".join(sorted(self.refused.get(name, set())))


def setup(app: Sphinx) -> dict[str, bool]:
    """Tell Sphinx when to do it."""
    app.connect("builder-inited", Environments)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
