"""Limits to the points, seeds and runs of a study, a fit or an analysis: one for all."""

from __future__ import annotations

import os
from numbers import Integral
from typing import Any, Final

from multicell.errors import SceneError
from multicell.units import shown

MAX_POINTS: Final = 20_000
"""Sets of parameters. The scene of each one is checked beforehand, which takes about 2 ms."""
MAX_SEEDS: Final = 20_000
MAX_RUNS: Final = 100_000


def whole_between(name: str, value: Any, least: int, most: int, hint: str = "") -> int:
    """Return a whole number between two others; raises SceneError if it is none."""
    fits = isinstance(value, Integral) and not isinstance(value, bool)
    if not fits or not least <= int(value) <= most:
        problem = f"is {shown(value)}, must be a whole number from {least:,} to {most:,}"
        raise SceneError(name, problem, hint)
    return int(value)


def check_seeds(seeds: Any, first: int) -> int:
    """Return a number of runs of each point, whose seeds begin with a scene's."""
    count = whole_between("seeds", seeds, 1, MAX_SEEDS, "It is the number of runs of each point.")
    if first + count - 1 >= 2**63:
        problem = f"is {count}: beginning with the scene's seed {first} they end too high"
        raise SceneError("seeds", problem, "Let the scene begin with a smaller seed.")
    return count


def check_runs(points: int, seeds: int, name: str = "seeds") -> None:
    """Refuse too many points, or too many runs of them."""
    if points > MAX_POINTS:
        problem = f"makes {points:,} points, must be at most {MAX_POINTS:,}"
        raise SceneError(name, problem, "Vary less.")
    if points * seeds > MAX_RUNS:
        problem = f"makes {points * seeds:,} runs, must be at most {MAX_RUNS:,}"
        raise SceneError(name, problem, "Take fewer points or seeds.")


def check_cores(cores: int | None) -> None:
    """Refuse a number of worker processes that this machine cannot be meant to have."""
    if cores is not None:
        whole_between("cores", cores, 1, max(8, 4 * (os.cpu_count() or 1)))
