"""Forecast of compilation: the parts that this machine lacks for a run, and their time."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


class _Landmark(NamedTuple):
    """A kernel whose code on disk says that its part is compiled.

    - ``seconds``: wall time of the part on a 2.5 GHz Xeon, as ``multicell run spheroid`` had it
    """

    module: str
    kernel: str
    seconds: float


_LANDMARKS: Final = {
    "random numbers": _Landmark("philox", "philox_blocks", 0.7),
    "fields": _Landmark("nutrient.stencil", "apply_operator", 17.0),
    "motion": _Landmark("mechanics.forces", "forces", 9.0),
    "forces": _Landmark("mechanics.forces", "forces", 4.5),
    "neighbour lists": _Landmark("mechanics.neighbours.repairing", "repair", 6.5),
}
"""Kernels by the names of parts that :mod:`multicell.compiling.listeners` counts."""

LISTS_FROM: Final = 1000.0  # cells from which on lists are repaired, and that is compiled


def missing_parts(scene: Scene) -> dict[str, float]:
    """Return the parts without code on disk, and the seconds that each is expected to take."""
    from multicell.compiling.numba_068 import is_on_disk

    found = {}
    for part, (module, kernel, seconds) in _LANDMARKS.items():
        if part == "fields" and not scene.nutrients:
            continue
        known = getattr(import_module(f"multicell.{module}"), kernel)
        if not is_on_disk(known):
            found[part] = seconds
    return found
