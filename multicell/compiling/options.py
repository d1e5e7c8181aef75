"""Options with which all kernels are compiled.

Numba puts the code of a function into each one that calls it, where LLVM optimises all of it once
more. What is small and called by other compiled code alone is neither optimised nor turned into
machine code by itself (:data:`INNER`); what is large is called at an address
(:mod:`multicell.compiling.calls`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

from multicell.compiling.cache import stamp_of
from multicell.compiling.numba_068 import PieceCompiler, change_numba

change_numba(stamp_of)

KERNEL: dict[str, Any] = {"cache": True, "no_cfunc_wrapper": True, "error_model": "numpy"}
"""Options of functions that Python calls: what C would need to call them is not made."""
ADDRESSED: dict[str, Any] = {**KERNEL, "no_cpython_wrapper": True}
"""Options of functions that are called at an address alone: what Python needs is not made."""
INNER: dict[str, Any] = {**ADDRESSED, "cache": False, "pipeline_class": PieceCompiler}
"""Options of functions that other compiled code calls alone: they have no code of their own, on
disk neither, where those are that have taken it in."""
UNCOUNTED: dict[str, Any] = {**INNER, "_nrt": False}
"""Options of inner functions that make no arrays: they count no references to those that their
callers hold, so that they must not return arrays either. Counting is atomic, takes longer than a
few lines of arithmetic, and is compiled in each of the callers."""
INLINED: dict[str, Any] = {**UNCOUNTED, "forceinline": True}
"""Options of such functions that must not cost a call, as those of one pair."""

_F = TypeVar("_F", bound=Callable[..., Any])


def typed(**options: Any) -> Callable[[_F], _F]:
    """Return ``numba.njit`` with options, for functions that state their types."""
    return cast(Callable[[_F], _F], njit(**options))


def arithmetic(body: Callable[..., Any], **options: Any) -> Any:
    """Compile a function that both Python and compiled code call, apart for each of them.

    Most runs have one kind of callers, and only that is compiled.
    """
    outside, inside = njit(**KERNEL, **options)(body), njit(**INNER, **options)(body)
    outside.get_call_template, outside.get_overload = inside.get_call_template, inside.get_overload
    return outside
