"""Units in titles of tables are those of the one list, at every door that reads a table."""

import pytest

import multicell as mc
from multicell.errors import DataError, OutputError, SceneError
from multicell.measured.columns import columns_of
from multicell.measured.table import read_measurements
from multicell.report.plots.section import Plane
from multicell.studies.axes import parse_axis
from multicell.tables.titles import read_title

QUESTION = "How many um is a pixel?"
WRONG = {
    "px": QUESTION, "pixels": QUESTION, "in": "radius_um", "pt": "radius_um", "kum": "'um'",
    "Mm": "'mm'", "d 3 h": "radius_um",
}  # fmt: skip


@pytest.mark.parametrize("unit", WRONG)
def test_titles_of_cells(unit):
    for title in (f"radius_{unit}", f"radius / {unit}", f"radius [{unit}]", f"radius ({unit})"):
        with pytest.raises(DataError) as caught:
            read_title(title, {"radius": "um"}, "cells.csv")
        assert WRONG[unit] in caught.value.hint
    assert read_title("radius_micron", {"radius": "um"}, "cells.csv").factor == 1.0
    assert read_title("volume_um3", {"volume": "um^3"}, "cells.csv").factor == 1.0


@pytest.mark.parametrize("unit", WRONG)
def test_a_table_of_cells_at_the_start(unit):
    with pytest.raises(DataError, match="must be one like um"):
        mc.run(mc.load_scene("growth"), cells={f"x_{unit}": [0.0], "y_um": [0.0], "z_um": [0.0]})


@pytest.mark.parametrize(
    ("title", "words"),
    [
        ("diameter / px", QUESTION), ("diameter / in", "unknown unit"),
        ("oxygen / M", "Did you mean '1 mM'"), ("diameter / um 2 nm", "cannot be read"),
    ],
)  # fmt: skip
def test_measured_data(title, words):
    table = read_measurements({"time / h": [1.0], title: [3.0]})
    with pytest.raises(DataError) as caught:
        columns_of(table, mc.load_scene("spheroid"))
    assert words in f"{caught.value.problem}. {caught.value.hint}"


def test_a_title_has_one_unit():
    """Of '2 days 3 h' only values may be made: a column has numbers of one unit."""
    table = read_measurements({"time / d 3 h": [1.0], "cells": [3.0]})
    with pytest.raises(DataError, match="must be a single one"):
        columns_of(table, mc.load_scene("spheroid"))
    for text in ("0,2 d 3 h", "1:2:3 d 3 h"):
        with pytest.raises(SceneError, match="must have a single one for all"):
            parse_axis("duration", text, mc.load_scene("spheroid"))
    axis = parse_axis("duration", "1 d 3 h, 2 d 6 h", mc.load_scene("spheroid"))
    assert axis.numbers == (97_200.0, 194_400.0)


def test_a_plane_and_a_time():
    with pytest.raises(OutputError, match=f"is no plane.*{QUESTION[:-1]}"):
        Plane.parse("z=12 px")
    scene = mc.load_scene("doublet").with_changes({"duration": "20 s", "coupling_step": "5 s"})
    result = mc.run(scene, threads=1)
    with pytest.raises(SceneError, match="Did you mean '3 min'"):
        result.at("3 miin")
    assert result.at("0 min 19 s").time == 20.0
