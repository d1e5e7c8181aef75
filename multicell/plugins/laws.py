"""Registries of laws by their names in a scene: ours, and those made in this process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar, Generic, TypeVar, final

L = TypeVar("L")


class OwnLaw:
    """Base of all laws of the user's own: their origin.

    - ``source``: ``file.py:name`` of the function
    - ``fingerprint``: changes with the function and all that it reads
    """

    source: ClassVar[str]
    fingerprint: ClassVar[str]

    @classmethod
    def scene_name(cls) -> str:
        """Return the name of the law in a scene, ``file.py:name@fingerprint``."""
        return f"{cls.source}@{cls.fingerprint}"


@final
class Laws(Mapping[str, type[L]], Generic[L]):
    """Laws by the name that a scene gives; our own are listed, the user's only found.

    A law of the user's own is named ``file.py:name@fingerprint``. Without the fingerprint the name
    means the one that was made last; with it no other law is taken for it, so that a scene on disk
    means the same law for ever.
    """

    def __init__(self, laws: Mapping[str, type[L]]) -> None:
        self._ours = dict(laws)
        self._own: dict[str, type[L]] = {}
        self._latest: dict[str, str] = {}

    def add(self, source: str, fingerprint: str, law: type[L]) -> None:
        """Enter a law of the user's own."""
        name = f"{source}@{fingerprint}"
        self._own[name] = law
        self._latest[source] = name

    def __getitem__(self, name: str) -> type[L]:
        return self._ours[name] if name in self._ours else self._own[self._latest.get(name, name)]

    def __contains__(self, name: object) -> bool:
        return name in self._ours or name in self._own or name in self._latest

    def __iter__(self) -> Iterator[str]:
        return iter(self._ours)

    def __len__(self) -> int:
        return len(self._ours)

    def hint(self, name: str) -> str:
        """Return a hint for a scene that names a law of the user's own that is not there."""
        source = name.partition("@")[0]
        if source in self._latest:
            return f"'{source}' has changed since: as it is now it is '{self._latest[source]}'."
        if ":" not in source:
            return ""
        return f"No scene runs a file by itself: name it with --law {source}, or import it first."
