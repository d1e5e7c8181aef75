"""Trajectories of Simularium, read back by its own package."""

from __future__ import annotations

import numpy as np
import pytest

import multicell as mc
from multicell.errors import OutputError

simulariumio = pytest.importorskip("simulariumio")


@pytest.fixture(scope="module")
def run():
    scene = mc.load_scene("growth").with_changes(
        {"duration": "6 h", "initial.count": 3, "growth.cycle_time": "3 h", "output.every": "2 h"}
    )
    return mc.run(scene)


def read_back(path):
    file = simulariumio.FileConverter(simulariumio.InputFileData(str(path)))
    return file._data


def test_cells_come_back_with_places_radii_times_and_names(run, tmp_path):
    (path,) = mc.export(run, tmp_path, format="simularium")
    data = read_back(path)
    agents = data.agent_data
    assert data.time_units.name == "s"
    assert data.spatial_units.name in ("um", "µm")
    np.testing.assert_allclose(agents.times, run.frames.times)
    for row, frame in enumerate(run.frames):
        n = len(frame.cells)
        assert agents.n_agents[row] == n
        np.testing.assert_array_equal(agents.unique_ids[row, :n], frame.cells.id)
        np.testing.assert_allclose(agents.positions[row, :n], frame.cells.position, rtol=1e-6)
        np.testing.assert_allclose(agents.radii[row, :n], frame.cells.radius, rtol=1e-6)
        assert set(agents.types[row]) == {"cell#proliferating"}
    assert len(run.frames[-1].cells) > 3


def test_one_frame_is_written_and_too_many_cells_are_refused(run, tmp_path, monkeypatch):
    (path,) = mc.export(run, tmp_path, format="simularium", frame=-1)
    assert len(read_back(path).agent_data.times) == 1
    monkeypatch.setattr("multicell.report.exports.simularium._LARGEST", 3)
    with pytest.raises(OutputError, match="too much for Simularium"):
        mc.export(run, tmp_path / "more", format="simularium")
