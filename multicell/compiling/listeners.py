"""Listeners while numba compiles: garbage is not collected, signals wait, time is counted."""

from __future__ import annotations

import gc
import time as clock
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, final

from multicell.compiling.numba_068 import event
from multicell.host.interrupts import UNCUT

PARTS: Final = {
    "philox": "random numbers",
    "nutrient": "fields",
    "integrators": "motion",
    "mechanics": "forces",
    "mechanics.neighbours": "neighbour lists",
}
"""Rooms and files with kernels, and what their parts are called in progress and forecasts."""


def part_of(module: str) -> str:
    """Return the part that the functions of a module belong to, as progress names it."""
    known = [name for name in PARTS if f"{module}.".startswith(f"multicell.{name}.")]
    return PARTS[max(known, key=len)] if known else "other functions"


@final
class _WithoutCollector(event.Listener):
    """Times numba's compiling, and holds Python's search for cyclic garbage back meanwhile.

    Numba makes millions of objects that live until it is done: to look through them again and
    again takes a sixth of the time.

    - ``seconds``: wall time so far; ``parts``: and by the name of the part
    - ``part``: what is compiled now, since ``begin``; empty when nothing is
    """

    def __init__(self) -> None:
        self.depth = 0
        self.enabled = False
        self.begin = self.seconds = 0.0
        self.part = ""
        self.parts: dict[str, float] = {}

    def on_start(self, event: event.Event) -> None:
        """Note whether the collector runs, and stop it."""
        if self.depth == 0:
            self.begin = clock.perf_counter()
            self.part = part_of(event.data["dispatcher"].py_func.__module__)
            self.enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event: event.Event) -> None:
        """Let it run again."""
        self.depth -= 1
        if self.depth == 0:
            took = clock.perf_counter() - self.begin
            self.seconds += took
            self._end(took)
            if self.enabled:
                gc.enable()

    @contextmanager
    def awaited(self, part: str) -> Iterator[None]:
        """Show a part as compiled now while the caller waits for a process that compiles it."""
        self.begin, self.part = clock.perf_counter(), part
        try:
            yield
        finally:
            self._end(clock.perf_counter() - self.begin)

    def _end(self, took: float) -> None:
        self.parts[self.part] = self.parts.get(self.part, 0.0) + took
        self.part = ""


@final
class _Uncut(event.Listener):
    """Delays signals until numba has compiled, loaded or saved a function.

    An exception in between leaves parts of it behind, and numba ends in errors of its own.
    """

    def on_start(self, event: event.Event) -> None:
        """Delay them, before numba takes its lock."""
        UNCUT.__enter__()

    def on_end(self, event: event.Event) -> None:
        """Deliver what has come, after numba has given its lock back."""
        UNCUT.__exit__()


COMPILATION = _WithoutCollector()  # functions compiled so far in this process
event.register("numba:compile", COMPILATION)  # type: ignore[no-untyped-call]
event.register("numba:compiler_lock", _Uncut())  # type: ignore[no-untyped-call]
