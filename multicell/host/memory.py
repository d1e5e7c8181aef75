"""Memory that is free goes back to the system, which counts memory held by a process, used or not.

The allocator of the C library keeps what is freed between blocks that are in use. A run with many
cells frees arrays of all sizes in every step, and in hours holds twice what it ever needed.
"""

from __future__ import annotations

import ctypes
import os
import sys
import time as clock
from typing import Any, Final, final

WORTH_RETURNING: Final = 10_000  # cells below which nothing is worth giving back

_EVERY: Final = 10.0
"""Seconds of the wall clock. To give back after each step of 100,000 cells, and to get again, took
8 % of the step's CPU time, and the most that a process held was 5 % less."""


@final
class Returns:
    """Gives memory back now and then; where the C library cannot, does nothing."""

    def __init__(self) -> None:
        self._trim = _trim()
        self._last = clock.monotonic()

    def now_and_then(self, cells: int) -> None:
        """Give back what is free if there are many cells, and the last time is a while ago."""
        if self._trim is None or cells < WORTH_RETURNING or clock.monotonic() - self._last < _EVERY:
            return
        self._trim(0)
        self._last = clock.monotonic()


def peak() -> float | None:
    """Return the most memory that this process has held so far, MB; None where nobody counts it."""
    try:
        import resource
    except ImportError:
        return None
    most = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return most / (1e6 if sys.platform == "darwin" else 1e6 / 1024.0)  # bytes there, KiB elsewhere


def physical_memory() -> int | None:
    """Return the memory of this machine in bytes, or None where it is unknown."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return None


def _trim() -> Any:
    """Return the function of glibc that gives back all free pages, None in other systems."""
    if not sys.platform.startswith("linux"):
        return None
    return getattr(ctypes.CDLL(None), "malloc_trim", None)
