"""Packs of compiled kernels: found where packages are installed, checked, and read where they fit.

``python -m multicell.compiling.kernels`` makes a pack for processors of one level. It is used for
kernels that numba's cache on disk lacks, if what decides the code is the same here as where it was
made. Anything else counts as if there were no pack; ``multicell doctor`` reports why.
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

from multicell.compiling.cache import stamp
from multicell.host.closed import pack_folder, why_open

_V2: Final = "cmov crc32 cx16 cx8 fxsr mmx popcnt sahf sse sse2 sse3 sse4.1 sse4.2 ssse3"
_V3: Final = f"{_V2} avx avx2 bmi bmi2 f16c fma lzcnt movbe xsave"
_V4: Final = f"{_V3} avx512bw avx512cd avx512dq avx512f avx512vl"
PROCESSOR_LEVELS: Final = {"generic": "", "x86-64-v2": _V2, "x86-64-v3": _V3, "x86-64-v4": _V4}
"""Levels of processors, as LLVM calls them, and the features that their code needs.

They are those of the x86-64 psABI. ``"generic"`` code runs on all processors of the same kind.
"""

Processor = tuple[str, str, str]
"""Target triple, name and features of the processor that numba compiles for."""


def setting() -> dict[str, str]:
    """Return the versions and settings that decide compiled code, by names for messages."""
    return {
        "Python": str(sys.implementation.cache_tag),
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "NumPy": ".".join(np.__version__.split(".")[:2]),
        "SVML": str(numba.config.USING_SVML),  # type: ignore[attr-defined]
        "sources": stamp().hex(),
    }


@final
class Pack:
    """A folder with compiled kernels: ``about.json``, and numba's files in folders by rooms.

    - ``processor``: that numba compiles for in this process

    - ``refusal``: why it is not used, in words; empty if it is
    - ``level``: key of :data:`PROCESSOR_LEVELS`; ``loaded``: number of kernels that came from it
    """

    def __init__(self, folder: str, processor: Processor) -> None:
        self.folder, self.loaded, self.level = folder, 0, ""
        try:
            self.refusal = why_open(folder) or self._read(processor)
        except (
            OSError,
            ValueError,
            LookupError,
            TypeError,
            AttributeError,
            RecursionError,
        ) as error:
            self.refusal = f"about.json cannot be read ({error!r})"

    def _read(self, processor: Processor) -> str:
        with open(os.path.join(self.folder, "about.json"), encoding="utf-8") as file:
            about = json.load(file)
        self.level, self.processor = about["level"], tuple(about["for"])
        self._files: dict[str, str] = dict(about["files"])
        given = processor[2].replace("+", "").split(",")
        lacking = set(PROCESSOR_LEVELS[self.level].split()).difference(given)
        for name, own in setting().items():
            if about["setting"][name] != own:
                return f"it is for {name} {about['setting'][name]}, here is {own}"
        if processor == self.processor or (processor[0] == self.processor[0] and not lacking):
            return ""
        return f"it is for {self.level}, {self.processor[0]}, not for {processor[:2]}"

    def folder_of(self, source: str) -> str:
        """Return the folder with the kernels of a file of the package."""
        return os.path.join(self.folder, os.path.basename(os.path.dirname(source)))

    def is_sound(self, path: str) -> bool:
        """Return whether a file is the one that was packed."""
        digest = self._files.get("/".join(path.split(os.sep)[-2:]))
        return digest is not None and digest == digest_of(path)


def digest_of(path: str) -> str:
    """Return the digest of a file; empty if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return hashlib.sha256(file.read()).hexdigest()
    except OSError:
        return ""


@cache
def installed_pack(processor: Processor) -> Pack | None:
    """Return the pack that is installed here, used or not; None if there is none."""
    folder = pack_folder()
    return Pack(folder, processor) if folder else None
