"""Packs of compiled kernels: found where packages are installed, checked, and read where they fit.

``python -m multicell.kernels`` makes a pack for processors of one level. It is used for kernels
that numba's cache on disk lacks, if what decides the code is the same here as where it was made.
Anything else counts as if there were no pack; ``multicell doctor`` reports why.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from functools import cache
from typing import Final, final

import llvmlite
import numba
import numpy as np

from multicell.compiling.cache import PACKAGE_FOLDER, stamp
from multicell.host.closed import pack_folder, why_open

_V2: Final = "cmov crc32 cx16 cx8 fxsr mmx popcnt sahf sse sse2 sse3 sse4.1 sse4.2 ssse3"
_V3: Final = f"{_V2} avx avx2 bmi bmi2 f16c fma lzcnt movbe xsave"
_V4: Final = f"{_V3} avx512bw avx512cd avx512dq avx512f avx512vl"
LEVELS: Final = {"generic": "", "x86-64-v2": _V2, "x86-64-v3": _V3, "x86-64-v4": _V4}
"""Levels of processors, as LLVM calls them, and the features that their code needs.

They are those of the x86-64 psABI. ``"generic"`` code runs on all processors of the same kind.
"""

Processor = tuple[str, str, str]
"""Target triple, name and features of the processor that numba compiles for."""


def setting() -> dict[str, str]:
    """Return what decides compiled code, the processor apart, by names for messages."""
    svml = numba.config.USING_SVML  # type: ignore[attr-defined]
    return {
        "Python": str(sys.implementation.cache_tag),
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "NumPy": ".".join(np.__version__.split(".")[:2]),
        "Intel's vector mathematics": "used" if svml else "absent",
        "sources": stamp().hex(),
    }


@final
class Pack:
    """A folder with compiled kernels.

    - ``folder``: with ``about.json`` and numba's files, in folders as those of the package
    - ``processor``: that numba compiles for in this process

    - ``refusal``: why it is not used, in words; empty if it is
    - ``level``: key of :data:`LEVELS`; ``loaded``: number of kernels that came from it
    """

    def __init__(self, folder: str, processor: Processor) -> None:
        self.folder, self.loaded, self.level = folder, 0, ""
        self.refusal = self._read() or self._difference(processor)

    def _read(self) -> str:
        try:
            if why := why_open(self.folder):
                return why
            with open(os.path.join(self.folder, "about.json"), encoding="utf-8") as file:
                about = json.load(file)
            self.level, self.processor = str(about["level"]), tuple(about["processor"])
            self._setting, self._files = dict(about["setting"]), dict(about["files"])
            self._needed = set(LEVELS[self.level].split())
        except (OSError, ValueError, KeyError, TypeError) as error:
            return f"about.json cannot be read ({type(error).__name__}: {error})"
        return ""

    def _difference(self, processor: Processor) -> str:
        for name, own in setting().items():
            if (other := self._setting.get(name)) != own:
                return f"it is of other {name}: {other}, not {own}"
        if processor == self.processor:
            return ""
        given = {part[1:] for part in processor[2].split(",") if part.startswith("+")}
        if processor[0] != self.processor[0]:
            return f"it is for {self.processor[0]}"
        lacking = ", ".join(sorted(self._needed - given))
        return f"it is for {self.level}; this processor lacks {lacking}" if lacking else ""

    def folder_of(self, source: str) -> str:
        """Return the folder with the kernels of a file of the package."""
        place = os.path.relpath(os.path.dirname(source), PACKAGE_FOLDER)
        return os.path.normpath(os.path.join(self.folder, place))

    def is_sound(self, path: str) -> bool:
        """Return whether a file is the one that was packed."""
        name = os.path.relpath(path, self.folder).replace(os.sep, "/")
        try:
            return name in self._files and digest_of(path) == self._files[name]
        except OSError:
            return False

    def words(self) -> str:
        """Return in words what it is, and whether it is used."""
        if self.refusal:
            return f"{self.folder} is not used: {self.refusal}"
        damaged = [name for name in self._files if not self.is_sound(f"{self.folder}/{name}")]
        wrong = f", of which {len(damaged)} are damaged" if damaged else ""
        return f"{self.folder}, for {self.level}: {len(self._files)} files{wrong}"


def digest_of(path: str) -> str:
    """Return the digest of a file."""
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


@cache
def installed_pack(processor: Processor) -> Pack | None:
    """Return the pack that is installed here, used or not; None if there is none."""
    folder = pack_folder()
    return Pack(folder, processor) if folder else None
