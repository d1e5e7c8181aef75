"""Types that stand for functions: kernels reach a function by the type of an argument.

The name of a type holds a fingerprint of the function and of all that it reads. Compiled code is
kept on disk under the types of its arguments, so that after a change it is not found again.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Sequence
from typing import Any


def stand_in_types(
    module: str,
    prefix: str,
    fields: Callable[[str], Sequence[str]],
    defaults: Sequence[Any] = (),
) -> tuple[Callable[[str], Any], Callable[[str], Any]]:
    """Return the function that gives the type with a name, and the ``__getattr__`` of its module.

    The index of compiled code on disk asks the module by name for each type.

    - ``module``: whose attributes the types are
    - ``prefix``: with which their names begin
    - ``fields``: of the NamedTuple with a name
    - ``defaults``: of its last fields
    """
    types: dict[str, Any] = {}

    def type_named(name: str) -> Any:
        if name not in types:
            made = namedtuple(name, [*fields(name)], defaults=[*defaults])  # type: ignore[misc]
            made.__module__ = module
            types[name] = made
        return types[name]

    def attribute(name: str) -> Any:
        if name.startswith(prefix):
            return type_named(name)
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return type_named, attribute
