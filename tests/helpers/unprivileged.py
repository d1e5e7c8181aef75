"""Another user's view: folders of root's in which nobody else may read some files.

Root may read everything, so what is tested gives up its rights, in a process of its own. All that
it needs is loaded before: the installation may be where only its user can read it.
"""

import json
import os
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

import multicell as mc

only_root = pytest.mark.skipif(
    getattr(os, "geteuid", lambda: 1)() != 0, reason="only root is two users"
)
NOBODY = 65534


@contextmanager
def open_folder():
    """Yield a folder that all users may write to; that of a test is its user's alone."""
    place = Path(tempfile.mkdtemp(prefix="multicell-open-"))
    place.chmod(0o777)
    try:
        yield place
    finally:
        shutil.rmtree(place)


def give_away(folder):
    """Let all users write in a folder and to the files in it."""
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o777 if path.is_dir() else 0o666)


def become_nobody():
    """Give up all rights of root in this process."""
    os.setgroups([])
    os.setgid(NOBODY)
    os.setuid(NOBODY)


def content(folder):
    """Return the bytes of all files in a folder, by path."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def carry_out(folder, copy, retry):
    """Run a study as nobody, and print its outcomes; ``copy`` is one that is run by root before."""
    mc.load_study(copy).run(cores=1, retry=True)
    mc.load_study(copy).to_xarray()
    become_nobody()
    study = mc.load_study(folder)
    states = [(state.state, state.kind) for state in study.status()]
    outcomes = study.run(cores=1, retry=retry)
    table = study.to_xarray()
    found = {
        "states": states,
        "outcomes": [(outcome.state, outcome.reason) for outcome in outcomes],
        "table": table["state"].values.ravel().tolist(),
    }
    print(json.dumps(found))
