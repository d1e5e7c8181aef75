"""Encodings, separators and decimal commas: found, or refused where two things may be meant."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from multicell.errors import DataError
from multicell.tables.columns import from_bytes
from multicell.tables.text import text_form

TITLES = ("POSITION_X", "Time (h)", "Diameter, mean [µm]", "SD", "Ø [µm²]", "phi", "A1: Image 1")


def written(titles, rows, separator, comma, encoding, quoting):
    text = io.StringIO()
    writer = csv.writer(text, delimiter=separator, quoting=quoting)
    writer.writerow(titles)
    for row in rows:
        writer.writerow([f"{x:.4f}".replace(".", "," if comma else ".") for x in row])
    return text.getvalue().encode(encoding)


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.sampled_from(TITLES), min_size=2, max_size=6, unique=True),
    st.integers(1, 30),
    st.sampled_from([(",", False), (";", True), (";", False), ("\t", True), ("\t", False),
                     ("|", False), ("|", True)]),
    st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-32", "cp1252", "utf-16-le"]),
    st.sampled_from([csv.QUOTE_MINIMAL, csv.QUOTE_ALL]),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_a_table_is_read_however_it_is_written(titles, count, marks, encoding, quoting, seed):
    numbers = np.random.default_rng(seed).uniform(-500, 5e4, (count, len(titles))).round(4)
    content = written(titles, numbers, *marks, encoding, quoting)
    table = from_bytes(content, "t.csv")
    assert list(table.columns) == titles
    np.testing.assert_array_equal(np.stack(list(table.columns.values()), axis=1), numbers)
    assert table.form.separator == marks[0]


@pytest.mark.parametrize(
    ("encoding", "label"),
    [("cp932", "腫瘍の細胞塊を培養した"), ("gb18030", "肿瘤细胞球体培养实验数据"),
     ("cp1251", "Опухолевые клетки в культуре"), ("cp1252", "tumeurs cultivées à l'été")],
)  # fmt: skip
def test_labels_of_other_languages_are_read(encoding, label):
    rows = "".join(f"{k},{label}\n" for k in range(20))
    table = from_bytes(f"x,label\n{rows}".encode(encoding), "t.csv")
    assert table.columns["label"].tolist() == [label] * 20


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x;y\n1,234;5,678\n", "thousands, or three decimals"),
        ("x;y\n1,5;5.5\n", "decimal points and commas"),
        ("x;y\n1,25;5\n" + "1,25;6\n" * 400 + "2.5;3\n", "'2.5' in a table with decimal commas"),
        ("x;y\n1;2\n3\n", "has 1 fields, the header has 2"),
    ],
)
def test_what_may_mean_two_things_is_refused(text, said):
    with pytest.raises(DataError, match=said):
        from_bytes(text.encode(), "t.csv")


def test_other_lines_above_the_titles_are_left_out_and_lines_are_those_of_the_file():
    text = "Vessel: 1\nMetric: Area (µm²)\n\nTime\tA1\tA2\n0\t1\t2\n6\t3\t4\n"
    table = from_bytes(text.encode("utf-16"), "t.txt")
    assert table.form.above == 2
    assert table.lines.tolist() == [5, 6]
    assert table.columns["A2"].tolist() == [2, 4]


def test_a_table_of_multicell_has_the_plain_form():
    form = text_form(b"# remark\nx_um,y_um,type\n0,1.5,soft\n", "t.csv")
    assert form.plain
    assert form.words() == ""


def test_text_below_numbers_makes_a_column_text_in_blocks(monkeypatch):
    monkeypatch.setattr("multicell.tables.columns._ROWS", 3)
    table = from_bytes(
        b"n,type\n" + b"".join(b"%d,0%d\n" % (k, k) for k in range(7)) + b"7,a\n", "t"
    )
    assert table.columns["n"].tolist() == list(range(8))
    assert table.columns["type"].tolist() == ["00", "01", "02", "03", "04", "05", "06", "a"]
