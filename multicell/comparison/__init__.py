"""Comparison of integration methods: work against precision, and limits of stability."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multicell.comparison.methods import Method
    from multicell.comparison.result import WorkPrecision
    from multicell.comparison.stability import StabilityMap, run_stability, stability
    from multicell.comparison.workprecision import compare, run_compare

__all__ = [
    "Method",
    "StabilityMap",
    "WorkPrecision",
    "compare",
    "run_compare",
    "run_stability",
    "stability",
]

_LAZY = {
    "Method": "multicell.comparison.methods",
    "WorkPrecision": "multicell.comparison.result",
    "compare": "multicell.comparison.workprecision",
    "run_compare": "multicell.comparison.workprecision",
    "run_stability": "multicell.comparison.stability",
    "StabilityMap": "multicell.comparison.stability",
}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for."""
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'multicell.comparison' has no attribute {name!r}")
