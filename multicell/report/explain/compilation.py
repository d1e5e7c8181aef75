"""Forecast of compilation: the parts that this machine lacks for a run, and their time."""

from __future__ import annotations

import math
from importlib import import_module
from typing import TYPE_CHECKING, Final

from multicell.host.closed import may_be_on_disk

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


_LANDMARKS: Final = {
    "random numbers": ("philox", "philox_blocks", 0.7),
    "fields": ("nutrient.stencil", "account", 17.0),
    "motion": ("mechanics.forces", "forces", 9.0),
    "forces": ("mechanics.forces", "forces", 4.5),
    "neighbour lists": ("mechanics.neighbours.repairing", "repair", 6.5),
}
"""Module and kernel whose code on disk says that a part is compiled, and the wall time in s of the
part on a 2.5 GHz Xeon, as ``multicell run spheroid`` had it; by the names of parts that
:mod:`multicell.compiling.listeners` counts."""

LISTS_FROM: Final = 1000.0  # cells from which on lists are repaired, and that is compiled


def missing_parts(scene: Scene) -> dict[str, float]:
    """Return the parts without code on disk, and the seconds that each is expected to take."""
    found = {}
    absent = {"fields"} if not scene.nutrients else set()
    most = _most_cells(scene)
    if most < LISTS_FROM:
        absent.add("neighbour lists")
    if most < 2.0 and scene.motility is None and not scene.chemotaxis:
        absent |= {"motion", "forces"}
    for part, (module, kernel, seconds) in _LANDMARKS.items():
        if part not in absent and not _is_compiled(module, kernel):
            found[part] = seconds
    return found


def _most_cells(scene: Scene) -> float:
    """Return more cells than a scene is going to have, without the time of a forecast."""
    if scene.growth is None:
        return float(scene.initial.count)
    shortest = min((kind.cycle_scale for kind in scene.types.values()), default=1.0)
    cycles = scene.duration / (shortest * scene.growth.mean_cycle)
    return scene.initial.count * math.exp(min(4.0 * cycles, 100.0))


def _is_compiled(module: str, kernel: str) -> bool:
    """Return whether there is code of a kernel on disk; where there is no file numba is not asked.

    To load it takes as long as all else before a first run speaks.
    """
    if not may_be_on_disk(module, kernel):
        return False
    from multicell.compiling.numba_068 import is_on_disk

    return is_on_disk(getattr(import_module(f"multicell.{module}"), kernel))
