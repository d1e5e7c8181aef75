"""Work–precision: what accuracy each integration method gives, and what it costs."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multicell.compare.methods import Method
    from multicell.compare.result import WorkPrecision
    from multicell.compare.workprecision import compare, run_compare

__all__ = ["Method", "WorkPrecision", "compare", "run_compare"]

_LAZY = {
    "Method": "multicell.compare.methods",
    "WorkPrecision": "multicell.compare.result",
    "compare": "multicell.compare.workprecision",
    "run_compare": "multicell.compare.workprecision",
}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for."""
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'multicell.compare' has no attribute {name!r}")
