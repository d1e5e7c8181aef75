"""The page of validation: it lists what the tests in ``tests/validation`` compare, and no more."""

import ast
from dataclasses import replace

import pytest
from comparisons import Comparing, Comparison, store, stored_rows
from docs_programs import DOCS, program

FILES = sorted((DOCS.parent / "tests" / "validation").glob("test_*.py"))
ROWS = stored_rows()


def comparing_tests(path):
    """Return the tests of a file that ask for the fixture ``compare``."""
    items = ast.parse(path.read_text(encoding="utf-8")).body
    functions = [item for item in items if isinstance(item, ast.FunctionDef)]
    return {f.name for f in functions if "compare" in {arg.arg for arg in f.args.args}}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_test_that_compares_is_on_the_page_and_no_other(path):
    listed = {row.test.partition("[")[0] for row in ROWS if row.file == path.name}
    assert listed == {name for name in comparing_tests(path) if name.startswith("test_")}
    assert listed


def test_the_page_is_made_of_the_stored_rows():
    validation = program("validation")
    text = validation.PAGE.read_text(encoding="utf-8")
    assert validation.page(text, ROWS) == text
    assert {row.file for row in ROWS} == {path.name for path in FILES}
    assert all(row.within for row in ROWS)
    one = ROWS[0]
    other = [replace(one, ours=one.ours + 7.0 + 7.0 * one.tolerance), *ROWS[1:]]
    assert validation.page(text, other) != text
    with pytest.raises(ValueError, match="lacks the marks"):
        validation.page(text, [*ROWS, replace(one, subject="alchemy")])


def row_of(**changes):
    given = Comparison("test_a.py", "test_b", "contact", "hertz1882", "force", "value", "2", 2.1,
                       0.2, "nN", 0.1)  # fmt: skip
    return replace(given, **changes)


def test_rows_are_stored_as_they_are_read(tmp_path):
    rows = [row_of(), row_of(what="|energy|, at 1 µm", kind="deviation", theirs="∫ F", ours=1e-15)]
    store(rows, tmp_path / "rows.csv")
    assert stored_rows(tmp_path / "rows.csv") == rows


def comparing(known):
    return Comparing("test_a.py", "test_b", "contact", "hertz1882", known)


@pytest.mark.parametrize(
    ("changes", "words"),
    [({}, ""), ({"theirs": "3"}, "another theirs"), ({"tolerance": 0.3}, "another tolerance"),
     ({"ours": 2.5}, "another ours"), ({"source": "jkr1971"}, "another source"),
     ({"what": "energy"}, "is not on the page")],
)  # fmt: skip
def test_a_comparison_fails_where_the_page_states_another(changes, words):
    stored = row_of(**changes)
    compare = comparing({stored.what: stored})
    if not words:
        compare.value("force", 2.0, 2.1, 0.2, "nN")
        compare.finish()
        return
    with pytest.raises(AssertionError, match=words):
        compare.value("force", 2.0, 2.1, 0.2, "nN")


@pytest.mark.parametrize("ours", [2.3, float("nan"), float("inf")])
def test_a_comparison_fails_where_ours_is_not_within_the_tolerance(ours):
    with pytest.raises(AssertionError, match="must be within"):
        comparing(None).value("force", 2.0, ours, 0.2)
    with pytest.raises(AssertionError, match="must be within"):
        comparing(None).deviation("force", "a formula", ours, 0.2)


def test_what_the_page_lists_and_nobody_compares_fails():
    compare = comparing({"force": row_of(), "energy": row_of(what="energy")})
    compare.value("force", 2.0, 2.1, 0.2, "nN")
    with pytest.raises(AssertionError, match="energy"):
        compare.finish()
