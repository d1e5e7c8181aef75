"""Comparisons of the package with what others publish or a formula gives, as rows of a table.

Each file of ``tests/validation`` is one source: its constant ``SOURCE`` is a key of
``docs/references.bib`` or says in words where the numbers come from, and ``SUBJECT`` names the
table of the page that lists it. A test measures, and hands what it finds to its fixture
``compare``::

    def test_rest(compare):
        compare.value("distance at rest", 17.178, found, tolerance=5e-4, unit="µm")
        compare.deviation("force", "4/3 E* √r h^1.5", np.abs(ours / theirs - 1).max(), 1e-12)

``python docs/programs/validation.py`` runs all of them, stores the rows, and makes the page.
"""

from __future__ import annotations

import csv
import math
import time
from dataclasses import asdict, dataclass, fields
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
STORED = DOCS / "chart-data" / "validation.csv"
PROPERTY = "comparison"
"""Name under which a test hands a row to the program that stores it."""
ANEW = "comparisons are stored"
"""Name of a plugin of pytest while that program runs."""


@dataclass(frozen=True)
class Comparison:
    """One row: what is compared, what others have, what the package has, and how near it must be.

    ``kind`` is "value" where both are numbers, and "deviation" where ``theirs`` is a formula or a
    program and ``ours`` the largest distance from it. ``cost`` is CPU time in s.
    """

    file: str
    test: str
    subject: str
    source: str
    what: str
    kind: str
    theirs: str
    ours: float
    tolerance: float
    unit: str
    cost: float

    @property
    def off(self) -> float:
        """How far ours is from theirs."""
        return abs(self.ours - float(self.theirs)) if self.kind == "value" else self.ours

    @property
    def within(self) -> bool:
        """Whether ours is as near as it must be; not if it is no number."""
        return math.isfinite(self.off) and self.off <= self.tolerance

    def differs(self, stored: Comparison) -> str:
        """Return the column by which a stored row is another one, or nothing.

        What was measured, also elsewhere, may differ by as much as the comparison allows.
        """
        for name in ("subject", "source", "kind", "theirs", "unit"):
            if getattr(self, name) != getattr(stored, name):
                return name
        # a part of a value that processors round differently
        if not math.isclose(self.tolerance, stored.tolerance, rel_tol=1e-9):
            return "tolerance"
        return "" if abs(self.ours - stored.ours) <= self.tolerance else "ours"


def stored_rows(path: Path = STORED) -> list[Comparison]:
    """Return the rows of the page."""
    numbers = {field.name for field in fields(Comparison) if field.type == "float"}
    with path.open(encoding="utf-8", newline="") as file:
        return [
            Comparison(**{k: float(v) if k in numbers else v for k, v in row.items()})
            for row in csv.DictReader(file)
        ]


def store(rows: list[Comparison], path: Path = STORED) -> None:
    """Write rows for the page, ordered by file, with numbers that are short enough to read."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Comparison)])
        writer.writeheader()
        for row in sorted(rows, key=lambda row: row.file):
            cost, ours = float(f"{row.cost:.2g}"), float(f"{row.ours:.10g}")
            writer.writerow(asdict(row) | {"cost": cost, "ours": ours})


class Comparing:
    """The fixture ``compare`` of one test; it fails where a comparison or its stored row does."""

    def __init__(self, file: str, test: str, subject: str, source: str, known: dict | None) -> None:
        """Compare in a test; ``known`` are its stored rows by what they compare, if they count."""
        self.place = {"file": file, "test": test, "subject": subject, "source": source}
        self.known, self.rows = known, []
        self._since = time.process_time()

    def value(
        self, what: str, theirs: float, ours: float, tolerance: float, unit: str = ""
    ) -> None:
        """Compare a number with theirs; both in ``unit``."""
        self._add(what, "value", f"{theirs:.12g}", ours, tolerance, unit)

    def deviation(
        self, what: str, theirs: str, ours: float, tolerance: float, unit: str = ""
    ) -> None:
        """Compare with a formula, a table or a program, by the largest distance from it."""
        self._add(what, "deviation", theirs, ours, tolerance, unit)

    def _add(
        self, what: str, kind: str, theirs: str, ours: float, tolerance: float, unit: str
    ) -> None:
        now = time.process_time()
        row = Comparison(
            **self.place, what=what, kind=kind, theirs=theirs, ours=float(ours),
            tolerance=float(tolerance), unit=unit, cost=now - self._since,
        )  # fmt: skip
        self._since = now
        assert what not in {other.what for other in self.rows}, f"{what!r} is compared twice"
        self.rows.append(row)
        assert row.within, f"{what}: {row.off:.3g} {unit} from {theirs}, must be within {tolerance}"
        if self.known is not None:
            again = "run python docs/programs/validation.py"
            assert what in self.known, f"{what!r} is not on the page of validation: {again}"
            column = row.differs(self.known[what])
            assert not column, f"{what!r} is on the page with another {column}: {again}"

    def finish(self) -> None:
        """See that the page lists nothing else of this test."""
        more = {*(self.known or {})} - {row.what for row in self.rows}
        assert not more, f"the page of validation lists {sorted(more)}, which nobody compares"
