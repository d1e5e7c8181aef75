# ruff: noqa: E501 - tables of data and what is said of them stand on one line
"""Measured data: what is read of them, and what is refused before anything runs."""

from __future__ import annotations

import math
from functools import partial

import cheap_fits
import numpy as np
import pytest

import multicell as mc
from multicell.errors import DataError
from multicell.measured.data import read_data
from multicell.measured.observables import at_the_end, in_history

SCENE = mc.load_scene("spheroid")

TEXT = """# Growth of spheroids in two media, three of each
start / h, time / h, diameter / um, diameter sd / um, cells, cells sd / %, nutrients.oxygen.boundary / mM, label
102, 148, 272, 14, 1472, , 0.2, rich
102, 193, 370, 19.5, 4409, 20, 0.2, rich

102, 150, 0.26, , , , 0.07, poor
"""


read = partial(cheap_fits.read, scene=SCENE)


def test_numbers_come_in_base_units_with_times_conditions_and_deviations(tmp_path):
    measured = read(TEXT.replace("0.26,", "260,"), tmp_path)
    assert [d.observable for d in measured.data] == ["diameter", "cells"] * 2 + ["diameter"]
    assert [d.time for d in measured.data] == [46 * 3600.0] * 2 + [91 * 3600.0] * 2 + [48 * 3600.0]
    assert [d.sigma for d in measured.data] == [14.0, 0.1, 19.5, 0.2, 26.0]
    assert [d.log for d in measured.data] == [False, True, False, True, False]
    assert [d.assumed for d in measured.data] == [False, True, False, False, True]
    assert [d.place for d in measured.data[::2]] == ["line 3", "line 4", "line 6"]
    assert [c.label for c in measured.conditions] == ["rich", "poor"]
    assert [c.scene.nutrients["oxygen"].boundary for c in measured.conditions] == [0.2, 0.07]
    assert measured.numbers == {0: [0, 1, 2, 3], 1: [4]}
    assert measured.units == {"diameter": "um", "cells": ""}


def test_runs_end_with_their_data_before_the_scene_does_and_after_it(tmp_path):
    measured = read(TEXT, tmp_path)
    assert [c.scene.duration for c in measured.conditions] == [91 * 3600.0, 48 * 3600.0]
    later = read("time / d, cells\n400, 7\n", tmp_path)
    assert later.conditions[0].scene.duration == 400 * 86400.0
    at_end = read("time / h, cells\n5, 7\n, 8\n", tmp_path)
    assert at_end.conditions[0].scene.duration == SCENE.duration
    assert [d.time for d in at_end.data] == [5 * 3600.0, None]


def test_units_of_any_size_give_the_same_data(tmp_path):
    one = read("time / h, diameter / um\n24, 260\n", tmp_path)
    other = read("time / d, diameter / mm\n1, 0.26\n", tmp_path)
    assert one.data == other.data


def test_a_frame_and_a_mapping_say_the_same_as_a_file(tmp_path):
    pandas = pytest.importorskip("pandas")
    text = "time / h, diameter / um, cells, contact.law\n24, 260, 7, jkr\n48, , 9, jkr\n"
    from_file = read(text, tmp_path)
    columns = {
        "time / h": [24, 48], "diameter / um": [260.0, math.nan], "cells": [7, np.int64(9)],
        "contact.law": ["jkr", "jkr"],
    }  # fmt: skip
    for source in (columns, pandas.DataFrame(columns)):
        measured = read_data(source, SCENE)
        assert [(d.observable, d.value, d.time) for d in measured.data] == [
            (d.observable, d.value, d.time) for d in from_file.data
        ]
        assert [d.place for d in measured.data] == ["row 0", "row 0", "row 1"]
        assert measured.conditions[0].changes == {"contact.law": "jkr"}


def test_oxygen_may_be_a_pressure_as_in_scenes(tmp_path):
    text = "time / h, cells, nutrients.oxygen.boundary / mmHg\n5, 7, 38\n"
    boundary = read(text, tmp_path).conditions[0].scene.nutrients["oxygen"].boundary
    changed = SCENE.with_changes({"nutrients.oxygen.boundary": "38 mmHg"})
    assert boundary == changed.nutrients["oxygen"].boundary


