"""Compilation by numba: options, calls at addresses, stamps of code on disk, listeners."""

from __future__ import annotations

from multicell.compiling.calls import (
    address_of,
    call_at,
    called_at,
    called_with_rows,
    floats_at,
    kind_of,
)
from multicell.compiling.listeners import COMPILATION
from multicell.compiling.options import (
    ADDRESSED,
    INLINED,
    INNER,
    KERNEL,
    UNCOUNTED,
    arithmetic,
    typed,
)

__all__ = [
    "ADDRESSED",
    "COMPILATION",
    "INLINED",
    "INNER",
    "KERNEL",
    "UNCOUNTED",
    "address_of",
    "arithmetic",
    "call_at",
    "called_at",
    "called_with_rows",
    "floats_at",
    "kind_of",
    "typed",
]
