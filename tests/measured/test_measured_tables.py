"""Tables of measurements as people have them, read without a change to the file."""

from __future__ import annotations

import math

import numpy as np
import pytest

import multicell as mc
from multicell.errors import DataError
from multicell.measured.data import read_data
from multicell.measured.table import read_measurements

SCENE = mc.load_scene("growth")


def data_of(table, **how):
    return read_data(table, SCENE, **how).data


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("Time (h),Diameter [µm],SD\n24,100.5,5\n48,150.25,6\n", "utf-8"),
        ("time / h, diameter / um, diameter sd / um\n24,100.5,5\n48,150.25,6\n", "utf-8"),
        ("Time (h);Diameter (µm);Std Dev\n24;100,5;5,0\n48;150,25;6\n", "cp1252"),
        ("Day\tRadius (µm)\tRadius SD (µm)\n1\t50.25\t2.5\n2\t75.125\t3\n", "utf-16"),
        (",Hours,Diameter (mm),SEM\n0,24,0.1005,0.005\n1,48,0.15025,0.006\n", "utf-8-sig"),
    ],
)
def test_titles_that_people_write_are_read(text, encoding, tmp_path):
    path = tmp_path / "d.csv"
    path.write_bytes(text.encode(encoding))
    found = data_of(path)
    assert [datum.time for datum in found] == [86400.0, 172800.0]
    double = 2.0 if found[0].observable == "radius" else 1.0
    assert [double * d.value for d in found] == pytest.approx([100.5, 150.25])
    assert [double * d.sigma for d in found] == pytest.approx([5.0, 6.0])
    assert math.isinf(found[0].tissues) == ("SEM" in text)


@pytest.mark.parametrize("power", [2, 3])
@pytest.mark.parametrize("name", ["Area", "Radius", "Diameter"])
def test_an_area_or_a_volume_is_that_of_a_disc_or_a_ball(power, name):
    """The error of the length follows by finite differences of the size."""
    length = "radius" if name == "Radius" else "diameter"
    radius = 60.0

    def size(r):
        return math.pi * r**2 if power == 2 else 4.0 / 3.0 * math.pi * r**3

    error = (size(radius + 1e-4) - size(radius - 1e-4)) / 2e-4
    title = "Volume" if name == "Area" and power == 3 else name
    rows = {"Time (h)": [24.0], f"{title} (um^{power})": [size(radius)], "SD": [error]}
    (datum,) = data_of(rows)
    double = 2.0 if length == "diameter" else 1.0
    assert datum.observable == length
    assert datum.value == pytest.approx(double * radius)
    assert datum.sigma == pytest.approx(double, rel=1e-6)
    relative = {"time / h": [24.0], f"{title} (um^{power})": [size(radius)], "sd / %": [6.0]}
    (datum,) = data_of(relative)
    assert datum.sigma == pytest.approx(double * radius * 0.06 / power)


LONG = {
    "CellLine": ["a", "a", "b", "a"],
    "Seeded": [500, 500, 500, 1000],
    "Day": [1, 2, 1, 1],
    "R": [50.0, 60.0, 1.0, 80.0],
    "ϕ": [0.5, 0.25, 1.0, 0.1],
}


def test_rows_are_chosen_and_columns_are_named():
    names = "day=Day, radius=R um, necrotic_radius=φ*R um"
    table = read_measurements(LONG, names, "CellLine=a, Seeded=500")
    found = data_of(table)
    values = {(d.observable, d.time / 86400): d.value for d in found}
    assert values == {("radius", 1): 50.0, ("radius", 2): 60.0,
                      ("necrotic_radius", 1): 25.0, ("necrotic_radius", 2): 15.0}  # fmt: skip
    assert table.said.startswith("data read: 2 of 4 rows; day = Day, radius = R um")
    table = read_measurements(LONG, names, "CellLine=a|b, Day=1..1.5, Seeded=500.0")
    assert [row[1] for row in table.rows] == ["50.0", "1.0"]