def test_logarithms_are_compared_where_the_deviation_of_a_count_is_relative(tmp_path):
    measured = read("time / h, cells, cells sd, diameter / um\n5, 100, , 50\n6, 100, 8, 50\n", tmp_path)  # fmt: skip
    by_ratio, length, by_difference, _ = measured.data
    assert by_ratio.scaled(100.0 * math.e) - by_ratio.scaled(100.0) == pytest.approx(1.0)
    assert math.isnan(by_ratio.scaled(0.0))
    assert by_difference.scaled(0.0) == 0.0
    assert (by_ratio.sigma, by_difference.sigma, length.sigma) == (0.1, 8.0, 5.0)


REFUSED = {
    "time, cells\n5, 7\n": "growth.csv, 'time': has no unit. Write 'time / h'.",
    "time / h, diameter /\n5, 7\n": "'diameter /': has a '/' and no unit after it",
    "time / fortnites, cells\n5, 7\n": "with the unknown unit 'fortnites'",
    "time / h, diameters / um\n5, 7\n": "'diameters' is no observable and no key of the scene. Did you mean 'diameter'?",
    "time / h, hypoxic_radius_glucose / um\n5, 7\n": "growth.csv, 'hypoxic_radius_glucose / um': 'hypoxic_radius_glucose' is no observable of this scene. Did you mean 'hypoxic_radius_oxygen'?",
    "time / h, divisions\n5, 7\n": "line 2, 'divisions': 'divisions' is known at the end of a run only",
    "time / h, cells\n5, nan\n": "line 2, 'cells': is nan, must be a finite number",
    "time / h, cells\n5, -7\n": "line 2, 'cells': is -7, must not be negative",
    "time / h, cells\n5, 7\n6,\n": "growth.csv, line 3: has no measured value",
    "time / h\n5\n": "growth.csv: has no column of measured values. Observables of the scene: cells,",
    "time / h, cells, cells\n5, 7, 7\n": "'cells': says the same as 'cells'",
    "time / h, cells, cells sd\n5, 7, 0\n": "line 2, 'cells sd': is 0, must be above 0",
    "time / h, cells, diameter sd / um\n5, 7, 1\n": "'diameter sd / um': has no column 'diameter' beside it",
    "time / h, necrotic\n5, 0\n": "line 2, 'necrotic': is 0, of which a relative standard deviation says nothing. Add a column 'necrotic sd' with its unit.",
    "time / h, cells, cells n\n5, 7, 1.5\n": "line 2, 'cells n': is 1.5, must be a whole number of at least 1",
    "time / h, cells, cells sem, cells n\n5, 7, 1, 3\n": "line 2, 'cells': has both 'cells sem' and 'cells sd' or 'cells n'. The error of the mean stands in place of both.",
    "time / h, cells\n-1, 7\n": "line 2: was measured 1 h before the run begins",
    "time / h, cells\n0, 7\n": "line 2: is of the run's very start",
    "time / h, cells, nutrients.oxygen.boundary\n5, 7, 0.2\n": "growth.csv, 'nutrients.oxygen.boundary': has no unit. Write 'nutrients.oxygen.boundary / mM'.",
    "time / h, cells, nutrients.oxygen.boundary / mM\n5, 7,\n": "is empty: each row states all conditions",
}  # fmt: skip


def test_replicates_at_a_time_are_one_datum_of_several_tissues(tmp_path):
    text = "time / h, diameter / um, diameter sd / um\n5, 100, 4\n5, 106, 4\n5, 106, 4\n9, 200, 5\n"
    three, one = read(text, tmp_path).data
    assert (three.value, three.tissues, three.place) == (104.0, 3.0, "line 2 and 2 more")
    assert three.sigma == pytest.approx(4.0 / math.sqrt(3.0))
    assert (one.value, one.sigma, one.tissues) == (200.0, 5.0, 1.0)
    text = "time / h, diameter / um, diameter sd / um, diameter n\n5, 104, 4, 3\n"
    (mean,) = read(text, tmp_path).data
    assert (mean.value, mean.tissues) == (three.value, three.tissues)
    assert mean.sigma == pytest.approx(three.sigma)


