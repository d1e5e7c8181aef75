"""The example of a study runs, goes on, and its table is what the runs say."""

from pathlib import Path

import numpy as np
import pytest
from example_programs import is_picture, load

import multicell as mc

TWO_CELLS = {"duration": "18 h", "output.every": "6 h"}


@pytest.mark.slow
def test_a_study_of_twelve_runs(tmp_path: Path) -> None:
    study = load("study").main(tmp_path / "study", **TWO_CELLS)
    table = study.to_xarray()
    assert dict(table.sizes) == {"surface_energy": 3, "young": 2, "seed": 2, "time": 4}
    assert (table["state"] == "done").all()
    for run in study.runs:
        summary = mc.load_result(study.folder / "runs" / run.name).summary()
        found = table.sel(run.coordinates).isel(time=-1)
        assert found["packing_ratio"] == summary["packing_ratio"]
    # one seed has divided or not at all points alike: the cycle does not depend on what is varied
    cells = table["cells"].isel(time=-1).values
    np.testing.assert_array_equal(cells, np.broadcast_to(cells[:1, :1], cells.shape))
    assert is_picture(tmp_path / "study" / "map-diameter.png")
    again = study.run()
    assert all(outcome.reused for outcome in again)
