"""Calls of compiled functions at their addresses, and what stands for the types of arguments.

What is large and called from several loops is compiled once, and called at its address
(:func:`address_of`, :func:`call_at`), where numba would put its code into each caller.
"""

from __future__ import annotations

from inspect import Parameter, Signature
from typing import Any

import numpy as np
from numba import TypingError, typeof, types
from numba.extending import intrinsic

from multicell.compiling.numba_068 import cgutils

_typeof: Any = typeof


_OWNED = 0x4  # flag of arrays whose memory is their own, which is no part of their type


def kind_of(value: Any) -> Any:
    """Return a key for the type of an argument: equal where numba's types are equal.

    Numba's own ``typeof`` takes a quarter of a millisecond for the tuples that loops are given.
    """
    kind = type(value)
    if kind is float or kind is int or value is None:
        return kind
    if kind is np.ndarray or isinstance(value, np.ndarray):
        return value.dtype.char, value.ndim, value.flags.num & ~_OWNED
    if isinstance(value, tuple):
        return (kind, *map(kind_of, value))
    return value if kind in _TYPES else kind


_TYPES = frozenset({types.NamedTuple, types.NamedUniTuple})
"""Types that are arguments themselves, see :mod:`multicell.mechanics.any_law`."""
_ADDRESSES: dict[Any, int] = {}


def address_of(function: Any, result: Any, *arguments: Any) -> int:
    """Return where a jitted function is that takes values like these; compile it if need be.

    - ``result``: a value of the type that it must return
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


def call_at(result: Any, address: Any, *arguments: Any) -> tuple[Any, Any]:
    """Return signature and code of an intrinsic that calls the function at an address.

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


def called_at(count: int, result: Any, frozen: int | None = None) -> Any:
    """Return an intrinsic that calls the function at an address with ``count`` arguments.

    - ``result``: returns its type, given those of address and arguments
    - ``frozen``: number of the argument that is an array which the function only reads, as that is
      known to callers in Python too; None: there is none
    """

    def call(context: Any, address: Any, *given: Any) -> tuple[Any, Any]:
        found = [t.copy(readonly=True) if k == frozen else t for k, t in enumerate(given)]
        return call_at(result(address, *found), address, *found)

    return _intrinsic_of(call, count)


def called_with_rows(count: int, rows: int) -> Any:
    """Return an intrinsic that calls a function of a float and rows of floats at an address.

    The function gets where the first float of each row is: numba would hand over seven numbers for
    an array. It returns a float.

    - ``count``: arguments of the call, address not counted; ``rows``: of the function, which finds
      zeros for those that the call lacks
    """

    def call(context: Any, *given: Any) -> tuple[Any, Any]:
        own = [kind for kind in given if isinstance(kind, types.Array)]
        if any(kind.layout != "C" or kind.dtype != types.float64 for kind in own):
            raise TypingError(f"rows of floats must be contiguous, and are {own}")
        time = [] if len(own) == count else [types.float64]
        places = [types.intp] * rows
        _, generate = call_at(types.float64, given[0], types.float64, *places)

        def with_places(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            zero = context.get_constant(types.intp, 0)
            now = values[1] if time else context.get_constant(types.float64, 0.0)
            pairs = list(zip(own, values[-len(own) :], strict=True))
            first = [context.make_array(k)(context, builder, v).data for k, v in pairs]
            first = [builder.ptrtoint(one, zero.type) for one in first]
            first += [zero] * (rows - len(first))
            return generate(context, builder, signature, [values[0], now, *first])

        return types.float64(given[0], *time, *own), with_places

    return _intrinsic_of(call, count)


def _intrinsic_of(call: Any, count: int) -> Any:
    # numba packs what has no names of its own into a tuple
    names = [Parameter(f"_{k}", Parameter.POSITIONAL_OR_KEYWORD) for k in range(count + 2)]
    call.__signature__ = Signature(names)
    return intrinsic(call)


@intrinsic
def floats_at(context: Any, place: Any) -> tuple[Any, Any]:
    """Return a pointer to floats of which the first is at a place in memory."""
    pointer = types.CPointer(types.float64)  # type: ignore[no-untyped-call]

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.inttoptr(values[0], context.get_value_type(pointer))

    return pointer(types.intp), generate
