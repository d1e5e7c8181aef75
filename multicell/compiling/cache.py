"""The stamp by which numba knows whether compiled code on disk is that of today's files.

Numba's own stamp is a digest of the file in which a kernel stands. Kernels take in helpers and
constants of other files, so theirs is a digest of all files from which kernels are made: those of
the rooms with kernels, and those at the top of the package. A change in any of them compiles all
kernels anew. Whoever edits a command or a picture keeps the compiled code. Functions of users are
known by what they read (:func:`multicell.plugins.fingerprints.fingerprint`).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from functools import cache
from typing import Final

PACKAGE_FOLDER: Final = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
ROOMS: Final = (
    "compiling",
    "contact",
    "integrators",
    "mechanics",
    "networks",
    "nutrient",
    "plugins",
)
"""Folders whose files kernels are made of."""


def stamp_of(file: str) -> bytes | None:
    """Return the stamp of the kernels in a file of this package; None for all other files."""
    file = os.path.abspath(file)
    if not file.startswith(PACKAGE_FOLDER + os.sep):
        return None
    folder = os.path.relpath(file, PACKAGE_FOLDER).split(os.sep)[0]
    return stamp() if folder in ROOMS or folder.endswith(".py") else stamp(file)


@cache
def stamp(*more: str) -> bytes:
    """Return the digest of all files that kernels are made of, and of more files."""
    digest = hashlib.sha256()
    for file in (*sources(), *more):
        with open(file, "rb", buffering=0) as source:
            content = source.read()
        digest.update(b"%s %d\n" % (os.path.relpath(file, PACKAGE_FOLDER).encode(), len(content)))
        digest.update(content)
    return digest.digest()


def sources() -> Iterator[str]:
    """Yield the files that kernels are made of, in the order of their names."""
    yield from _modules(PACKAGE_FOLDER, deep=False)
    for room in ROOMS:
        yield from _modules(os.path.join(PACKAGE_FOLDER, room), deep=True)


def _modules(folder: str, *, deep: bool) -> Iterator[str]:
    with os.scandir(folder) as found:
        for entry in sorted(found, key=lambda entry: entry.name):
            if entry.name.endswith(".py"):
                yield entry.path
            elif deep and entry.name != "__pycache__" and entry.is_dir():
                yield from _modules(entry.path, deep=True)
