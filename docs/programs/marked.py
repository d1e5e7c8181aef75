"""Blocks of pages that are made by scripts: what stands between two marks is replaced."""

from __future__ import annotations


def replaced(text: str, name: str, block: str) -> str:
    """Return a page with one of its marked blocks replaced.

    Raises
    ------
    ValueError
        If the page has no such marks.
    """
    begin, end = f"<!-- {name}: made by a script -->", f"<!-- end of {name} -->"
    before, found, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"the page lacks the marks {begin!r} and {end!r}")
    return f"{before}{begin}\n\n{block}\n\n{end}{after}"
