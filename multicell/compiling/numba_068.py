"""The insides of numba 0.68 that this package reads or changes; no other module touches them.

Changes hold for the whole process, also for a user's own numba code in it. What that code computes
does not change. All of them are made once, by :func:`change_numba`, when a module with kernels is
first imported.

===========================  =========  ==========================================================
what                         for        why
===========================  =========  ==========================================================
source stamps of our files   truth      numba compares a kernel's own file with its code on disk.
                                        Ours take in helpers of other files: their stamp is a
                                        digest of all files that compile. Others' stay as they are.
index of a cache file        safety     an index that names types which are gone (after an
                                        upgrade) raises ``AttributeError`` in every run: it counts
                                        as empty, and is written anew.
files of other users         safety     to read compiled code is to run it: index and data that
                                        are not the user's or root's own count as absent.
boxes of arrays and tuples   safety     numba's run Python, and do not ask whether it raised: a
                                        signal's handler there ends in a segmentation fault.
packs of compiled kernels    speed      kernels that the folder of compiled code lacks are looked
                                        for in :mod:`multicell.compiling.pack`: four fifths of the
                                        first command.
folder of compiled code      safety     one that others can write to is replaced by a private one
                                        (:mod:`multicell.host.closed`).
signals while numba works    safety     an exception within its lock leaves parts of a function
                                        behind, and numba ends in errors of its own.
jit of numba's own           speed      ``np.empty`` and others are compiled as pieces of their
functions                               callers, as ours are; each would be optimised and turned
                                        into machine code that nothing calls: 6 % of the first
                                        command. Not those of users: pieces have no environment,
                                        which ``objmode`` and exceptions with values need.
types of operators           speed      numba tries dozens of rules for each operator, and words why
                                        most of them do not fit: 7 % of the first command.
collector of garbage         speed      numba makes millions of objects that live until it is done:
                                        8 % of the first command.
tables for compilation       start      numba fills them, and imports what it compiles them from,
                                        before it loads code from disk too, which only runs; whoever
                                        compiles fills them first. 0.15 s of each further command.
extensions of others         start      numba asks all packages for them before it looks at the
                                        arguments of a function; ours have no types of others. What
                                        compiles asks all the same. 0.03 s.
SciPy's BLAS                 start      numba imports ``scipy.linalg`` to ask whether it is there;
                                        it is loaded when a kernel calls it: 0.1 s of each command
                                        (0.8 % of the first).
===========================  =========  ==========================================================

Gains are parts of the CPU time of ``multicell run spheroid -o out --set duration="2 d" --quiet``
with an empty cache. What gains less than a fiftieth of that is left as numba has it: remembered
sizes of types (1 %).

:mod:`multicell.host.surroundings` keeps ``numba.core.config`` from reading files of the working
folder, before numba is imported. The pin ``numba>=0.68,<0.69`` stands for all this: with another
version each row is tried without the change first, by its test in ``tests/test_compiling.py``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, final

from llvmlite import ir
from numba import types
from numba._dispatcher import compute_fingerprint
from numba.core import boxing, caching, cgutils, config, event
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.dispatcher import Dispatcher
from numba.core.event import install_recorder
from numba.core.pythonapi import _boxers
from numba.core.registry import cpu_target
from numba.core.runtime.nrt import rtsys
from numba.core.types.functions import BaseFunction
from numba.core.typing.templates import _OverloadFunctionTemplate
from numba.cpython import hashing  # noqa: F401 - names symbols that code from disk may ask for
from numba.np import linalg
from numba.np.numpy_support import as_dtype

from multicell.compiling.pack import Pack, Processor, installed_pack
from multicell.host.closed import choose_cache, is_own

__all__ = [
    "PieceCompiler",
    "cgutils",
    "change_numba",
    "compute_fingerprint",
    "event",
    "install_recorder",
    "installed_pack",
    "is_on_disk",
    "processor",
]

_ensure_blas = linalg.ensure_blas


def _assume_blas() -> None:
    """Load nothing of scipy.linalg until a kernel calls it; numba asks once whether it is there."""
    linalg.ensure_blas = _ensure_blas


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
class PieceCompiler(Compiler):
    """Compile a function as a piece of its callers, without machine code of its own."""

    def __init__(
        self,
        typing: Any,
        target: Any,
        library: Any,
        arguments: Any,
        result: Any,
        flags: Any,
        local: Any,
    ) -> None:
        library = _Piece(target.codegen(), "piece")  # type: ignore[no-untyped-call]
        super().__init__(typing, target, library, arguments, result, flags, local)  # type: ignore[no-untyped-call]


_plain_jit = _OverloadFunctionTemplate._get_jit_decorator
_OURS = ("multicell.", "numba.cpython.", "numba.np.")
"""Modules whose overloads need no environment: they raise no exception with values in its text."""


def _jit_of_overloads(template: Any) -> Callable[..., Any]:
    """Return a function that compiles an overload, such as numba's ``np.empty``: as a piece."""
    compiles = _plain_jit(template)  # type: ignore[no-untyped-call]
    if not str(template._overload_func.__module__).startswith(_OURS):
        return compiles  # type: ignore[no-any-return]
    return lambda **options: compiles(
        **{"pipeline_class": PieceCompiler, "no_cfunc_wrapper": True, **options}
    )


_Function: Any = BaseFunction
_plain_call_type = _Function.get_call_type
_CALL_TYPES: dict[Any, Any] = {}


