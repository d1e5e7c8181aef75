"""Compare methods of integration: error against cost, limits of stability."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multicell.comparison.ladders import Method
    from multicell.comparison.result import WorkPrecision
    from multicell.comparison.stability_limits.result import StabilityMap
    from multicell.comparison.stability_limits.search import stability
    from multicell.comparison.work_precision import compare

__all__ = ["Method", "StabilityMap", "WorkPrecision", "compare", "stability"]

_LAZY = {
    "Method": "multicell.comparison.ladders",
    "WorkPrecision": "multicell.comparison.result",
    "compare": "multicell.comparison.work_precision",
    "stability": "multicell.comparison.stability_limits.search",
    "StabilityMap": "multicell.comparison.stability_limits.result",
}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for."""
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'multicell.comparison' has no attribute {name!r}")
