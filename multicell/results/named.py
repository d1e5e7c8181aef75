"""Tables by name whose errors say which name is near."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn, TypeVar, final

from multicell.schema import near_miss

V = TypeVar("V")


@final
class Named(dict[str, V]):
    """A dictionary of what a result holds by name, such as the columns of its history."""

    def __init__(self, entries: Mapping[str, V], what: str) -> None:
        super().__init__(entries)
        self._what = what

    def __missing__(self, name: object) -> NoReturn:
        raise KeyError(f"there is no {self._what} {name!r}. {near_miss(str(name), self)}")

    def __reduce__(self) -> tuple[Any, ...]:
        return Named, (dict(self), self._what)
