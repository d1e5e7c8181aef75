"""Compile functions without garbage collection, and apart from their callers.

Numba puts the code of a function into each one that calls it, where LLVM optimises all of it once
more. What is large and called from several loops is compiled once instead, and called at its
address (:func:`address_of`, :func:`call_at`). What is small and called by other compiled code alone
is neither optimised nor turned into machine code by itself (:data:`INNER`).
"""

from __future__ import annotations

import gc
import hashlib
import sys
import time as clock
from collections.abc import Callable
from inspect import Parameter, Signature
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast, final

import numpy as np
from llvmlite import ir
from numba import njit, typeof, types
from numba.core import boxing, caching, cgutils, event
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.cpu import CPUContext
from numba.core.pythonapi import _boxers
from numba.core.targetconfig import TargetConfig
from numba.core.typing.templates import _OverloadFunctionTemplate
from numba.extending import intrinsic
from numba.np import linalg
from numba.np.numpy_support import as_dtype

from multicell.host.interrupts import UNCUT

_ensure_blas = linalg.ensure_blas


def _assume_blas() -> None:
    """Load nothing of scipy.linalg until a kernel calls it; numba asks once whether it is there."""
    linalg.ensure_blas = _ensure_blas


if "numba.np.arraymath" not in sys.modules:
    linalg.ensure_blas = _assume_blas


@final
class _Piece(JITCodeLibrary):
    """Code that other functions take in, and that has no machine code of its own."""

    @property
    def codegen(self) -> Any:
        """A stand-in for the code generator: no caller needs the function's environment."""
        return _Nowhere()

    def get_pointer_to_function(self, name: str) -> int:
        """Return that it is nowhere."""
        self._ensure_finalized()  # type: ignore[no-untyped-call]
        return 0

    def _optimize_functions(self, module: Any) -> None:
        """Leave that to those who take it in."""
        module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        """Leave that to those who take it in."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._verify_declare_only_symbols()  # type: ignore[no-untyped-call]
        self._finalized = True


@final
class _Nowhere:
    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing."""


@final
class _PieceCompiler(Compiler):
    """Compiles to a :class:`_Piece`."""

    def __init__(
        self, typing: Any, target: Any, library: Any, arguments: Any, result: Any, flags: Any,
        local: Any,
    ) -> None:  # fmt: skip
        library = _Piece(target.codegen(), "piece")  # type: ignore[no-untyped-call]
        super().__init__(typing, target, library, arguments, result, flags, local)  # type: ignore[no-untyped-call]


def _jit_of_overloads(template: Any) -> Callable[..., Any]:
    """Return what compiles numba's own functions, such as ``np.empty``: as pieces of their callers.

    Each of them would be optimised and turned into machine code that nothing calls.
    """
    compiles = _plain_jit(template)
    return lambda **options: compiles(
        **{"pipeline_class": _PieceCompiler, "no_cfunc_wrapper": True, **options}
    )


def _same_options(one: Any, other: Any) -> Any:
    """Return whether options of functions are equal, which numba asks for each call in a kernel."""
    if not isinstance(other, type(one)):
        return NotImplemented
    return one._values == other._values or one.values() == other.values()


_SIZES: dict[str, int] = {}


def _size_of(context: Any, kind: Any) -> int:
    """Return the size of a type in bytes, for which numba has LLVM read a program each time."""
    name = str(kind)
    if name not in _SIZES:
        _SIZES[name] = kind.get_abi_size(context.target_data)
    return _SIZES[name]


def _index_of(cache: Any) -> Any:
    """Return numba's index of a file on disk; nothing of one that names types which are gone."""
    try:
        return _plain_index(cache)
    except AttributeError:
        return {}


_templates: Any = _OverloadFunctionTemplate
_caches: Any = caching.IndexDataCacheFile
_plain_index, _caches._load_index = _caches._load_index, _index_of
_options: Any = TargetConfig
_context: Any = CPUContext
_plain_jit = _templates._get_jit_decorator
_templates._get_jit_decorator = _jit_of_overloads
_options.__eq__, _options.__hash__ = _same_options, lambda options: hash(type(options))
_context.get_abi_sizeof = _size_of


KERNEL: dict[str, Any] = {"cache": True, "no_cfunc_wrapper": True, "error_model": "numpy"}
"""Options of functions that Python calls: what C would need to call them is not made."""
ADDRESSED: dict[str, Any] = {**KERNEL, "no_cpython_wrapper": True}
"""Options of functions that are called at an address alone: what Python needs is not made."""
INNER: dict[str, Any] = {**ADDRESSED, "cache": False, "pipeline_class": _PieceCompiler}
"""Options of functions that other compiled code calls alone: they have no code of their own, on
disk neither, where those are that have taken it in."""
INLINED: dict[str, Any] = {**INNER, "forceinline": True}
"""Options of small functions of one pair, which must not cost a call."""

_F = TypeVar("_F", bound=Callable[..., Any])


def typed(**options: Any) -> Callable[[_F], _F]:
    """Return ``numba.njit`` with options, for functions that state their types."""
    return cast(Callable[[_F], _F], njit(**options))


