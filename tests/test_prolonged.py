"""Runs that end within a coupling step and are prolonged: no time is lost or counted twice."""

import numpy as np
import pytest

import multicell as mc

SCENE = mc.Scene.from_dict(
    {
        "duration": "25 min",
        "coupling_step": "10 min",
        "initial": {"count": 12, "stage": "uniform"},
        "growth": {"cycle_time": "3 d", "cycle_variation": 0},
        "drag": {"viscosity": "0.5 kPa s"},
        "output": {"every": "5 min"},
    }
)


@pytest.mark.parametrize(
    "ends", [["45 min"], ["26 min", "27 min", "52 min"], ["25.0001 min", "1 h"]]
)
def test_time_goes_on_where_it_stopped(ends, tmp_path):
    mc.run(SCENE, output=tmp_path / "run", report=False)
    for end in ends:
        result = mc.resume(tmp_path / "run", changes={"duration": end}, report=False)
    time = result.history["time"]
    last = result.scene.duration
    assert time[-1] == last
    assert (np.diff(time) > 0.0).all()
    assert np.diff(time).max() <= 600.0 * (1.0 + 1e-12)
    cells, start = result.frames[-1].cells, result.frames[0].cells
    # nobody divides: each has grown older, and larger, by just the time that has passed
    older = cells.age[np.argsort(cells.id)] - start.age[np.argsort(start.id)]
    np.testing.assert_allclose(older, last, rtol=1e-12)
    grown = cells.volume[np.argsort(cells.id)] - start.volume[np.argsort(start.id)]
    birth = 0.5 * 4.0 / 3.0 * np.pi * 5.0**3
    np.testing.assert_allclose(grown, birth * last / (3 * 86400.0), rtol=1e-9)


def test_a_prolonged_run_is_resumed_bit_for_bit(tmp_path):
    mc.run(SCENE, output=tmp_path / "run", report=False)
    whole = mc.resume(
        tmp_path / "run", changes={"duration": "55 min"}, output=tmp_path / "a", report=False
    )
    for frame in range(4, len(whole.frames) - 1):
        again = mc.resume(tmp_path / "a", frame, output=tmp_path / f"b{frame}", report=False)
        assert again.history["time"].tolist() == whole.history["time"].tolist()
        np.testing.assert_array_equal(
            again.frames[-1].cells.position, whole.frames[-1].cells.position
        )
