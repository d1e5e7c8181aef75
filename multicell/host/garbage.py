"""Python's collector of cyclic garbage in a command's processes, which make little of it."""

from __future__ import annotations

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

_RARELY: Final = 100_000
"""New objects after which garbage is looked for. Python's own 700 suit programs that make it;
modules make hundreds of thousands of objects that live on."""
_AT_FIRST: Final = 400_000
"""The same until the first search: most commands end before, and make little but their modules."""


def collect_rarely() -> None:
    """Look for garbage rarely in this process, and not once more among all modules at its end."""
    gc.set_threshold(_AT_FIRST, *gc.get_threshold()[1:])
    gc.callbacks.append(_more_often)
    atexit.register(gc.freeze)


@contextmanager
def without_what_there_is() -> Iterator[None]:
    """Look for garbage only among what is made from here on, not among all modules again.

    Where the caller has done so, that stays as it is.
    """
    if gc.get_freeze_count():
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _more_often(phase: str, about: dict[str, int]) -> None:
    """Take the second number from the first search on."""
    if phase == "stop":
        gc.set_threshold(_RARELY, *gc.get_threshold()[1:])
        gc.callbacks.remove(_more_often)