def test_a_standard_error_of_the_mean_holds_the_scatter_of_tissues(tmp_path):
    text = "time / h, diameter / um, diameter sem / %\n5, 100, 4\n5, 200, 1\n"
    (datum,) = read(text, tmp_path).data
    # two means of which each says how sure it is: weights 1/16 and 1/4
    assert datum.value == pytest.approx(180.0)
    assert datum.sigma == pytest.approx(math.sqrt(1.0 / (1.0 / 16.0 + 1.0 / 4.0)))
    assert math.isinf(datum.tissues)


def test_a_core_that_has_not_begun_is_known_to_the_radius_of_a_cell(tmp_path):
    zero, later = read("time / h, necrotic_radius / um\n5, 0\n9, 40\n", tmp_path).data
    assert zero.sigma == SCENE.cells.division_radius
    assert later.sigma == 4.0


@pytest.mark.parametrize("text", REFUSED)
def test_what_cannot_be_used_is_named_with_row_and_column(text, tmp_path):
    with pytest.raises(DataError) as caught:
        read(text, tmp_path)
    assert REFUSED[text] in str(caught.value)
    assert caught.value.exit_code == 2


def test_data_beyond_the_cells_at_which_runs_stop_are_refused(tmp_path):
    with pytest.raises(DataError, match=r"line 3: has 24,000 cells, where runs end with 20,000"):
        read("time / h, cells\n5, 700\n300, 24000\n", tmp_path, scene=mc.load_scene("emt6"))


def test_files_that_cannot_be_read_are_named(tmp_path):
    with pytest.raises(DataError, match=r"nothing\.csv: does not exist"):
        read_data(tmp_path / "nothing.csv", SCENE)
    with pytest.raises(DataError, match="Is a directory"):
        read_data(tmp_path, SCENE)


def test_bad_options_are_named(tmp_path):
    with pytest.raises(DataError, match="sd: is 0, must be a relative"):
        read("time / h, cells\n5, 7\n", tmp_path, sd=0)


DRIVEN = mc.Scene.from_dict({
    "duration": "1 min", "coupling_step": "30 s", "initial": {"count": 3},
    "motions": {"tug": {"cells": [0], "velocity": [0.001, 0.0, 0.0]}},
})  # fmt: skip


def recorded_by(simulation):
    """Return the columns of the history that tell of tissue, not of the computation."""
    of_the_computation = "time", "step", "splitting_", "shift_", "stability_"
    return {c for c in simulation.history_row() if not c.startswith(of_the_computation)}


def test_only_what_has_a_sign_may_be_negative(tmp_path):
    scene = mc.load_scene("compression")
    measured = read("time / min, force_plate_z / nN\n1, -2.5\n", tmp_path, scene=scene)
    assert measured.data[0].value == -2.5
    with pytest.raises(DataError, match="largest_pressure"):
        read("time / min, largest_pressure / kPa\n1, -2.5\n", tmp_path, scene=scene)


FEW = ("driven", "doublet", "doublet-settle", "growth", "compression")
"""Scenes that are small, or need their cells."""


@pytest.mark.parametrize("name", [*FEW, "emt6", "sorting-signal", "spheroid", "treatment"])
def test_observables_of_a_scene_are_those_of_its_runs(name):
    """Columns that tell of the computation are no observables; all others are."""
    scene = DRIVEN if name == "driven" else mc.load_scene(name)
    small = {"initial.count": 12} if name not in FEW else {}
    simulation = mc.Simulation(scene.with_changes(small), threads=1)
    assert set(in_history(simulation.scene)) == recorded_by(simulation)
    summary = simulation.summary()
    for dotted in at_the_end(simulation.scene):
        entry = summary
        for part in dotted.split("."):
            # known only once all contacts have broken
            entry = entry.get(part, {}) if part != "separation" else {"time": 0.0, "force": 0.0}
        assert isinstance(entry, int | float)
