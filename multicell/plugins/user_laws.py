"""Laws of the user's own: the class that a decorated function stands for, and its fingerprint."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import MISSING
from typing import Any

from multicell.errors import SceneError
from multicell.plugins.fingerprints import fingerprint
from multicell.plugins.laws import Laws, OwnLaw
from multicell.plugins.named import load_object
from multicell.schema import number, quantity
from multicell.schema import parameters as declare
from multicell.units import is_unit, shown


def load_law(spec: str) -> type[OwnLaw]:
    """Return the law that ``file.py:Name`` names, after which scenes may name it as well.

    Raises
    ------
    SceneError
        If it cannot be loaded, or is neither a pair law (:func:`pair_law`) nor a growth law
        (:func:`multicell.growth_law`).
    """
    found = load_object(spec, "law")
    if not (isinstance(found, type) and issubclass(found, OwnLaw)):
        hint = "A function becomes one by the decorator multicell.pair_law or growth_law."
        raise SceneError("law", f"{spec!r} is neither a pair law nor a growth law", hint)
    return found


def refuse_names(base: type[OwnLaw], names: Mapping[str, Any], hidden: Sequence[str] = ()) -> None:
    """Refuse parameters with a name that laws of a kind have, unless they may hide it."""
    if not isinstance(names, Mapping):
        raise TypeError(
            f"parameters are {shown(names)}, must be names with units: {{'stiffness': 'nN/um'}}"
        )
    taken = [name for name in names if hasattr(base, name) and name not in hidden]
    if taken:
        raise TypeError(f"{taken[0]!r} cannot be the name of a parameter of a law")


def law_of(
    base: type[OwnLaw],
    function: Any,
    parameters: Mapping[str, Any],
    laws: Laws[Any],
    read: Sequence[Any],
    attributes: Mapping[str, Any],
) -> type[Any]:
    """Return the class of laws that a user's function stands for: the same one for the same code.

    - ``base``: of what kind it is, with ``attributes`` of its own
    - ``laws``: where it is entered
    - ``read``: the functions that its fingerprint is of
    """
    declared = {name: _declaration(name, entry) for name, entry in parameters.items()}
    source = f"{os.path.basename(function.__code__.co_filename)}:{function.__qualname__}"
    mark = _mark_of(read, declared)
    if f"{source}@{mark}" in laws:
        return laws[f"{source}@{mark}"]
    members = {
        **{name: getattr(function, name) for name in ("__doc__", "__module__", "__qualname__")},
        **declared,
        "__annotations__": dict.fromkeys(parameters, float),
        "source": source,
        "fingerprint": mark,
        **attributes,
    }
    law: type[Any] = declare(type(function.__name__, (base,), members))
    laws.add(source, mark, law)
    return law


def _mark_of(functions: Sequence[Any], declared: Mapping[str, Any]) -> str:
    """Return the fingerprint of a law: of its functions and of its declared parameters."""
    stated = []
    for name, column in declared.items():
        spec = column.metadata["parameter"]
        default = "" if column.default is MISSING else repr(column.default)
        stated.append(f"{name} {spec.unit} {spec.bounds} {default}")
    given = hashlib.sha256("\n".join([*map(fingerprint, functions), *stated]).encode())
    return given.hexdigest()[:12]


def _declaration(name: str, entry: Any) -> Any:
    """Return the declaration of a parameter that is given by its unit."""
    if not isinstance(entry, str):
        return entry
    if entry and not is_unit(entry):
        hint = "Write for example 'nN/um', 'kPa', 'um', 's', or '' for a plain number."
        raise SceneError(f"parameters.{name}", f"has the unknown unit {entry!r}", hint)
    return quantity(entry) if entry else number()
