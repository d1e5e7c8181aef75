"""Promises of parts, and how checks say which of them are broken."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, final


@final
class BrokenPromise(AssertionError):  # noqa: N818 - it names what happened to a promise
    """A promise that is not kept, in words."""


def require(kept: object, problem: str) -> None:
    """Raise :class:`BrokenPromise` with the problem unless a promise is kept."""
    if not kept:
        raise BrokenPromise(problem)


def carry_out_checks(checks: Iterable[Callable[[Any], None]], subject: Any, name: str) -> None:
    """Raise ``AssertionError`` with all promises that checks of a subject find broken."""
    problems = []
    for check in checks:
        try:
            check(subject)
        except BrokenPromise as error:
            problems.append(str(error))
    fail_with(name, problems)


def carry_out_tests(tests: object, subject: Any, name: str) -> None:
    """Raise ``AssertionError`` with all promises that methods ``test_...`` find broken."""
    names = [test for test in vars(type(tests)) if test.startswith("test_")]
    carry_out_checks([getattr(tests, test) for test in names], subject, name)


def fail_with(name: str, problems: Iterable[str]) -> None:
    """Raise ``AssertionError`` with the name of a part and its problems, if there are any."""
    found = "; ".join(dict.fromkeys(problems))
    if found:
        raise AssertionError(f"{name}: {found}")
