"""Promises of parts, and how checks say which of them are broken."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, final


@final
class BrokenPromise(AssertionError):  # noqa: N818 - it names what happened to a promise
    """A promise that is not kept, in words."""


def require(kept: object, problem: str) -> None:
    """Raise :class:`BrokenPromise` with the problem unless a promise is kept."""
    if not kept:
        raise BrokenPromise(problem)


def carry_out_tests(tests: object, subject: Any, name: str) -> None:
    """Raise ``AssertionError`` with all promises that methods ``test_...`` find broken."""
    problems = []
    for test in (x for kind in type(tests).__mro__ for x in vars(kind) if x.startswith("test_")):
        try:
            getattr(tests, test)(subject)
        except BrokenPromise as error:
            problems.append(str(error))
    fail_with(name, problems)


def fail_with(name: str, problems: Iterable[str]) -> None:
    """Raise ``AssertionError`` with the name of a part and its problems, if there are any."""
    found = "; ".join(dict.fromkeys(problems))
    if found:
        raise AssertionError(f"{name}: {found}")
