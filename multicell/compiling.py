"""How functions are compiled: without wasted collections, and apart from those that call them.

Numba puts the code of a function into each one that calls it, where LLVM optimises all of it once
more. What is large and called from several loops is compiled once instead, and called at its
address (:func:`address_of`, :func:`calling`).
"""

from __future__ import annotations

import gc
from typing import Any, final

import numpy as np
from numba import typeof, types
from numba.core import cgutils, event

KERNEL: dict[str, Any] = {"cache": True, "no_cfunc_wrapper": True}
"""Options of functions that Python calls: what C would need to call them is not made."""
INNER: dict[str, Any] = {**KERNEL, "error_model": "numpy", "no_cpython_wrapper": True}
"""Options of functions that other compiled code calls alone: what Python needs is not made."""
INLINED: dict[str, Any] = {**INNER, "forceinline": True}
"""Options of small functions of one pair, which must not cost a call."""


@final
class _WithoutCollector(event.Listener):
    """Holds Python's search for cyclic garbage back while numba compiles.

    Numba makes millions of objects that live until it is done: to look through them again and
    again takes a sixth of the time.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.enabled = False

    def on_start(self, event: event.Event) -> None:
        """Note whether the collector runs, and stop it."""
        if self.depth == 0:
            self.enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event: event.Event) -> None:
        """Let it run again."""
        self.depth -= 1
        if self.depth == 0 and self.enabled:
            gc.enable()


_LISTENER = _WithoutCollector()
event.register("numba:compile", _LISTENER)  # type: ignore[no-untyped-call]


_typeof: Any = typeof


def kind_of(value: Any) -> Any:
    """Return what stands for the type of an argument: equal where numba's types are equal.

    Numba's own ``typeof`` takes a quarter of a millisecond for the tuples that loops are given.
    """
    if isinstance(value, np.ndarray):
        return value.dtype.char, value.ndim, value.flags.num
    if isinstance(value, tuple):
        return type(value), *map(kind_of, value)
    return type(value)


_ADDRESSES: dict[Any, int] = {}


def address_of(function: Any, result: Any, *arguments: Any) -> int:
    """Return where a jitted function is that takes values like these; compile it if need be.

    Parameters
    ----------
    function
        A jitted function of a module.
    result
        A value of the type that it must return.
    arguments
        Values of the types of its arguments.

    Raises
    ------
    TypeError
        If it returns something else.
    """
    key = (function, kind_of(result), kind_of(arguments))
    if key not in _ADDRESSES:
        signature = tuple(map(_typeof, arguments))
        function.compile(signature)
        found = function.overloads[signature]
        if found.signature.return_type != _typeof(result):
            raise TypeError(f"{function} returns {found.signature.return_type}")
        _ADDRESSES[key] = found.library.get_pointer_to_function(found.fndesc.llvm_func_name)
    return _ADDRESSES[key]


def calling(result: Any, address: Any, *arguments: Any) -> tuple[Any, Any]:
    """Return what an intrinsic needs that calls the function at an address, its first argument.

    The function must have been compiled for exactly the types of the other arguments, literal
    ones apart, and return ``result``. Exceptions come through.
    """
    given = tuple(map(types.unliteral, arguments))

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        convention = context.call_conv
        kind = convention.get_function_type(result, given).as_pointer()
        function = builder.inttoptr(values[0], kind)
        status, returned = convention.call_function(builder, function, result, given, values[1:])
        failed = cgutils.if_unlikely(builder, status.is_error)  # type: ignore[no-untyped-call]
        with failed:
            convention.return_status_propagate(builder, status)
        return returned

    return result(address, *given), generate
