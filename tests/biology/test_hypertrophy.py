"""Cells that are held in a phase: they grow beyond the volume of division, or stop there."""

import numpy as np
import pytest

import multicell as mc
from multicell.cells import Phase
from multicell.errors import DataError
from multicell.report.explain.scene import explain
from multicell.scene.sizes import division_volume
from multicell.scene.start_checks import check_start_table
from multicell.scene.start_table import with_cells

DAY = 86400.0
PHASES = {"G1": {"duration": "15 h"}, "S": {"duration": "7 h"}, "G2": {"duration": "3 h"},
          "M": {"duration": "1 h", "grows": False}}  # fmt: skip
HOLD = {"hold": {"behaviour": "entry into S", "law": "constant", "largest": 0.0}}


def scene(law="linear", hold=True, **growth):
    if law == "relaxation":
        growth["parameters"] = {"target": 3.0}
    return mc.Scene.from_dict(
        {
            "duration": 10 * DAY,
            "coupling_step": 3600.0,
            "initial": {"count": 3},
            "growth": {"phases": PHASES, "law": law, **growth},
            "responses": HOLD if hold else {},
            "output": {"every": 2 * DAY},
        }
    )


def giants(result):
    notes = result.summary().get("notes", [])
    return [note for note in notes if "larger than at division" in note]


@pytest.fixture(scope="module")
def held():
    return mc.run(scene(), threads=1)


def test_held_cells_grow_linearly_beyond_division_with_a_note(held):
    """V' = V_b/T with T = 25 h of growth: 2.4 and 5.3 volumes of division after 4 and 10 d."""
    division = division_volume(held.scene)
    for frame in held.frames:
        assert (frame.cells.phase == Phase.G1).all()
        expected = 0.5 * division * (1.0 + frame.time / (25 * 3600.0))
        np.testing.assert_allclose(frame.cells.volume, expected, rtol=1e-9)
    (note,) = giants(held)
    assert "3 living cell(s)" in note
    assert "5.3 times" in note
    assert any("growth.hypertrophy = false" in n for n in explain(held.scene)["notes"])


@pytest.mark.parametrize("law", ["linear", "exponential", "relaxation"])
def test_without_hypertrophy_they_stop_at_the_volume_of_division(law):
    stopped = scene(law, hypertrophy=False)
    result = mc.run(stopped, threads=1)
    np.testing.assert_allclose(result.frames[-1].cells.volume, division_volume(stopped), rtol=1e-12)
    assert giants(result) == []
    assert not any("keep growing" in n for n in explain(stopped)["notes"])
    # released, they divide once at the end of M into cells of the usual size
    onward = mc.run(
        scene(law, hold=False, hypertrophy=False).with_changes({"duration": "36 h"}),
        cells=result.frames[-1].cells, threads=1,
    )  # fmt: skip
    assert onward.history["cells"][-1] >= 6


def test_cells_that_nothing_holds_are_as_before():
    free = scene(hold=False).with_changes({"duration": "3 d"})
    results = [
        mc.run(free.with_changes({"growth.hypertrophy": x}), threads=1) for x in (True, False)
    ]
    for one in results:
        assert giants(one) == []
    np.testing.assert_allclose(*(r.frames[-1].cells.volume for r in results), rtol=1e-12)


@pytest.mark.parametrize("number", range(6))
@pytest.mark.parametrize("hold", [True, False])
def test_any_frame_of_a_held_run_starts_the_next(held, number, hold, tmp_path):
    frame, onward = held.frames[number], scene(hold=hold).with_changes({"duration": "2 h"})
    again = mc.run(onward, cells=frame.cells, threads=1)
    first = again.frames[0].cells
    np.testing.assert_allclose(np.sort(first.volume), np.sort(frame.cells.volume), rtol=1e-12)
    assert (first.phase == Phase.G1).all()
    # and so does the table that an export writes
    file = tmp_path / "cells.csv"
    file.write_bytes(with_cells(onward, frame.cells).initial.cells.given.content())
    check_start_table(onward.with_changes({"initial.cells": str(file)}))


def test_a_slip_of_the_unit_is_still_refused():
    place = {"x_um": [0.0], "y_um": [0.0], "z_um": [0.0]}
    with pytest.raises(DataError, match="beyond the radius of a dividing cell"):
        mc.run(scene(), cells={**place, "radius_um": [50.0]})
    with pytest.raises(DataError, match="beyond the radius of a dividing cell"):
        mc.run(mc.load_scene("growth"), cells={**place, "radius_um": [50.0]})
