"""The page of validation: run all comparisons of the package with published numbers and formulas.

Problem   what others publish, closed forms, and programs that share no line with the package
Question  how near is the package to each of them
Measured  the number or the largest deviation, and the CPU time, of each comparison in
          tests/validation, one file a source
Command   python docs/programs/validation.py          (some minutes; FILES for some sources alone,
          --tables from stored results)
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path

import pytest
from marked import replaced

DOCS = Path(__file__).parents[1]
TESTS = DOCS.parent / "tests"
sys.path.insert(0, str(TESTS / "helpers"))

from comparisons import ANEW, PROPERTY, STORED, Comparison, store, stored_rows  # noqa: E402

PAGE = DOCS / "validation.md"
HEADER = ("comparison", "source", "theirs", "ours", "within", "CPU time")


class Recorder:
    """A plugin of pytest that collects what tests compare."""

    def __init__(self) -> None:
        self.rows: list[Comparison] = []

    def pytest_configure(self, config: pytest.Config) -> None:
        """Tell tests that stored rows are about to change."""
        config.pluginmanager.register(object(), ANEW)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take the rows of a test from its report, once it has ended."""
        if report.when == "teardown":
            found = [text for name, text in report.user_properties if name == PROPERTY]
            self.rows += [Comparison(**json.loads(text)) for text in found]


def measured(files: list[Path]) -> list[Comparison]:
    """Run tests of validation and return what they compare; end the program if one fails."""
    recorder = Recorder()
    code = pytest.main(["-q", "-p", "no:cacheprovider", *map(str, files)], plugins=[recorder])
    if code != 0:
        raise SystemExit(f"nothing is stored: pytest ended with {int(code)}")
    return recorder.rows


def quantity(number: float, unit: str) -> str:
    """Return a number with three digits and its unit."""
    text = f"{number:.3g}"
    if "e" in text:
        digits, _, power = text.partition("e")
        text = f"{digits}·10{superscript(int(power))}"
    return f"{text} {unit}".replace(" %", " %").strip()


def superscript(power: int) -> str:
    """Return a whole number as an exponent."""
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def cited(source: str) -> str:
    """Return a source as the page cites it: by its key, or in words."""
    return f"{{cite:t}}`{source}`" if re.fullmatch(r"[a-z]+\d{4}[a-z]*", source) else source


def line(row: Comparison) -> str:
    """Return a row of the page."""
    if row.kind == "value":
        # as many digits as the tolerance leaves
        places = max(0, 1 - exponent(row.tolerance))
        theirs, ours = (f"{x:.{places}f} {row.unit}".strip() for x in (float(row.theirs), row.ours))
    else:
        theirs, ours = row.theirs, f"off by {quantity(row.ours, row.unit)}"
    cost = "< 0.1 s" if row.cost < 0.1 else f"{row.cost:.1f} s"
    entries = (row.what, cited(row.source), theirs, ours, quantity(row.tolerance, row.unit), cost)
    return "| " + " | ".join(entry.replace("|", "\\|") for entry in entries) + " |"


def exponent(number: float) -> int:
    """Return the power of ten of a number's first digit."""
    return int(f"{number:e}".partition("e")[2])


def table(rows: list[Comparison]) -> str:
    """Return the rows of one subject as a table in Markdown."""
    lines = ["| " + " | ".join(HEADER) + " |", "|---" * len(HEADER) + "|"]
    return "\n".join([*lines, *map(line, rows)])


def page(text: str, rows: list[Comparison]) -> str:
    """Return the page with a table for each subject.

    Raises
    ------
    ValueError
        If the page has no place for a subject.
    """
    subjects = dict.fromkeys(row.subject for row in rows)
    for subject in subjects:
        chosen = [row for row in rows if row.subject == subject]
        text = replaced(text, f"comparisons: {subject}", table(chosen))
    return text


def main() -> None:
    """Measure, store, and make the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path, help="of tests/validation; all by default")
    parser.add_argument("--tables", action="store_true", help="make the page from stored results")
    given = parser.parse_args()
    if not given.tables:
        files = [file.resolve() for file in given.files] or [TESTS / "validation"]
        rows = measured(files)
        if given.files:
            done = {file.name for file in files}
            rows += [row for row in stored_rows() if row.file not in done]
        store(rows)
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), stored_rows()), encoding="utf-8")
    print(f"{len(stored_rows())} comparisons of {STORED.name} stand in {PAGE.name}")


if __name__ == "__main__":
    main()