@final
class _WithoutCollector(event.Listener):
    """Times numba's compiling, and holds Python's search for cyclic garbage back meanwhile.

    Numba makes millions of objects that live until it is done: to look through them again and
    again takes a sixth of the time.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.enabled = False
        self.begin = self.seconds = 0.0

    def on_start(self, event: event.Event) -> None:
        """Note whether the collector runs, and stop it."""
        if self.depth == 0:
            self.begin = clock.perf_counter()
            self.enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event: event.Event) -> None:
        """Let it run again."""
        self.depth -= 1
        if self.depth == 0:
            self.seconds += clock.perf_counter() - self.begin
            if self.enabled:
                gc.enable()


def arithmetic(body: Callable[..., Any]) -> Any:
    """Compile a function that both Python and compiled code call, apart for each of them.

    Most runs have one kind of callers, and only that is compiled.
    """
    outside, inside = njit(**KERNEL)(body), njit(**INNER)(body)
    outside.get_call_template, outside.get_overload = inside.get_call_template, inside.get_overload
    return outside


COMPILATION = _WithoutCollector()  # what this process has compiled: ``seconds`` of wall time so far
event.register("numba:compile", COMPILATION)  # type: ignore[no-untyped-call]


@final
class _Uncut(event.Listener):
    """Delays signals until numba has compiled, loaded or saved a function.

    An exception in between leaves parts of it behind, and numba ends in errors of its own.
    """

    def on_start(self, event: event.Event) -> None:
        """Delay them, before numba takes its lock."""
        UNCUT.__enter__()

    def on_end(self, event: event.Event) -> None:
        """Deliver what has come, after numba has given its lock back."""
        UNCUT.__exit__()


event.register("numba:compiler_lock", _Uncut())  # type: ignore[no-untyped-call]


def _constant(c: Any, value: Any) -> Any:
    """Return code that finds a constant that was stored together with a compiled function."""
    return c.env_manager.read_const(c.env_manager.add_const(value))


def _box_array(kind: Any, value: Any, c: Any) -> Any:
    """Return code that makes the array of Python that a kernel returns, and runs no Python.

    Numba's own unpickles the class of the array by a function in Python, and does not ask whether
    that succeeded: where the handler of a signal raises an exception there, the process ends with
    a segmentation fault.
    """
    number = ir.IntType(32)
    native = cgutils.alloca_once_value(c.builder, value)  # type: ignore[no-untyped-call]
    shape = ir.FunctionType(
        c.pyapi.pyobj, [c.pyapi.voidptr, c.pyapi.pyobj, number, number, c.pyapi.pyobj]
    )
    adapt = c.pyapi._get_function(shape, name="NRT_adapt_ndarray_to_python_acqref")
    made = c.builder.call(
        adapt,
        [
            c.builder.bitcast(native, c.pyapi.voidptr),
            _constant(c, kind.box_type),
            number(kind.ndim),
            number(int(kind.mutable)),
            _constant(c, as_dtype(kind.dtype)),
        ],
    )
    c.context.nrt.decref(c.builder, kind, value)
    return made


def _box_named_tuple(kind: Any, value: Any, c: Any) -> Any:
    """Return code that makes the NamedTuple that a kernel returns, as :func:`_box_array` does."""
    plain = boxing.box_tuple(kind, value, c)
    new = _constant(c, tuple.__new__)
    made = c.pyapi.call_function_objargs(new, (_constant(c, kind.instance_class), plain))
    c.pyapi.decref(plain)
    return made


_boxers.functions |= {
    types.Array: _box_array,
    types.NamedTuple: _box_named_tuple,
    types.NamedUniTuple: _box_named_tuple,
}


def fingerprint_of(*modules: ModuleType) -> str:
    """Return twelve hexadecimal digits that change with the files of modules."""
    digest = hashlib.sha256()
    for module in modules:
        assert module.__file__ is not None
        digest.update(Path(module.__file__).read_bytes())
    return digest.hexdigest()[:12]


_typeof: Any = typeof


_OWNED = 0x4  # flag of arrays whose memory is their own, which is no part of their type


def kind_of(value: Any) -> Any:
    """Return what stands for the type of an argument: equal where numba's types are equal.

    Numba's own ``typeof`` takes a quarter of a millisecond for the tuples that loops are given.
    """
    if isinstance(value, np.ndarray):
        return value.dtype.char, value.ndim, value.flags.num & ~_OWNED
    if isinstance(value, tuple):
        return type(value), *map(kind_of, value)
    return type(value)


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


def called_at(count: int, result: Any) -> Any:
    """Return what compiled code calls with an address and ``count`` arguments of a function there.

    ``result`` returns its type, given those of address and arguments.
    """

    def call(context: Any, *given: Any) -> tuple[Any, Any]:
        return call_at(result(*given), *given)

    # numba packs what has no names of its own into a tuple
    names = [Parameter(f"_{k}", Parameter.POSITIONAL_OR_KEYWORD) for k in range(count + 2)]
    call.__signature__ = Signature(names)  # type: ignore[attr-defined]
    return intrinsic(call)
