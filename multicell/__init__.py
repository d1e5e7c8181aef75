"""Centre-based simulation of multicellular tissue.

>>> import multicell as mc
>>> scene = mc.load_scene("spheroid").with_changes({"duration": "2 d"})
>>> result = mc.run(scene)                                      # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from multicell.errors import MulticellError, OutputError, SceneError, StepFailed

if TYPE_CHECKING:
    from multicell.cells import Cells, State
    from multicell.comparison.result import WorkPrecision
    from multicell.comparison.stability import StabilityMap, stability
    from multicell.comparison.workprecision import compare
    from multicell.contact import JKR, Hertz
    from multicell.exporting import export
    from multicell.result import Result, load_result
    from multicell.resuming import resume
    from multicell.running import run
    from multicell.scene import Scene, load_scene, scene_names
    from multicell.simulation import Simulation

__version__ = "0.1.0"

__all__ = [
    "JKR",
    "Cells",
    "Hertz",
    "MulticellError",
    "OutputError",
    "Result",
    "Scene",
    "SceneError",
    "Simulation",
    "StabilityMap",
    "State",
    "StepFailed",
    "WorkPrecision",
    "compare",
    "export",
    "load_result",
    "load_scene",
    "resume",
    "run",
    "scene_names",
    "stability",
]

_LAZY = {
    "Cells": "multicell.cells",
    "Hertz": "multicell.contact",
    "JKR": "multicell.contact",
    "Result": "multicell.result",
    "Scene": "multicell.scene",
    "Simulation": "multicell.simulation",
    "State": "multicell.cells",
    "load_result": "multicell.result",
    "load_scene": "multicell.scene",
    "WorkPrecision": "multicell.comparison.result",
    "StabilityMap": "multicell.comparison.stability",
    "compare": "multicell.comparison.workprecision",
    "export": "multicell.exporting",
    "resume": "multicell.resuming",
    "run": "multicell.running",
    "scene_names": "multicell.scene",
    "stability": "multicell.comparison.stability",
}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for: numba and SUNDIALS take their time."""
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'multicell' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
