"""Constants of pair laws: NamedTuples whose type selects the law in the kernels.

The function of a law is written with bare floats and returns a tuple of force (nN), stiffness
dF/dh (nN/µm) and energy (fJ). It is called as ``function(overlap, modulus, radius, p, ...)`` with

=============  ====================================================================
``overlap``    h = r_i + r_j - distance, µm; below zero for spheres apart
``modulus``    E_ij, kPa (eq. 3.3)
``radius``     r_ij, µm (eq. 3.4)
``p``          the constants of the law
``rest``       r_i + r_j, µm                            } only where the function has
``adhesion``   √(6πσ_ij) of the pair, (nN/µm)^½         } an argument of that name,
``unit``       the law's own unit of overlap, µm        } in one of the orders of
``onset``      the overlap in it from which it acts     } :data:`FURTHER`
=============  ====================================================================

The name of a type of constants holds a fingerprint of the function, of all functions that it
calls and of the values that they read. Compiled code is kept on disk under the types of its
arguments: after a change of any of them it is not found again, wherever they are defined. The
tuples are flat, since numba's parallel loops take no others.
"""

from __future__ import annotations

import hashlib
import re
from collections import namedtuple
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from inspect import signature
from types import CodeType, FunctionType, ModuleType
from typing import Any, final

Function = Callable[..., Any]

TINY = 1e-300
"""Keeps 0 / 0 out of a law's function where there is no overlap, and numerator and all are zero."""
BASIC = ("overlap", "modulus", "radius", "p")  # the first arguments of the function of a law
FURTHER = ((), ("rest",), ("adhesion",), ("rest", "adhesion"), ("adhesion", "unit", "onset"))
"""What the arguments after those may be."""

SHARED = ("adhesion_constant", "bond_strength", "medium_drag")
"""What the kernels add to the constants of each law: √(6πσ) where it is one for all pairs, f_ad
of receptors in nN/µm² (None without any), and 6πη in kPa s."""

_UNCHANGING = ("cmath", "math", "numba", "numpy")
"""Modules that numba compiles by itself: with another version of them it compiles anew."""

_TYPES: dict[str, Any] = {}
_FUNCTIONS: dict[Any, LawFunction] = {}


@final
@dataclass(frozen=True)
class LawFunction:
    """The function of a law and the names of its further arguments.

    ``force_alone`` and ``without_energy`` are the same with zeros in the other places of the
    result, for laws whose stiffness or energy cost more than the force; else the function itself.
    """

    whole: Function
    further: tuple[str, ...]
    without_energy: Function
    force_alone: Function


def constants_of(
    function: Function,
    *fields: str,
    without_energy: Function | None = None,
    force_alone: Function | None = None,
) -> Any:
    """Return the type of a law's constants: a NamedTuple of floats with these fields.

    - ``without_energy``, ``force_alone``: see :class:`LawFunction`
    """
    for name in fields:
        if name in SHARED or name.startswith("_") or "__" in name:
            raise TypeError(f"{name!r} cannot be the name of a constant of a law")
    further = further_arguments(function)
    mark = fingerprint(function, modules=True)
    made = _type("__".join([f"Constants_{mark}", *fields]))
    _FUNCTIONS[made] = LawFunction(
        function, further, without_energy or function, force_alone or without_energy or function
    )
    return made


def further_arguments(function: Function) -> tuple[str, ...]:
    """Return the names of the arguments after the basic ones; TypeError if they are no law's."""
    found = tuple(signature(function).parameters)
    if found[: len(BASIC)] != BASIC or found[len(BASIC) :] not in FURTHER:
        orders = "; ".join(", ".join(names) or "no more" for names in FURTHER)
        raise TypeError(
            f"{function.__name__}({', '.join(found)}) must have the arguments {', '.join(BASIC)}, "
            f"and after them one of these: {orders}"
        )
    return found[len(BASIC) :]


def function_of(constants: Any) -> LawFunction:
    """Return the function of a law from its constants or their type."""
    return _FUNCTIONS[constants if isinstance(constants, type) else type(constants)]


def fingerprint(function: Function, *, modules: bool = False) -> str:
    """Return twelve hexadecimal digits that change with a function and all that it reads.

    With ``modules`` also with the names of the modules that these come from, which compiled code
    on disk asks for when it is loaded: the same file in another folder is another module.
    """
    digest = hashlib.sha256()
    for part in _walk(function, set(), modules):
        digest.update(part)
    return digest.hexdigest()[:12]


def helpers_of(function: Function) -> list[Function]:
    """Return the plain Python functions that a function calls, and those that they call."""
    found: list[Function] = []
    left = [function]
    while left:
        called = [v for _, v in _read_by(left.pop()) if isinstance(v, FunctionType)]
        new = [other for other in called if other not in found]
        found += new
        left += new
    return found


def _walk(function: Any, seen: set[int], modules: bool) -> Iterator[bytes]:
    """Yield the code of a function and of all that it calls, and the values that they read."""
    function = getattr(function, "py_func", function)  # what numba has compiled
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


def _type(name: str) -> Any:
    """Return the type of constants with a name, always the same one."""
    if name not in _TYPES:
        fields = [*name.split("__")[1:], *SHARED]
        made = namedtuple(name, fields, defaults=(0.0, None, 0.0))  # type: ignore[misc]
        made.__module__ = __name__
        _TYPES[name] = made
    return _TYPES[name]


def __getattr__(name: str) -> Any:
    """Return a type of constants: the index of compiled code on disk asks by name for them all."""
    if name.startswith("Constants_"):
        return _type(name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