def _call_type(function: Any, context: Any, args: Any, kws: Any) -> Any:
    """Return the types of a call of what numba implements itself, such as the sum of two numbers.

    What is implemented by compiled code is left out: that depends on more than the types.
    """
    key = function, context, tuple(args), tuple(kws.items())
    if (found := _CALL_TYPES.get(key)) is None:
        found = _plain_call_type(function, context, args, kws)
        if function._impl_keys[found.args] is function.typing_key:
            _CALL_TYPES[key] = found
        return found
    function._impl_keys[found.args] = function.typing_key
    return found


_plain_index = caching.IndexDataCacheFile._load_index


def _index_of(cache: Any) -> Any:
    """Return numba's index of a file on disk; nothing of one that names types which are gone.

    Nor of one that another user has made, or could have changed: to read it is to run it.
    """
    try:
        return _plain_index(cache) if is_own(cache._index_path) else {}  # type: ignore[no-untyped-call]
    except (AttributeError, FileNotFoundError):
        return {}


_plain_data = caching.IndexDataCacheFile._load_data


def _data_of(cache: Any, name: str) -> Any:
    """Return a compiled function from disk, with the same care; None to compile it anew.

    What a function of the user's reads is found by its module, which may have been none (code that
    was executed as text) or may be gone.
    """
    try:
        return _plain_data(cache, name) if is_own(cache._data_path(name)) else None  # type: ignore[no-untyped-call]
    except ModuleNotFoundError:
        return None


_plain_load: Any = caching.Cache.load_overload


def _load_overload(cache: Any, types_of: Any, target: Any) -> Any:
    """Return compiled code of ours from disk, with no tables of what compiles; None without it."""
    if not _is_ours(cache._py_func):
        return _plain_load(cache, types_of, target)
    rtsys.initialize(target)
    with cache._guard_against_spurious_io_errors():
        found = cache._load_overload(types_of, target)
        return _from_pack(cache, types_of, target) if found is None else found


@final
class _PackFile(caching.IndexDataCacheFile):
    """Numba's index of a kernel, and its code, in a pack: what is not as packed is not read."""

    def __init__(self, cache: Any, pack: Pack) -> None:
        own, folder = cache._cache_file, pack.folder_of(cache._impl.locator._py_file)
        super().__init__(folder, cache._impl.filename_base, own._source_stamp)  # type: ignore[no-untyped-call]
        self.pack = pack

    def _load_index(self) -> Any:
        return _index_of(self) if self.pack.is_sound(self._index_path) else {}

    def _load_data(self, name: str) -> Any:
        return _data_of(self, name) if self.pack.is_sound(self._data_path(name)) else None  # type: ignore[no-untyped-call]


def _pack_file(cache: Any) -> _PackFile | None:
    pack = installed_pack(processor())
    return None if pack is None or pack.refusal else _PackFile(cache, pack)


def _from_pack(cache: Any, types_of: Any, target: Any) -> Any:
    """Return a compiled function from an installed pack; None to compile it."""
    file = _pack_file(cache)
    if file is None:
        return None
    signature, _, code = cache._index_key(types_of, target.codegen())
    try:
        data = file.load((signature, file.pack.processor, code))  # type: ignore[no-untyped-call]
        found = None if data is None else cache._impl.rebuild(target, data)
    except Exception as error:  # whatever reading raises: from here on all is compiled
        file.pack.refusal = f"{file._index_name} cannot be read ({error!r})"
        return None
    file.pack.loaded += found is not None
    return found


def processor() -> Processor:
    """Return target, name and features of the processor that numba compiles for."""
    return cpu_target.target_context.codegen().magic_tuple()  # type: ignore[no-any-return]


_Dispatcher: Any = Dispatcher
_plain_hook = _Dispatcher._compilation_chain_init_hook


def _hook(dispatcher: Any) -> None:
    """Let other packages bring their types to numba where a function is not of ours."""
    if not _is_ours(dispatcher.py_func):
        _plain_hook(dispatcher)


def _is_ours(function: Any) -> bool:
    return str(function.__module__).startswith("multicell.")


def is_on_disk(dispatcher: Any) -> bool:
    """Return whether cache or pack have code of a kernel, for any arguments, of today's files."""
    if dispatcher._cache._cache_file._load_index():
        return True
    file = _pack_file(dispatcher._cache)
    return file is not None and file.pack.is_sound(file._index_path)


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


def change_numba(stamp_of: Callable[[str], Any]) -> None:
    """Change numba as the table of this module says.

    - ``stamp_of``: returns the source stamp of kernels in a file of ours; None for other files
    """
    choose_cache(vars(config))
    locator: Any = caching._SourceFileBackedLocatorMixin
    plain_stamp = locator.get_source_stamp

    def stamp(self: Any) -> Any:
        own = stamp_of(self._py_file)
        return plain_stamp(self) if own is None else own

    locator.get_source_stamp = stamp
    index: Any = caching.IndexDataCacheFile
    index._load_index, index._load_data = _index_of, _data_of
    caching.Cache.load_overload = _load_overload  # type: ignore[method-assign]
    _Dispatcher._compilation_chain_init_hook = _hook
    template: Any = _OverloadFunctionTemplate
    template._get_jit_decorator = _jit_of_overloads
    _Function.get_call_type = _call_type
    _boxers.functions |= {
        types.Array: _box_array,
        types.NamedTuple: _box_named_tuple,
        types.NamedUniTuple: _box_named_tuple,
    }
    if "numba.np.arraymath" not in sys.modules:
        linalg.ensure_blas = _assume_blas
