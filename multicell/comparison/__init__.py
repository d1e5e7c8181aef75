"""Methods of integration against each other: work, precision, stability."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multicell.comparison.ladders import Method
    from multicell.comparison.result import WorkPrecision
    from multicell.comparison.stability.result import StabilityMap
    from multicell.comparison.stability.search import run_stability
    from multicell.comparison.work_precision import compare, run_compare

__all__ = [
    "Method",
    "StabilityMap",
    "WorkPrecision",
    "compare",
    "run_compare",
    "run_stability",
]

_LAZY = {
    "Method": "multicell.comparison.ladders",
    "WorkPrecision": "multicell.comparison.result",
    "compare": "multicell.comparison.work_precision",
    "run_compare": "multicell.comparison.work_precision",
    "run_stability": "multicell.comparison.stability.search",
    "StabilityMap": "multicell.comparison.stability.result",
}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for."""
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'multicell.comparison' has no attribute {name!r}")
