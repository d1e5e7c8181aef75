"""Every public name has its place in the reference: the build fails where one is missing."""

from collections.abc import Iterator
from inspect import getdoc

from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util import logging

import multicell
import multicell.testing


def public_names() -> Iterator[str]:
    """Yield the names that the reference must have."""
    for name in multicell.__all__:
        if name != "testing":
            yield f"multicell.{name}"
    for name in multicell.testing.__all__:
        if callable(getattr(multicell.testing, name)):
            yield f"multicell.testing.{name}"


def check(app: Sphinx, environment: BuildEnvironment) -> None:
    """Warn of each public name that no page describes, or that has no docstring."""
    log = logging.getLogger(__name__)
    described = environment.domains.python_domain.objects
    for name in public_names():
        module, _, last = name.rpartition(".")
        home = multicell.testing if module == "multicell.testing" else multicell
        if name not in described:
            log.warning("%s is on no page of docs/api", name)
        elif not getdoc(getattr(home, last)):
            log.warning("%s has no docstring", name)


def setup(app: Sphinx) -> dict[str, bool]:
    """Tell Sphinx when to do it."""
    app.connect("env-check-consistency", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
