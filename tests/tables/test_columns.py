"""Columns of CSV and Parquet files, data frames and mappings: the same from each of them."""

from __future__ import annotations

import io

import numpy as np
import pandas as pd
import pytest

from multicell.errors import DataError
from multicell.tables.columns import from_bytes, from_object, refuse_twins
from multicell.tables.titles import Title, read_title, split_title, titled

KNOWN = {"radius": "um", "phase": "", "phase_length": "s", "stress": "kPa", "flow": "nN/um"}


def equal(one, other):
    assert list(one.columns) == list(other.columns)
    for title, column in one.columns.items():
        np.testing.assert_array_equal(column, other.columns[title], strict=True)


def test_a_table_is_the_same_from_each_source():
    frame = pd.DataFrame(
        {
            "n": [1, 2, 3],
            "x": [0.1, -2.5e-7, 1e300],
            "word": ["a", "b c", "ß"],
            "whole": [1.0, 2, 3],
        }
    )
    parquet = io.BytesIO()
    frame.to_parquet(parquet)
    tables = [
        from_object(frame, "cells"),
        from_object(dict(frame), "cells"),
        from_object({title: list(column) for title, column in frame.items()}, "cells"),
        from_bytes(frame.to_csv(index=False).encode(), "cells"),
        from_bytes(parquet.getvalue(), "cells"),
    ]
    for table in tables[1:]:
        equal(tables[0], table)
    assert tables[0].place(1, "x") == "cells, row 1, 'x'"
    assert tables[3].place(1, "x") == "cells, line 3, 'x'"


def test_lines_are_those_of_the_file():
    table = from_bytes(b"\xef\xbb\xbf# a\n\n x, y\r\n1,2\r\n,,\n# b\n3,4\n", "t.csv")
    assert table.lines.tolist() == [4, 7]
    assert table.columns["x"].tolist() == [1, 3]


class Counted(str):
    """A title that counts how often one is compared with another."""

    compared = 0
    __hash__ = str.__hash__

    def __eq__(self, other):
        Counted.compared += 1
        return str.__eq__(self, other)


def test_two_columns_of_one_title_are_found_by_a_look_at_each():
    titles = [Counted(f"cell {k}") for k in range(3000)]
    refuse_twins(titles, "t")
    assert Counted.compared < 10 * len(titles)
    with pytest.raises(DataError, match="t, 'cell 7': is the title of two columns"):
        refuse_twins([*titles, Counted("cell 7")], "t")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "t: holds no data"),
        (b"x,y\n", "t: holds no rows"),
        (b"x,y\n1,2\n\n3\n", "t, line 4: has 1 fields, the header has 2"),
        (b"x,x\n1,2\n", "t, 'x': is the title of two columns"),
        (b"x,y\n1,\x00\xff\xfe\xd8\n", r"t: is not UTF-8 text \(byte 7\)"),
        (b"PAR1 and nothing more", "t: is no Parquet file"),
    ],
)
def test_broken_files_are_refused_by_place(content, said):
    with pytest.raises(DataError, match=said):
        from_bytes(content, "t")


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (3, "cells: is a int, must be a file, a DataFrame or columns by title"),
        ({"x": [1, 2], "y": [1]}, "different lengths: 'x' 2, 'y' 1"),
        ({"x": 5}, "'x': is not a column of single values"),
        ({}, "cells: holds no rows"),
    ],
)
def test_objects_that_are_no_tables_are_refused(source, said):
    with pytest.raises(DataError, match=said):
        from_object(source, "cells")


@pytest.mark.parametrize(
    ("title", "name", "factor"),
    [
        ("radius_µm", "radius", 1.0),
        ("radius / nm", "radius", 0.001),
        ("radius [um]", "radius", 1.0),
        ("phase_length_h", "phase_length", 3600.0),
        ("phase", "phase", 1.0),
        ("flow_mN_per_m", "flow", 1.0),
    ],
)
def test_titles_name_columns_and_units(title, name, factor):
    found = read_title(title, KNOWN, "t")
    assert found.name == name
    assert found.factor == pytest.approx(factor, rel=1e-9)


def test_titles_have_a_name_and_perhaps_a_unit():
    titles = {
        "cells.young (kPa)": ("cells.young", "kPa"),
        " contact.law ": ("contact.law", ""),
        "a [nN/um]": ("a", "nN/um"),
        "a / nN/(um s)": ("a", "nN/(um s)"),
        "diameter sd/%": ("diameter sd", "%"),
    }
    assert {title: split_title(title) for title in titles} == titles


def test_every_title_that_is_written_is_read():
    for name, unit in KNOWN.items():
        assert read_title(titled(name, unit), KNOWN, "t") == Title(name, 1.0)
    assert read_title("radii_um", KNOWN, "t") is None


@pytest.mark.parametrize(
    ("title", "said"),
    [
        ("radius", "t, 'radius': has no unit. Title it 'radius_um'"),
        ("radius_s", "has the unit 's', must be one like um"),
        ("phase_um", "has the unit 'um', but phase is a number or a word without a unit"),
    ],
)
def test_titles_with_wrong_units_are_refused(title, said):
    with pytest.raises(DataError, match=said):
        read_title(title, KNOWN, "t")
