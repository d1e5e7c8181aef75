"""Wall time of the phases of the loop."""

from __future__ import annotations

import time as clock
from typing import Final, final

from multicell.compiling import COMPILATION

PHASES: Final = ("compile", "nutrient", "biology", "mechanics", "events", "record")
"""Phases of the loop whose wall time is measured; no moment belongs to two of them."""


@final
class Phase:
    """Adds the wall time of a block to that of a phase, and what numba took of it to another."""

    def __init__(self, wall: dict[str, float], name: str) -> None:
        self.wall, self.name = wall, name

    def __enter__(self) -> None:
        self.begin, self.compiled = clock.perf_counter(), COMPILATION.seconds

    def __exit__(self, *_: object) -> None:
        compiled = COMPILATION.seconds - self.compiled
        self.wall["compile"] += compiled
        self.wall[self.name] += clock.perf_counter() - self.begin - compiled
