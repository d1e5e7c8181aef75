"""Measurements from files of other programs, made after their documentation."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

import multicell as mc
from multicell.errors import DataError
from multicell.measured.data import read_data
from multicell.measured.table import read_measurements

SCENE = mc.load_scene("growth")
DIAMETERS = {24: (200.0, 210.0), 48: (240.0, 250.0)}
"""Of two spheroids by hours, µm."""
ROWS = [
    (hours, well, d)
    for hours, pair in DIAMETERS.items()
    for well, d in zip(("A1", "A2"), pair, strict=True)
]


class Foreign(NamedTuple):
    """A table, what is said of its columns and rows, and what is read of it."""

    text: str
    columns: str = ""
    where: str = ""
    encoding: str = "utf-8"
    means: tuple[float, ...] = (205.0, 245.0)
    followed: bool = True  # whether wells are known again


def area(d):
    return math.pi * d**2 / 4.0


def volume(d):
    return math.pi * d**3 / 6.0


def table(head, row, between=",", above=""):
    """Return a table with a row for each spheroid and time, of hours, well and diameter."""
    rows = (between.join(map(str, row(*values))) for values in ROWS)
    return above + "\n".join([head, *rows]) + "\n"


def incucyte(between, well, metric="Largest Brightfield Object Area (µm²)", size=area):
    head = f"Vessel Name: Plate 7\nMetric: {metric}\nCell Type: WM983b\n\n"
    titles = between.join(["Date Time", "Elapsed", *(well.format(w) for w in ("A1", "A2"))])
    rows = [
        between.join([f"10/0{h // 24}/2026 10:04:00 AM", str(h), *[repr(size(d)) for d in pair]])
        for h, pair in DIAMETERS.items()
    ]
    return head + "\n".join([titles, *rows]) + "\n"


def german(text):
    return text.replace(",", ";").replace(".", ",")


WELLS = "24,200,210\n48,240,250\n"
FILES = {
    "Incucyte": Foreign(incucyte("\t", "{}"), encoding="utf-16"),
    "Incucyte, images": Foreign(incucyte("\t", "{}, Image 1")),
    "Incucyte, commas": Foreign(incucyte(",", "{} (1)")),
    "Incucyte, diameters": Foreign(
        incucyte("\t", "{}", "Largest Brightfield Object Diameter (µm)", float)
    ),
    "Incucyte, another metric": Foreign(
        incucyte("\t", "{}", "Spheroid Area"), 'hours=Elapsed, diameter="A?" um^2'
    ),
    "Prism": Foreign("Hours,Control,Control\n" + WELLS, 'hours=Hours, diameter="Control*" um'),
    "Prism, headings over replicates": Foreign(
        "Hours,Control,,Drug,\n24,200,210,1,2\n48,240,250,3,4\n",
        'hours=Hours, diameter="Control*" um',
    ),
    "ImageJ": Foreign(
        table(" ,Label,Area,Mean,Feret", lambda h, w, d: (1, f"{h:03}h-{w}.tif", area(d), 9, d)),
        "time=48 h, diameter=Area um^2",
        'Label="048h-A1.tif|048h-A2.tif"',
        means=(245.0,),
        followed=False,
    ),
    "ImageJ, a slice an hour": Foreign(
        table(" \tArea\tSlice", lambda h, w, d: (1, area(d) / 0.65**2, h), "\t"),
        "hours=Slice, diameter=Area pixel^2, pixel=0.65 um",
        followed=False,
    ),
    "SpheroidSizer": Foreign(
        table(
            "File Name,Major Axial Length (um),Minor Axial Length (um),Volume (mm^3),Day",
            lambda h, w, d: (f"{w}_{h}.tif", d, d, volume(d) / 1e9, h / 24),
        ),
        'day=Day, diameter="Volume (mm^3)"',
        followed=False,
    ),
    "AnaSP": Foreign(
        table(
            "Image_Name,Area,EquivalentDiameter,Solidity,Sphericity,Volume,Hour",
            lambda h, w, d: (f"{w}.tif", area(d), d, 1, 1, volume(d), h),
        ),
        "hours=Hour, diameter=EquivalentDiameter um",
        followed=False,
    ),
    "Celigo": Foreign(
        table(
            "Plate ID,Well,Day,Colony Count,Colony Total Area (µm²)",
            lambda h, w, d: ("P1", w, h // 24, 1, area(d)),
        ),
        'specimen=Well, day=Day, diameter="Colony Total Area (µm²)"',
    ),
    "Harmony": Foreign(
        table(
            "Row\tColumn\tTimepoint\tTime [h]\tSpheroids - Area [µm²] - Mean per Well",
            lambda h, w, d: (2, int(w[1]) + 2, h // 24, h, area(d)),
            "\t",
            "Database Name\tOpera\nEvaluation Signature\t12ab\nPlate Name\tP7\n\n[Data]\n",
        ),
        'time="Time [h]", specimen=Column, diameter="Spheroids - Area [µm²] - Mean per Well" um^2',
    ),
    "CellProfiler, images": Foreign(
        table(
            "ImageNumber,Metadata_Day,Metadata_Well,Mean_Spheroid_AreaShape_EquivalentDiameter",
            lambda h, w, d: (h, h / 24, w, d / 0.65),
        ),
        "day=Metadata_Day, specimen=Metadata_Well, pixel=0.65 um, "
        "diameter=Mean_Spheroid_AreaShape_EquivalentDiameter pixel",
    ),
    "Gen5": Foreign(
        "Software Version\t3.12\nPlate Number\tPlate 1\n\nTime\tA1\tA2\n"
        "24:00:00\t200\t210\n48:00:00\t240\t250\n",
        'time=Time, diameter="A?" um',
    ),
    "MetaXpress, German Excel": Foreign(
        german(
            table("Well Name,Zeit (h),Spheroid Diameter (µm)", lambda h, w, d: (w, h, d + 0.25))
        ),
        'specimen="Well Name", time="Zeit (h)", diameter="Spheroid Diameter (µm)"',
        encoding="cp1252",
        means=(205.25, 245.25),
    ),
    "R, write.csv": Foreign(
        table('"","line","well","t","d"', lambda h, w, d: (f'"{h}{w}"', '"x"', f'"{w}"', h, d)),
        "time=t h, diameter=d um, specimen=well",
        "line=x",
    ),
    "R, write.csv2": Foreign(
        german(table('"","well","t","d"', lambda h, w, d: (f'"{h}{w}"', f'"{w}"', h, d)))
        + '"9";"A3";48;NA\n',
        "time=t h, diameter=d um, specimen=well",
    ),
    "pandas": Foreign(
        table(",specimen,time_h,diameter_um", lambda h, w, d: (ROWS.index((h, w, d)), w, h, d))
    ),
    "MATLAB": Foreign(
        "Time_h,Diameter_1,Diameter_2\n" + WELLS, 'time=Time_h h, diameter="Diameter_*" um'
    ),
    "LibreOffice, with a mark": Foreign(
        table("Day;Well;Radius [µm]", lambda h, w, d: (h // 24, w, d / 2), ";"),
        'day=Day, specimen=Well, diameter="Radius [µm]" 2 um',
        encoding="utf-8-sig",
    ),
    "Google Sheets": Foreign(
        table("Day\tspecimen\tDiameter (µm)", lambda h, w, d: (h // 24, w, d), "\t")
    ),
    "tidy data": Foreign(
        table("Day,well,name,number", lambda h, w, d: (h // 24, w, "diameter", d))
        + "2,A1,cells,77\n",
        "day=Day, specimen=well, diameter=number um",
        "name=diameter",
    ),
    "ratios of radii": Foreign(
        table("CellLine,Day,R,ϕ", lambda h, w, d: ("983b", h / 24, 500.0, d / 1000)),
        "day=Day, diameter=φ*R 2 um",
        "CellLine=983b",
        followed=False,
    ),
    "minutes between bars": Foreign(
        table("well|min|size", lambda h, w, d: (w, 60 * h, d / 1000), "|"),
        "specimen=well, time=min min, diameter=size mm",
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_a_table_of_a_program_gives_the_means_of_its_spheroids(name, tmp_path):
    file = FILES[name]
    path = tmp_path / "d.csv"
    path.write_bytes(file.text.encode(file.encoding))
    found = read_data(read_measurements(path, file.columns, file.where), SCENE).data
    assert [datum.time for datum in found] == [86400.0, 172800.0][-len(file.means) :]
    assert {datum.observable for datum in found} == {"diameter"}
    np.testing.assert_allclose([datum.value for datum in found], file.means, rtol=1e-9)
    # specimens that were followed have a mean with an error; others count as replicates
    assert {math.isinf(datum.tissues) for datum in found} == {file.followed}


def test_there_are_files_of_a_dozen_programs():
    assert len({name.partition(",")[0] for name in FILES}) >= 12


@pytest.mark.parametrize(
    ("text", "columns", "said"),
    [
        ("Date,Diameter (um)\n2026-01-01 10:00,205\n", "", "titled 'day' or 'time / h'"),
        ("Hours,C,C\n24,1,2\n", "hours=Hours, diameter=C um", r"'C'.*several.*'\"C\*\" um'"),
        ("Hours,C,\n24,1,2\n", "hours=Hours, diameter=C um", "is the title of several columns"),
        ("Time,Diameter (um)\n24,205\n", "", "'Time'.*has no unit. Write 'Time / h'"),
        ("Time,Diameter (um)\n24:00,205\n25,210\n", "", "'Time'.*has no unit"),
        ("Hours,D\n24,205\n", "hours=Hours, diameter=D", "'diameter'.*has no unit"),
        ("Hours,D\n24,x\n", "hours=Hours, diameter=D um", "line 2.*is 'x', must be a number"),
        ("Hours,D\n24,-5\n", "hours=Hours, diameter=D um", "must not be negative"),
        ("Hours,D\n24,NA\n", "hours=Hours, diameter=D um", "holds no data"),
        ("Hours,D\n", "hours=Hours, diameter=D um", "holds no data"),
        ("", "", "holds no data"),
        ("Hours,D\n24,1.5;2\n", "hours=Hours, diameter=D kg", "kg"),
        (
            "Hours;D\n24;1.205,5\n",
            "hours=Hours, diameter=D um",
            "must be a number|decimal|thousands",
        ),
        ("Hours,D\n24,1,2\n", "hours=Hours, diameter=D um", "has 3 fields, the header has 2"),
    ],
)
def test_what_cannot_be_read_is_refused_with_what_to_write(text, columns, said, tmp_path):
    path = tmp_path / "d.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=said):
        read_data(read_measurements(path, columns), SCENE)