def test_columns_can_be_named_in_toml(tmp_path):
    path = tmp_path / "names.toml"
    path.write_text('[columns]\nday = "Day"\nradius = "R 2 um"\n')
    found = data_of(read_measurements(LONG, str(path), "CellLine=b"))
    assert [datum.value for datum in found] == [2.0]


def test_columns_side_by_side_are_specimens_that_were_followed():
    wide = {"Day": [1, 2], "A1": [50.0, 60.0], "A2": [52.0, math.nan], "note": ["", "lost"]}
    table = read_measurements(wide, 'day=Day, radius="A*" um')
    assert table.titles == ("day", "radius / um", "specimen")
    assert table.rows == (("1", "50.0", "A1"), ("2", "60.0", "A1"), ("1", "52.0", "A2"))
    assert "1 without a value are left out" in table.said


INCUCYTE = (
    "Vessel Name: Plate 7\nMetric: Largest Brightfield Object Area (µm²)\n"
    "Cell Type: WM\n\nDate Time\tElapsed\tA1\tA2\tA1 (Std Err Img)\n"
    "10/07/2026 10:04:00 AM\t0\t{0}\t{1}\t12\n10/07/2026 4:04:00 PM\t6\t{2}\t\t12\n"
)


def test_an_incucyte_s_export_is_read_as_it_is(tmp_path):
    sizes = [math.pi * r**2 for r in (100.0, 110.0, 120.0)]
    path = tmp_path / "plate.txt"
    path.write_bytes(INCUCYTE.format(*sizes).encode("utf-16"))
    table = read_measurements(path)
    assert "an Incucyte's Largest Brightfield Object Area (µm²) of 2 wells" in table.said
    assert [row[::2] for row in table.rows] == [("0", "A1"), ("6", "A1"), ("0", "A2")]
    np.testing.assert_allclose([float(row[1]) for row in table.rows], [200.0, 240.0, 220.0])
    path.write_text(INCUCYTE.replace("(µm²)", "(%)").format(1, 2, 3))
    with pytest.raises(DataError, match="with the metric 'Largest Brightfield Object Area"):
        read_measurements(path)


def test_a_sheet_is_chosen_by_name(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["about"])
    sheet = book.create_sheet("growth")
    for row in (["Time (h)", "Diameter (µm)"], [24, 100.5], [48, None]):
        sheet.append(row)
    book.save(tmp_path / "d.xlsx")
    names = 'sheet=growth, time="Time (h)", diameter="Diameter (µm)"'
    (datum,) = data_of(read_measurements(tmp_path / "d.xlsx", names))
    assert (datum.time, datum.value, datum.place) == (86400.0, 100.5, "row 2")
    with pytest.raises(DataError, match=r"has no sheet 'x'\. It has: Sheet, growth"):
        read_measurements(tmp_path / "d.xlsx", "sheet=x")


@pytest.mark.parametrize(
    ("names", "where", "said"),
    [
        ("day=Day, radius=Rad um", "", "is 'Rad um', which data has no column for"),
        ("", "Line=a", "has no column 'Line'.*CellLine"),
        ("", "CellLine=c", "has no row with CellLine=c"),
        ('day="*", radius="*" um', "", "several columns side by side for day and radius"),
        ("day=Day, radius=CellLine*R um", "", "row 0, 'CellLine'.*is 'a', must be a number"),
        ("day=Day, radius=R um", "Day=9..", "has no row with Day=9.."),
    ],
)
def test_wrong_names_and_rows_are_refused(names, where, said):
    with pytest.raises(DataError, match=said):
        read_measurements(LONG, names, where)


def test_a_nan_in_a_table_without_names_is_refused():
    with pytest.raises(DataError, match="must be a finite number"):
        data_of({"time / h": ["1"], "diameter / um": ["nan"]})
