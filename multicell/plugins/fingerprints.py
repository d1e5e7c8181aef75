"""Fingerprints of users' functions: digests of their code and of all that they read.

Compiled code is kept on disk under them, and scenes and results name laws by them.
"""

from __future__ import annotations

import hashlib
import inspect
import re
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any

_UNCHANGING = ("cmath", "math", "numba", "numpy")
"""Modules that numba compiles by itself: with another version of them it compiles anew."""

_ANY_NUMBER = inspect.CO_VARARGS | inspect.CO_VARKEYWORDS
"""Flags of code that takes any number of arguments."""


def fingerprint(function: Callable[..., Any], *, modules: bool = False) -> str:
    """Return twelve hexadecimal digits that change with a function and all that it reads.

    With ``modules`` also with the names of the modules that these come from, which compiled code
    on disk asks for when it is loaded: the same file in another folder is another module.
    """
    digest = hashlib.sha256()
    for part in _walk(function, set(), modules):
        digest.update(part)
    return digest.hexdigest()[:12]


def helpers_of(function: Callable[..., Any]) -> list[Callable[..., Any]]:
    """Return the plain Python functions that a function calls, and those that they call."""
    found: list[Callable[..., Any]] = []
    left = [function]
    while left:
        called = [v for _, v in _read_by(left.pop()) if isinstance(v, FunctionType)]
        new = [other for other in called if other not in found]
        found += new
        left += new
    return found


def _walk(function: Any, seen: set[int], modules: bool) -> Iterator[bytes]:
    """Yield the code of a function and of all that it calls, and the values that they read."""
    function = getattr(function, "py_func", function)  # a function that numba has compiled
    if id(function) in seen:
        return
    seen.add(id(function))
    yield from _code(function.__code__)
    if modules:
        yield str(function.__module__).encode()
    yield repr((function.__defaults__, function.__kwdefaults__)).encode()
    for name, value in _read_by(function):
        yield name.encode()
        if isinstance(value, FunctionType) or hasattr(value, "py_func"):
            yield from _walk(value, seen, modules)
        elif not isinstance(value, ModuleType):
            # an address is another one in each process
            text = re.sub(" at 0x[0-9a-fA-F]+", "", repr(value))
            yield value.tobytes() if hasattr(value, "tobytes") else text.encode()


def _code(code: CodeType) -> Iterator[bytes]:
    yield repr((code.co_argcount, code.co_kwonlyargcount, code.co_flags & _ANY_NUMBER)).encode()
    yield code.co_code
    yield repr(code.co_names).encode()
    for constant in code.co_consts[1:] if code.co_consts else ():  # the first is the docstring
        if isinstance(constant, CodeType):
            yield from _code(constant)
        else:
            yield repr(constant).encode()


def _read_by(function: Any) -> list[tuple[str, Any]]:
    """Return all that a function reads: globals, enclosing variables, attributes of modules."""
    names = list(_names(function.__code__))
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    found = [(n, function.__globals__[n]) for n in names if n in function.__globals__]
    found += [(name, cell.cell_contents) for name, cell in cells]
    modules = [value for _, value in found if isinstance(value, ModuleType)]
    for module in modules:  # those of modules in modules are found in the same way
        if module.__name__.split(".")[0] in _UNCHANGING:
            continue
        inside = [(n, getattr(module, n)) for n in names if hasattr(module, n)]
        modules += [x for _, x in inside if isinstance(x, ModuleType) and x not in modules]
        found += inside
    return found


def _names(code: CodeType) -> Iterator[str]:
    """Yield the names that a function reads, and those that functions within it read."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)
