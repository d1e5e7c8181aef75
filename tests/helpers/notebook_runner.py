"""Runs the code of a notebook as a plain program, in an environment that lacks other packages.

``python notebook_runner.py BOOK.ipynb`` runs its cells in the current folder: lines ``!command`` by
the shell, those of ``multicell`` alone in this process, ``%%writefile`` as writing, the last
expression of a cell as a display.
:func:`environment` has the variables of processes in which only the packages of a requirement can
be imported.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import multicell

PACKAGE = Path(multicell.__file__).parents[1]
"""Where the package is that tests import; for that of another folder all would be compiled anew."""


def environment(asked: list[str], folder: Path) -> dict[str, str]:
    """Return variables for processes with packages of requirements only; writes to a folder."""
    import requirements  # beside the documentation's extensions; processes have no need of it

    folder.mkdir()
    for name, words in {"multicell": "-m multicell", "python": ""}.items():
        program = folder / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" {words} "$@"\n', "utf-8")
        program.chmod(0o755)
    found = requirements.variables(folder, requirements.refused(asked))
    return {
        **os.environ,
        **found,
        "PYTHONPATH": os.pathsep.join([found["PYTHONPATH"], str(PACKAGE)]),
        "PATH": os.pathsep.join([str(folder), os.environ["PATH"]]),
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
