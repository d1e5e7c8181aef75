"""Listeners while numba compiles: garbage is not collected, signals wait, and time is counted."""

from __future__ import annotations

import gc
import time as clock
from typing import final

from multicell.compiling.numba_068 import event
from multicell.host.interrupts import UNCUT


@final
class _WithoutCollector(event.Listener):
    """Times numba's compiling, and holds Python's search for cyclic garbage back meanwhile.

    Numba makes millions of objects that live until it is done: to look through them again and
    again takes a sixth of the time.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.enabled = False
        self.begin = self.seconds = 0.0

    def on_start(self, event: event.Event) -> None:
        """Note whether the collector runs, and stop it."""
        if self.depth == 0:
            self.begin = clock.perf_counter()
            self.enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event: event.Event) -> None:
        """Let it run again."""
        self.depth -= 1
        if self.depth == 0:
            self.seconds += clock.perf_counter() - self.begin
            if self.enabled:
                gc.enable()


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


COMPILATION = _WithoutCollector()  # what this process has compiled: ``seconds`` of wall time so far
event.register("numba:compile", COMPILATION)  # type: ignore[no-untyped-call]
event.register("numba:compiler_lock", _Uncut())  # type: ignore[no-untyped-call]
