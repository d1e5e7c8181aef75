"""Units of observables of the user's own, as scenes of this process state them.

Those who read results ask by the name of a column alone, also where the function that made it is
not loaded. A scene enters its observables once it is accepted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from multicell.scene.parts import OwnObservable

_STATED: Final[dict[str, set[str]]] = {}


def enter_units(observables: Mapping[str, OwnObservable]) -> None:
    """Enter the units of a scene's observables of the user's own."""
    for name, own in observables.items():
        _STATED.setdefault(name, set()).add(own.unit)


def own_units(name: str) -> set[str]:
    """Return the units that scenes of this process state for an observable of the user's own."""
    return set(_STATED.get(name, ()))


def own_names() -> list[str]:
    """Return the observables of the user's own that scenes have named in this process."""
    return list(_STATED)
