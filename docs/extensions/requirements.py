"""Packages that a requirement brings, and processes that find no others.

Tests use it too, where there is no Sphinx.
"""

import functools
import importlib.metadata
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
REFUSED = "REFUSED_MODULES"
FILTER = f'''
import os
import sys

REFUSED = frozenset(os.environ.get("{REFUSED}", "").split(","))


class Filtered:
    """A finder of modules that does not find some."""

    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in REFUSED:
            return None
        return self.finder.find_spec(name, path, target)

    def __getattr__(self, name):
        return getattr(self.finder, name)


sys.meta_path[:] = [Filtered(finder) for finder in sys.meta_path]
'''


def needed(requirements: list[str]) -> set[str]:
    """Return names of distributions that requirements bring, with what those need in turn.

    ``.[extra]`` stands for this package, whose lists are in ``pyproject.toml``.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    found: set[tuple[str, str]] = set()
    waiting = [Requirement(text.replace(".[", "multicell[")) for text in requirements]
    while waiting:
        one = waiting.pop()
        name = canonicalize_name(one.name)
        for extra in {"", *one.extras}:
            if (name, extra) in found:
                continue
            found.add((name, extra))
            if name == "multicell":
                lines = (
                    project["optional-dependencies"][extra] if extra else project["dependencies"]
                )
            else:
                lines = _requires(name)
            for line in map(Requirement, lines):
                if line.marker is None or line.marker.evaluate({"extra": extra}):
                    waiting.append(line)
    return {name for name, _ in found}


def _requires(name: str) -> list[str]:
    try:
        return importlib.metadata.requires(name) or []
    except importlib.metadata.PackageNotFoundError:
        return []


def refused(requirements: list[str]) -> set[str]:
    """Return modules of this environment that requirements do not bring."""
    brought = needed(requirements)
    return {
        module
        for module, homes in _homes().items()
        if not {canonicalize_name(home) for home in homes} & brought
    } - {"multicell"}


@functools.cache
def _homes() -> Mapping[str, list[str]]:
    """Return the distributions that each module comes with."""
    return importlib.metadata.packages_distributions()


def variables(folder: Path, modules: set[str]) -> dict[str, str]:
    """Return variables of processes that cannot import some modules; write to a folder."""
    (folder / "sitecustomize.py").write_text(FILTER, "utf-8")
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {"PYTHONPATH": os.pathsep.join(paths), REFUSED: ",".join(sorted(modules))}
