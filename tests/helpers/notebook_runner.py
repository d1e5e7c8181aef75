"""Runs the code of a notebook as a plain program, in an environment that lacks other packages.

``python notebook_runner.py BOOK.ipynb`` runs its cells in the current folder: lines ``!command`` by
the shell, those of ``multicell`` alone in this process, ``%%writefile`` as writing, the last
expression of a cell as a display.
:func:`environment` has the variables of processes in which only the packages of a requirement can
be imported.
"""

from __future__ import annotations

import ast
import importlib.metadata
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import multicell

ROOT = Path(__file__).parents[2]
PACKAGE = Path(multicell.__file__).parents[1]
"""Where the package is that tests import; for that of another folder all would be compiled anew."""
BLOCK = '''
import os
import sys

REFUSED = frozenset(os.environ["REFUSED_MODULES"].split(","))


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


def needed(asked: list[str]) -> set[str]:
    """Return names of distributions that requirements bring, with what those need in turn.

    ``.[extra]`` stands for this package, whose lists are in ``pyproject.toml``.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    found: set[tuple[str, str]] = set()
    waiting = [Requirement(text.replace(".[", "multicell[")) for text in asked]
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


def refused(asked: list[str]) -> set[str]:
    """Return modules of this environment that requirements do not bring."""
    brought = needed(asked)
    return {
        module
        for module, homes in importlib.metadata.packages_distributions().items()
        if not {canonicalize_name(home) for home in homes} & brought
    } - {"multicell"}


def environment(asked: list[str], folder: Path) -> dict[str, str]:
    """Return variables for processes with packages of requirements only; writes to a folder."""
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(BLOCK, "utf-8")
    command = folder / "multicell"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m multicell "$@"\n', "utf-8")
    python = folder / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n', "utf-8")
    for program in (command, python):
        program.chmod(0o755)
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(folder), str(PACKAGE)]),
        "PATH": os.pathsep.join([str(folder), os.environ["PATH"]]),
        "REFUSED_MODULES": ",".join(sorted(refused(asked))),
        "MPLBACKEND": "agg",
    }


def run_cell(text: str, names: dict[str, object]) -> None:
    """Run one cell; print what a notebook would show.

    Raises
    ------
    subprocess.CalledProcessError
        If a line ``!command`` ends with an exit code other than 0.
    """
    if found := re.match(r"%%writefile (\S+)\n", text):
        Path(found[1]).write_text(text[found.end() :] + "\n", "utf-8")
        return
    names["shell_line"] = _shell_line
    text = re.sub(r"(?m)^( *)!(.+)$", lambda f: f"{f[1]}shell_line({f[2]!r})", text)
    tree = ast.parse(text)
    shown = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    if shown is not None:
        value = eval(compile(ast.Expression(shown.value), "cell", "eval"), names)
        if value is not None:
            print(repr(value))


def _shell_line(command: str) -> None:
    sys.stdout.flush()
    if not command.startswith("multicell ") or set("|;&<>$") & set(command):
        subprocess.run(command, shell=True, check=True)
        return
    from multicell.cli.main import main

    try:
        main(shlex.split(command)[1:])
    except SystemExit as end:
        if end.code:
            raise subprocess.CalledProcessError(int(end.code), command) from end


if __name__ == "__main__":
    sys.path.insert(0, "")  # modules that cells write
    book = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    spaces: dict[str, object] = {"__name__": "__main__"}
    for cell in book["cells"]:
        if cell["cell_type"] == "code":
            run_cell("".join(cell["source"]), spaces)
